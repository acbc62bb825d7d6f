"""Where MuJoCo and pinocchio meet: one model for both, and the check that they agree.

MuJoCo keeps a body's pose relative to its parent body and joint anchors apart from it;
pinocchio keeps joint placements. Both include the armature in M here. A free joint becomes a
floating body of the same name; what its coordinates are, `scenarios.plant_coordinates` says.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl.arrays import finite_array
from qpctrl.errors import InputError, ModelMismatchError
from qpctrl.robot import DEFAULT_TORQUE_RATE, Robot, from_pinocchio
from scenarios.plant_coordinates import coordinates

AGREEMENT = 1e-9
"""Largest relative difference of M, h or J between the engines that is accepted."""

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def robot_from_mujoco(model: mujoco.MjModel, home: np.ndarray | None = None) -> Robot:
    """Return the robot of a compiled model; its bodies and sites become named frames.

    Limits come from the joints (range, actuator force range) and, for speed and torque rate,
    from custom numerics ``velocity_limit`` [rad/s or m/s] and ``torque_rate_limit`` [Nm/s or
    N/s], with one entry for each hinge and slide. Every hinge and slide is driven, no free joint.

    Args:
        model: the plant.
        home: start configuration as ``qpos`` of MuJoCo (nq) [m, rad].

    Raises:
        InputError: a ball joint, a numeric of another size, or no such home.
    """
    tree = pin.Model()
    tree.name = model.names[: model.names.index(b"\0")].decode()
    tree.gravity.linear = model.opt.gravity.copy()
    holder = {0: (0, pin.SE3.Identity())}  # body → (pinocchio joint, pose of the body in it)
    for body in range(1, model.nbody):
        holder[body] = _add_body(tree, model, body, holder[int(model.body_parentid[body])])
    for site in range(model.nsite):
        joint, X_JB = holder[int(model.site_bodyid[site])]
        X_BS = _pose(model.site_pos[site], model.site_quat[site])
        _add_frame(tree, model.site(site).name, joint, X_JB * X_BS)
    tree.armature = model.dof_armature.copy()
    _set_limits(tree, model)
    rate = _numeric(model, "torque_rate_limit", DEFAULT_TORQUE_RATE)
    robot = from_pinocchio(tree, tau_rate=rate)
    if home is None:
        return robot
    qpos = finite_array(home, (model.nq,), "home")
    return replace(robot, home=coordinates(model, robot).q_from_mujoco(qpos))


def check_agreement(model: mujoco.MjModel, robot: Robot, frame: str, states: int = 5) -> None:
    """Compare M, h and J of MuJoCo and pinocchio at random states.

    Args:
        model: the plant.
        robot: what the controller believes.
        frame: a site or body of the plant, and frame of the robot, for J.
        states: number of random states.

    Raises:
        ModelMismatchError: a term differs by more than 1e-9 of its largest entry.
    """
    rng = np.random.default_rng(0)
    data, other = mujoco.MjData(model), robot.model.createData()
    lo = np.maximum(robot.limits.q_min, -np.pi)
    hi = np.minimum(robot.limits.q_max, np.pi)
    for _ in range(states):
        q = robot.integrate(pin.neutral(robot.model), rng.uniform(lo, hi))
        v = rng.normal(size=robot.nv)
        for term, (ours, theirs) in _terms(model, data, robot, other, frame, q, v).items():
            gap = np.abs(ours - theirs).max() / max(np.abs(theirs).max(), 1e-3)
            if not gap <= AGREEMENT:
                raise ModelMismatchError(
                    f"robot {robot.name!r}: {term} of MuJoCo and pinocchio differ by {gap:.1e} "
                    f"of its largest entry, allowed {AGREEMENT:.0e}; the file says something that "
                    "only one of them understands"
                )


def frame_pose(model: mujoco.MjModel, data: mujoco.MjData, frame: str) -> pin.SE3:
    """Return ``X_WF`` of a site or body, from the last forward pass."""
    kind, index = _locate(model, frame)
    holder = data.site(index) if kind == "site" else data.body(index)
    position = holder.xpos
    return pin.SE3(holder.xmat.reshape(3, 3).copy(), position.copy())


def _terms(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    robot: Robot,
    other: pin.Data,
    frame: str,
    q: np.ndarray,
    v: np.ndarray,
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return each term of both engines, along MuJoCo's velocities: v = T q̇, a = T q̈ + drift."""
    both = coordinates(model, robot)
    T, drift = both.T(q), both.drift(v)
    data.qpos[:], data.qvel[:] = both.qpos_from_pinocchio(q), both.qvel_from_pinocchio(q, v)
    mujoco.mj_forward(model, data)
    M = np.zeros((robot.nv, robot.nv))
    mujoco.mj_fullM(model, data, M)
    kind, index = _locate(model, frame)
    J = np.zeros((6, robot.nv))
    jacobian = mujoco.mj_jacSite if kind == "site" else mujoco.mj_jacBody
    jacobian(model, data, J[:3], J[3:], index)
    upper = np.triu(pin.crba(robot.model, other, q))
    fid = robot.frame_id(frame)
    pin.framesForwardKinematics(robot.model, other, q)
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    J_theirs = pin.computeFrameJacobian(robot.model, other, q, fid, world).reshape(6, robot.nv)
    M_theirs = upper + np.triu(upper, 1).T
    h_theirs = pin.nonLinearEffects(robot.model, other, q, v) + M_theirs @ drift
    return {
        "M": (M, T.T @ M_theirs @ T),
        "h": (data.qfrc_bias.copy(), T.T @ h_theirs),
        "J": (J, J_theirs @ T),
    }


