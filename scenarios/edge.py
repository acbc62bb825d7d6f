"""An eraser that tips over its long edge while it presses: contact changes k = 3 → 2 → 3.

Flat on the board it is a face (three rows). The centre of pressure moves to the edge, the face
becomes an edge (two rows) about which the tool tips and comes back; once the face is felt again
it takes the pressure back to its middle. Every mode uses the frame at the edge.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix, Vector, non_negative, positive
from qpctrl.constraint import EdgeOnPlane, FaceOnPlane
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.space import TaskSpace
from scenarios.metric import column, rms, tick_metrics, whole_run_metrics
from scenarios.panel import Panel, step_panel
from scenarios.plant_mujoco import MujocoPlant
from scenarios.report_trace import Curve, curve_figure
from scenarios.robot_file import load_robot
from scenarios.scenario import Criterion, Experiment, Options, Outcome
from scenarios.tipping import (
    CLEARANCE,
    FACE,
    FEEL_ANGLE,
    FREE,
    HALF_WIDTH,
    LINE,
    TippingGuide,
    TippingPlan,
)
from scenarios.torque_step import torque_steps
from scenarios.video.run import Scene, board_view
from scenarios.world import EDGE, Pad, World, build_world
from tasks import ForceTask, MotionTask, PostureTask

SPACE = TaskSpace(EDGE)
DT = 1e-3  # s, the control period and the step of the plant
STEEPEST = 60.0  # deg
FINAL = 0.1  # s at the end, in which the pressure must be back
LEAST_FORCE = 0.5  # N, below it the centre of pressure means nothing
LIMITS = {
    "force_rmse_N": (0.1, "N"),
    "tip_angle_error_deg": (0.5, "deg"),
    "torque_step_max": (0.5, "× limit"),  # so that the limit is not what makes it smooth
    "torque_step_switch_max": (0.5, "× limit"),
    "contact_loss_fraction": (0.0, ""),
    "edge_shift_mm": (0.2, "mm"),
    "pressure_to_edge_mm": (2.5, "mm"),  # when the face becomes an edge
    "pressure_to_middle_mm": (1.0, "mm"),  # at the end
    "qp_law_gap_max": (1e-8, "× max |τ|"),
    "fallback_ticks": (0.0, "ticks"),
}


@dataclass(frozen=True, kw_only=True)
class Edge:
    """Tip an eraser over its long edge and back while it presses on the board."""

    name: ClassVar[str] = "edge"
    summary: ClassVar[str] = "tip an eraser over its edge while it presses, k = 3 → 2 → 3"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf) with a frame ``flange``."""
    force: float = 10.0
    """Force on the board [N]."""
    angle: float = 20.0
    """Angle to tip to [deg]."""
    rate: float = 20.0
    """Mean rate of tipping [deg/s]."""
    friction: float = 0.3
    """Coulomb friction between pad and board [1]."""

    def __post_init__(self) -> None:
        for name in ("force", "angle", "rate"):
            positive(getattr(self, name), (), name)
        non_negative(self.friction, (), "friction")
        least = np.degrees(FEEL_ANGLE)
        if not least < self.angle <= STEEPEST:
            raise InputError(f"angle: got {self.angle}, need {least:g} < angle <= {STEEPEST:g} deg")

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        world = self._world()
        joints = options.joints(world.robot, DT)
        robot = joints.robot
        plan = TippingPlan(
            X_WE=world.X_WE,
            force=self.force,
            angle=np.radians(self.angle),
            rate=np.radians(self.rate),
        )
        return Experiment(
            robot=robot,
            controller=options.controller(robot, modes(world), DT),
            plant=joints.drive(
                MujocoPlant(world, frame=EDGE, dt=joints.dt, armature=joints.armature)
            ),
            guide=TippingGuide(plan, robot),
            start_mode=FREE,
            q_start=robot.home,
            horizon=sum(step.duration for step in plan.steps) + 1.0,
            geometry={"X_WE": world.X_WE.homogeneous},
        )

    def _world(self) -> World:
        pad = Pad(friction=self.friction)
        return build_world(self.robot, clearance=CLEARANCE, pad=pad, dt=DT)

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run: forces on the edge, the rest from touch to end."""
        if not (table["phase"] == "spread").any():
            unknown = dict.fromkeys(LIMITS, float("nan"))
            return unknown | tick_metrics(table) | whole_run_metrics(table)
        seen, step = observe(table), torque_steps(table, load_robot(self.robot))
        phase, mode = table["phase"].to_numpy(), table["mode"].to_numpy()
        time, touching = column(table, "time"), table["touching"].to_numpy()
        pressed = phase != "touch"
        settled = pressed & (phase != "press")
        end = (phase == "spread") & (time > time[-1] - FINAL)
        shift = np.linalg.norm(seen.p_E[:, :2] - seen.p_E[0, :2], axis=1)
        to_edge = np.abs(HALF_WIDTH - seen.centre)
        tip_error = np.abs(np.degrees(seen.tilt) - self.angle)
        return {
            "force_rmse_N": rms((seen.normal_force - self.force)[mode == LINE]),
            "force_peak_N": float(seen.normal_force[pressed].max()),
            "tip_angle_error_deg": float(tip_error[phase == "hold"].max()),
            "torque_step_max": float(step.max()),
            "torque_step_switch_max": float(step[mode[1:] != mode[:-1]].max()),
            "contact_loss_fraction": float(np.mean(~touching[pressed])),
            "edge_shift_mm": 1e3 * float(shift[settled].max()),
            "pressure_to_edge_mm": 1e3 * float(to_edge[phase == "lean"][-1]),
            "pressure_to_middle_mm": 1e3 * float(np.abs(seen.centre[end]).max()),
            **tick_metrics(table),
            **whole_run_metrics(table),
        }

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        return tuple(
            Criterion(name, metrics[name], limit, unit) for name, (limit, unit) in LIMITS.items()
        )

    def scene(self, outcome: Outcome) -> Scene:
        """Return robot and board."""
        world = self._world()
        view = board_view(world.X_WE)
        return Scene(model=world.model, view=view, forces={"wrench_meas": EDGE})

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the tip angle, the centre of pressure, forces and the steps of torque."""
        table = outcome.table
        seen = observe(table)
        tilt = np.degrees(seen.tilt)
        wanted = tilt + np.degrees(column(table, "motion.X_e.3"))
        angles = [Curve("measured", tilt), Curve("reference", wanted, dashed=True)]
        forces = [
            Curve("normal, measured", seen.normal_force),
            *(Curve(f"along {axis}", column(table, f"wrench_meas.f{axis}")) for axis in "xy"),
            Curve("normal, set-point", _set_force(table), dashed=True),
        ]
        edge = np.full(len(table), 1e3 * HALF_WIDTH)
        centres = [Curve("measured", 1e3 * seen.centre), Curve("edge", edge, dashed=True)]
        return (
            Panel(
                "tilt",
                "Angle of tipping",
                "About the edge, against the board. The face has no reference: felt gives way.",
                curve_figure(table, "angle", "deg", angles),
                True,
            ),
            Panel(
                "centre",
                "Centre of pressure",
                "From the middle of the pad towards the edge, from the moment about the edge.",
                curve_figure(table, "centre of pressure", "mm", centres),
                True,
            ),
            Panel(
                "force",
                "Force on the board",
                "Robot on board: along the normal of the board, and along x and y of the tool.",
                curve_figure(table, "force", "N", forces),
            ),
            step_panel(table, load_robot(self.robot)),
        )


