"""A face that wipes a board on a conveyor: the constraint itself moves, v_c(t) ≠ 0.

The board is carried along and back while it heaves and rocks, and the controller knows how. The
textbook law, which does not know v̇_c, errs by Aᵀ S⁻¹ (Ȧ V − v̇_c).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import positive
from qpctrl.constraint import FaceOnPlane, Moving
from qpctrl.errors import InputError
from qpctrl.objective import Reference
from scenarios.guided import (
    DT,
    FLANGE,
    MODE,
    PRESS_TIME,
    Stroke,
    ThereAndBack,
    arm_at_home,
    guided_controller,
    guided_criteria,
    guided_metrics,
)
from scenarios.metric import column, rms_norm
from scenarios.panel import Panel, environment_panels
from scenarios.plant import PlantState
from scenarios.plant_rigid import RigidPlant
from scenarios.report_trace import Curve, curve_figure
from scenarios.ride import EASE, Eight, Ride, board_speed, seen_from_board
from scenarios.scenario import Criterion, Directive, Experiment, Options, Outcome
from tasks import ForceReference, MotionReference

BOARD = "board"
FASTEST = 5.0  # m/s, of tool and board
LIMITS = {
    "force_rmse_N": (1e-4, "N"),  # the law is exact: what the ramp left when the board sets off
    "position_rmse_mm": (0.02, "mm"),  # torque is held for a period while the reference moves on
    "board_gap_um": (0.01, "µm"),  # of the plant, not the controller: its integration error
    "board_tilt_deg": (1e-6, "deg"),  # the same
}


@dataclass(frozen=True, kw_only=True, eq=False)
class ConveyorJob:
    """Phases ``press`` (all at rest, the force ramps up) and ``move``."""

    ride: Ride
    figure: Eight
    wipe: ThereAndBack
    """Angle on the figure."""
    force: float
    """Force on the board [N]."""

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when tool and board are back."""
        start = self.ride.start
        if state.time >= start + self.ride.duration:
            return None
        F_ref = np.array([0.0, 0.0, self.force, 0.0, 0.0, 0.0])
        references: dict[str, Reference] = {
            "motion": self.reference(state.time),
            "force": ForceReference(F_ref=F_ref, F_meas=state.wrench_meas),
            BOARD: self.ride.shift(state.time),
        }
        return Directive("press" if state.time < start else "move", MODE, references)

    def reference(self, time: float) -> MotionReference:
        """Return pose, body twist and its derivative of a tool that wipes the moving board."""
        X_WE, V, V_dot = self.ride.at(time)
        p, p_dot, p_ddot = self.figure.at(self.wipe.at(time - self.ride.start))
        spin, spin_dot = pin.skew(V[3:]), pin.skew(V_dot[3:])
        V_des, V_dot_des = V.copy(), V_dot.copy()
        V_des[:3] += spin @ p + p_dot
        V_dot_des[:3] += spin_dot @ p + spin @ p_dot + p_ddot
        X_WD = X_WE * pin.SE3(np.eye(3), p)
        return MotionReference(X_WD=X_WD, V_des=V_des, V_dot_des=V_dot_des)


