"""The world of the system `arm-on-plane`, and the controller that believes in a flat one."""

import functools
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector
from qpctrl.constraint import PointOnPlane
from qpctrl.controller import Controller
from qpctrl.law import Law
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from scenarios.force_sensor import ForceSensor, SensedPlant
from scenarios.plant import Plant
from scenarios.plant_mujoco import MujocoPlant
from scenarios.plant_rigid import RigidPlant
from scenarios.robot_file import load_robot
from scenarios.scenario import Options
from scenarios.study.system import Setting
from scenarios.world import BALL_RADIUS, TOOL, Pad, World, build_world
from tasks import ForceTask, MotionTask, PostureTask

ROBOTS = ("fr3", "ur5")
PLANTS = ("exact", "mujoco")
DIRECTIONS = (1, -1)
MODE, DT = "press", 1e-3
K_P, K_D = 2500.0, 100.0  # 1/s², 1/s, of the motion: settled within the hold
RISE = 0.05  # s, in which the set-point ramps up
NO_FRICTION = 1e-5  # the least that MuJoCo takes


class Arm(NamedTuple):
    """An arm as the controller believes it to be, in front of its plane."""

    robot: Robot
    frame: str
    """At the point that touches, z into the plane."""
    X_WE: pin.SE3
    """Believed plane: the pose of the tool at home."""
    world: World | None
    """MuJoCo's scene, where a ball touches a board."""

    @property
    def ball(self) -> float:
        """Radius [m] of what touches; 0: a point."""
        return 0.0 if self.world is None else BALL_RADIUS


@functools.lru_cache(maxsize=4)
def arm(robot: str, plant: str) -> Arm:
    """Return an arm by name, for one of `PLANTS`."""
    if plant == "mujoco":
        world = build_world(robot, tip="ball", clearance=0.0, dt=DT)
        return Arm(world.robot, TOOL, world.robot.pose(world.robot.home, TOOL), world)
    model = load_robot(robot)
    return Arm(model, "flange", model.pose(model.home, "flange"), None)


@functools.lru_cache(maxsize=12)
def controller_of(robot: str, plant: str, law: Law) -> Controller:
    """Return the controller that believes in the plane at home."""
    held = arm(robot, plant)
    space = TaskSpace(held.frame)
    tasks = (
        MotionTask(space=space, K_p=K_P, K_d=K_D),
        ForceTask(space=space),
        PostureTask(q_ref=held.robot.home),
    )
    believed = PointOnPlane(space=space, X_WE=held.X_WE)
    mode = Mode(name=MODE, tasks=tuple(Weighted(task) for task in tasks), constraints=(believed,))
    return Options(law=law, compiled="no").controller(held.robot, [mode], DT)


def true_normal(setting: Setting) -> Vector:
    """Return the direction (3) into the true plane, in the axes of the believed one."""
    tilt = np.radians(setting["tilt"])
    return np.array([0.0, -np.sin(tilt), np.cos(tilt)])


def true_plane(held: Arm, setting: Setting) -> pin.SE3:
    """Return the pose of the plane that the tool just touches at home."""
    n = true_normal(setting)
    R = pin.utils.rotate("x", np.radians(setting["tilt"]))
    return held.X_WE * pin.SE3(R, held.ball * (1 - n[2]) * n)


def plant_of(held: Arm, setting: Setting) -> Plant:
    """Return the true world, seen through its force sensor."""
    plane, friction = true_plane(held, setting), setting["friction"]
    plant: Plant
    if held.world is None:
        true = PointOnPlane(space=TaskSpace(held.frame), X_WE=plane)
        plant = RigidPlant(held.robot, true, friction=friction, dt=DT)
    else:
        pad = Pad(friction=max(friction, NO_FRICTION), solref=(setting["contact_time"], 1.0))
        plant = MujocoPlant(held.world, frame=held.frame, board=plane, pad=pad)
    bias = np.array([0.0, 0.0, setting["sensor_bias"], 0.0, 0.0, 0.0])
    return SensedPlant(plant, ForceSensor(bias=bias)) if setting["sensor_bias"] else plant
