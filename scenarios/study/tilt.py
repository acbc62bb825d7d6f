"""The study ``tilt``: an arm presses and slides on a plane whose normal it does not know.

A point of the tool (k = 1) is held by an exact rigid plane without friction. The controller
believes in a plane that is turned against it by a signed angle about the plane's x axis; it
presses along the believed normal, holds still, then slides along the believed y axis.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, Vector, finite_array, non_negative, positive
from qpctrl.constraint import PointOnPlane
from qpctrl.controller import Controller, Law
from qpctrl.errors import InputError, unknown_name
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from scenarios.guided import Stroke, ThereAndBack
from scenarios.metric import column, tick_metrics
from scenarios.panel import Panel
from scenarios.plant import PlantState
from scenarios.plant_rigid import RigidPlant
from scenarios.robot_file import load_robot
from scenarios.scenario import Criterion, Directive, Experiment, Options
from scenarios.simulation import simulate
from scenarios.study import tilt_panel
from scenarios.study.design import one_at_a_time, sobol
from scenarios.study.factor import Factor
from scenarios.study.rollout import (
    CLASS_MEASURES,
    FORCE_MEASURES,
    OutcomeClass,
    force_measures,
)
from scenarios.study.study import Measures
from scenarios.study.wrong_normal import ForceLaw, Held, held, mobility
from tasks import ForceReference, ForceTask, MotionReference, MotionTask, PostureTask

CONTROLLERS: dict[str, Law] = {"qp": "qp", "hybrid": "hybrid", "textbook": "textbook"}
"""What is sent to the joints, by name of the controller."""

ARMS = ("fr3", "ur5")
"""Robots of this package that can move along all six axes; a file's content is in no identity."""

FRAME, MODE, DT = "flange", "press", 1e-3
HOLD, SLIDE = 0.4, 0.6  # s, at rest and moving
PRESSED = 0.2  # s, from which on the force is judged
STEADY = 0.1  # s at the end, over which the speed is averaged
K_P, K_D = 2500.0, 100.0  # 1/s², 1/s, of the motion: settled within the hold
RAMP = 1e4  # N/s, the set-point is there at once
STEEPEST = 45.0  # deg
CLOSED_FORM_GAP = 1e-3  # relative, to the closed forms
NO_OFFSET = 1e-6  # m, what an offset is compared with where its closed form is smaller


