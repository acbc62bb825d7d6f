"""A robot erases a chalkboard: approach, touch, press, wipe, lift off.

The textbook's example of hybrid motion-force control, with k = 3 natural constraints.
Source: LynchPark2017 §11.6.1.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import polars as pl

from qpctrl.arrays import positive
from qpctrl.constraint import FaceOnPlane
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.space import TaskSpace
from scenarios.joint_level import JointLevel
from scenarios.metric import wiping_metrics
from scenarios.panel import Panel, board_panels
from scenarios.parameter import need_within
from scenarios.plant import SteppedPlant
from scenarios.plant_mujoco import MujocoPlant
from scenarios.plant_rigid import RigidPlant
from scenarios.report_energy import energy_panel
from scenarios.scenario import Criterion, Experiment, Options, Outcome
from scenarios.video.run import Scene, board_view
from scenarios.wiping import WipingGuide, WipingPlan
from scenarios.world import TOOL, Pad, World, build_world
from tasks import EnergyTask, ForceTask, MotionTask, PostureTask

SPACE = TaskSpace(TOOL)
DT = 1e-3  # s, the control period and the step of the plants


@dataclass(frozen=True, kw_only=True)
class Eraser:
    """Erase a chalkboard: press with a set force while wiping at a set speed."""

    name: ClassVar[str] = "eraser"
    summary: ClassVar[str] = "press a felt eraser on a chalkboard and wipe it, k = 3 constraints"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf)."""
    tool: str = "flange"
    """Frame of the robot that carries the eraser, z pointing away from the arm."""
    home: tuple[float, ...] | None = None
    """Start configuration [rad]; default: the file's keyframe."""
    plant: Literal["mujoco", "rigid"] = "mujoco"
    """MuJoCo contact, or an exact rigid and friction-free board."""
    force: float = 10.0
    """Force on the board [N]."""
    speed: float = 0.2
    """Wiping speed [m/s]."""
    duration: float = 8.0
    """Time spent wiping [s]."""
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
    k_i: float = 0.0
    """Integral gain of the motion task [1/s³]."""
    k_d: float = 80.0
    """Damping of the motion task [1/s]."""

    def __post_init__(self) -> None:
        for name in ("force", "speed", "duration"):
            positive(getattr(self, name), (), name)
        need_within(self, {"duration": (0.0, 3600.0, "s"), "speed": (0.0, 5.0, "m/s")})
        for name in ("friction", "force_noise", "k_fp", "k_fi", "damping", "k_p", "k_i", "k_d"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise InputError(f"{name}: got {value}, need a finite number >= 0")

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        world = self._world()
        joints = options.joints(world.robot, DT)
        robot, rigid = joints.robot, self.plant == "rigid"
        plan = WipingPlan(
            X_WE=world.X_WE,
            X_WT_home=robot.pose(robot.home, TOOL),
            force=self.force,
            speed=self.speed,
            duration=self.duration,
            dt=DT,
            damping=self.damping,
            start_on_board=rigid,
        )
        return Experiment(
            robot=robot,
            controller=options.controller(robot, self.modes(world), DT),
            plant=joints.drive(self._plant(world, joints, options.seed)),
            guide=WipingGuide(plan, lambda q: robot.pose(q, TOOL)),
            start_mode="contact" if rigid else "free",
            q_start=robot.home,
            horizon=plan.longest,
            geometry={"X_WE": world.X_WE.homogeneous, "loops": plan.loops.p},
        )

    def _world(self) -> World:
        pad = Pad(friction=self.friction)
        return build_world(self.robot, tool=self.tool, home=self.home, pad=pad, dt=DT)

    def modes(self, world: World) -> tuple[Mode, ...]:
        """Return the modes ``free`` and ``contact`` of the controller."""
        motion = MotionTask(space=SPACE, K_p=self.k_p, K_i=self.k_i, K_d=self.k_d)
        force = ForceTask(space=SPACE, K_fp=self.k_fp, K_fi=self.k_fi, damping=self.damping)
        watch, posture = EnergyTask(space=SPACE), PostureTask(q_ref=world.robot.home)
        board = FaceOnPlane(space=SPACE, R_WE=world.X_WE.rotation, name="board")
        return (
            Mode(name="free", tasks=(Weighted(motion), Weighted(watch), Weighted(posture))),
            Mode(
                name="contact",
                tasks=(Weighted(motion), Weighted(force), Weighted(posture)),
                constraints=(board,),
            ),
        )

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run, taken while wiping."""
        return wiping_metrics(table, self.force)

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics, all while wiping."""
        smooth = self.friction == 0 or self.plant == "rigid"
        limits = [
            ("force_rmse_N", 0.02 if smooth else 0.1, "N"),
            ("force_bias_abs_N", 0.02, "N"),
            ("position_rmse_mm", 0.02 if smooth else 0.2, "mm"),
            ("tilt_max_deg", 0.05, "deg"),
            ("touch_peak_ratio", 2.0, "× set-point"),
            ("contact_loss_fraction", 0.0, ""),
            ("fallback_ticks", 0.0, "ticks"),
            ("qp_law_gap_max", 1e-8, "× max |τ|"),
        ]
        return tuple(Criterion(name, metrics[name], limit, unit) for name, limit, unit in limits)

    def scene(self, outcome: Outcome) -> Scene:
        """Return robot and board."""
        world = self._world()
        view = board_view(world.X_WE)
        return Scene(model=world.model, view=view, forces={"wrench_meas": TOOL})

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return path, position error and force on the board, and the energy given to it."""
        table = outcome.table
        board = board_panels(outcome.summary, table, outcome.experiment.geometry)
        return (*board, energy_panel(table))

    def _plant(self, world: World, joints: JointLevel, seed: int) -> SteppedPlant:
        dt, armature = joints.dt, joints.armature
        if self.plant == "rigid":
            board = FaceOnPlane(space=SPACE, R_WE=world.X_WE.rotation, name="board")
            return RigidPlant(joints.robot, board, dt=dt, armature=armature)
        return MujocoPlant(world, force_noise=self.force_noise, seed=seed, dt=dt, armature=armature)
