"""The humanoid before a wall: its scene, and the modes of its controller."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector
from qpctrl.constraint import Constraint, Embedded, PointOnPlane
from qpctrl.contact import Footprint, FrictionCone, WrenchLimit
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from scenarios.plant_bodies import BodiesPlant, Touch
from scenarios.plant_coordinates import coordinates
from scenarios.plant_model import check_agreement, frame_pose, robot_from_mujoco
from scenarios.robot_file import MODELS
from scenarios.whole_body.contact import CarryingContact
from tasks import CentreOfMassTask, EnergyTask, ForceTask, MomentumTask, MotionTask, PostureTask

HAND, TORSO = TaskSpace("right_hand"), TaskSpace("torso", ("wx", "wy", "wz"))
SOLES = ("left_sole", "right_sole")
"""Names of the soles: of their sites, their contacts and their constraints."""
TRUSTED_FRICTION = 0.9
"""Share of the true friction that the controller makes use of."""
TRUSTED_SOLE = 0.9, 0.6
"""Share of the soles along x and y: a push that nobody announces moves the pressure further, and
most across a sole that carries little."""
PENETRATION = 2e-3
"""How deep [m] a sole may be in the ground at the start."""
FREE, CONTACT = "free", "contact"
"""Modes: on two feet, and with the hand on the wall besides."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HumanoidWorld:
    """A compiled scene, the robot in it, and what the contacts can carry."""

    model: mujoco.MjModel
    robot: Robot
    X_WE: pin.SE3
    """Wall frame where the hand will touch, z into the wall."""
    soles: tuple[CarryingContact, ...]
    """The soles, as they are."""
    start: Vector
    """Configuration (nq) in which the soles carry the weight [m, rad]."""


def humanoid_world(
    *, friction: float, ground_friction: float, lift: float, dt: float
) -> HumanoidWorld:
    """Return the scene, with the humanoid ``lift`` [m] above where it stands.

    Raises:
        InputError: the soles do not touch the ground.
    """
    model = mujoco.MjModel.from_xml_path(str(MODELS / "humanoid.xml"))
    model.opt.timestep = dt
    model.pair("right hand on wall").friction[:2] = friction
    for side in ("left", "right"):
        model.pair(f"{side} sole on ground").friction[:2] = ground_friction
    robot = robot_from_mujoco(model, model.key("home").qpos.copy())
    check_agreement(model, robot, HAND.frame)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    half = model.geom(SOLES[0]).size
    robot = replace(robot, home=_standing(model, robot))
    return HumanoidWorld(
        model=model,
        robot=robot,
        X_WE=frame_pose(model, data, "wall"),
        soles=tuple(
            CarryingContact(name, ground_friction, (float(half[0]), float(half[1])))
            for name in SOLES
        ),
        start=_lifted(robot, lift),
    )


def humanoid_plant(world: HumanoidWorld) -> BodiesPlant:
    """Return the plant, which measures the wrench of the hand and tells those of the soles."""
    touches = (
        Touch(name="hand", frame=HAND.frame, body="right_fist", others=("wall",)),
        *(Touch(name=name, frame=name, body=f"{name[:-5]}_foot") for name in SOLES),
    )
    return BodiesPlant(world.model, world.robot, touches, main="hand")


def humanoid_modes(
    world: HumanoidWorld,
    *,
    ramp: float,
    k_fp: float,
    k_fi: float,
    damping: float,
    k_p: float,
    k_d: float,
) -> tuple[Mode, ...]:
    """Return the modes `FREE` and `CONTACT`; ramp [N/s] and gains are those of the hand."""
    robot, wall = world.robot, PointOnPlane(space=HAND, X_WE=world.X_WE, name="hand")
    standing = (
        Weighted(MotionTask(space=HAND, K_p=k_p, K_d=k_d), 1.0),
        Weighted(CentreOfMassTask(K_p=16.0, K_d=8.0), 10.0),
        Weighted(MomentumTask(K=5.0), 0.1),
        Weighted(MotionTask(space=TORSO, K_p=100.0, K_d=20.0, name="torso"), 1.0),
        Weighted(PostureTask(q_ref=robot.home, K_p=25.0, K_d=10.0), 0.03),
        *(Weighted(ForceTask(space=TaskSpace(s), name=f"{s} force"), 1e-3) for s in SOLES),
    )
    force = ForceTask(space=HAND, K_fp=k_fp, K_fi=k_fi, damping=damping, ramp=ramp)
    feet, limits = _feet(world), _limits(world)
    watch = Weighted(EnergyTask(space=HAND))
    return (
        Mode(
            name=FREE,
            tasks=(*standing, watch),
            constraints=feet,
            contact_limits=limits,
            metric="home",
        ),
        Mode(
            name=CONTACT,
            tasks=(*standing, Weighted(force, 1.0)),
            constraints=(*feet, wall),
            contact_limits=limits,
            metric="home",
        ),
    )