class Sliding(NamedTuple):
    """Rests for `HOLD`, then sets off along y of E and is not stopped."""

    X_WE: pin.SE3
    """Believed plane; the tool starts in this pose."""
    force: float
    """Set-point along z of E [N]."""
    stroke: ThereAndBack

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the time is over."""
        t = state.time - HOLD
        if t >= SLIDE - DT / 2:
            return None
        stroke = self.stroke.at(t) if t >= 0 else Stroke(0.0, 0.0, 0.0)
        along = np.eye(6)[1]
        motion = MotionReference(
            X_WD=self.X_WE * pin.SE3(np.eye(3), stroke.s * along[:3]),
            V_des=stroke.s_dot * along,
            V_dot_des=stroke.s_ddot * along,
        )
        force = ForceReference(F_ref=self.force * np.eye(6)[2], F_meas=state.wrench_meas)
        phase = "hold" if t < 0 else "slide"
        return Directive(phase, MODE, {"motion": motion, "force": force})


@dataclass(frozen=True, kw_only=True)
class Tilt:
    """Tilt of a rigid plane that the controller does not know of."""

    name: ClassVar[str] = "tilt"
    summary: ClassVar[str] = "an arm presses and slides on a plane that is tilted unknown to it"
    measures: ClassVar[tuple[str, ...]] = (
        *("force_ratio", "force_ratio_closed", "force_gap", "force_gap_isotropic"),
        *("offset_mm", "offset_closed_mm", "offset_gap"),
        *("speed_m_s", "speed_closed_m_s", "speed_gap"),
        *(*FORCE_MEASURES, *CLASS_MEASURES, "qp_law_gap_max"),
    )

    shown: ClassVar[dict[str, str]] = {
        "force_ratio": "λ / f_d",
        "force_ratio_closed": "closed form",
        "force_gap": "gap",
        "offset_mm": "offset\nmm",
        "offset_closed_mm": "closed form\nmm",
        "offset_gap": "gap",
        "speed_m_s": "speed\nm/s",
        "speed_closed_m_s": "closed form\nm/s",
        "speed_gap": "gap",
    }

    low: float = -10.0
    """Smallest tilt [deg]."""
    high: float = 10.0
    """Largest tilt [deg]."""
    levels: int = 9
    """Tilts, equally spaced."""
    sobol: int | None = None
    """Size of a scrambled Sobol design, a power of two, instead of the levels."""
    controllers: tuple[str, ...] = ("qp", "textbook")
    """Side by side: qp, hybrid, textbook."""
    robot: str = "fr3"
    """fr3 or ur5."""
    force: float = 10.0
    """Set-point along the believed normal [N]."""
    speed: float = 0.1
    """Speed along the believed plane [m/s]."""
    k_fp: float = 0.5
    """Proportional force gain [1]."""
    k_fi: float = 100.0
    """Integral force gain [1/s]; 0 and k_fp 0 is feed-forward alone."""
    cutoff: float = 0.0
    """Cut-off [Hz] of the feed-forward of the wrench outside the believed normal; 0: none."""

    def __post_init__(self) -> None:
        for name in ("force", "speed"):
            positive(getattr(self, name), (), name)
        for name in ("k_fp", "k_fi", "cutoff"):
            non_negative(getattr(self, name), (), name)
        for name in ("low", "high"):
            if abs(float(finite_array(getattr(self, name), (), name))) > STEEPEST:
                got = getattr(self, name)
                raise InputError(f"{name}: got {got:g}, need -{STEEPEST:g} to {STEEPEST:g} deg")
        if not self.controllers or len(set(self.controllers)) < len(self.controllers):
            raise InputError(f"controllers: got {' '.join(self.controllers)!r}, need some, once")
        for name in self.controllers:
            if name not in CONTROLLERS:
                raise unknown_name("controller", name, CONTROLLERS)
        self.design(0)
        if self.robot not in ARMS:
            raise unknown_name("robot", self.robot, ARMS)

    @property
    def factors(self) -> tuple[Factor, ...]:
        """The signed tilt about x of the believed plane."""
        return (Factor("tilt", "deg", self.low, self.high),)

    def design(self, seed: int) -> Matrix:
        """Return the tilts (points × 1) [deg]."""
        if self.sobol is not None:
            return sobol(self.factors, self.sobol, seed)
        return one_at_a_time(self.factors, self.levels)

    def run(self, point: Mapping[str, float], controller: str, seed: int) -> Measures:
        """Return the measures of one rollout; no QP−law gap where every tick is saturated."""
        robot, tilt = _robot(self.robot), np.radians(point["tilt"])
        X_WE = robot.pose(robot.home, FRAME)
        X_WE_true = X_WE * pin.SE3(pin.utils.rotate("x", tilt), np.zeros(3))
        true = PointOnPlane(space=TaskSpace(FRAME), X_WE=X_WE_true)
        gains = (self.k_fp, self.k_fi, self.cutoff)
        experiment = Experiment(
            robot=robot,
            controller=_controller(self.robot, CONTROLLERS[controller], gains),
            plant=RigidPlant(robot, true, dt=DT),
            guide=Sliding(X_WE, self.force, ThereAndBack(far=2 * self.speed, speed=self.speed)),
            start_mode=MODE,
            q_start=robot.home,
            horizon=HOLD + SLIDE + 1.0,
            geometry={},
        )
        table = simulate(experiment)
        return self._measures(robot, table, X_WE.rotation, X_WE_true.rotation)

    def closed_form(self, robot: Robot, q: Vector, R_FE: Matrix, tilt: float) -> Held:
        """Return what is left at rest in ``q`` (nq), exactly.

        Args:
            robot: the arm.
            q: its configuration (nq) [rad].
            R_FE: believed plane in the tool frame.
            tilt: of the true plane about x of E [rad].
        """
        law = ForceLaw(self.force, self.k_fp, self.k_fi, K_P, outside=self.cutoff > 0)
        normals = np.array([[0, 0, 1.0], [0, -np.sin(tilt), np.cos(tilt)]]) @ R_FE.T
        A_b, A_t = np.hstack([normals, np.zeros((2, 3))])
        return held(mobility(robot, FRAME, q), A_b, A_t, law)

    def _measures(
        self, robot: Robot, table: pl.DataFrame, R_WE: Matrix, R_WE_true: Matrix
    ) -> Measures:
        n_b, n_t = R_WE[:, 2], R_WE_true[:, 2]
        cos, tilt = float(n_b @ n_t), float(np.arctan2(-n_t @ R_WE[:, 1], n_b @ n_t))
        lam = _force(table) @ n_t
        rest = int((table["phase"] == "hold").sum()) - 1
        q = np.array([table[f"q.{name}"][rest] for name in robot.joint_names])
        R_EF = R_WE.T @ robot.pose(q, FRAME).rotation
        closed = self.closed_form(robot, q, R_EF.T, tilt)
        X_e = np.array([table[f"motion.X_e.{i}"][rest] for i in range(3)])
        offset, wanted = float((R_EF @ X_e)[1]), float((R_EF @ closed.offset[:3])[1])
        ratio = float(lam[rest]) / self.force
        V = np.stack([column(table, f"motion.V.{i}") for i in range(3)], axis=1)
        steady = (column(table, "time") >= HOLD + SLIDE - STEADY - DT / 2).nonzero()[0]
        speed = float(np.linalg.norm(V[steady], axis=1).mean())
        judged = lam[round(PRESSED / DT) :]
        ticks = tick_metrics(table)
        return {
            "force_ratio": ratio,
            "force_ratio_closed": closed.force_ratio,
            "force_gap": abs(ratio / closed.force_ratio - 1),
            "force_gap_isotropic": abs(ratio * cos - 1),
            "offset_mm": 1e3 * offset,
            "offset_closed_mm": 1e3 * wanted,
            "offset_gap": abs(offset - wanted) / max(abs(wanted), NO_OFFSET),
            "speed_m_s": speed,
            "speed_closed_m_s": self.speed / cos,
            "speed_gap": abs(speed * cos / self.speed - 1),
            **force_measures(judged, self.force),
            "contact_lost_fraction": float((judged <= 0).mean()),
            **{name: ticks[name] for name in ("saturated_fraction", "fallback_ticks")},
            "qp_law_gap_max": None if table["saturated"].all() else ticks["qp_law_gap_max"],
        }

    def judge(self, table: pl.DataFrame) -> tuple[Criterion, ...]:
        """Return the study's own criteria: every rollout meets the closed forms."""
        limits = {
            "force_gap": (CLOSED_FORM_GAP, "relative"),
            "offset_gap": (CLOSED_FORM_GAP, "relative"),
            "speed_gap": (CLOSED_FORM_GAP, "relative"),
            "qp_law_gap_max": (1e-8, "× max |τ|"),
            "fallback_ticks": (0.0, "ticks"),
        }
        judged = [Criterion(name, _worst(table[name]), *of) for name, of in limits.items()]
        diverged = float((table["outcome"] == OutcomeClass.DIVERGED).sum())
        return (*judged, Criterion("rollouts_diverged", diverged, 0.0, "rollouts"))

    def panels(self, table: pl.DataFrame) -> tuple[Panel, ...]:
        """Return force, offset and speed against the signed tilt, with the closed forms."""
        robot = _robot(self.robot)
        fine = np.linspace(self.low, self.high, 241)
        forms = [self.closed_form(robot, robot.home, np.eye(3), x) for x in np.radians(fine)]
        curves = tilt_panel.Curves(
            tilt=fine,
            force=np.array([100 * (form.force_ratio - 1) for form in forms]),
            offset=np.array([1e3 * form.offset[1] for form in forms]),
            speed=100 * (1 / np.cos(np.radians(fine)) - 1),
        )
        return tilt_panel.tilt_panels(table, curves, self.speed)


