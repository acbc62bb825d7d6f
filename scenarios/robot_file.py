"""Robots by name or file: our own MJCF, or any user's MJCF or URDF, as an editable spec."""

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl.errors import InputError, QpctrlError, unknown_name
from qpctrl.robot import Robot, from_pinocchio
from qpctrl.urdf import urdf_text, xml_root
from scenarios.plant_model import check_agreement, joint_order, robot_from_mujoco

MODELS = Path(__file__).parent / "models"

ROBOTS = ("fr3", "planar_2r", "ur5")
"""Robots that ship with the package; each has a site ``flange`` and a keyframe ``home``."""


def load_robot(robot: str, home: tuple[float, ...] | None = None) -> Robot:
    """Return a robot by name (`ROBOTS`) or file (.xml MJCF, .urdf), as a controller sees it.

    Raises:
        InputError: unknown name, missing or unreadable file, wrong home.
        ModelMismatchError: two engines read the file differently.
    """
    spec = robot_spec(robot)
    model = compile_spec(spec, robot)
    loaded = robot_from_mujoco(model, home_of(model, home))
    check_agreement(model, loaded, loaded.frame_names[-1])
    return loaded


def robot_spec(robot: str) -> mujoco.MjSpec:
    """Return the spec of a robot by name or file, without its own contacts and actuators.

    Torques are applied to the joints, gravity is the controller's business, and the only
    contact of a scenario is the one that it declares. So actuators, sensors, tendons, gravity
    compensation, collisions, joint damping, friction and springs, air drag and option flags of the
    file are switched off. Equality constraints are refused.
    """
    path = MODELS / f"{robot}.xml" if robot in ROBOTS else Path(robot)
    if not _exists(path):
        if path.suffix in (".xml", ".urdf", ".mjcf"):
            raise InputError(f"robot file {robot!r} does not exist")
        raise unknown_name("robot", robot, (*ROBOTS, "FILE.xml", "FILE.urdf"))
    spec = _urdf_spec(path) if path.suffix == ".urdf" else _mjcf_spec(path)
    if len(spec.equalities):
        names = ", ".join(repr(item.name) for item in spec.equalities)
        raise InputError(f"{path}: equality constraints ({names}) are not supported; remove them")
    _strip(spec)
    return spec


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a name that no file system takes
        return False


def _strip(spec: mujoco.MjSpec) -> None:
    """Switch off what the controller's model does not have: see `robot_spec`."""
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    for body in spec.bodies:
        body.gravcomp = 0
    for joint in spec.joints:
        joint.damping = np.zeros_like(joint.damping)
        joint.stiffness = np.zeros_like(joint.stiffness)
        joint.frictionloss = 0
    for item in (*spec.actuators, *spec.sensors, *spec.tendons):
        spec.delete(item)
    for key in spec.keys:
        key.ctrl = key.act = []
    spec.option.density = spec.option.viscosity = 0
    spec.option.wind = np.zeros(3)
    spec.option.disableflags = spec.option.enableflags = 0


def compile_spec(spec: mujoco.MjSpec, name: str) -> mujoco.MjModel:
    """Return the compiled model.

    Raises:
        InputError: MuJoCo refuses the file, or it is no arm on a fixed base.
    """
    try:
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"robot {name!r}: {_one_line(error)}") from error
    if model.nv == 0:
        raise InputError(f"robot {name!r}: has no joints")
    if model.nq != model.nv:
        raise InputError(
            f"robot {name!r}: has a ball or a floating body; need hinge or slide joints"
        )
    return model


def home_of(model: mujoco.MjModel, home: tuple[float, ...] | None) -> np.ndarray:
    """Return the given home, else keyframe ``home``, the first keyframe, or the mid-range."""
    if home is not None:
        if len(home) != model.nq or not np.isfinite(home).all():
            raise InputError(f"home: got {list(home)}, need {model.nq} finite numbers")
        low, high = model.jnt_range.T
        outside = model.jnt_limited.astype(bool) & ((home < low) | (home > high))
        if outside.any():
            j = int(outside.argmax())
            room = f"need {low[j]:g} to {high[j]:g}"
            raise InputError(f"home: joint {model.joint(j).name!r} at {home[j]:g}, {room}")
        return np.array(home, dtype=np.float64)
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    if model.nkey:
        return np.array(model.key_qpos[max(index, 0)])
    limited = model.jnt_limited.astype(bool)
    return np.where(limited, model.jnt_range.mean(axis=1), 0.0)


def _mjcf_spec(path: Path) -> mujoco.MjSpec:
    root = xml_root(path)
    if root.tag == "robot":
        return _urdf_spec(path)
    if root.tag != "mujoco":
        raise InputError(f"{path}: got <{root.tag}>, need <mujoco> (MJCF) or <robot> (URDF)")
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{path}: {_one_line(error)}") from error


def _urdf_spec(path: Path) -> mujoco.MjSpec:
    """Return MuJoCo's reading of a URDF, refused where pinocchio reads another robot."""
    text = urdf_text(path)
    options = '<mujoco><compiler fusestatic="false" balanceinertia="false"/></mujoco>'
    try:
        spec = mujoco.MjSpec.from_string(text.replace("</robot>", f"{options}</robot>"))
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{path}: {_one_line(error)}") from error
    model = compile_spec(spec.copy(), str(path))
    try:
        other = from_pinocchio(pin.buildModelFromXML(text))
    except (ValueError, RuntimeError) as error:
        if isinstance(error, QpctrlError):
            raise
        raise InputError(f"{path}: {_one_line(error)}") from error
    shared = [model.body(i).name for i in range(1, model.nbody)]
    check_agreement(model, other, [name for name in shared if name in other.frame_names][-1])
    v_max = other.limits.v_max[joint_order(model, other)]
    speed = np.where(np.isinf(v_max), 0.0, v_max)  # 0 means none
    spec.add_numeric(name="velocity_limit", size=len(speed), data=speed)
    return spec


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