@dataclass(frozen=True, kw_only=True)
class Conveyor:
    """Wipe a board that is carried along, heaves and rocks, pressing on it meanwhile."""

    name: ClassVar[str] = "conveyor"
    summary: ClassVar[str] = "wipe a board that moves with a conveyor, k = 3 and v_c(t) ≠ 0"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf) with a frame ``flange``."""
    force: float = 10.0
    """Force on the board [N]."""
    speed: float = 0.3
    """Largest speed of the tool on the board [m/s]."""
    board_speed: float = 0.1
    """Speed of the conveyor [m/s]."""
    distance: float = 0.15
    """Way of the conveyor until it turns back [m]."""
    heave: float = 0.015
    """Amplitude of the board along its normal [m]."""
    rock: float = 4.0
    """Amplitude of its tilt [deg]."""
    frequency: float = 0.5
    """Frequency of heave and tilt [Hz]."""

    def __post_init__(self) -> None:
        for name in ("force", "speed", "board_speed", "distance", "heave", "rock", "frequency"):
            positive(getattr(self, name), (), name)
        for name in ("speed", "board_speed"):
            if getattr(self, name) > FASTEST:
                raise InputError(f"{name}: got {getattr(self, name)}, need at most {FASTEST:g} m/s")

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        arm, X_WF = arm_at_home(self.robot)
        job = self.job(X_WF)
        board = Moving(whole=FaceOnPlane(space=FLANGE, R_WE=X_WF.rotation, name=BOARD))
        joints = options.joints(arm, DT)
        plant = RigidPlant(
            joints.robot,
            board,
            environment=lambda time: job.ride.shift(time).arrays,
            dt=joints.dt,
            armature=joints.armature,
        )
        angles = np.linspace(0.0, 2 * np.pi, 200)
        return Experiment(
            robot=joints.robot,
            controller=guided_controller(joints.robot, board, options),
            plant=joints.drive(plant),
            guide=job,
            start_mode=MODE,
            q_start=arm.home,
            horizon=PRESS_TIME + job.ride.duration + 1.0,
            geometry={
                "X_WE": X_WF.homogeneous,
                "reference": np.array([job.figure.at(Stroke(s, 0.0, 0.0))[0] for s in angles]),
            },
        )

    def job(self, X_WE_start: pin.SE3) -> ConveyorJob:
        """Return what tool and board do, from the pose at the start."""
        figure = Eight(height=0.03, width=0.06)
        turning = self.speed / np.hypot(2 * figure.height, figure.width)
        wipe = ThereAndBack(far=2 * np.pi, speed=turning)
        carry = ThereAndBack(far=self.distance, speed=self.board_speed)
        ride = Ride(
            X_WE_start=X_WE_start,
            start=PRESS_TIME,
            carry=carry,
            heave=self.heave,
            rock=np.radians(self.rock),
            frequency=self.frequency,
            duration=2 * max(wipe.half, carry.half, EASE),
        )
        return ConveyorJob(ride=ride, figure=figure, wipe=wipe, force=self.force)

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run while the board moves; positions are those on the board."""
        found, move = guided_metrics(table), table.filter(pl.col("phase") == "move")
        if move.is_empty():
            return found
        job = self.job(arm_at_home(self.robot)[1])
        since_start = (column(move, "time") - PRESS_TIME).tolist()
        wanted = np.array([job.figure.at(job.wipe.at(t))[0] for t in since_start])
        p_E, tilt = seen_from_board(move, job.ride)
        return found | {
            "position_rmse_mm": 1e3 * rms_norm((p_E - wanted)[:, :2]),
            "board_gap_um": 1e6 * float(np.abs(p_E[:, 2]).max()),
            "board_tilt_deg": float(np.degrees(tilt.max())),
        }

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        return guided_criteria(metrics, LIMITS)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the path on the board, its speed along the rows, forces and pose errors."""
        geometry, table = outcome.experiment.geometry, outcome.table
        job = self.job(pin.SE3(geometry["X_WE"]))
        p_E, _ = seen_from_board(table, job.ride)
        places = {f"motion.X_WF.{9 + i}": p_E[:, i] for i in range(3)}
        seen = table.with_columns(**{name: pl.Series(x) for name, x in places.items()})
        in_E = {
            "X_WE": np.eye(4),
            "plane": np.array([1.0, 0.0]),
            "reference": geometry["reference"],
        }
        into, about_x, about_y = board_speed(table, job.ride).T
        turns = [Curve("about x", np.degrees(about_x)), Curve("about y", np.degrees(about_y))]
        words = "How fast the board moves along the rows of the constraint, at the tool: v_c."
        return (
            *environment_panels(seen, in_E, "as seen from the moving board"),
            Panel(
                "board_speed",
                "Speed of the board into the tool's rows",
                words,
                curve_figure(table, "v_c along z", "mm/s", [Curve("along z", 1e3 * into)]),
                True,
            ),
            Panel(
                "board_turn",
                "Turning of the board",
                "The same, of the two rotations that tip the face.",
                curve_figure(table, "v_c about x and y", "deg/s", turns),
                True,
            ),
        )
