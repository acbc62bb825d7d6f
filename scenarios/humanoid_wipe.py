"""A humanoid on two feet wipes a wall, is pushed meanwhile, and steps its hand back.

The base floats: the weight, the force on the wall and the push all go through the soles, which
can slip and tip. Contacts: two soles (k = 6 each) with friction cones and footprints, and a ball at
the hand (k = 1), which comes and goes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
import polars as pl

from qpctrl.arrays import Wrench, finite_array, non_negative, positive
from qpctrl.errors import InputError
from scenarios.panel import Panel
from scenarios.parameter import need_within
from scenarios.path import wiping_loops
from scenarios.scenario import Criterion, Experiment, Options, Outcome, criteria
from scenarios.video.run import Scene
from scenarios.video.take import View
from scenarios.whole_body.humanoid_guide import PUSH_TIME, RECOVER_TIME, HumanoidGuide, Stance
from scenarios.whole_body.humanoid_metric import humanoid_metrics, what_gave_way
from scenarios.whole_body.humanoid_panels import humanoid_panels
from scenarios.whole_body.humanoid_world import (
    FREE,
    HAND,
    SOLES,
    TORSO,
    HumanoidWorld,
    humanoid_modes,
    humanoid_plant,
    humanoid_world,
)
from scenarios.wiping import WipingPlan

DT = 1e-3  # s, the control period and the step of the plant
LEAST_RAMP, UNLOAD_TIME = 100.0, 0.2  # N/s, and s in which any force is ramped down
SWAY = 0.05  # m, by which the circles move to either side
LIMITS = {
    "force_rmse_share": (0.03, "× set-point"),
    "position_rmse_mm": (2.0, "mm"),
    "orientation_rmse_deg": (1.0, "deg"),
    "touch_peak_ratio": (1.5, "× set-point"),
    "contact_loss_fraction": (0.0, ""),
    "foot_slip_max_mm": (0.5, "mm"),
    "foot_tilt_max_deg": (0.5, "deg"),
    "torso_drop_max_mm": (50.0, "mm"),
    "friction_used_max": (0.95, "× cone"),
    "pressure_used_max": (0.95, "× sole"),
    "torque_used_max": (1.0 + 1e-9, "× limit"),
    "torque_step_switch_max": (0.5, "× limit"),
    "kkt_residual_max": (1e-8, ""),
    "fallback_ticks": (0.0, "ticks"),
}
ROOM = {
    "speed": (1e-3, 0.5, "m/s"),
    "radius": (1e-3, 0.1, "m"),
    "duration": (0.0, 3600.0, "s"),
    "force": (0.1, 1000.0, "N"),
    "push": (0.0, 2000.0, "N"),
    "friction": (0.0, 10.0, ""),
    "ground_friction": (0.0, 10.0, ""),
}


@dataclass(frozen=True, kw_only=True)
class HumanoidWipe:
    """Wipe a wall with a humanoid on two feet, and push it meanwhile."""

    name: ClassVar[str] = "humanoid_wipe"
    summary: ClassVar[str] = "a humanoid on two feet wipes a wall and is pushed, k = 6 + 6 + 1"

    force: float = 15.0
    """Force on the wall [N]."""
    speed: float = 0.1
    """Wiping speed [m/s]."""
    radius: float = 0.04
    """Radius of the circles that the hand wipes [m]."""
    duration: float = 4.0
    """Time spent wiping before the push [s]; 2 s more follow it."""
    push: float = 40.0
    """Push at the torso [N], for 0.2 s, while the hand wipes on."""
    push_direction: float = 0.0
    """Where it pushes to [deg]: 0 towards the wall, 90 to the left, 180 away from the wall."""
    friction: float = 0.5
    """Coulomb friction between hand and wall [1]."""
    ground_friction: float = 0.8
    """Coulomb friction between soles and ground [1]; the controller knows it."""
    lift: float = 0.0
    """Height of the start above the pose in which the soles carry the weight [mm]."""
    k_fp: float = 0.5
    """Proportional force gain [1]."""
    k_fi: float = 20.0
    """Integral force gain [1/s]."""
    damping: float = 20.0
    """Velocity damping of the force direction [1/s]."""
    k_p: float = 400.0
    """Stiffness of the hand's motion [1/s²]."""
    k_d: float = 40.0
    """Damping of the hand's motion [1/s]."""

    def __post_init__(self) -> None:
        for name in ("force", "speed", "radius", "duration", "ground_friction"):
            positive(getattr(self, name), (), name)
        for name in ("push", "friction", "k_fp", "k_fi", "damping", "k_p", "k_d"):
            non_negative(getattr(self, name), (), name)
        for name in ("push_direction", "lift"):
            finite_array(getattr(self, name), (), name)
        need_within(self, ROOM)

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run.

        Raises:
            InputError: the soles are not on the ground, or joints are not ideal.
        """
        world = self.world()
        if options.actuator != "ideal":
            raise InputError(f"actuator: got {options.actuator!r}, this scenario has 'ideal' alone")
        options.joints(world.robot, DT)
        gains = {name: getattr(self, name) for name in ("k_fp", "k_fi", "damping", "k_p", "k_d")}
        ramp = max(LEAST_RAMP, self.force / UNLOAD_TIME)
        modes = humanoid_modes(world, ramp=ramp, **gains)
        controller = options.controller(world.robot, modes, DT)
        stance, plant = self.stance(world), humanoid_plant(world)
        return Experiment(
            robot=world.robot,
            controller=controller,
            plant=plant,
            guide=HumanoidGuide(stance, partial(plant.push, TORSO.frame)),
            start_mode=FREE,
            q_start=world.start,
            horizon=stance.longest,
            geometry={
                "X_WE": world.X_WE.homogeneous,
                "plane": np.array([1.0, 0.0]),
                "reference": _in_world(world, stance.wiping),
            },
            contacts=("hand", *SOLES),
        )

    def world(self) -> HumanoidWorld:
        """Return the scene with the humanoid in it."""
        return humanoid_world(
            friction=self.friction,
            ground_friction=self.ground_friction,
            lift=1e-3 * self.lift,
            dt=DT,
        )

    def stance(self, world: HumanoidWorld) -> Stance:
        """Return what to do in ``world``."""
        total = self.duration + PUSH_TIME + RECOVER_TIME
        wiping = WipingPlan(
            X_WE=world.X_WE,
            X_WT_home=world.robot.pose(world.robot.home, HAND.frame),
            force=self.force,
            speed=self.speed,
            duration=total,
            dt=DT,
            damping=self.damping,
            path=wiping_loops(self.speed, total, DT, radius=self.radius, sway=SWAY),
        )
        return Stance(world=world, wiping=wiping, push=self._shove(), push_at=self.duration)

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run: of the hand while it wipes, of the feet throughout."""
        return humanoid_metrics(table, self.world(), self.force)

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        return criteria(metrics, LIMITS)

    def scene(self, outcome: Outcome) -> Scene:
        """Return the humanoid in front of the wall; the forces are those on the humanoid."""
        world = self.world()
        x, y, _ = world.X_WE.translation
        view = View(azimuth=62.0, elevation=-12.0, distance=2.9, lookat=(x - 0.3, y, 0.75))
        forces = {f"contact.{sole}": sole for sole in SOLES} | {"contact.hand": HAND.frame}
        return Scene(model=world.model, view=view, forces=forces, scale=-0.002)

    def events(self, table: pl.DataFrame) -> tuple[str, ...]:
        """Return in words what bound, slipped, tipped and fell, in the order of time."""
        return what_gave_way(table, self.world())

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return path and force of the hand, contacts of the soles, centre of mass and torque."""
        return humanoid_panels(outcome, self.world())

    def _shove(self) -> Wrench:
        angle = np.radians(self.push_direction)
        return self.push * np.array([np.cos(angle), np.sin(angle), 0.0, 0.0, 0.0, 0.0])


def _in_world(world: HumanoidWorld, plan: WipingPlan) -> np.ndarray:
    """Return the path of wiping (samples×3) [m] in the world."""
    p_E = np.pad(plan.loops.p, ((0, 0), (0, 1)))
    path: np.ndarray = world.X_WE.translation + p_E @ world.X_WE.rotation.T
    return path
