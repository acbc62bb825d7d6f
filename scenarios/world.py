"""The scene: a robot holding the eraser in front of a board."""

from dataclasses import dataclass
from typing import Literal, get_args

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, positive
from qpctrl.errors import InputError, unknown_name
from qpctrl.robot import Robot
from scenarios.plant_model import check_agreement, frame_pose, robot_from_mujoco
from scenarios.robot_file import MODELS, compile_spec, home_of, robot_spec

TOOL = "eraser/tool"
"""Frame at the centre of the pad's face, z into the board."""

EDGE = "eraser/edge"
"""Frame at the middle of the pad's long edge at y = 25 mm of `TOOL`, with the axes of that."""

SENSOR = "eraser/ft"
"""Frame of the force-torque sensor, between arm and eraser."""

PAIR = "qpctrl/pad on board"
"""The only contact of the scene."""

Tip = Literal["pad", "ball"]
"""What touches the board: the flat felt (up to k = 3), or a ball (k = 1) with `TOOL` at its end."""

BALL_RADIUS = 0.01
"""Of the ball [m]."""

_SMALLEST_SINGULAR = 0.02  # of the tool's Jacobian at home; below it no scenario starts


@dataclass(frozen=True, kw_only=True)
class Pad:
    """Contact of the felt pad with the board, in MuJoCo's terms."""

    friction: float = 0.3
    """Coulomb friction [1]."""
    solref: tuple[float, float] = (0.01, 1.0)
    """Time constant [s] and damping ratio of the contact."""
    solimp: tuple[float, float, float] = (0.0, 0.95, 0.002)
    """Impedance at touch, impedance when pressed in, and that depth [m]: felt starts soft."""


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A compiled scene and the robot in it."""

    model: mujoco.MjModel
    robot: Robot
    X_WE: pin.SE3
    """Board frame, as believed: origin on its surface in front of the tool, z into the board."""
    X_WE_true: pin.SE3
    """Board frame, as it is."""
    pad: Pad
    """Contact with the board."""


def build_world(
    robot: str,
    *,
    tool: str = "flange",
    home: tuple[float, ...] | None = None,
    clearance: float = 0.03,
    pad: Pad | None = None,
    tip: Tip = "pad",
    radius: float = BALL_RADIUS,
    board_error: pin.SE3 | None = None,
    dt: float = 1e-3,
) -> World:
    """Return the scene with the eraser on frame ``tool`` and the board ``clearance`` [m] ahead.

    Args:
        robot: name or file of the robot.
        tool: site, body or link that carries the eraser, z pointing away from the arm.
        home: start configuration [rad or m]; default: the file's own.
        clearance: free distance between pad and board at home [m].
        pad: contact properties.
        tip: what touches the board, in the place of the pad's face.
        radius: of a ball [m].
        board_error: pose of the true board in the believed one: X_WE_true = X_WE * error, which
            turns it about its origin in front of the tool; default: none. `MujocoPlant` can do
            the same to a world that is built.
        dt: time step [s].

    Raises:
        InputError: no such frame or tip, or the arm is singular at home.
        ModelMismatchError: MuJoCo and pinocchio disagree on the scene's robot.
    """
    spec = robot_spec(robot)
    q_home = home_of(compile_spec(spec.copy(), robot), home)
    _mount_eraser(spec, tool, tip, radius)
    X_WE, pad = _board_pose(spec, robot, q_home, clearance), pad or Pad()
    X_WE_true = X_WE if board_error is None else X_WE * board_error
    _add_board(spec, X_WE_true, pad)
    add_sensors(spec)
    _add_surroundings(spec)
    spec.option.timestep = dt
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    model = compile_spec(spec, robot)
    described = robot_from_mujoco(model, q_home)
    check_agreement(model, described, TOOL)
    return World(model=model, robot=described, X_WE=X_WE, X_WE_true=X_WE_true, pad=pad)


def place_board(model: mujoco.MjModel, X_WE: pin.SE3) -> None:
    """Put the board of a compiled scene at ``X_WE``."""
    board = model.body("qpctrl/board")
    board.pos[:], board.quat[:] = X_WE.translation, _quaternion(X_WE)


def set_pad(model: mujoco.MjModel, pad: Pad) -> None:
    """Give the contact with the board of a compiled scene other properties."""
    pair = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PAIR, PAIR)
    model.pair_friction[pair, :2] = pad.friction
    model.pair_solref[pair] = pad.solref
    model.pair_solimp[pair, :3] = pad.solimp


def _mount_eraser(spec: mujoco.MjSpec, tool: str, tip: Tip, radius: float) -> None:
    eraser = mujoco.MjSpec.from_file(str(MODELS / "eraser.xml"))
    if tip == "ball":
        r, ball = float(positive(radius, (), "radius")), eraser.geom("pad")
        end = ball.pos[2] + ball.size[2]
        ball.type, ball.size, ball.pos = mujoco.mjtGeom.mjGEOM_SPHERE, [r, 0, 0], [0, 0, end - r]
    elif tip != "pad":
        raise unknown_name("tip", tip, get_args(Tip))
    site, body = spec.site(tool), spec.body(tool)
    if site is not None:
        spec.attach(eraser, site=site, prefix="eraser/")
    elif body is not None:
        spec.attach(eraser, frame=body.add_frame(), prefix="eraser/")
    else:
        names = [item.name for item in (*spec.sites, *spec.bodies) if item.name]
        raise unknown_name("tool frame", tool, names)


def _board_pose(spec: mujoco.MjSpec, robot: str, q_home: Array, clearance: float) -> pin.SE3:
    model = compile_spec(spec.copy(), robot)
    data = mujoco.MjData(model)
    data.qpos[:] = q_home
    mujoco.mj_forward(model, data)
    J = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, J[:3], J[3:], model.site(TOOL).id)
    smallest = np.linalg.svd(J, compute_uv=False)[min(6, model.nv) - 1]
    if model.nv < 6 or smallest < _SMALLEST_SINGULAR:
        raise InputError(
            f"robot {robot!r}: cannot move the eraser in all six directions from home "
            f"{np.round(data.qpos, 3).tolist()} ({model.nv} joints, smallest singular value "
            f"{smallest:.3g}, need {_SMALLEST_SINGULAR}); give another --home"
        )
    X_WT = frame_pose(model, data, TOOL)
    return X_WT * pin.SE3(np.eye(3), np.array([0.0, 0.0, clearance]))


def _add_board(spec: mujoco.MjSpec, X_WE: pin.SE3, pad: Pad) -> None:
    half = np.array([0.35, 0.5, 0.01])
    board = spec.worldbody.add_body(
        name="qpctrl/board", pos=X_WE.translation, quat=_quaternion(X_WE)
    )
    board.add_geom(
        name="qpctrl/board",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=half,
        pos=[0, 0, half[2]],
        rgba=[0.12, 0.28, 0.22, 1],
        contype=0,
        conaffinity=0,
    )
    for x in (-half[0] - 0.015, half[0] + 0.015):
        board.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[0.015, half[1] + 0.03, 0.018],
            pos=[x, 0, 0.012],
            rgba=[0.55, 0.38, 0.22, 1],
            contype=0,
            conaffinity=0,
        )
    spec.add_pair(
        name=PAIR,
        geomname1="eraser/pad",
        geomname2="qpctrl/board",
        condim=3,
        friction=[pad.friction, pad.friction, 0.0, 0.0, 0.0],
        solref=pad.solref,
        solimp=[*pad.solimp, 0.5, 2.0],
        margin=0.0,
        gap=0.0,
    )


def add_sensors(spec: mujoco.MjSpec) -> None:
    """Add what the wrench on the eraser is measured with, in the frame `SENSOR`."""
    for name, kind in (
        ("force", mujoco.mjtSensor.mjSENS_FORCE),
        ("torque", mujoco.mjtSensor.mjSENS_TORQUE),
        ("accelerometer", mujoco.mjtSensor.mjSENS_ACCELEROMETER),
        ("gyro", mujoco.mjtSensor.mjSENS_GYRO),
        ("angular acceleration", mujoco.mjtSensor.mjSENS_FRAMEANGACC),
    ):
        spec.add_sensor(
            name=f"qpctrl/{name}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=SENSOR
        )


def _add_surroundings(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[3, 3, 0.1],
        rgba=[0.82, 0.82, 0.80, 1],
        contype=0,
        conaffinity=0,
    )
    spec.worldbody.add_light(pos=[-1.0, -1.5, 3.0], dir=[0.4, 0.5, -1.0])


def _quaternion(X: pin.SE3) -> Array:
    x, y, z, w = pin.Quaternion(X.rotation).coeffs()
    return np.array([w, x, y, z])