def joint_order(model: mujoco.MjModel, robot: Robot) -> list[int]:
    """Return pinocchio's index of each velocity of MuJoCo; they may list branches differently."""
    return [int(index) for index in coordinates(model, robot).qvel_at]


def _locate(model: mujoco.MjModel, frame: str) -> tuple[str, int]:
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, frame)
    if index >= 0:
        return "site", index
    return "body", mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, frame)


def _add_body(
    tree: pin.Model, model: mujoco.MjModel, body: int, parent: tuple[int, pin.SE3]
) -> tuple[int, pin.SE3]:
    joint, X_PB = parent
    X_JB = X_PB * _pose(model.body_pos[body], model.body_quat[body])
    for j in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
        name, kind = model.joint(j).name or f"joint{j}", int(model.jnt_type[j])
        if kind == _FREE:  # its coordinates are the body's pose in the world
            joint = tree.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
            X_JB = pin.SE3.Identity()
            continue
        anchor = pin.SE3(np.eye(3), model.jnt_pos[j].copy())
        joint = tree.addJoint(joint, _moves(kind, model.jnt_axis[j], name), X_JB * anchor, name)
        X_JB = anchor.inverse()
    if model.body_mass[body] > 0 and joint > 0:
        X_BI = _pose(model.body_ipos[body], model.body_iquat[body])
        about_com = X_BI.rotation @ np.diag(model.body_inertia[body]) @ X_BI.rotation.T
        inertia = pin.Inertia(float(model.body_mass[body]), X_BI.translation, about_com)
        tree.appendBodyToJoint(joint, inertia, X_JB)
    _add_frame(tree, model.body(body).name, joint, X_JB)
    return joint, X_JB


def _moves(kind: int, axis: np.ndarray, name: str) -> pin.JointModel:
    if kind == _HINGE:
        return pin.JointModelRevoluteUnaligned(axis.copy())
    if kind == _SLIDE:
        return pin.JointModelPrismaticUnaligned(axis.copy())
    raise InputError(f"joint {name!r}: got a ball joint, need hinge, slide or free")


def _add_frame(tree: pin.Model, name: str, joint: int, X_JF: pin.SE3) -> None:
    if name and not tree.existFrame(name):
        tree.addFrame(pin.Frame(name, joint, 0, X_JF, pin.FrameType.OP_FRAME), False)


def _pose(position: np.ndarray, quaternion: np.ndarray) -> pin.SE3:
    w, x, y, z = (float(part) for part in quaternion)
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), position.copy())


def _set_limits(tree: pin.Model, model: mujoco.MjModel) -> None:
    """Give each hinge and slide its limits, and free joints none (0 means none but for q)."""
    single = _single(model)
    at_q, at_v = model.jnt_qposadr[single], model.jnt_dofadr[single]
    none = np.array([[-np.inf], [np.inf]])
    bounds, effort, speed = np.tile(none, model.nq), np.zeros(model.nv), np.zeros(model.nv)
    bounds[:, at_q] = np.where(model.jnt_limited, model.jnt_range.T, none)[:, single]
    effort[at_v] = np.where(model.jnt_actfrclimited, model.jnt_actfrcrange[:, 1], 0.0)[single]
    speed[at_v] = _numeric(model, "velocity_limit", 0.0)
    tree.lowerPositionLimit, tree.upperPositionLimit = bounds
    tree.upperEffortLimit, tree.lowerEffortLimit = effort, -effort
    tree.upperVelocityLimit, tree.lowerVelocityLimit = speed, -speed


def _numeric(model: mujoco.MjModel, name: str, default: float) -> np.ndarray:
    size = int(_single(model).sum())
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    if index < 0:
        return np.full(size, default)
    values = np.array(model.numeric(index).data, dtype=np.float64)
    if values.shape != (size,):
        raise InputError(
            f"numeric {name!r}: got {values.size} values, need {size}, one for each hinge and slide"
        )
    return values


def _single(model: mujoco.MjModel) -> np.ndarray:
    return np.isin(model.jnt_type, (_HINGE, _SLIDE))
