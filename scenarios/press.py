"""A tool tied to springs in every direction: pure force control, k = 6.

Source: LynchPark2017 §11.5. A payload that the controller's gravity model lacks acts as a
constant force error w: feed-forward keeps it, P divides it by 1 + K_fp, PI removes it at the
rate K_fi / (1 + K_fp), for springs that are stiff against that rate.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, Vector, Wrench, finite_array, positive
from qpctrl.constraint import Pfaffian
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Reference, Weighted
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from scenarios.environment import Springs
from scenarios.metric import tick_metrics, whole_run_metrics
from scenarios.panel import Panel
from scenarios.plant import PlantState
from scenarios.plant_compliant import CompliantPlant
from scenarios.record import WRENCH
from scenarios.report_trace import wrench_figure
from scenarios.robot_file import load_robot
from scenarios.scenario import Criterion, Directive, Experiment, Options, Outcome
from tasks import ForceReference, ForceTask, MotionReference, MotionTask, PostureTask

DT = 1e-3  # s, the control period
GAINS = {"feedforward": (0.0, 0.0, 0.0), "pi": (0.5, 2.0, 0.0), "pi-damping": (0.5, 2.0, 20.0)}
"""K_fp [1], K_fi [1/s] and damping [1/s] of each law."""
SETTLE_TIME = 2.0  # s without set-point, in which the gravity error decays
FIT = (0.3, 1.8)  # s, window of the fitted decay: after the springs, before the floor
SMALLEST_SINGULAR = 0.01  # of the Jacobian at home
PHASE_WORDS = (
    "While settling the set-point is zero: what is left is the payload that the model lacks. "
    "Below: measured − set-point."
)
FINAL = 0.2  # s at the end over which the steady error is averaged


@dataclass(frozen=True, kw_only=True, eq=False)
class PressGuide:
    """Holds no wrench while the gravity error settles, then presses."""

    X_WD: pin.SE3
    """Pose of the tool at the start; no direction is left in which to follow it."""
    force: Wrench
    """Set-point (6) [N, Nm]."""
    duration: float
    """Time spent pressing [s]."""

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the time is over."""
        if state.time >= SETTLE_TIME + self.duration:
            return None
        pressing = state.time >= SETTLE_TIME
        F_ref = self.force if pressing else np.zeros(6)
        references: dict[str, Reference] = {
            "motion": MotionReference(X_WD=self.X_WD),
            "force": ForceReference(F_ref=F_ref, F_meas=state.wrench_meas),
        }
        return Directive("press" if pressing else "settle", "tied", references)


