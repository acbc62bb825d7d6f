"""The scene of the mobile arm: a long board, and an arm with an eraser on a base that drives."""

import mujoco
import numpy as np

from scenarios.plant_model import check_agreement, frame_pose, robot_from_mujoco
from scenarios.robot_file import MODELS, compile_spec, home_of, robot_spec
from scenarios.world import PAIR, TOOL, Pad, World, add_sensors

BASE = ("base_x", "base_y", "base_yaw")
"""Joints of the base, in the order of its configuration."""

CARRIAGE = "carriage"
"""Frame in the middle of the base, on the ground, with the axes of the world at home."""

BOARD_LEFT = 2.3
"""Way [m] along the board from in front of the tool at home to its far edge."""

_FILE = "mobile_arm"
_BOARD = "board"  # its body, its geom and the site of its frame


def mobile_world(*, pad: Pad, fixed_base: bool, dt: float) -> World:
    """Return the scene of ``mobile_arm.xml``, in the form of that of an arm.

    Args:
        pad: contact of eraser and board.
        fixed_base: whether the base is bolted to the ground, and has no joints then.
        dt: time step [s].

    Raises:
        ModelMismatchError: MuJoCo and pinocchio disagree on the robot.
    """
    spec = robot_spec(str(MODELS / f"{_FILE}.xml"))
    if fixed_base:
        _bolt(spec)
    _name_board(spec, pad)
    add_sensors(spec)
    spec.option.timestep = dt
    model = compile_spec(spec, _FILE)
    home = home_of(model, None)
    robot = robot_from_mujoco(model, home)
    check_agreement(model, robot, TOOL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    X_WE = frame_pose(model, data, _BOARD)
    return World(model=model, robot=robot, X_WE=X_WE, X_WE_true=X_WE, pad=pad)


def _bolt(spec: mujoco.MjSpec) -> None:
    """Take the joints of the base away, with their limits and their part of home."""
    for name in BASE:
        spec.delete(spec.joint(name))
    for numeric in spec.numerics:
        numeric.data = np.asarray(numeric.data)[len(BASE) :]
        numeric.size = len(numeric.data)
    for key in spec.keys:
        key.qpos = np.asarray(key.qpos)[len(BASE) :]


def _name_board(spec: mujoco.MjSpec, pad: Pad) -> None:
    """Give board and contact the names and the felt that plants know them by."""
    name = PAIR.partition("/")[0] + "/board"
    board, (pair,) = spec.body(_BOARD), spec.pairs
    spec.geom(_BOARD).name = name
    board.name, pair.name, pair.geomname2 = name, PAIR, name
    pair.friction = [pad.friction, pad.friction, 0.0, 0.0, 0.0]
    pair.solref, pair.solimp = pad.solref, [*pad.solimp, 0.5, 2.0]
