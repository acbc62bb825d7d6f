"""A tool led along its constraint by a rigid environment: what doors, cranks and balls share.

The environment is exact and free of friction (`RigidPlant`), so what is left of a force or
position error is the controller's own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, Twist, Vector, Wrench
from qpctrl.constraint import Constraint
from qpctrl.controller import Controller
from qpctrl.mode import Mode
from qpctrl.objective import Reference, Weighted
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from scenarios.metric import column, largest_norm, rms_norm, tick_metrics, whole_run_metrics
from scenarios.path import glide
from scenarios.plant import PlantState
from scenarios.plant_rigid import RigidPlant
from scenarios.robot_file import load_robot
from scenarios.scenario import Criterion, Directive, Experiment, Options, criteria
from tasks import ForceReference, ForceTask, MotionReference, MotionTask, PostureTask

FLANGE = TaskSpace("flange")
DT = 1e-3  # s, the control period and the step of the plant
PRESS_TIME = 0.5  # s, to ramp the force at rest
MODE = "guided"


class Stroke(NamedTuple):
    """Where the reference is along its path, and how fast it goes."""

    s: float
    """Coordinate [rad or m]."""
    s_dot: float
    s_ddot: float


@dataclass(frozen=True, kw_only=True)
class ThereAndBack:
    """From 0 to ``far`` and back, at constant speed between smooth starts and stops."""

    far: float
    """Coordinate of the turning point [rad or m]."""
    speed: float
    """Speed between the ramps [rad/s or m/s]."""

    @property
    def ramp(self) -> float:
        """Time of each start and stop [s]: 0.4 s, or what a short way leaves."""
        return min(0.4, self.far / self.speed)

    @property
    def half(self) -> float:
        """Time from 0 to the turning point [s]."""
        return self.far / self.speed + self.ramp

    def at(self, t: float) -> Stroke:
        """Return coordinate, velocity and acceleration at ``t`` [s]."""
        forth, back = self._one_way(t), self._one_way(t - self.half)
        return Stroke(*(a - b for a, b in zip(forth, back, strict=True)))

    def _one_way(self, t: float) -> Stroke:
        t, T, ramp = min(max(t, 0.0), self.half), self.half, self.ramp
        rise, fall = glide(t, ramp), glide(t - (T - ramp), ramp)
        rising, falling = _area(t, ramp), _area(t - (T - ramp), ramp)
        return Stroke(
            self.speed * (rising - falling),
            self.speed * (rise.s - fall.s),
            self.speed * (rise.s_dot - fall.s_dot),
        )


def _area(t: float, ramp: float) -> float:
    """Return the integral of `glide` from 0 to ``t``."""
    if t <= 0.0:
        return 0.0
    x = min(t / ramp, 1.0)
    return ramp * x**4 * (2.5 - 3 * x + x * x) + max(t - ramp, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class TwistPath:
    """A pose that moves along one fixed twist ξ: X_WD = exp(s ξ) X_W0."""

    X_W0: pin.SE3
    """Pose at s = 0."""
    xi_W: Twist
    """Spatial twist in the world (6) for ṡ = 1."""

    def reference(self, stroke: Stroke) -> MotionReference:
        """Return pose, body twist and its derivative; ξ is the same in every pose on the way."""
        X_WD = pin.exp6(stroke.s * self.xi_W) * self.X_W0
        xi = self.X_W0.toActionMatrixInverse() @ self.xi_W
        return MotionReference(X_WD=X_WD, V_des=stroke.s_dot * xi, V_dot_des=stroke.s_ddot * xi)


@dataclass(frozen=True, kw_only=True, eq=False)
class CirclePath:
    """A circle that is travelled without turning: the tool keeps the axes of E."""

    X_WE: pin.SE3
    """Frame at the centre of the circle."""
    radius: float
    """Radius [m]."""
    start: tuple[float, float, float]
    """Direction in E from the centre to where s = 0 [1]."""
    side: tuple[float, float, float]
    """Direction in E of the motion there [1]; s is the angle [rad]."""

    def outward(self, s: float) -> Vector:
        """Return the direction (3) from the centre to the tool, in E."""
        return np.cos(s) * np.array(self.start) + np.sin(s) * np.array(self.side)

    def reference(self, stroke: Stroke) -> MotionReference:
        """Return pose, body twist and its derivative."""
        out, along = self.outward(stroke.s), self.outward(stroke.s + np.pi / 2)
        V, V_dot = np.zeros(6), np.zeros(6)
        V[:3] = self.radius * stroke.s_dot * along
        V_dot[:3] = self.radius * (stroke.s_ddot * along - stroke.s_dot**2 * out)
        X_WD = pin.SE3(self.X_WE.rotation, self.X_WE.act(self.radius * out))
        return MotionReference(X_WD=X_WD, V_des=V, V_dot_des=V_dot)

    def radial(self, force: float) -> Callable[[Stroke], Wrench]:
        """Return the wrench of a ``force`` [N] away from the centre, as it turns with s."""
        return lambda stroke: np.concatenate([force * self.outward(stroke.s), np.zeros(3)])


class Scenery(NamedTuple):
    """The plane in which the tool moves, for a picture of the run."""

    X_WE: pin.SE3
    """Frame of the environment."""
    plane: tuple[int, int]
    """Axes of E that are drawn to the right and up."""
    outline: Matrix = np.zeros((0, 2))
    """The environment itself (samples×2) [m] in that plane."""


def arc(radius: float, start: float = 0.0, end: float = 2 * np.pi) -> Matrix:
    """Return points (samples×2) [m] on a circle about the origin, between two angles [rad]."""
    angle = np.linspace(start, end, 181)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Guidance:
    """How the reference runs, and the wrench that is held meanwhile."""

    stroke: ThereAndBack
    reference: Callable[[Stroke], MotionReference]
    wrench: Callable[[Stroke], Wrench]
    """Set-point on the environment (6) [N, Nm] in the tool frame."""
    scenery: "Scenery"
    """Where it happens, for the picture."""


class GuidedJob:
    """Phases ``press`` (at rest, the force ramps up) and ``move``."""

    def __init__(self, guidance: Guidance) -> None:
        self._guidance = guidance

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the tool is back."""
        t, plan = state.time - PRESS_TIME, self._guidance
        if t >= 2 * plan.stroke.half:
            return None
        stroke = plan.stroke.at(t)
        force = ForceReference(F_ref=plan.wrench(stroke), F_meas=state.wrench_meas)
        references: dict[str, Reference] = {"motion": plan.reference(stroke), "force": force}
        return Directive("press" if t < 0 else "move", MODE, references)


