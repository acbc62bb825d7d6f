"""Admittance control on a stiff wall, where it is expected to fail.

The reading of the force is late by sensor, filter and loop. On a wall of stiffness k_e the late
force turns the virtual damping negative: above a limit of k_e contact forces grow from tick to
tick. The limit is found twice, by bisection with the real controller on the plant and from the
eigenvalues of the sampled linear loop, and the growth above it is compared as well.
Source: LynchPark2017 §11.7: an admittance-controlled robot should meet an impedance.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pinocchio as pin
import polars as pl
from scipy.linalg import expm
from scipy.optimize import brentq

from qpctrl.arrays import Matrix, non_negative, positive
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Reference, Weighted
from scenarios.bisection import boundary
from scenarios.environment import Grip
from scenarios.force_sensor import ForceSensor, SensedPlant
from scenarios.metric import column, tick_metrics, whole_run_metrics
from scenarios.panel import Panel
from scenarios.plant import PlantState
from scenarios.plant_compliant import CompliantPlant
from scenarios.report_trace import Curve, curve_figure
from scenarios.scenario import Criterion, Directive, Experiment, Options, Outcome
from scenarios.simulation import simulate
from scenarios.slider import SPACE, slider
from tasks import AdmittanceReference, AdmittanceTask

DT = 1e-3  # s, the control period
TASK = "admittance"
OFFSET = 1e-4  # m, how far the wall is pressed in at the start
RUNAWAY = 1e4  # times the force at the start, where a run ends
TRIAL_TIME = 1.0  # s, of a run of the bisection
SEARCHED = (1e2, 1e6)  # N/m, where the limit is looked for
REST = pin.SE3.Identity()


class StiffWallGuide:
    """Holds the tool at rest, until the time is over or the force has run away."""

    def __init__(self, force: float, duration: float) -> None:
        self._end, self._duration = RUNAWAY * force, duration

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none at the end."""
        if state.time >= self._duration or abs(state.wrench[0]) > self._end:
            return None
        reading = AdmittanceReference(X_WD=REST, F_meas=state.wrench_meas[:1])
        references: dict[str, Reference] = {TASK: reading}
        return Directive("on the wall", TASK, references)


