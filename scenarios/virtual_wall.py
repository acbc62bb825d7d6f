"""A stiff virtual wall, felt through an interface with quantised encoders.

The wall is a spring that is computed once a period T and held: late by T/2 on average, it gives
back more energy than it took, as a damper of −K T / 2 would. Only friction of the interface itself
makes up for it: the wall is passive iff b > K T / 2. The limit is found by bisection: a hand
moves the interface to and fro inside the wall, and the energy it gets back is summed up.
Source: Colgate1997.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Vector, positive
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Reference, Weighted
from scenarios.bisection import boundary
from scenarios.encoder import EncodedPlant
from scenarios.environment import Grip
from scenarios.metric import column, tick_metrics, whole_run_metrics
from scenarios.panel import Panel
from scenarios.plant import Plant, PlantState
from scenarios.plant_compliant import CompliantPlant
from scenarios.report_trace import Curve, curve_figure
from scenarios.scenario import Criterion, Directive, Experiment, Options, Outcome
from scenarios.simulation import simulate
from scenarios.slider import SPACE, slider
from tasks import ImpedanceReference, ImpedanceTask

DT = 1e-3  # s, the control period T
TASK = "wall"
FREQUENCY = 5.0  # Hz, of the hand
SETTLE_CYCLES = 2  # of the hand, before energy is summed up
COUNTED_CYCLES = 3
GRIP = (2e4, 60.0)  # N/m and N s/m of the hand's grip
REST = pin.SE3.Identity()


class EnergyMeter:
    """A compliant plant that notes the energy given to its environment after every period.

    Attributes:
        energy: ∫ Fᵀ V dt [J], one number a period.
    """

    def __init__(self, plant: Plant, interface: CompliantPlant) -> None:
        """Watch ``plant``, which is ``interface`` moved by its drives or not."""
        self._plant, self._interface = plant, interface
        self.energy: list[float] = []

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq)."""
        self.energy = []
        return self._plant.reset(q)

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period."""
        state = self._plant.step(tau)
        self.energy.append(self._interface.energy)
        return state


@dataclass(frozen=True, kw_only=True, eq=False)
class VirtualWallGuide:
    """Renders the wall where the interface is behind its face, and nothing before it."""

    K: float
    duration: float

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the time is over."""
        if state.time >= self.duration:
            return None
        inside = state.q[0] > 0.0
        K_v = np.array([[self.K if inside else 0.0]])
        references: dict[str, Reference] = {TASK: ImpedanceReference(X_WD=REST, gains={"K_v": K_v})}
        return Directive("in the wall" if inside else "free", TASK, references)


