"""The board falls away under the wiping eraser: contact is lost, felt for, and regained.

Until the loss is noticed, the force that was meant for the board drives the tool:

    v ≤ (1 + K_fp) f / m · (T + t_τ / 2),   m = 1 / S_zz

after ``loss_time`` T, with the time t_τ that the torque rate needs to take it away. (The
integral adds less than the damping takes, as long as K_fi < d (1 + K_fp).) T is chosen so that
this stays below the set speed. The search is a motion task whose reference moves at 90 % of
that speed from wherever the tool is: the tool approaches it from below, at the rate K_d.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Array, positive
from qpctrl.errors import InputError
from qpctrl.robot import Robot
from scenarios.eraser import DT, Eraser
from scenarios.metric import (
    SETTLE_TIME,
    column,
    loss_events,
    loss_metrics,
    normal_speed,
    tick_metrics,
    whole_run_metrics,
)
from scenarios.panel import Panel, board_panels
from scenarios.plant_falling_board import FallingBoard
from scenarios.plant_mujoco import MujocoPlant
from scenarios.report_energy import energy_panel
from scenarios.report_trace import Curve, curve_figure
from scenarios.scenario import Criterion, Experiment, Options, Outcome
from scenarios.video.run import Scene, board_view
from scenarios.wiping import (
    PRESS_TIME,
    SEARCH_DEPTH,
    SEARCH_SHARE,
    SPEED_PER_FORCE,
    WipingGuide,
    WipingPlan,
)
from scenarios.world import TOOL, Pad, World, build_world

REGAIN_MARGIN = 0.1  # s to notice the loss, reach the speed of the search, and feel the board
NEAR = (0.05, 0.3)  # s before loss and after regain that the picture of them shows


@dataclass(frozen=True, kw_only=True)
class Gap:
    """Wipe a board that falls away: the tool must feel for it without gathering speed."""

    name: ClassVar[str] = "gap"
    summary: ClassVar[str] = "the board falls away while wiping: contact lost, felt for, regained"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf)."""
    tool: str = "flange"
    """Frame of the robot that carries the eraser, z pointing away from the arm."""
    home: tuple[float, ...] | None = None
    """Start configuration [rad]; default: the file's keyframe."""
    force: float = 10.0
    """Force on the board [N]."""
    speed: float = 0.2
    """Wiping speed [m/s]."""
    duration: float = 3.0
    """Time spent wiping [s]."""
    friction: float = 0.3
    """Coulomb friction between pad and board [1]."""
    force_noise: float = 0.0
    """Standard deviation of the measured force [N]."""
    depth: float = 0.008
    """How far the board falls away along its normal [m]."""
    fall_after: float = 1.8
    """Time from the first touch to the fall [s]."""
    search_speed: float | None = None
    """Speed into the board [m/s] that the tool never exceeds while it has lost contact;
    default: 2 mm/s for each newton of the force."""
    loss_time: float | None = None
    """Time without force [s] after which contact counts as lost; default: the longest that
    keeps to the speed of the search."""
    k_fp: float = 0.5
    """Proportional force gain [1]."""
    k_fi: float = 20.0
    """Integral force gain [1/s]."""
    damping: float = 20.0
    """Velocity damping of the force directions [1/s]."""

    def __post_init__(self) -> None:
        optional = ("search_speed", "loss_time")
        given = [name for name in optional if getattr(self, name) is not None]
        for name in ("depth", "fall_after", *given):
            positive(getattr(self, name), (), name)
        self._wiping()  # checks what it shares with the eraser
        if self.depth >= SEARCH_DEPTH:
            raise InputError(f"depth: got {self.depth}, need less than {SEARCH_DEPTH} m")
        least = self.fall_after + self.search_time + 2 * SETTLE_TIME
        if self.loss_time is None and self.k_fi >= self.damping * (1 + self.k_fp):
            raise InputError(
                f"k_fi: got {self.k_fi}, need less than damping (1 + k_fp) = "
                f"{self.damping * (1 + self.k_fp):g} 1/s: else the integral gathers speed"
            )
        if self.loss_time is not None and self.loss_time >= self.search_time:
            raise InputError(
                f"loss_time: got {self.loss_time}, need less than {self.search_time:.3g} s, in "
                "which the search would cross the gap"
            )
        if self.fall_after <= PRESS_TIME + SETTLE_TIME:
            raise InputError(
                f"fall_after: got {self.fall_after}, need more than {PRESS_TIME + SETTLE_TIME} s, "
                "for the eraser to wipe by then"
            )
        if PRESS_TIME + self.duration < least:
            raise InputError(
                f"duration: got {self.duration}, need at least {least - PRESS_TIME:.3g} s to find "
                "the board and wipe on"
            )

    @property
    def set_speed(self) -> float:
        """Speed into the board [m/s] that is not exceeded: given, or in proportion to the force."""
        return SPEED_PER_FORCE * self.force if self.search_speed is None else self.search_speed

    @property
    def search_time(self) -> float:
        """Time [s] in which the search crosses the gap."""
        return self.depth / (SEARCH_SHARE * self.set_speed)

    def _wiping(self) -> Eraser:
        """Return the job without the fall."""
        names = ("robot", "tool", "home", "force", "speed", "duration", "friction", "force_noise")
        gains = ("k_fp", "k_fi", "damping")
        return Eraser(**{name: getattr(self, name) for name in (*names, *gains)})

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run.

        Raises:
            InputError: the set force accelerates the tool beyond the speed of the search before
                any loss can be noticed.
        """
        world = self._world()
        joints = options.joints(world.robot, DT)
        robot, plan = joints.robot, self._plan(world, joints.robot)
        board = MujocoPlant(
            world,
            force_noise=self.force_noise,
            seed=options.seed,
            dt=joints.dt,
            armature=joints.armature,
        )
        return Experiment(
            robot=robot,
            controller=options.controller(robot, self._wiping().modes(world), DT),
            plant=FallingBoard(
                plant=joints.drive(board),
                board=board,
                way_W=self.depth * world.X_WE.rotation[:, 2],
                after=self.fall_after,
            ),
            guide=WipingGuide(plan, lambda q: robot.pose(q, TOOL)),
            start_mode="free",
            q_start=robot.home,
            horizon=plan.longest,
            geometry={"X_WE": world.X_WE.homogeneous, "loops": plan.loops.p},
        )

    def _world(self) -> World:
        pad = Pad(friction=self.friction)
        return build_world(self.robot, tool=self.tool, home=self.home, pad=pad, dt=DT)

    def _plan(self, world: World, robot: Robot) -> WipingPlan:
        given = self.loss_time
        return WipingPlan(
            X_WE=world.X_WE,
            X_WT_home=robot.pose(robot.home, TOOL),
            force=self.force,
            speed=self.speed,
            duration=self.duration,
            dt=DT,
            damping=self.damping,
            loss_time=longest_loss(robot, self) if given is None else given,
            search_speed=self.set_speed,
        )

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run: speed in the gap, force at the regain and after it."""
        wipe = table.filter(pl.col("phase") == "wipe")
        loss = loss_metrics(wipe, force=self.force, speed=self.set_speed)
        return {**loss, **tick_metrics(wipe), **whole_run_metrics(table)}

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = [
            ("loss_speed_ratio", 1.0, "× set speed"),
            ("regain_peak_ratio", 2.0, "× set-point"),
            ("regain_time_s", self.search_time + REGAIN_MARGIN, "s"),
            ("contact_losses", 1.0, ""),
            ("force_rmse_N", 0.1, "N"),
            ("force_bias_abs_N", 0.02, "N"),
            ("position_rmse_mm", 0.2, "mm"),
            ("fallback_ticks", 0.0, "ticks"),
            ("qp_law_gap_max", 1e-8, "× max |τ|"),
        ]
        return tuple(Criterion(name, metrics[name], limit, unit) for name, limit, unit in limits)

    def scene(self, outcome: Outcome) -> Scene:
        """Return the robot and the board, which falls when the tool loses it."""
        world = self._world()
        events = loss_events(outcome.table.filter(pl.col("phase") == "wipe"))
        falls_at = np.inf if events is None else events.gone

        def places(table: pl.DataFrame) -> dict[str, Array]:
            X_WB = np.tile(world.X_WE.homogeneous, (len(table), 1, 1))
            fallen = column(table, "time") >= falls_at
            X_WB[fallen, :3, 3] += self.depth * world.X_WE.rotation[:, 2]
            return {"qpctrl/board": X_WB}

        view, forces = board_view(world.X_WE), {"wrench_meas": TOOL}
        return Scene(model=world.model, view=view, forces=forces, places=places)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return loss and regain from near, the whole run on the board, and the energy."""
        table = outcome.table
        whole = board_panels(outcome.summary, table, outcome.experiment.geometry)
        return (*self._near(table), *whole, energy_panel(table))

    def _near(self, table: pl.DataFrame) -> tuple[Panel, ...]:
        """Return force and speed from just before the loss until the force is back."""
        events = loss_events(table.filter(pl.col("phase") == "wipe"))
        if events is None:
            return ()
        begin, end = events.gone - NEAR[0], events.regained + NEAR[1]
        near = table.filter(pl.col("time").is_between(begin, end))
        near = near.with_columns(phase=pl.col("contact").str.to_lowercase())
        speed = [
            Curve("measured", 1e3 * normal_speed(near)),
            Curve("set speed", np.full(len(near), 1e3 * self.set_speed), dashed=True),
        ]
        force = [
            Curve("on the board", column(near, "wrench.fz")),
            Curve("set-point", column(near, "force.F_des.2"), dashed=True),
        ]
        return (
            Panel(
                "loss-speed",
                "Speed into the board, from loss to regain",
                "Along the board's normal, true. Behind: the phases of the contact.",
                curve_figure(near, "speed", "mm/s", speed),
                half=True,
            ),
            Panel(
                "loss-force",
                "Force on the board, from loss to regain",
                "True, robot on board. The set-point ramps up anew once the board is felt.",
                curve_figure(near, "force", "N", force),
                half=True,
            ),
        )


def longest_loss(robot: Robot, gap: Gap) -> float:
    """Return the longest ``loss_time`` [s] that keeps to the speed of the search.

    In whole periods, from the robot's inertia at home.

    Raises:
        InputError: there is none.
    """
    model, data, frame = robot.model, robot.model.createData(), robot.frame_id(TOOL)
    normal = pin.computeFrameJacobian(model, data, robot.home, frame, pin.ReferenceFrame.LOCAL)[2]
    upper = np.triu(pin.crba(model, data, robot.home))
    M = upper + np.triu(upper, 1).T
    drive = (1 + gap.k_fp) * gap.force
    faster = drive * float(normal @ np.linalg.solve(M, normal))  # m/s²
    unload = float((np.abs(normal) * drive / robot.limits.tau_rate).max())  # s
    periods = np.floor((gap.set_speed / faster - unload / 2) / DT)
    if periods < 1:
        least = faster * (DT + unload / 2)
        raise InputError(
            f"search_speed: got {gap.set_speed:g}, need at least {least:.3g} m/s: that fast the "
            f"force of {gap.force:g} N makes the tool before it can be stopped"
        )
    return float(periods * DT)
