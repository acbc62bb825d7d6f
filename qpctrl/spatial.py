"""Spatial algebra as CasADi expressions: linear first, ``(v, ω)`` and ``(f, m)``.

A pose ``X_AB`` maps coordinates in B to coordinates in A and is held as its rotation ``R``
(3×3) and translation ``p`` [m]. *Modern Robotics* orders twists angular first; the two
orders meet only in `angular_first` and `linear_first`.
"""

from typing import NamedTuple, TypeAlias

import casadi as ca
import numpy as np

from qpctrl.arrays import Array

SX: TypeAlias = ca.SX

AXES = ("vx", "vy", "vz", "wx", "wy", "wz")
"""Names of the six twist axes, in order."""

_SMALL_ANGLE_SQUARED = 1e-3  # rad²; below it a series to θ⁶ is exact to 2e-20


class SymbolicPose(NamedTuple):
    """Pose ``X_AB``: rotation ``R`` (3×3) and translation ``p`` (3) [m]."""

    R: SX
    p: SX


def compose(X_AB: SymbolicPose, X_BC: SymbolicPose) -> SymbolicPose:
    """Return ``X_AC = X_AB * X_BC``."""
    return SymbolicPose(X_AB.R @ X_BC.R, X_AB.p + X_AB.R @ X_BC.p)


def inverse(X_AB: SymbolicPose) -> SymbolicPose:
    """Return ``X_BA``."""
    return SymbolicPose(X_AB.R.T, -(X_AB.R.T @ X_AB.p))


def skew(w: SX) -> SX:
    """Return ``[w]×``, the 3×3 matrix with ``[w]× u = w × u``."""
    return ca.skew(w)


def motion_to_parent(X_AB: SymbolicPose, V_B: SX) -> SX:
    """Return ``Ad_{X_AB} V_B``: a twist in B's coordinates, in A's."""
    angular = X_AB.R @ V_B[3:]
    return ca.vertcat(X_AB.R @ V_B[:3] + ca.cross(X_AB.p, angular), angular)


def motion_to_child(X_AB: SymbolicPose, V_A: SX) -> SX:
    """Return ``Ad_{X_BA} V_A``: a twist in A's coordinates, in B's."""
    return ca.vertcat(
        X_AB.R.T @ (V_A[:3] - ca.cross(X_AB.p, V_A[3:])),
        X_AB.R.T @ V_A[3:],
    )


def force_to_parent(X_AB: SymbolicPose, F_B: SX) -> SX:
    """Return the wrench ``F_B`` in A's coordinates, about A's origin."""
    force = X_AB.R @ F_B[:3]
    return ca.vertcat(force, X_AB.R @ F_B[3:] + ca.cross(X_AB.p, force))


def motion_cross(V: SX, W: SX) -> SX:
    """Return ``ad_V W``: the rate of a twist ``W`` fixed in a frame moving with ``V``."""
    linear = ca.cross(V[3:], W[:3]) + ca.cross(V[:3], W[3:])
    return ca.vertcat(linear, ca.cross(V[3:], W[3:]))


def force_cross(V: SX, F: SX) -> SX:
    """Return ``-ad_Vᵀ F``: the rate of a wrench ``F`` fixed in a frame moving with ``V``."""
    angular = ca.cross(V[3:], F[3:]) + ca.cross(V[:3], F[:3])
    return ca.vertcat(ca.cross(V[3:], F[:3]), angular)


def log6(X: SymbolicPose) -> SX:
    """Return the twist ``[log X]`` (6) [m, rad], for rotation angles below π."""
    half_cos = ca.sqrt(ca.fmax(1.0 + ca.trace(X.R), 1e-12)) / 2
    antisymmetric = ca.vertcat(X.R[2, 1] - X.R[1, 2], X.R[0, 2] - X.R[2, 0], X.R[1, 0] - X.R[0, 1])
    half_axis = antisymmetric / (4 * half_cos)  # axis · sin(θ/2)
    half_sin = ca.sqrt(ca.sumsqr(half_axis))
    theta = 2 * ca.atan2(half_sin, half_cos)
    small = theta**2 < _SMALL_ANGLE_SQUARED
    stretch = ca.if_else(
        half_sin < 1e-9, 2 / half_cos, theta / ca.if_else(half_sin < 1e-9, 1, half_sin)
    )
    w = stretch * half_axis
    series = 1 / 12 + theta**2 / 720 + theta**4 / 30240 + theta**6 / 1209600
    safe = ca.if_else(small, 1, half_sin)
    closed = (1 - theta / 2 * half_cos / safe) / ca.if_else(small, 1, theta**2)
    curl = ca.cross(w, X.p)
    linear = X.p - curl / 2 + ca.if_else(small, series, closed) * ca.cross(w, curl)
    return ca.vertcat(linear, w)


def angular_first(spatial: Array) -> Array:
    """Return twists or wrenches (…, 6), linear first, in *Modern Robotics* order."""
    return np.concatenate([spatial[..., 3:], spatial[..., :3]], axis=-1)


def linear_first(spatial: Array) -> Array:
    """Return twists or wrenches (…, 6), angular first, in this library's order."""
    return angular_first(spatial)