@dataclass(frozen=True, kw_only=True)
class StiffWall:
    """Hold a tool on a stiff wall under admittance control; it fails above a limit, as computed."""

    name: ClassVar[str] = "stiff_wall"
    summary: ClassVar[str] = "admittance control on a stiff wall: unstable above a known stiffness"

    times_limit: float = 1.5
    """Stiffness of the wall, in units of the computed limit [1]."""
    mass: float = 3.0
    """Mass of the tool itself [kg]."""
    virtual_mass: float = 1.0
    """Virtual mass [kg]."""
    damping: float = 40.0
    """Virtual damping [N s/m]."""
    stiffness: float = 100.0
    """Virtual stiffness [N/m]."""
    cutoff: float = 30.0
    """Cut-off of the filter on the reading [Hz]; 0 is no filter."""
    delay: int = 2
    """Age of the reading [ticks], beyond the one period of the loop."""
    duration: float = 1.0
    """Longest time of the run [s]."""

    def __post_init__(self) -> None:
        for name in ("times_limit", "mass", "virtual_mass", "damping", "duration"):
            positive(getattr(self, name), (), name)
        for name in ("stiffness", "cutoff"):
            non_negative(getattr(self, name), (), name)
        ForceSensor(delay=self.delay)
        if self.duration > 60.0:
            raise InputError(f"duration: got {self.duration}, need at most 60 s")

    def computed_limit(self) -> float:
        """Return the stiffness [N/m] at which an eigenvalue of the sampled loop has magnitude 1.

        Raises:
            InputError: the loop is stable, or unstable, over the whole range searched.
        """

        def margin(exponent: float) -> float:
            return float(np.log(spectral_radius(self.loop(10.0**exponent))))

        low, high = np.log10(SEARCHED)
        if not margin(low) < 0 < margin(high):
            raise InputError(
                f"stiff_wall: no limit between {SEARCHED[0]:g} and {SEARCHED[1]:g} N/m for these "
                "gains; change damping, cutoff or delay"
            )
        return float(10.0 ** brentq(margin, low, high, xtol=1e-9))

    def loop(self, k_e: float) -> Matrix:
        """Return the matrix of the sampled loop on a wall of stiffness ``k_e`` [N/m].

        The state: position, velocity, filtered force, and positions back to the oldest reading.
        """
        m, size = self.mass, 4 + self.delay
        held = expm(DT * np.array([[0, 1, 0], [-k_e / m, 0, 1 / m], [0, 0, 0]]))
        follow = 1 - np.exp(-2 * np.pi * self.cutoff * DT) if self.cutoff else 1.0
        force = np.zeros(size)
        force[2], force[-1] = 1 - follow, follow * k_e
        answer = np.zeros(size)
        answer[:2] = -self.stiffness, -self.damping
        tau = m * (answer - force) / self.virtual_mass + force
        loop = np.zeros((size, size))
        loop[:2, :2] = held[:2, :2]
        loop[:2] += np.outer(held[:2, 2], tau)
        loop[2], loop[3, 0] = force, 1.0
        loop[4:, 3:-1] = np.eye(self.delay)
        return loop

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        return self.on_wall(self.times_limit * self.computed_limit(), options)

    def on_wall(self, k_e: float, options: Options) -> Experiment:
        """Return the experiment on a wall of stiffness ``k_e`` [N/m]."""
        joints = options.joints(slider(self.mass), DT)
        robot = joints.robot
        task = AdmittanceTask(
            space=SPACE,
            M_v=self.virtual_mass,
            B_v=self.damping,
            K_v=self.stiffness,
            cutoff=self.cutoff,
        )
        controller = options.controller(robot, (Mode(name=TASK, tasks=(Weighted(task),)),), DT)
        wall = Grip(lambda t: (-OFFSET, 0.0), stiffness=k_e, damping=0.0)
        plant = joints.drive(
            CompliantPlant(robot, SPACE.frame, wall, dt=joints.dt, armature=joints.armature)
        )
        return Experiment(
            robot=robot,
            controller=controller,
            plant=SensedPlant(plant, ForceSensor(delay=self.delay), options.seed),
            guide=StiffWallGuide(k_e * OFFSET, self.duration),
            start_mode=TASK,
            q_start=robot.home,
            horizon=self.duration + 1.0,
            geometry={},
        )

    def found_limit(self) -> float:
        """Return the stiffness [N/m] above which the force grows in a run, by bisection."""
        trial = replace(self, duration=TRIAL_TIME)

        def calm(exponent: float) -> bool:
            table = simulate(trial.on_wall(10.0**exponent, Options()))
            return growth_rate(table) < 0

        middle = np.log10(self.computed_limit())
        return float(10.0 ** boundary(calm, middle - 0.5, middle + 0.5, 2e-3))

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return limit and growth, found and computed, and the usual."""
        computed, found = self.computed_limit(), self.found_limit()
        expected = float(np.log(spectral_radius(self.loop(self.times_limit * computed)))) / DT
        growth = growth_rate(table)
        return {
            "stiffness_limit_N_per_m": found,
            "stiffness_limit_gap": abs(found / computed - 1),
            "growth_per_s": growth,
            "growth_gap": abs(growth / expected - 1),
            **tick_metrics(table),
            **whole_run_metrics(table),
        }

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics: it fails where it must."""
        limits = [
            ("stiffness_limit_gap", 0.02, "× computed limit"),
            ("growth_gap", 0.05, "× computed growth"),
            ("fallback_ticks", 0.0, "ticks"),
            ("qp_law_gap_max", 1e-8, "× max |τ|"),
        ]
        return tuple(Criterion(name, metrics[name], limit, unit) for name, limit, unit in limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the force on the wall."""
        table, metrics = outcome.table, outcome.summary["metrics"]
        force = Curve("force on the wall", column(table, "wrench.fx"))
        late = (1 + self.delay) * DT + (1 / (2 * np.pi * self.cutoff) if self.cutoff else 0.0)
        words = (
            f"The wall is {self.times_limit:g} times as stiff as the limit of "
            f"{metrics['stiffness_limit_N_per_m']:.4g} N/m. The arm sees the force "
            f"{1e3 * late:.1f} ms late; a late spring force has a part that pushes along with the "
            "velocity; beyond the limit it outweighs the virtual damping, and every bounce is "
            "higher than the last. A softer wall, more damping, or a virtual mass as heavy as "
            "the tool's own cures it; a faster sensor moves the limit."
        )
        figure = curve_figure(table, "force", "N", [force])
        return (Panel("force", "Force on the wall", words, figure),)


def spectral_radius(loop: Matrix) -> float:
    """Return the largest magnitude of the eigenvalues [1]."""
    return float(np.abs(np.linalg.eigvals(loop)).max())


def growth_rate(table: pl.DataFrame) -> float:
    """Return the rate [1/s] at which the peaks of the speed grow, from the last half of them."""
    time, speed = column(table, "time"), np.abs(column(table, "v.x"))
    peaks = np.flatnonzero((speed[1:-1] > speed[:-2]) & (speed[1:-1] >= speed[2:])) + 1
    late = peaks[len(peaks) // 2 :]
    if len(late) < 3:
        return float("nan")
    return float(np.polyfit(time[late], np.log(speed[late]), 1)[0])