def modes(world: World) -> tuple[Mode, ...]:
    """Return the three modes, all on the frame at the edge.

    The face believes that felt is rigid, but it gives way where it tips: a tool of mass m on a
    spring k swings unless K_fi stays far below d (1 + K_fp), and creeps at k (1 + K_fp) / (m d).
    """
    motion = Weighted(MotionTask(space=SPACE, K_p=400.0, K_d=40.0))
    force = Weighted(ForceTask(space=SPACE, K_fp=0.8, K_fi=2.0, damping=10.0))
    posture = Weighted(PostureTask(q_ref=world.robot.home))
    face = FaceOnPlane(space=SPACE, R_WE=world.X_WE.rotation, name="face")
    edge = EdgeOnPlane(space=SPACE, X_WE=world.X_WE, edge=(1.0, 0.0, 0.0), name="edge")
    return (
        Mode(name=FREE, tasks=(motion, posture)),
        Mode(name=FACE, tasks=(motion, force, posture), constraints=(face,)),
        Mode(name=LINE, tasks=(motion, force, posture), constraints=(edge,)),
    )


class Observed(NamedTuple):
    """What the record says of pose and contact; the tool starts aligned with the board."""

    tilt: Vector
    """Angle about the edge (ticks) [rad]."""
    p_E: Matrix
    """Place of the edge (ticks×3) [m], along the axes of the board."""
    normal_force: Vector
    """Measured force into the board (ticks) [N]."""
    centre: Vector
    """Centre of pressure (ticks) [m] from the middle of the pad towards the edge; NaN in air."""


def observe(table: pl.DataFrame) -> Observed:
    """Return angle, place, force and centre of pressure of every tick."""
    pose = np.stack([column(table, f"motion.X_WF.{i}") for i in range(12)], axis=1)
    R_WF = pose[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1)
    R_EF = R_WF[0].T @ R_WF
    force = np.stack([column(table, f"wrench_meas.{axis}") for axis in ("fx", "fy", "fz")], axis=1)
    pressed = np.where(force[:, 2] > LEAST_FORCE, force[:, 2], np.nan)
    return Observed(
        tilt=np.arctan2(R_EF[:, 2, 1], R_EF[:, 2, 2]),
        p_E=pose[:, 9:] @ R_WF[0],
        normal_force=(R_EF[:, 2] * force).sum(axis=1),
        centre=HALF_WIDTH + column(table, "wrench_meas.mx") / pressed,
    )


def _set_force(table: pl.DataFrame) -> Vector:
    """Return the length of the ramped set-point of force (ticks) [N]."""
    return np.linalg.norm([column(table, f"force.F_des.{i}") for i in range(3)], axis=0)