def _feet(world: HumanoidWorld) -> tuple[Constraint, ...]:
    robot = world.robot
    return tuple(
        Embedded(space=TaskSpace(name), X_WE=robot.pose(robot.home, name), name=name)
        for name in SOLES
    )


def _limits(world: HumanoidWorld) -> tuple[WrenchLimit, ...]:
    found: list[WrenchLimit] = []
    for sole in world.soles:
        space = TaskSpace(sole.name)
        a, b = np.array(TRUSTED_SOLE) * (sole.half or (0.0, 0.0))
        mu = TRUSTED_FRICTION * sole.friction
        found += [
            FrictionCone(space=space, mu=mu, sides=8, name=f"{sole.name} friction"),
            Footprint(space=space, half=(float(a), float(b)), name=f"{sole.name} footprint"),
        ]
    return tuple(found)


def _standing(model: mujoco.MjModel, robot: Robot) -> Vector:
    """Return home (nq), lowered until the soles carry the weight."""
    weight = pin.computeTotalMass(robot.model) * -float(model.opt.gravity[2])
    data, hold = mujoco.MjData(model), _holding_torque(robot)
    hold = coordinates(model, robot).qfrc_from_pinocchio(robot.home, hold)
    low, high = -PENETRATION, 0.0
    for _ in range(60):
        middle = (low + high) / 2
        lifts = _ground_force(model, data, hold, middle) > weight
        low, high = (middle, high) if lifts else (low, middle)
    q = robot.home.copy()
    q[2] += high
    return q


def _holding_torque(robot: Robot) -> Vector:
    """Return B τ (nv) [Nm] that holds still at home, with the least wrenches at the soles."""
    data, local = robot.model.createData(), pin.ReferenceFrame.LOCAL
    g = pin.computeGeneralizedGravity(robot.model, data, robot.home)
    J = np.vstack(
        [
            pin.computeFrameJacobian(robot.model, data, robot.home, robot.frame_id(name), local)
            for name in SOLES
        ]
    )
    undriven = ~robot.B.any(axis=1)
    F = np.linalg.lstsq(J[:, undriven].T, g[undriven], rcond=None)[0]
    held: Vector = np.where(undriven, 0.0, g - J.T @ F)
    return held


def _lifted(robot: Robot, lift: float) -> Vector:
    """Return home (nq), ``lift`` [m] above it.

    Raises:
        InputError: a sole does not touch the ground then, or is deep in it.
    """
    q = robot.home.copy()
    q[2] += lift
    for name in SOLES:
        height = float(robot.pose(q, name).translation[2])
        if not -PENETRATION <= height < 0.0:
            where = "above the ground" if height >= 0 else "deep in the ground"
            raise InputError(
                f"lift: got {1e3 * lift:g} mm, which puts {name.replace('_', ' ')} "
                f"{1e3 * abs(height):.3g} mm {where}; need both soles on it, at most "
                f"{1e3 * PENETRATION:g} mm deep"
            )
    return q


def _ground_force(model: mujoco.MjModel, data: mujoco.MjData, hold: Vector, height: float) -> float:
    """Return the normal force [N] of the ground ``height`` [m] above home, at rest."""
    total, force = 0.0, np.zeros(6)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    data.qpos[2] += height
    data.qfrc_applied[:] = hold
    mujoco.mj_forward(model, data)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        total += float(force[0])
    return total
