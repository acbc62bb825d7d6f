"""The force loop on a rigid wall: it settles below its critical gain, which theory knows.

One mass presses on a wall; the force that is fed back is some ticks old. The critical gains are
found by bisection with the real controller and compared with their closed forms.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import non_negative, positive
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Reference, Weighted
from scenarios import report_style as style
from scenarios.critical_gain import CASES, DT, MODE, SPACE, WALL, critical_gain, one_mass
from scenarios.force_sensor import ForceSensor, SensedPlant
from scenarios.metric import column, tick_metrics, whole_run_metrics
from scenarios.panel import Panel
from scenarios.plant import PlantState
from scenarios.plant_rigid import RigidPlant
from scenarios.report_style import Figure, trace
from scenarios.report_trace import Curve, curve_figure
from scenarios.scenario import Criterion, Directive, Experiment, Options, Outcome
from tasks import ForceReference, ForceTask, MotionReference, MotionTask

LONGEST = 50  # ticks of delay in the run that is shown

AGREEMENT = 0.01
"""Relative: the bisection stops at 0.25 %, a short run sees growth of a fraction of 1 %."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceLoopGuide:
    """Asks for a step of the force at time 0."""

    force: float
    duration: float

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the time is over."""
        if state.time >= self.duration:
            return None
        F_ref = np.array([self.force, 0.0])
        references: dict[str, Reference] = {
            "motion": MotionReference(X_WD=pin.SE3.Identity()),
            "force": ForceReference(F_ref=F_ref, F_meas=state.wrench_meas[:2]),
        }
        return Directive("press", MODE, references)


@dataclass(frozen=True, kw_only=True)
class ForceLoop:
    """Press on a rigid wall with feedback of a late force, below the critical gain and at it."""

    name: ClassVar[str] = "force_loop"
    summary: ClassVar[str] = "critical gains of the force loop, found and computed"

    delay: int = 3
    """Age of the measured force [ticks] in the run that is shown."""
    share: float = 0.5
    """Integral gain of that run, in units of the critical one [1]."""
    force: float = 10.0
    """Set-point of that run [N]."""
    duration: float = 0.2
    """Time of that run [s]."""

    def __post_init__(self) -> None:
        for name in ("force", "duration"):
            positive(getattr(self, name), (), name)
        non_negative(self.share, (), "share")
        if not 1 <= self.delay <= LONGEST:
            raise InputError(f"delay: got {self.delay}, need 1 to {LONGEST} ticks")
        if self.duration > 60.0:
            raise InputError(f"duration: got {self.duration}, need at most 60 s")

    @property
    def k_fi(self) -> float:
        """Integral gain of the run that is shown [1/s]."""
        return float(self.share * 2 * np.sin(np.pi / (2 * (2 * self.delay - 1))) / DT)

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        joints = options.joints(one_mass(), DT)
        robot = joints.robot
        force = ForceTask(space=SPACE, K_fi=self.k_fi, integral_max=1e9, ramp=1e9)
        tasks = (Weighted(MotionTask(space=SPACE)), Weighted(force))
        controller = options.controller(
            robot, (Mode(name=MODE, tasks=tasks, constraints=(WALL,)),), DT
        )
        sensor = ForceSensor(delay=self.delay - 1)
        plant = joints.drive(RigidPlant(robot, WALL, dt=joints.dt, armature=joints.armature))
        return Experiment(
            robot=robot,
            controller=controller,
            plant=SensedPlant(plant, sensor, options.seed),
            guide=ForceLoopGuide(force=self.force, duration=self.duration),
            start_mode=MODE,
            q_start=robot.home,
            horizon=self.duration + 1.0,
            geometry={},
        )

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return each critical gain as a share of its closed form, and how the run ends."""
        found = {
            f"critical gain: {case.words}": critical_gain(
                case.gain, delay=case.delay, k_fp=case.k_fp
            )
            / case.closed_form
            for case in CASES
        }
        final = column(table, "wrench.fx")[-10:]
        return {
            "critical_gain_gap_max": max(abs(share - 1) for share in found.values()),
            "final_error_share": float(np.abs(final - self.force).max()) / self.force,
            **found,
            **tick_metrics(table),
            **whole_run_metrics(table),
        }

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = [
            ("critical_gain_gap_max", AGREEMENT, "× closed form"),
            ("final_error_share", 0.01, "× set-point"),
            ("fallback_ticks", 0.0, "ticks"),
            ("qp_law_gap_max", 1e-8, "× max |τ|"),
        ]
        return tuple(Criterion(name, metrics[name], limit, unit) for name, limit, unit in limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the critical gains over their closed forms, and the force of the run."""
        metrics, table = outcome.summary["metrics"], outcome.table
        words = (
            "P: K_fp = 1 at any delay. PI at one tick: κ = K_fi T = 2 (1 − K_fp). "
            "I at d ticks: κ = 2 sin(π / (2 (2d − 1)))."
        )
        force = [
            Curve("measured, late", column(table, "wrench_meas.fx")),
            Curve("true", column(table, "wrench.fx")),
            Curve("set-point", column(table, "force.F_des.0"), dashed=True),
        ]
        said = f"Integral gain at {self.share:g} of the critical one, {self.delay} ticks of delay."
        return (
            Panel("gains", "Critical gains", words, _gain_figure(metrics)),
            Panel("force", "Force on the wall", said, curve_figure(table, "force", "N", force)),
        )


def _gain_figure(metrics: Mapping[str, float]) -> Figure:
    """Return found over closed form for each case, against the delay or gain in words."""
    place = np.arange(len(CASES), dtype=np.float64)
    exact = np.array([case.closed_form for case in CASES])
    found = exact * np.array([metrics[f"critical gain: {case.words}"] for case in CASES])
    dots = {"mode": "markers", "marker": {"color": style.SERIES[1], "size": 9}}
    bars = {"mode": "markers", "marker": {"color": style.INK, "size": 22, "symbol": "line-ew-open"}}
    figure = style.figure(
        [
            trace(place, exact, "closed form", hovertemplate="%{y:.4f}", **bars),
            trace(place, found, "found by bisection", hovertemplate="%{y:.4f}", **dots),
        ],
        "",
        "critical K_fp or κ [1]",
        height=420,
    )
    labels = {"tickvals": place.tolist(), "ticktext": [case.words for case in CASES]}
    figure["layout"]["xaxis"] |= labels
    return figure
