"""Two arms at a table with a box on it: the scene, the robot in it, and where both start."""

from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector
from qpctrl.errors import InputError
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from scenarios.plant_bodies import BodiesPlant, Touch
from scenarios.plant_coordinates import coordinates
from scenarios.plant_model import check_agreement, robot_from_mujoco
from scenarios.robot_file import MODELS
from scenarios.whole_body.contact import CarryingContact
from scenarios.world import Pad

SIDES = ("left", "right")
PADS = tuple(TaskSpace(f"{side}_pad", relative_to="box") for side in SIDES)
"""Motion of each pad as seen from the box."""
HANDS = tuple(TaskSpace(f"{side}_pad") for side in SIDES)
"""Motion of each pad in the world."""
BOTTOM = TaskSpace("box_bottom")
"""Motion of the middle of the box's lowest face, z down."""

CONTACTS = (*SIDES, "table")
HALF = 0.12  # m, from the middle of the box to each face
PAD_HALF = (0.04, 0.04)  # m
GAP = 0.005  # m, between pads and box at the start
DOWN = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
"""From a frame with z up to one with z down."""
FELT = Pad()
"""What covers the table: MuJoCo lifts a body that slides on hard ground off it."""
CLOSE = 1e-10
"""m, rad: how far from their places the pads may be at the start."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxWorld:
    """The scene, and the robot that a controller believes in: two arms and the box."""

    model: mujoco.MjModel
    robot: Robot
    """Its home is the start: the box on the table, a pad in front of each side."""
    X_WT: pin.SE3
    """Frame of the table's top, z down."""
    weight: float
    """Of the box [N]."""
    contacts: tuple[CarryingContact, ...]
    """The contacts, as the plant has them."""

    def plant(self) -> BodiesPlant:
        """Return a plant of this scene that tells the wrenches of all contacts."""
        touches = [
            Touch(name=side, frame=f"{side}_pad", body=f"{side}_hand", others=("box",))
            for side in SIDES
        ]
        touches.append(Touch(name="table", frame=BOTTOM.frame, body="box", others=("table",)))
        return BodiesPlant(self.model, self.robot, touches, main="table")


def build_box_world(
    *, mass: float = 2.0, friction: float = 1.0, table_friction: float = 0.3, dt: float = 1e-3
) -> BoxWorld:
    """Return the scene.

    Args:
        mass: of the box [kg], spread evenly.
        friction: Coulomb friction between pads and box [1].
        table_friction: the same between box and table [1].
        dt: step of the plant [s].
    """
    spec = mujoco.MjSpec.from_file(str(MODELS / "two_arms.xml"))
    spec.geom("box").mass = mass
    spec.option.timestep = dt
    for pair in spec.pairs:
        on_table = pair.name == "box on table"
        pair.friction[:2] = table_friction if on_table else friction
        if on_table:
            pair.solimp[:3] = FELT.solimp
        else:
            pair.solreffriction[:2] = 2 * dt, 1.0
    model = spec.compile()
    robot = robot_from_mujoco(model, model.key("home").qpos)
    check_agreement(model, robot, BOTTOM.frame)
    X_WT = robot.pose(robot.home, "table") * DOWN
    start = _box_on_table(model, robot, X_WT)
    robot = robot_from_mujoco(model, start)
    pads = tuple(CarryingContact(side, friction, PAD_HALF) for side in SIDES)
    return BoxWorld(
        model=model,
        robot=robot,
        X_WT=X_WT,
        weight=mass * float(np.linalg.norm(model.opt.gravity)),
        contacts=(*pads, CarryingContact("table", table_friction, (HALF, HALF))),
    )


def box_from_bottom(X_WB: pin.SE3) -> pin.SE3:
    """Return the pose of the box whose lowest face has the frame ``X_WB``, z down."""
    return X_WB * DOWN * pin.SE3(np.eye(3), np.array([0.0, 0.0, HALF]))


def _box_on_table(model: mujoco.MjModel, robot: Robot, X_WT: pin.SE3) -> Vector:
    """Return ``qpos`` with the box in the middle of the table and the pads in front of it."""
    both = coordinates(model, robot)
    X_WO = box_from_bottom(X_WT)
    q = robot.home.copy()
    at = int(robot.model.joints[robot.model.getJointId("box")].idx_q)
    q[at : at + 7] = pin.SE3ToXYZQUAT(X_WO)
    X_WK, away = robot.pose(robot.home, "box"), pin.SE3(np.eye(3), np.array([0.0, 0.0, -GAP]))
    goals = {
        hand.frame: X_WO * X_WK.inverse() * robot.pose(robot.home, hand.frame) * away
        for hand in HANDS
    }
    return both.qpos_from_pinocchio(reach(robot, q, goals))


def reach(robot: Robot, q: Vector, goals: dict[str, pin.SE3]) -> Vector:
    """Return the configuration (nq) near ``q`` whose frames have the poses ``goals``.

    Raises:
        InputError: there is none within the reach of the arms.
    """
    data = robot.model.createData()
    driven = np.flatnonzero(robot.B.any(axis=1))
    for _ in range(100):
        pin.computeJointJacobians(robot.model, data, q)
        pin.updateFramePlacements(robot.model, data)
        errors, rows = [], []
        for frame, X_WD in goals.items():
            index = robot.frame_id(frame)
            errors.append(pin.log6(data.oMf[index].inverse() * X_WD).vector)
            rows.append(pin.getFrameJacobian(robot.model, data, index, pin.LOCAL)[:, driven])
        error = np.concatenate(errors)
        if np.abs(error).max() < CLOSE:
            return np.asarray(q)
        dq = np.zeros(robot.nv)
        dq[driven] = np.linalg.lstsq(np.vstack(rows), error, rcond=None)[0]
        q = robot.integrate(q, dq)
    raise InputError(f"reach: no configuration with {', '.join(goals)} where they shall be")