def _worst(values: pl.Series) -> float:
    """Return the largest; NaN where a rollout has none, or there is no rollout."""
    return float("nan") if values.is_empty() or values.has_nulls() else float(values.max())  # type: ignore[arg-type]


def _force(table: pl.DataFrame) -> Matrix:
    """Return the force on the plane (ticks×3) [N] in the world."""
    F = np.stack([column(table, f"wrench.f{axis}") for axis in "xyz"], axis=1)
    columns = [column(table, f"motion.X_WF.{i}") for i in range(9)]  # of R_WF, one by one
    R_WF = np.stack(columns, axis=1).reshape(-1, 3, 3).transpose(0, 2, 1)
    return np.einsum("tij,tj->ti", R_WF, F)


@functools.lru_cache(maxsize=4)
def _robot(name: str) -> Robot:
    return load_robot(name)


@functools.lru_cache(maxsize=8)
def _controller(name: str, law: Law, gains: tuple[float, float, float]) -> Controller:
    """Return the controller that believes in the plane at home."""
    robot, space = _robot(name), TaskSpace(FRAME)
    K_fp, K_fi, cutoff = gains
    force = ForceTask(space=space, K_fp=K_fp, K_fi=K_fi, ramp=RAMP, cutoff=cutoff)
    tasks = (MotionTask(space=space, K_p=K_P, K_d=K_D), force, PostureTask(q_ref=robot.home))
    believed = PointOnPlane(space=space, X_WE=robot.pose(robot.home, FRAME))
    mode = Mode(name=MODE, tasks=tuple(Weighted(task) for task in tasks), constraints=(believed,))
    return Options(law=law, compiled="no").controller(robot, [mode], DT)
