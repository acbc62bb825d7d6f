"""What constraints in a frame E of the environment share: its pose, and derivatives of poses."""

from collections.abc import Mapping

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Rotation
from qpctrl.errors import InputError
from qpctrl.space import CentroidalSpace, TaskSpace
from qpctrl.spatial import AXES, SX, SymbolicPose, compose, inverse


def need_six_axes(space: TaskSpace, what: str) -> None:
    """Refuse a space that does not have all six axes.

    Raises:
        InputError: axes are missing or in another order, or it is that of the centre of mass.
    """
    if isinstance(space, CentroidalSpace):
        raise InputError(f"{what} needs the space of a frame, got that of the centre of mass")
    if space.axes != AXES:
        raise InputError(f"{what} needs the axes {' '.join(AXES)}, got {' '.join(space.axes)}")


def need_rotation(R: Rotation, name: str) -> None:
    """Refuse what is not a rotation matrix.

    Raises:
        InputError: wrong shape, not orthogonal, or a reflection.
    """
    R = np.asarray(R)
    if R.shape != (3, 3) or not np.allclose(R.T @ R, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0:
        raise InputError(f"{name}: need a rotation matrix (3×3)")


def pose_inputs(X_WE: pin.SE3) -> dict[str, Array]:
    """Return the input ``X_WE`` (3×4): rotation and translation [m] of E in the world."""
    return {"X_WE": np.ascontiguousarray(X_WE.homogeneous[:3])}


def pose_in_environment(X_WF: SymbolicPose, u: Mapping[str, SX]) -> SymbolicPose:
    """Return X_EF, the pose of the tool frame in E."""
    X_WE = SymbolicPose(u["X_WE"][:, :3], u["X_WE"][:, 3])
    return compose(inverse(X_WE), X_WF)


def axes_of_environment(X_EF: SymbolicPose) -> SX:
    """Return the rows (6×6) that turn a twist in F into its components along the axes of E.

    The point whose velocity is taken stays the origin of F.
    """
    return ca.diagcat(X_EF.R, X_EF.R)


def twist_at_environment(X_EF: SymbolicPose) -> SX:
    """Return Ad_{X_EF} (6×6), which maps a twist in F to the same twist in E, at its origin."""
    lever = ca.skew(X_EF.p) @ X_EF.R
    return ca.vertcat(ca.horzcat(X_EF.R, lever), ca.horzcat(ca.SX(3, 3), X_EF.R))


def body_gradient(c: SX, R: SX, p: SX) -> SX:
    """Return ∂ċ/∂V (m×6) of ``c(R, p)`` (m), along ṗ = R v and Ṙ = R [ω]×, exactly."""
    by_rotation = [ca.jtimes(c, ca.vec(R), ca.vec(R @ ca.skew(ca.SX(axis)))) for axis in np.eye(3)]
    return ca.densify(ca.horzcat(ca.jacobian(c, p) @ R, *by_rotation))
