"""A robot with one degree of freedom: a mass on a straight rail."""

import numpy as np
import pinocchio as pin

from qpctrl.robot import Robot, from_pinocchio
from qpctrl.space import TaskSpace

SPACE = TaskSpace("tool", ("vx",))
"""The only direction of the slider."""

UNLIMITED_RATE = 1e9  # N/s


def slider(mass: float) -> Robot:
    """Return a ``mass`` [kg] that slides along x with the frame ``tool``, without limits."""
    model = pin.Model()
    model.name = "slider"
    model.gravity.linear = np.zeros(3)
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.appendBodyToJoint(
        joint, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity()
    )
    model.addFrame(pin.Frame("tool", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return from_pinocchio(model, home=np.zeros(1), tau_rate=UNLIMITED_RATE)
