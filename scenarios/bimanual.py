"""Two arms squeeze a box, carry it along an eight, press it on a table, slide it, bring it back.

The box is a floating body of the robot: hands are held to it, seen from it, and it to the table.
The internal force of the grasp and the force on the table are set; the box follows its path with
what is left.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import polars as pl

from qpctrl.arrays import non_negative, positive
from qpctrl.errors import InputError
from scenarios.panel import Panel
from scenarios.parameter import need_within
from scenarios.scenario import Criterion, Experiment, Options, Outcome, criteria
from scenarios.video.run import Scene
from scenarios.video.take import View
from scenarios.whole_body.bimanual_guide import BoxGuide, BoxPlan
from scenarios.whole_body.bimanual_metric import box_metrics, what_gave_way
from scenarios.whole_body.bimanual_modes import REACH, Grip, box_modes
from scenarios.whole_body.bimanual_panels import box_panels
from scenarios.whole_body.bimanual_world import BOTTOM, CONTACTS, PADS, BoxWorld, build_box_world

DT = 1e-3  # s, the control period and the step of the plant
SIZE = (0.08, 0.04, 0.05)  # m: half width, half depth and height of the eight
RADIUS = 0.04  # m, of the ring on the table
TIMES = 17.0  # s that all but eight and ring take at most
ROOM = {
    "height": (1e-3, 0.15, "m"),
    "turn": (0.0, 30.0, "deg"),
    "mass": (0.01, 100.0, "kg"),
    "duration": (0.1, 600.0, "s"),
    "friction": (0.0, 10.0, ""),
    "table_friction": (0.0, 10.0, ""),
}
LIMITS = {
    "grasp_force_rmse_share": (0.03, "× set-point"),
    "force_rmse_share": (0.03, "× set-point"),
    "object_path_rmse_mm": (2.0, "mm"),
    "slip_max_mm": (0.5, "mm"),
    "friction_used_max": (0.95, "× cone"),
    "pressure_used_max": (0.95, "× half length"),
    "pad_friction_limit_ticks": (0.0, "ticks"),
    "pad_footprint_limit_ticks": (0.0, "ticks"),
    "pad_force_limit_ticks": (0.0, "ticks"),
    "unloaded_share": (0.2, "× weight"),
    "phases_left": (0.0, ""),
    "torque_step_switch_max": (0.6, "× limit"),
    "kkt_residual_max": (1e-8, ""),
    "fallback_ticks": (0.0, "ticks"),
}


@dataclass(frozen=True, kw_only=True)
class Bimanual:
    """Carry a box with two arms, press it on a table and slide it there."""

    name: ClassVar[str] = "bimanual"
    summary: ClassVar[str] = "two arms squeeze, carry, press and slide a box that floats"

    squeeze: float = 40.0
    """Internal force of the grasp [N]."""
    squeeze_max: float = 80.0
    """Largest force of a pad on the box [N]."""
    press: float = 30.0
    """Force of the box on the table while it slides [N]."""
    mass: float = 2.0
    """Of the box [kg]."""
    friction: float = 1.0
    """Coulomb friction between pads and box [1]."""
    assumed_friction: float = 0.8
    """The same as the controller believes it to be [1]."""
    table_friction: float = 0.3
    """Coulomb friction between box and table [1]."""
    height: float = 0.1
    """How high the box is lifted [m]."""
    turn: float = 15.0
    """Largest angle by which the box is turned on the eight [deg]."""
    duration: float = 4.0
    """Time for the eight, and for the ring on the table [s]."""

    def __post_init__(self) -> None:
        for name in ("squeeze", "squeeze_max", "press", "mass", "assumed_friction", "height"):
            positive(getattr(self, name), (), name)
        for name in ("friction", "table_friction", "turn"):
            non_negative(getattr(self, name), (), name)
        positive(self.duration, (), "duration")
        need_within(self, ROOM)
        if self.squeeze > self.squeeze_max:
            raise InputError(
                f"squeeze: got {self.squeeze:g} N, need at most squeeze_max, {self.squeeze_max:g} N"
            )

    def world(self) -> BoxWorld:
        """Return the scene."""
        return build_box_world(
            mass=self.mass, friction=self.friction, table_friction=self.table_friction, dt=DT
        )

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run.

        Raises:
            InputError: the options ask for drives, which this scenario has not.
        """
        if options.actuator != "ideal":
            raise InputError(
                f"actuator: got {options.actuator!r}, need 'ideal' with floating bodies"
            )
        world = self.world()
        plan = BoxPlan(
            robot=world.robot,
            X_WT=world.X_WT,
            weight=world.weight,
            squeeze=self.squeeze,
            press=self.press,
            height=self.height,
            size=SIZE,
            turn=np.radians(self.turn),
            radius=RADIUS,
            duration=self.duration,
        )
        grip = Grip(friction=self.assumed_friction, most=self.squeeze_max)
        joints = options.joints(world.robot, DT)
        return Experiment(
            robot=joints.robot,
            controller=options.controller(joints.robot, box_modes(world, grip), DT),
            plant=world.plant(),
            guide=BoxGuide(plan),
            start_mode=REACH,
            q_start=world.robot.home,
            horizon=TIMES + 2 * self.duration,
            geometry={"X_WT": world.X_WT.homogeneous},
            contacts=CONTACTS,
        )

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run."""
        return box_metrics(table, self.world(), squeeze=self.squeeze, press=self.press)

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        return criteria(metrics, LIMITS)

    def scene(self, outcome: Outcome) -> Scene:
        """Return arms, box and table."""
        world = self.world()
        x, y, z = world.robot.pose(world.robot.home, BOTTOM.frame).translation
        view = View(azimuth=120.0, elevation=-20.0, distance=2.1, lookat=(x, y, z - 0.05))
        frames = [*(pad.frame for pad in PADS), BOTTOM.frame]
        forces = {f"contact.{name}": of for name, of in zip(CONTACTS, frames, strict=True)}
        return Scene(model=world.model, view=view, forces=forces, scale=-0.006)

    def events(self, table: pl.DataFrame) -> tuple[str, ...]:
        """Return in words what bound, slipped and ended the run, in the order of time."""
        return what_gave_way(table, self.world())

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return path and forces of the box, and what its contacts carry and have left."""
        return box_panels(outcome, self.world())