@dataclass(frozen=True, kw_only=True)
class VirtualWall:
    """Move a haptic interface into a stiff virtual wall: passive iff its friction b > K T / 2."""

    name: ClassVar[str] = "virtual_wall"
    summary: ClassVar[str] = "a stiff virtual wall with quantised encoders: passive iff b > KT/2"

    stiffness: float = 4000.0
    """Stiffness K of the wall [N/m]."""
    mass: float = 0.5
    """Moving mass of the interface [kg]."""
    times_limit: float = 1.3
    """Friction of the interface, in units of K T / 2 [1]."""
    resolution: float = 1e-5
    """Resolution of the encoder [m]."""
    amplitude: float = 5e-3
    """How far the hand moves to and fro [m]."""
    duration: float = 2.0
    """Time of the run [s]."""

    def __post_init__(self) -> None:
        for name in (*("stiffness", "mass", "times_limit", "resolution", "amplitude", "duration"),):
            positive(getattr(self, name), (), name)
        if self.amplitude < 50 * self.resolution:
            raise InputError(
                f"amplitude: got {self.amplitude} m, need at least 50 encoder counts, "
                f"{50 * self.resolution:g} m"
            )
        if not 2 / FREQUENCY <= self.duration <= 60.0:
            raise InputError(f"duration: got {self.duration}, need {2 / FREQUENCY:g} to 60 s")

    @property
    def limit(self) -> float:
        """K T / 2 [N s/m]."""
        return self.stiffness * DT / 2

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment: the hand moves into the wall and out of it."""
        friction = self.times_limit * self.limit
        return self._felt(friction, 0.0, self.duration, options)[0]

    def _felt(
        self, friction: float, depth: float, duration: float, options: Options
    ) -> tuple[Experiment, "EnergyMeter"]:
        """Return the experiment with ``friction`` [N s/m], the hand moving about ``depth`` [m]."""
        joints = options.joints(slider(self.mass), DT)
        robot = joints.robot
        task = ImpedanceTask(space=SPACE, K_v=0.0, B_v=0.0, name=TASK)
        controller = options.controller(robot, (Mode(name=TASK, tasks=(Weighted(task),)),), DT)
        omega = 2 * np.pi * FREQUENCY

        def hand(time: float) -> tuple[float, float]:
            phase = omega * time
            swing, rate = self.amplitude * np.sin(phase), self.amplitude * omega * np.cos(phase)
            return depth + float(swing), float(rate)

        grip = Grip(hand, stiffness=GRIP[0], damping=GRIP[1])
        interface = CompliantPlant(
            robot,
            SPACE.frame,
            grip,
            joint_damping=friction,
            dt=joints.dt,
            armature=joints.armature,
        )
        meter = EnergyMeter(joints.drive(interface), interface)
        experiment = Experiment(
            robot=robot,
            controller=controller,
            plant=EncodedPlant(meter, self.resolution, DT),
            guide=VirtualWallGuide(K=self.stiffness, duration=duration),
            start_mode=TASK,
            q_start=np.array([depth]),
            horizon=duration + 1.0,
            geometry={},
        )
        return experiment, meter

    def energy_to_hand(self, friction: float) -> float:
        """Return the energy [J] that the hand gains in `COUNTED_CYCLES` inside the wall.

        Args:
            friction: viscous friction of the interface [N s/m].
        """
        cycle = round(1 / FREQUENCY / DT)
        start, end = SETTLE_CYCLES * cycle, (SETTLE_CYCLES + COUNTED_CYCLES) * cycle
        inside, meter = self._felt(friction, 2 * self.amplitude, (end + 1) * DT, Options())
        simulate(inside)
        return meter.energy[end - 1] - meter.energy[start - 1]

    def found_limit(self) -> float:
        """Return the friction [N s/m] below which the hand gains energy, by bisection."""
        low, high = 0.5 * self.limit, 1.5 * self.limit
        return boundary(lambda b: self.energy_to_hand(b) > 0, low, high, 4e-3 * self.limit)

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the passivity limit, found and computed, and the energy of the run."""
        found = self.found_limit()
        force, x = column(table, "wrench.fx"), column(table, "q.x")
        given = force[2:] * (x[2:] - x[:-2]) / 2  # a force is one period old
        return {
            "passivity_limit_Ns_per_m": found,
            "passivity_limit_gap": abs(found / self.limit - 1),
            "energy_to_hand_J": float(given.sum()),
            "wall_force_max_N": float(np.abs(force).max()),
            **tick_metrics(table),
            **whole_run_metrics(table),
        }

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = [
            ("passivity_limit_gap", 0.01, "× K T / 2"),
            ("energy_to_hand_J", -1e-9, "J"),
            ("fallback_ticks", 0.0, "ticks"),
            ("qp_law_gap_max", 1e-8, "× max |τ|"),
        ]
        return tuple(Criterion(name, metrics[name], limit, unit) for name, limit, unit in limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return force and position over time."""
        table, metrics = outcome.table, outcome.summary["metrics"]
        found = metrics["passivity_limit_Ns_per_m"]
        words = (
            "The wall is felt at positions above 0. The interface's friction is "
            f"{self.times_limit:g} times K T / 2 = {self.limit:g} N s/m; below {found:.4g} N s/m, "
            "found by bisection, the wall gives the hand more energy than it takes."
        )
        x = Curve("position", 1e3 * column(table, "q.x"))
        force = Curve("force on the hand", column(table, "wrench.fx"))
        return (
            Panel("force", "Force on the hand", words, curve_figure(table, "force", "N", [force])),
            Panel(
                "place",
                "Position",
                "As the encoder reads it.",
                curve_figure(table, "position", "mm", [x]),
            ),
        )
