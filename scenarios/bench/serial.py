"""Arms with as many joints as are asked for: FR3 arms in series, each on the flange of the last.

In series, since that is the dearest tree with n joints: every joint moves the tool and all links
after it, so no entry of M and J is zero, and n alone changes from one arm to the next. A torso
with two arms of the same n is cheaper.
"""

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector
from qpctrl.errors import InputError
from qpctrl.robot import Limits, Robot
from scenarios.robot_file import load_robot

TOOL = "flange"
"""Frame at the end."""

STRETCHED = 2.0
"""Torque limit over what holds the arm stretched out, beside the FR3's own."""

RATE = 20.0
"""Torque rate over torque limit [1/s]."""


def serial_arm(joints: int) -> Robot:
    """Return an arm with the FR3's links and joints; those that are over stand at the base.

    Args:
        joints: how many, at least 7; 7 is the FR3 itself.

    Raises:
        InputError: fewer than 7.
    """
    fr3 = load_robot("fr3")
    if joints < fr3.nv:
        raise InputError(f"joints: got {joints}, need at least {fr3.nv}")
    if joints == fr3.nv:
        return fr3
    own = fr3.model
    flange = own.frames[fr3.frame_id(TOOL)].placement
    model = pin.Model()
    model.name = f"serial_{joints}"
    model.gravity.linear = own.gravity.linear
    kinds = [(i - joints) % fr3.nv + 1 for i in range(joints)]  # the last is the FR3's last
    for i, kind in enumerate(kinds):
        place = own.jointPlacements[kind]
        if i and kind == 1:
            place = flange * place
        joint = model.addJoint(i, own.joints[kind], place, f"joint{i + 1}")
        model.appendBodyToJoint(joint, own.inertias[kind], pin.SE3.Identity())
    model.addFrame(pin.Frame(TOOL, joints, 0, flange, pin.FrameType.OP_FRAME))
    at = np.array(kinds) - 1
    model.armature = np.array(own.armature)[at]
    tau_max = fr3.limits.tau_max[at] + STRETCHED * _stretched(model)
    limits = Limits(
        q_min=fr3.limits.q_min[at],
        q_max=fr3.limits.q_max[at],
        v_max=fr3.limits.v_max[at],
        tau_max=tau_max,
        tau_rate=RATE * tau_max,
    )
    return Robot(model=model, limits=limits, home=fr3.home[at])


def _stretched(model: pin.Model) -> Vector:
    """Return the torque [Nm] that would hold each joint (nv) if all beyond it lay in one line."""
    steps = [float(np.linalg.norm(place.translation)) for place in model.jointPlacements]
    where = np.cumsum(steps)
    weight = 9.81 * np.array([inertia.mass for inertia in model.inertias])
    return np.array(
        [float(weight[i:] @ (where[i:] - where[i] + 0.1)) for i in range(1, model.njoints)]
    )
