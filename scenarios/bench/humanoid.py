"""A humanoid that stands on both feet, sways, and moves a hand: what a whole-body tick is timed on.

The same job as that of TSID's humanoid in ``peers/tsid_humanoid.py``, on a robot of our own.
"""

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl import Measurement, Mode, Robot, TaskSpace, Weighted
from qpctrl.constraint import Embedded
from qpctrl.contact import Footprint, FrictionCone, WrenchLimit
from qpctrl.controller import Controller
from qpctrl.errors import InputError
from qpctrl.objective import Reference
from qpctrl.status import Status
from scenarios.bench.course import DT, Moment
from scenarios.plant_model import robot_from_mujoco
from scenarios.robot_file import MODELS
from scenarios.whole_body.humanoid_world import HAND, TORSO
from tasks import (
    CentreOfMassReference,
    CentreOfMassTask,
    ForceTask,
    MotionReference,
    MotionTask,
    PostureTask,
)

HUMANOID = "humanoid"
ROWS = 12
"""Rows of the contacts of both feet."""

SWAY, REACH = 0.01, 0.02
"""How far the centre of mass and the hand go [m]."""
FRICTION, HALF = 0.7, (0.1, 0.04)
"""Of each sole: coefficient [1], and half lengths in which the centre of pressure stays [m]."""
SIDES = 4
"""Of each friction pyramid, as many as TSID's."""

SOLES = {side: TaskSpace(f"{side}_sole") for side in ("left", "right")}


def humanoid() -> Robot:
    """Return the robot: 35 velocities, 29 torques."""
    model = mujoco.MjModel.from_xml_path(str(MODELS / "humanoid.xml"))
    return robot_from_mujoco(model, model.key("home").qpos.copy())


def standing_mode(robot: Robot) -> Mode:
    """Return both feet on the ground, centre of mass, hand, torso and posture as weighted tasks."""
    limits: list[WrenchLimit] = []
    for side, space in SOLES.items():
        limits.append(FrictionCone(space=space, mu=FRICTION, sides=SIDES, name=f"{side} friction"))
        limits.append(Footprint(space=space, half=HALF, name=f"{side} footprint"))
    feet = (ForceTask(space=space, name=f"{side} force") for side, space in SOLES.items())
    return Mode(
        name="stand",
        tasks=(
            Weighted(CentreOfMassTask()),
            Weighted(MotionTask(space=HAND, name="hand"), 0.1),
            Weighted(MotionTask(space=TORSO, name="torso"), 0.1),
            Weighted(PostureTask(q_ref=robot.home, K_p=10.0, K_d=6.3), 0.1),
            *(Weighted(task, 1e-3) for task in feet),
        ),
        constraints=tuple(
            Embedded(space=space, X_WE=robot.pose(robot.home, space.frame), name=f"{side} foot")
            for side, space in SOLES.items()
        ),
        contact_limits=tuple(limits),
        metric="home",
    )


def standing_course(robot: Robot, length: int) -> tuple[Moment, ...]:
    """Return the ticks of one period of swaying and reaching, each on the answer before it.

    Raises:
        InputError: a tick has no solution.
    """
    controller = Controller(robot, [standing_mode(robot)], dt=DT)
    engine = controller.engines["stand"]
    q, v, memory = robot.home, np.zeros(robot.nv), controller.start("stand", robot.home)
    c_home = np.array(pin.centerOfMass(robot.model, robot.model.createData(), q))
    home = {space.frame: robot.pose(q, space.frame) for space in (HAND, TORSO)}
    moments = []
    for i in range(length):
        references = _references(2 * np.pi * i / length, length * DT, c_home, home)
        moments.append(Moment(q, v, references))
        _, report, memory = controller.step("stand", Measurement(i * DT, q, v), references, memory)
        if report.status is not Status.OK:
            raise InputError(f"the humanoid does not stand: {report.explain()}")
        a = engine.parts.point[0][: robot.nv]
        q, v = robot.integrate(q, DT * v + DT**2 / 2 * a), v + DT * a
    return tuple(moments)


def _references(
    angle: float, period: float, c_home: np.ndarray, home: dict[str, pin.SE3]
) -> dict[str, Reference]:
    w = 2 * np.pi / period
    s, c = np.sin(angle), np.cos(angle)
    sway = SWAY * np.array([0.0, s, np.sin(2 * angle) / 2])
    speed = SWAY * w * np.array([0.0, c, np.cos(2 * angle)])
    reach = REACH * np.array([s - np.sin(2 * angle) / 2, s, 1 - c])
    hand = home[HAND.frame]
    return {
        "centre of mass": CentreOfMassReference(c_des=c_home + sway, c_dot_des=speed),
        "hand": MotionReference(X_WD=pin.SE3(hand.rotation, hand.translation + reach)),
        "torso": MotionReference(X_WD=home[TORSO.frame]),
    }