@dataclass(frozen=True, kw_only=True)
class Press:
    """Press with a set wrench against springs in every direction."""

    name: ClassVar[str] = "press"
    summary: ClassVar[str] = "press on springs that resist every motion, k = 6 constraints"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf)."""
    tool: str = "flange"
    """Frame of the robot that is tied to the springs."""
    home: tuple[float, ...] | None = None
    """Start configuration [rad]; default: the file's keyframe."""
    feedback: Literal["feedforward", "pi", "pi-damping"] = "pi-damping"
    """Law of force; it sets the gains that are not given."""
    k_fp: float | None = None
    """Proportional force gain [1]."""
    k_fi: float | None = None
    """Integral force gain [1/s]."""
    damping: float | None = None
    """Velocity damping [1/s]."""
    force: tuple[float, ...] = (5.0, -3.0, 10.0, 0.3, -0.2, 0.1)
    """Set-point (6) [N, Nm] on the environment, in the tool frame."""
    duration: float = 4.0
    """Time spent pressing [s], after the time to settle."""
    payload_error: float = 0.5
    """Mass at the tool [kg] that the controller's gravity model lacks."""
    stiffness: float = 1e5
    """Linear stiffness of the springs [N/m]."""
    stiffness_rot: float = 1e4
    """Rotational stiffness of the springs [Nm/rad]."""
    spring_damping: float = 800.0
    """Linear damping of the springs [N s/m]."""
    spring_damping_rot: float = 40.0
    """Rotational damping of the springs [Nm s/rad]."""

    def __post_init__(self) -> None:
        for name in ("duration", "stiffness", "stiffness_rot"):
            positive(getattr(self, name), (), name)
        if not 0.3 <= self.duration <= 3600.0:
            raise InputError(f"duration: got {self.duration}, need 0.3 to 3600 s")
        if self.feedback not in GAINS:
            raise InputError(f"feedback: got {self.feedback!r}, need one of {', '.join(GAINS)}")
        optional = [name for name in ("k_fp", "k_fi", "damping") if getattr(self, name) is not None]
        for name in ("payload_error", "spring_damping", "spring_damping_rot", *optional):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"{name}: got {value}, need a finite number >= 0")
        if len(self.force) != 6:
            raise InputError(f"force: got {len(self.force)} numbers, need 6 (N, N, N, Nm, Nm, Nm)")
        finite_array(np.array(self.force), (6,), "force")

    @property
    def gains(self) -> tuple[float, float, float]:
        """K_fp [1], K_fi [1/s] and damping [1/s]: those given, else those of the law."""
        given = (self.k_fp, self.k_fi, self.damping)
        p, i, d = (
            x if x is not None else y for x, y in zip(given, GAINS[self.feedback], strict=True)
        )
        return p, i, d

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        joints = options.joints(load_robot(self.robot, self.home), DT)
        robot = joints.robot
        _check_reach(robot, self.tool)
        springs = Springs(
            np.repeat([self.stiffness, self.stiffness_rot], 3),
            np.repeat([self.spring_damping, self.spring_damping_rot], 3),
        )
        plant = CompliantPlant(
            robot,
            self.tool,
            springs,
            payload=self.payload_error,
            dt=joints.dt,
            armature=joints.armature,
        )
        controller = options.controller(robot, (self.mode(robot),), DT)
        X_WD = robot.pose(robot.home, self.tool)
        return Experiment(
            robot=robot,
            controller=controller,
            plant=joints.drive(plant),
            guide=PressGuide(X_WD=X_WD, force=np.array(self.force), duration=self.duration),
            start_mode="tied",
            q_start=robot.home,
            horizon=SETTLE_TIME + self.duration + 1.0,
            geometry={},
        )

    def mode(self, robot: Robot) -> Mode:
        """Return the mode ``tied``: every direction is a force direction."""
        space = TaskSpace(self.tool)
        p, i, d = self.gains
        tasks = (
            MotionTask(space=space, K_p=0.0, K_d=0.0),  # P = 0: it is there for the closed form
            ForceTask(space=space, K_fp=p, K_fi=i, damping=d),
            PostureTask(q_ref=robot.home),
        )
        springs = Pfaffian(space=space, A=np.eye(6), name="springs")
        weighted = tuple(Weighted(task) for task in tasks)
        return Mode(name="tied", tasks=weighted, constraints=(springs,))

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run: forces while pressing, the decay while settling."""
        robot, (p, i, _) = load_robot(self.robot, self.home), self.gains
        end = table.filter(pl.col("time") >= SETTLE_TIME + self.duration - FINAL)
        steady = _error(end).mean(axis=0)
        w = gravity_error(robot, _stack(end, [f"q.{j}" for j in robot.joint_names])[-1], self)
        final = (SETTLE_TIME + self.duration) * i / (1 + p)
        expected = w / (1 + p) * (np.exp(-final) if i > 0 else 1.0)
        size = max(float(np.linalg.norm(w)), float(np.linalg.norm(self.force)), 1e-3)
        error = _error(table.filter(pl.col("phase") == "press"))[:, :3]
        w_home = gravity_error(robot, robot.home, self)
        rate = decay_rate(table, w_home) if i > 0 and self.payload_error > 0 else float("nan")
        return {
            "force_rmse_N": float(np.sqrt((error**2).sum(axis=1).mean())),
            "steady_error_N": float(np.linalg.norm(steady[:3])),
            "steady_error_gap": float(np.linalg.norm(steady - expected) / size),
            "decay_rate_per_s": rate,
            "decay_rate_gap": abs(rate * (1 + p) / i - 1) if i > 0 else float("nan"),
            **tick_metrics(table),
            **whole_run_metrics(table),
        }

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = [
            ("steady_error_gap", 0.01, "× set-point"),
            ("fallback_ticks", 0.0, "ticks"),
            ("qp_law_gap_max", 1e-8, "× max |τ|"),
        ]
        if self.gains[1] > 0 and self.payload_error > 0:
            limits.insert(1, ("decay_rate_gap", 0.02, "relative"))
        return tuple(Criterion(name, metrics[name], limit, unit) for name, limit, unit in limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return forces and moments against their set-points."""
        table, words = outcome.table, f"Law: {self.feedback}. {PHASE_WORDS}"
        return (
            Panel("force", "Force on the springs", words, wrench_figure(table, slice(0, 3))),
            Panel("moment", "Moment on the springs", words, wrench_figure(table, slice(3, 6))),
        )


def gravity_error(robot: Robot, q: Vector, scenario: Press) -> Wrench:
    """Return the weight (6) [N, Nm] of the unknown payload in the tool frame at ``q`` (nq)."""
    R_WT = robot.pose(q, scenario.tool).rotation
    force = scenario.payload_error * R_WT.T @ robot.model.gravity.linear
    return np.concatenate([force, np.zeros(3)])


def decay_rate(table: pl.DataFrame, w: Wrench) -> float:
    """Return the rate [1/s] at which the error along ``w`` (6) decays in the window `FIT`."""
    window = table.filter(pl.col("time").is_between(*FIT))
    along = _error(window) @ w
    if len(along) < 2 or not (along > 0).all():
        return float("nan")
    return -float(np.polyfit(window["time"].to_numpy(), np.log(along), 1)[0])


def _check_reach(robot: Robot, frame: str) -> None:
    """Refuse a home from which the robot cannot press in every direction."""
    local, tool = pin.ReferenceFrame.LOCAL, robot.frame_id(frame)
    J = pin.computeFrameJacobian(robot.model, robot.model.createData(), robot.home, tool, local)
    smallest = float(np.linalg.svd(J, compute_uv=False)[-1])
    if robot.nv < 6 or smallest < SMALLEST_SINGULAR:
        raise InputError(
            f"robot {robot.name!r}: cannot press in all six directions from home "
            f"{np.round(robot.home, 3).tolist()} ({robot.nv} joints, smallest singular value "
            f"{smallest:.3g}, need {SMALLEST_SINGULAR}); give another robot or --home"
        )


def _error(table: pl.DataFrame) -> Matrix:
    measured = _stack(table, [f"wrench_meas.{axis}" for axis in WRENCH])
    return measured - _stack(table, [f"force.F_des.{i}" for i in range(6)])


def _stack(table: pl.DataFrame, names: list[str]) -> Matrix:
    return table.select(names).to_numpy().astype(np.float64)
