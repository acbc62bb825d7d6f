"""Where MuJoCo and pinocchio meet: one model for both, and the check that they agree.

MuJoCo keeps a body's pose relative to its parent body and joint anchors apart from it;
pinocchio keeps joint placements. Both include the armature in M here.
"""

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl.errors import InputError, ModelMismatchError
from qpctrl.robot import DEFAULT_TORQUE_RATE, Robot, from_pinocchio

AGREEMENT = 1e-9
"""Largest relative difference of M, h or J between the engines that is accepted."""

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


def robot_from_mujoco(model: mujoco.MjModel, home: np.ndarray | None = None) -> Robot:
    """Return the robot of a compiled model; its bodies and sites become named frames.

    Limits come from the joints (range, actuator force range) and, for speed and torque rate,
    from custom numerics ``velocity_limit`` [rad/s] and ``torque_rate_limit`` [Nm/s].

    Raises:
        InputError: a joint is neither hinge nor slide.
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
    tree.lowerPositionLimit, tree.upperPositionLimit = _ranges(model)
    effort = _effort(model)
    tree.upperEffortLimit, tree.lowerEffortLimit = effort, -effort
    speed = _numeric(model, "velocity_limit", 0.0)
    tree.upperVelocityLimit, tree.lowerVelocityLimit = speed, -speed
    rate = _numeric(model, "torque_rate_limit", DEFAULT_TORQUE_RATE)
    return from_pinocchio(tree, home=home, tau_rate=rate)


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
    if model.nv != robot.nv:
        raise ModelMismatchError(f"MuJoCo has {model.nv} joints, pinocchio {robot.nv}")
    lo = np.maximum(robot.limits.q_min, -np.pi)
    hi = np.minimum(robot.limits.q_max, np.pi)
    for _ in range(states):
        q, v = rng.uniform(lo, hi), rng.normal(size=robot.nv)
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
    order = joint_order(model, robot)
    data.qpos[:], data.qvel[:] = q[order], v[order]
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
    J_theirs = pin.computeFrameJacobian(robot.model, other, q, fid, world)
    M_theirs = upper + np.triu(upper, 1).T
    return {
        "M": (M, M_theirs[np.ix_(order, order)]),
        "h": (data.qfrc_bias.copy(), pin.nonLinearEffects(robot.model, other, q, v)[order]),
        "J": (J, J_theirs.reshape(6, robot.nv)[:, order]),
    }


def joint_order(model: mujoco.MjModel, robot: Robot) -> list[int]:
    """Return pinocchio's index of each joint of MuJoCo; the two may list branches differently."""
    names = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
    if set(names) != set(robot.joint_names):
        raise ModelMismatchError(
            f"robot {robot.name!r}: MuJoCo has joints {', '.join(names)}, pinocchio "
            f"{', '.join(robot.joint_names)}"
        )
    return [robot.joint_names.index(name) for name in names]


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
        name, axis = model.joint(j).name or f"joint{j}", model.jnt_axis[j].copy()
        if model.jnt_type[j] not in (_HINGE, _SLIDE):
            raise InputError(f"joint {name!r}: need hinge or slide, got a ball or free joint")
        revolute = model.jnt_type[j] == _HINGE
        kind = pin.JointModelRevoluteUnaligned if revolute else pin.JointModelPrismaticUnaligned
        anchor = pin.SE3(np.eye(3), model.jnt_pos[j].copy())
        joint = tree.addJoint(joint, kind(axis), X_JB * anchor, name)
        X_JB = anchor.inverse()
    if model.body_mass[body] > 0 and joint > 0:
        X_BI = _pose(model.body_ipos[body], model.body_iquat[body])
        about_com = X_BI.rotation @ np.diag(model.body_inertia[body]) @ X_BI.rotation.T
        inertia = pin.Inertia(float(model.body_mass[body]), X_BI.translation, about_com)
        tree.appendBodyToJoint(joint, inertia, X_JB)
    _add_frame(tree, model.body(body).name, joint, X_JB)
    return joint, X_JB


def _add_frame(tree: pin.Model, name: str, joint: int, X_JF: pin.SE3) -> None:
    if name and not tree.existFrame(name):
        tree.addFrame(pin.Frame(name, joint, 0, X_JF, pin.FrameType.OP_FRAME), False)


def _pose(position: np.ndarray, quaternion: np.ndarray) -> pin.SE3:
    w, x, y, z = (float(part) for part in quaternion)
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), position.copy())


def _ranges(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    limited = model.jnt_limited.astype(bool)
    lower = np.where(limited, model.jnt_range[:, 0], -np.inf)
    return lower, np.where(limited, model.jnt_range[:, 1], np.inf)


def _effort(model: mujoco.MjModel) -> np.ndarray:
    limited = model.jnt_actfrclimited.astype(bool)
    return np.where(limited, model.jnt_actfrcrange[:, 1], 0.0)  # 0 means none


def _numeric(model: mujoco.MjModel, name: str, default: float) -> np.ndarray:
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    if index < 0:
        return np.full(model.nv, default)
    values = np.array(model.numeric(index).data, dtype=np.float64)
    if values.shape != (model.nv,):
        raise InputError(f"numeric {name!r}: got {values.size} values, need {model.nv}")
    return values
