"""Task spaces: named axes of one frame, with their kinematics and inertia.

Λ⁻¹ = J M⁻¹ Jᵀ,  J̄ = M⁻¹ Jᵀ Λ,  η = J̄ᵀ h − Λ J̇v.
Source: Khatib1987; LynchPark2017 §8.6.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from qpctrl.arrays import Matrix, Vector
from qpctrl.dynamics import Dynamics
from qpctrl.errors import InputError, unknown_name
from qpctrl.factor import Factor
from qpctrl.spatial import AXES, SX, SymbolicPose

LEAST_MOBILITY = 1e-6
"""Smallest eigenvalue of a constant metric over its largest."""

IMMOBILE = 1e-12
"""Largest mobility [1/kg, 1/(kg m²)] up to which a frame counts as fixed."""


@dataclass(frozen=True)
class TaskSpace:
    """Axes of the body twist of a frame, expressed in that frame.

    A planar arm uses ``("vx", "vy")``; everything holds for that n. The twist is that in the
    world, or as seen from another frame of the robot: that of a hand from the box that it holds.
    """

    frame: str
    axes: tuple[str, ...] = AXES
    relative_to: str | None = None
    """Frame from which the motion is seen; none: the world."""

    def __post_init__(self) -> None:
        for axis in self.axes:
            if axis not in AXES:
                raise unknown_name("axis", axis, AXES)
        if not self.axes or len(set(self.axes)) < len(self.axes):
            raise InputError(f"axes: got {self.axes}, need one or more different ones of {AXES}")
        if self.frame == self.relative_to:
            raise InputError(f"task space: got frame {self.frame!r} seen from itself, need another")

    @property
    def n(self) -> int:
        """Number of axes."""
        return len(self.axes)

    @property
    def index(self) -> list[int]:
        """Position of each axis among the six of a twist."""
        return [AXES.index(axis) for axis in self.axes]

    @property
    def turns(self) -> bool:
        """Whether an angular axis is among them."""
        return any(axis.startswith("w") for axis in self.axes)


@dataclass(frozen=True)
class CentroidalSpace(TaskSpace):
    """Axes of the momentum about the centre of mass, in the axes of the world.

    Its "velocity" is the momentum h_G = A_G v [kg m/s, kg m²/s], its inertia the inverse of mass
    and composite inertia: the costs of a motion of it have the unit of all others.
    Source: Orin2013.
    """

    frame: str = "centre of mass"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.relative_to is not None:
            raise InputError(
                f"centre of mass: got relative_to {self.relative_to!r}; it is seen from the world"
            )


class FrameMotion(NamedTuple):
    """Pose and twist of the frame of a task space."""

    space: TaskSpace
    X_WF: SymbolicPose
    """Pose in the world, or in the frame from which it is seen; of a centre of mass its place."""
    V_full: SX
    """Body twist (6) [m/s, rad/s]; of a centre of mass the momentum [kg m/s, kg m²/s]."""

    @property
    def V(self) -> SX:
        """Twist along the axes of the space (n)."""
        return self.V_full[self.space.index]


class SpaceTerms(NamedTuple):
    """Expressions of one task space at (q, v)."""

    space: TaskSpace
    motion: FrameMotion
    """Pose and twist of the frame."""
    J: SX
    """Jacobian of the space's axes (n×nv)."""
    J_dot_v: SX
    """Drift (n) [m/s², rad/s²]."""
    Lambda_inv: SX
    """Inverse of the task-space inertia (n×n)."""
    Lambda: SX
    """Task-space inertia (n×n)."""
    task_inertia: SX
    """JᵀΛJ (nv×nv), the part of M that the task space takes; empty where Λ is a constant."""
    root: SX
    """R (n×nv) with RᵀR = JᵀΛJ where Λ is a constant; else empty."""
    mobility_left: SX
    """1 / Λ_ii (n), the mobility along an axis while the others are held, over the frame's mobility
    in all directions of the same unit; 0 at a singularity. Empty where Λ is a constant."""


