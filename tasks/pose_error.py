"""Pose error on SE(3) and the transported feed-forward, which several tasks share.

    [X_e] = log(X⁻¹ X_d),  V_e = Ad_{X⁻¹X_d} V_d − V
    d/dt(Ad_T V_d) = Ad_T V̇_d + ad_{Ad_T V_d} V

Source: LynchPark2017 §11.3.3.
"""

from collections.abc import Mapping
from typing import NamedTuple, final

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Twist
from qpctrl.errors import InputError
from qpctrl.factor import Factor
from qpctrl.space import CentroidalSpace, FrameMotion, TaskSpace
from qpctrl.spatial import (
    SX,
    SymbolicPose,
    compose,
    inverse,
    log6,
    motion_cross,
    motion_to_parent,
)

STILL: Twist = np.zeros(6)
"""No motion (6) [m/s, rad/s], [m/s², rad/s²]."""
STILL.flags.writeable = False  # references share it

AT_REST = {"X_WD": np.eye(4)[:3], "V_des": STILL, "V_dot_des": STILL}
"""Inputs of a pose reference: the identity pose, at rest."""


@final
class MotionReference:
    """Where the frame shall be, and how it shall move there.

    Arrays are kept as they are given: a motion that is laid out ahead, row by row, is not
    copied at its ticks.

    Attributes:
        arrays: the task inputs that this reference sets.
    """

    __slots__ = ("arrays",)

    def __init__(
        self,
        *,
        X_WD: pin.SE3 | Array,
        V_des: Twist = STILL,
        V_dot_des: Twist = STILL,
        gains: Mapping[str, Array] | None = None,
    ) -> None:
        """Describe the reference.

        Args:
            X_WD: desired pose of the frame in the world, as SE(3) or as [R p] (3×4) [1, m].
            V_des: desired body twist (6) [m/s, rad/s], in the desired frame.
            V_dot_des: its derivative (6) [m/s², rad/s²].
            gains: inputs of the task to change from this tick on, by name; default: none.
        """
        pose = X_WD if isinstance(X_WD, np.ndarray) else X_WD.homogeneous[:3]
        self.arrays = {"X_WD": pose, "V_des": V_des, "V_dot_des": V_dot_des}
        if gains:
            self.arrays.update(gains)

    @property
    def X_WD(self) -> pin.SE3:
        """Desired pose of the frame in the world."""
        pose = self.arrays["X_WD"]
        return pin.SE3(pose[:, :3], pose[:, 3])

    @property
    def V_des(self) -> Twist:
        """Desired body twist (6) [m/s, rad/s], in the desired frame."""
        return self.arrays["V_des"]

    @property
    def V_dot_des(self) -> Twist:
        """Its derivative (6) [m/s², rad/s²]."""
        return self.arrays["V_dot_des"]


class PoseError(NamedTuple):
    """How the frame differs from its reference, along the axes of a space."""

    X_e: SX
    """Pose error (n) [m, rad]."""
    V_e: SX
    """Twist error (n) [m/s, rad/s]."""
    feed_forward: SX
    """d/dt(Ad_{X⁻¹X_d} V_d) (n) [m/s², rad/s²]."""


def pose_error(space: TaskSpace, motion: FrameMotion, u: Mapping[str, SX]) -> PoseError:
    """Return the errors; a space without angular axes compares positions alone.

    Raises:
        InputError: the space is that of the centre of mass, which has no pose.
    """
    if isinstance(space, CentroidalSpace):
        raise InputError("a pose is that of a frame; for the centre of mass use CentreOfMassTask")
    X_WD = SymbolicPose(u["X_WD"][:, :3], u["X_WD"][:, 3])
    turning = ca.vertcat(1, 1, 1, *[float(space.turns)] * 3)
    V_des, V_dot_des = turning * u["V_des"], turning * u["V_dot_des"]
    X_FD = compose(inverse(motion.X_WF), X_WD)
    V_transported = motion_to_parent(X_FD, V_des)
    feed_forward = motion_to_parent(X_FD, V_dot_des) + motion_cross(V_transported, motion.V_full)
    X_e = log6(X_FD) if space.turns else ca.vertcat(X_FD.p, ca.SX.zeros(3))
    i = space.index
    return PoseError(X_e[i], (V_transported - motion.V_full)[i], feed_forward[i])


def motion_signals(error: PoseError, motion: FrameMotion) -> dict[str, SX]:
    """Return what every task on a pose records: errors, pose (3×4) and body twist (6)."""
    pose = ca.horzcat(motion.X_WF.R, motion.X_WF.p)
    return {"X_e": error.X_e, "V_e": error.V_e, "X_WF": pose, "V": motion.V_full}


def free_directions(A: SX) -> SX:
    """Return I − A⁺A (n×n), which drops the components along the rows of A."""
    n = A.shape[1]
    if A.shape[0] == 0:
        return ca.SX.eye(n)
    return ca.SX.eye(n) - A.T @ Factor(A @ A.T).solve(A)
