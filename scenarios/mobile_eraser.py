"""A mobile arm wipes a board that is longer than the arm's reach, base and arm moving together.

Three natural constraints of the eraser's face on the board, ten driven joints. With the metric
``inertia`` the eraser is the only task space: closed forms exist, although the robot is redundant,
and the base follows in the null space. With ``home`` the base has a task of its own.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, get_args

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Vector, non_negative, positive
from qpctrl.constraint import FaceOnPlane
from qpctrl.errors import InputError, unknown_name
from qpctrl.mode import Metric, Mode
from qpctrl.objective import Weighted
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from qpctrl.status import Status
from scenarios.metric import column, wiping_metrics
from scenarios.panel import Panel
from scenarios.parameter import need_within
from scenarios.path import advancing_loops
from scenarios.plant_mujoco import MujocoPlant
from scenarios.scenario import Criterion, Experiment, Options, Outcome
from scenarios.torque_step import torque_metrics
from scenarios.video.run import Scene
from scenarios.video.take import View
from scenarios.whole_body.mobile_guide import BasePlan, MobileGuide
from scenarios.whole_body.mobile_metric import (
    ACTS,
    acting_limits,
    centre_margin,
    joint_margins,
    limit_use,
    progress,
)
from scenarios.whole_body.mobile_panel import mobile_panels
from scenarios.whole_body.mobile_world import BASE, BOARD_LEFT, CARRIAGE, mobile_world
from scenarios.wiping import WipingGuide, WipingPlan
from scenarios.world import TOOL, Pad, World
from tasks import EnergyTask, ForceTask, MotionTask, PostureTask

SPACE = TaskSpace(TOOL)
ROOM = {
    "speed": (1e-3, 5.0, "m/s"),
    "radius": (1e-3, 0.2, "m"),
    "length": (0.01, np.inf, "m"),  # the board says where it ends
    "force": (0.1, 1000.0, "N"),
    "friction": (0.0, 10.0, ""),
}
BASE_SPACE = TaskSpace(CARRIAGE, ("vx", "vy", "wz"))
DT = 1e-3  # s, the control period and the step of the plant
EDGE_ROOM = 0.03  # m, from the middle of the pad to the edge of the board at least
STIFFNESS, DAMPING = 20.0, 9.0  # 1/s² and 1/s, of the posture
RAMP_RATE = 4.0  # 1/s, share of the set-point by which it is ramped: felt gives way slowly
NEAR = 0.01  # m from its reference, within which the eraser wipes where it shall
OF_SOLVED = ("position_rmse_mm", "orientation_rmse_deg", "tilt_max_deg")
"""Metrics of ticks with a solution; the others are counted as ``fallback_ticks``."""
LIMITS = {
    "force_rmse_share": (0.03, "× set-point"),
    "force_bias_abs_N": (0.02, "N"),
    "position_rmse_mm": (0.5, "mm"),
    "tilt_max_deg": (0.05, "deg"),
    "touch_peak_ratio": (2.0, "× set-point"),
    "contact_loss_fraction": (0.0, ""),
    "wiped_length_missing_m": (0.01, "m"),
    "torque_step_max_share": (0.5, "× limit"),
    "position_use_max_share": (1.0, "× limit"),
    "speed_use_max_share": (1.0, "× limit"),
    "kkt_residual_max": (1e-8, ""),
    "fallback_ticks": (0.0, "ticks"),
}


@dataclass(frozen=True, kw_only=True)
class MobileEraser:
    """Wipe a long board with an arm on a base, which presses with a set force as it drives."""

    name: ClassVar[str] = "mobile_eraser"
    summary: ClassVar[str] = "wipe a board longer than the arm's reach, base and arm together"

    metric: Metric = "inertia"
    """inertia: one task space, and closed forms; home: a task of its own for the base."""
    fixed_base: bool = False
    """Whether the base is bolted to the ground."""
    force: float = 10.0
    """Force on the board [N]."""
    speed: float = 0.25
    """Wiping speed along the path [m/s]."""
    length: float = 2.0
    """Way along the board [m]."""
    radius: float = 0.08
    """Radius of the circles that are wiped on the way [m]."""
    friction: float = 0.3
    """Coulomb friction between pad and board [1]."""
    force_noise: float = 0.0
    """Standard deviation of the measured force [N]."""
    k_fp: float = 0.5
    """Proportional force gain [1]."""
    k_fi: float = 20.0
    """Integral force gain [1/s]."""
    damping: float = 20.0
    """Velocity damping of the force directions [1/s]."""
    k_p: float = 1600.0
    """Stiffness of the motion task [1/s²]."""
    k_d: float = 80.0
    """Damping of the motion task [1/s]."""
    base_weight: float = 0.1
    """Weight of the task of the base, beside 1 of the eraser; metric ``home`` alone."""
    posture_weight: float = 1e-3
    """Weight of the posture; metric ``home`` alone."""

    def __post_init__(self) -> None:
        if self.metric not in get_args(Metric):
            raise unknown_name("metric", self.metric, get_args(Metric))
        for name in ("force", "speed", "length", "radius", "base_weight", "posture_weight"):
            positive(getattr(self, name), (), name)
        for name in ("friction", "force_noise", "k_fp", "k_fi", "damping", "k_p", "k_d"):
            non_negative(getattr(self, name), (), name)
        need_within(self, ROOM)
        room = BOARD_LEFT - EDGE_ROOM - self.radius
        if self.length > room:
            raise InputError(f"length: got {self.length}, need at most {room:g} m: the board ends")

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        world = self._world()
        joints = options.joints(world.robot, DT)
        robot = joints.robot
        path = advancing_loops(self.speed, self.length, DT, radius=self.radius)
        plan = WipingPlan(
            X_WE=world.X_WE,
            X_WT_home=robot.pose(robot.home, TOOL),
            force=self.force,
            speed=self.speed,
            duration=(len(path.p) - 1) * DT,
            dt=DT,
            damping=self.damping,
            path=path,
        )

        def pose(q: Vector) -> pin.SE3:
            return robot.pose(q, TOOL)

        base = BasePlan(
            pose=lambda q: robot.pose(q, CARRIAGE),
            q_home=robot.home,
            length=self.length,
            duration=plan.duration,
            dt=DT,
            along=None if self.fixed_base else robot.joint_names.index(BASE[1]),
            lead=DAMPING / STIFFNESS,
        )
        return Experiment(
            robot=robot,
            controller=options.controller(robot, self.modes(world), DT),
            plant=joints.drive(
                MujocoPlant(
                    world,
                    force_noise=self.force_noise,
                    seed=options.seed,
                    dt=joints.dt,
                    armature=joints.armature,
                )
            ),
            guide=MobileGuide(
                WipingGuide(plan, pose),
                base,
                pose,
                lift=plan.tracks["lift"],
                base_task=self._base_task,
            ),
            start_mode="free",
            q_start=robot.home,
            horizon=plan.longest,
            geometry={"X_WE": world.X_WE.homogeneous, "loops": plan.loops.p},
        )

    def modes(self, world: World) -> tuple[Mode, ...]:
        """Return the modes ``free`` and ``contact`` of the controller."""
        motion = Weighted(MotionTask(space=SPACE, K_p=self.k_p, K_d=self.k_d))
        force = ForceTask(
            space=SPACE,
            K_fp=self.k_fp,
            K_fi=self.k_fi,
            damping=self.damping,
            ramp=RAMP_RATE * self.force,
        )
        rest = self._rest(world.robot)
        board = FaceOnPlane(space=SPACE, R_WE=world.X_WE.rotation, name="board")
        watch = EnergyTask(space=SPACE)
        return (
            Mode(name="free", tasks=(motion, Weighted(watch), *rest), metric=self.metric),
            Mode(
                name="contact",
                tasks=(motion, Weighted(force), *rest),
                constraints=(board,),
                metric=self.metric,
            ),
        )

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run, taken while wiping.

        Torque steps, use of limits and the KKT residual are those of the whole run.
        """
        robot, wipe = self._world().robot, table.filter(pl.col("phase") == "wipe")
        limits = robot.limits
        solved = table.filter(pl.col("status") == Status.OK.name)
        metrics = wiping_metrics(table, self.force)
        metrics |= {name: wiping_metrics(solved, self.force)[name] for name in OF_SOLVED}
        residuals = column(solved, "kkt_residual")  # of the whole run
        metrics["kkt_residual_max"] = float(residuals.max(initial=0.0))
        metrics["force_rmse_share"] = metrics["force_rmse_N"] / self.force
        metrics |= progress(wipe, NEAR)
        metrics["wiped_length_missing_m"] = max(0.0, self.length - metrics["wiped_length_m"])
        metrics |= (
            torque_metrics(table, robot) | limit_use(table, limits) | joint_margins(table, limits)
        )
        if not wipe.is_empty():
            metrics["cop_margin_min_mm"] = centre_margin(wipe)
        return metrics | acting_limits(wipe, DT)

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria; no limit may act while wiping."""
        limits = dict(LIMITS)
        if self.metric == "inertia":
            limits["qp_law_gap_max"] = (1e-8, "× max |τ|")
        limits |= {name: (0.0, "s") for name in metrics if name.startswith(ACTS)}
        return tuple(
            Criterion(name, metrics[name], limit, unit) for name, (limit, unit) in limits.items()
        )

    def scene(self, outcome: Outcome) -> Scene:
        """Return robot and board, seen from behind the robot."""
        world = self._world()
        x, y, z = world.X_WE.translation
        middle = (x - 0.3, y + self.length / 2, 0.7 * z)
        view = View(azimuth=25.0, elevation=-25.0, distance=3.2, lookat=middle)
        return Scene(model=world.model, view=view, forces={"wrench_meas": TOOL})

    def events(self, table: pl.DataFrame) -> tuple[str, ...]:
        """Return in words for how long each limit acted while wiping, the first to act first."""
        acted = acting_limits(table.filter(pl.col("phase") == "wipe"), DT)
        return tuple(f"{name.removeprefix(ACTS)}: {time:.3f} s" for name, time in acted.items())

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the path on the board, the base from above, force, and what limits leave."""
        return mobile_panels(outcome)

    @property
    def _base_task(self) -> bool:
        return self.metric == "home" and not self.fixed_base

    def _world(self) -> World:
        return mobile_world(pad=Pad(friction=self.friction), fixed_base=self.fixed_base, dt=DT)

    def _rest(self, robot: Robot) -> tuple[Weighted, ...]:
        """Return what is done with the freedom that the eraser leaves."""
        weight, pull = self.posture_weight if self.metric == "home" else 1.0, np.ones(robot.nq)
        if self._base_task:
            pull[[robot.joint_names.index(name) for name in BASE]] = 0.0
        posture = PostureTask(q_ref=robot.home, K_p=STIFFNESS * pull, K_d=DAMPING * pull)
        base = MotionTask(space=BASE_SPACE, K_p=100.0, K_d=20.0, name="base")
        bases = (Weighted(base, self.base_weight),) if self._base_task else ()
        return *bases, Weighted(posture, weight)