def terms_here(space: TaskSpace, dynamics: Dynamics, M_factor: Factor, mu: SX) -> SpaceTerms:
    """Return the terms with the inertia of the robot where it is, damped by ``mu``."""
    motion, J_full, drift = _kinematics(space, dynamics)
    index, J = space.index, ca.densify(J_full[space.index, :])
    mobility = M_factor.congruence(ca.densify(J_full.T))
    Lambda_inv = mobility[index, index] + mu * ca.SX.eye(space.n)
    factor = Factor(Lambda_inv)
    Lambda = factor.congruence(ca.SX.eye(space.n))
    left = 1 / (ca.diag(Lambda) * _whole_mobility(mobility)[index])
    inertia, drift, none = factor.congruence(J), ca.densify(drift[index]), ca.SX(0, 0)
    return SpaceTerms(space, motion, J, drift, Lambda_inv, Lambda, inertia, none, left)


def terms_at_home(
    spaces: Iterable[TaskSpace], dynamics: Dynamics, home: Vector
) -> dict[TaskSpace, SpaceTerms]:
    """Return the terms of each space with a constant inertia, that at ``home`` (nq).

    No eigenvalue of its mobility J M⁻¹ Jᵀ is below `LEAST_MOBILITY` of the largest: a home that is
    singular still gives a metric.

    Raises:
        InputError: a frame is fixed to what it is seen from.
    """
    moved = {space: _kinematics(space, dynamics) for space in spaces}
    rows = {space: J_full[space.index, :] for space, (_, J_full, _) in moved.items()}
    here = ca.Function("home", [dynamics.q], [dynamics.M, *map(ca.densify, rows.values())])
    M, *found = (np.array(term) for term in here.call([ca.DM(home)]))
    terms = {}
    for (space, (motion, _, drift)), J_home in zip(moved.items(), found, strict=True):
        Lambda_inv = _metric(space, J_home @ np.linalg.solve(M, J_home.T))
        Lambda, J = np.linalg.inv(Lambda_inv), rows[space]
        root = ca.sparsify(ca.SX(np.linalg.cholesky(Lambda).T)) @ J
        constants = ca.SX(Lambda_inv), ca.SX(Lambda)
        none, left = ca.SX(0, 0), ca.SX(0, 1)
        drift = ca.densify(drift[space.index])
        terms[space] = SpaceTerms(space, motion, J, drift, *constants, none, root, left)
    return terms


def _metric(space: TaskSpace, mobility: Matrix) -> Matrix:
    """Return a mobility (n×n) with all eigenvalues raised to what a metric needs."""
    values, vectors = np.linalg.eigh(mobility)
    if not values[-1] > IMMOBILE:
        seen = f" seen from {space.relative_to!r}" if space.relative_to else ""
        raise InputError(f"task space: frame {space.frame!r} does not move{seen}")
    kept = np.maximum(values, LEAST_MOBILITY * values[-1])
    raised: Matrix = (vectors * kept) @ vectors.T
    return raised


def _kinematics(space: TaskSpace, dynamics: Dynamics) -> tuple[FrameMotion, SX, SX]:
    """Return motion, Jacobian (6×nv) and drift (6) of all axes of the frame of a space."""
    if isinstance(space, CentroidalSpace):
        _, p_WC, J, drift = dynamics.centroid()
        X_WF = SymbolicPose(ca.SX.eye(3), p_WC)
    else:
        name, other = space.frame, space.relative_to
        X_WF, J, drift = dynamics.frame(name) if other is None else dynamics.relative(name, other)
    return FrameMotion(space, X_WF, ca.densify(J @ dynamics.v)), J, drift


def _whole_mobility(mobility: SX) -> SX:
    """Return, for each axis (6), the trace of the frame's mobility over the axes of its unit."""
    linear, angular = ca.trace(mobility[:3, :3]), ca.trace(mobility[3:, 3:])
    return ca.fmax(ca.vertcat(linear, linear, linear, angular, angular, angular), 1e-12)