class Gains(NamedTuple):
    """Gains of a guided job, in the order motion, force."""

    K_p: float = 400.0
    K_d: float = 40.0
    K_fp: float = 0.5
    K_fi: float = 20.0
    damping: float = 20.0


def arm_at_home(robot: str) -> tuple[Robot, pin.SE3]:
    """Return the robot and the pose of its flange at home."""
    arm = load_robot(robot)
    return arm, arm.pose(arm.home, FLANGE.frame)


def guided_controller(robot: Robot, constraint: Constraint, options: Options) -> Controller:
    """Return the controller of a tool on ``constraint``, with the one mode `MODE`."""
    gains = Gains()
    tasks = (
        Weighted(MotionTask(space=FLANGE, K_p=gains.K_p, K_d=gains.K_d)),
        Weighted(ForceTask(space=FLANGE, K_fp=gains.K_fp, K_fi=gains.K_fi, damping=gains.damping)),
        Weighted(PostureTask(q_ref=robot.home)),
    )
    return options.controller(robot, [Mode(name=MODE, tasks=tasks, constraints=(constraint,))], DT)


def guided_experiment(
    robot: Robot, constraint: Constraint, guidance: Guidance, options: Options
) -> Experiment:
    """Return the experiment of a tool on ``constraint``, which the controller knows exactly."""
    joints = options.joints(robot, DT)
    plant = RigidPlant(joints.robot, constraint, dt=joints.dt, armature=joints.armature)
    return Experiment(
        robot=joints.robot,
        controller=guided_controller(joints.robot, constraint, options),
        plant=joints.drive(plant),
        guide=GuidedJob(guidance),
        start_mode=MODE,
        q_start=robot.home,
        horizon=PRESS_TIME + 2 * guidance.stroke.half + 1.0,
        geometry={
            "X_WE": guidance.scenery.X_WE.homogeneous,
            "plane": np.array(guidance.scenery.plane, dtype=np.float64),
            "outline": guidance.scenery.outline,
            "reference": _sampled(guidance),
        },
    )


def _sampled(guidance: Guidance) -> Matrix:
    """Return points (samples×3) [m] of the reference on its way out, in the world."""
    times = np.linspace(0.0, guidance.stroke.half, 200)
    poses = [guidance.reference(guidance.stroke.at(float(t))).X_WD for t in times]
    return np.array([X_WD.translation for X_WD in poses])


def guided_metrics(table: pl.DataFrame) -> dict[str, float]:
    """Return the metrics of a guided job, taken while it moves."""
    move = table.filter(pl.col("phase") == "move")
    if move.is_empty():
        return {}
    meas = np.stack([column(move, f"wrench_meas.{axis}") for axis in _WRENCH], axis=1)
    wanted = np.stack([column(move, f"force.F_des.{i}") for i in range(6)], axis=1)
    pose = np.stack([column(move, f"motion.X_e.{i}") for i in range(6)], axis=1)
    error = meas - wanted
    return {
        "force_rmse_N": rms_norm(error[:, :3]),
        "force_error_share": rms_norm(error[:, :3]) / max(rms_norm(wanted[:, :3]), 1e-12),
        "moment_rmse_Nm": rms_norm(error[:, 3:]),
        "force_peak_N": largest_norm(meas[:, :3]),
        "position_rmse_mm": 1e3 * rms_norm(pose[:, :3]),
        "orientation_rmse_deg": float(np.degrees(rms_norm(pose[:, 3:]))),
        **tick_metrics(move),
        **whole_run_metrics(table),
    }


def guided_criteria(
    metrics: Mapping[str, float], limits: Mapping[str, tuple[float, str]]
) -> tuple[Criterion, ...]:
    """Return the scenario's own ``limits`` (value and unit by metric), and those of every job."""
    every = {"qp_law_gap_max": (1e-8, "× max |τ|"), "fallback_ticks": (0.0, "ticks")}
    return criteria(metrics, {**limits, **every})


def axis_frame(origin: Vector, z: Vector, x: Vector) -> pin.SE3:
    """Return the frame at ``origin`` (3) [m] with its z axis along ``z`` and x nearest to ``x``."""
    z = z / np.linalg.norm(z)
    x = x - z * (z @ x)
    x = x / np.linalg.norm(x)
    return pin.SE3(np.column_stack([x, np.cross(z, x), z]), origin)


_WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
