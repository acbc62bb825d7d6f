"""Any surface φ(p) = 0: a point on it (k = 1), or a face tangent to it (k = 3)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import final

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Vector, finite_array, positive
from qpctrl.constraint.environment import (
    body_gradient,
    need_six_axes,
    pose_in_environment,
    pose_inputs,
)
from qpctrl.constraint.pfaffian import PfaffianRows, differentiate
from qpctrl.constraint.pose_constraint import expression, try_at
from qpctrl.errors import InputError
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX, SymbolicPose


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """The origin of the tool frame stays on φ(p) = 0; with ``face`` its z axis on the normal.

    n = ∇φ/‖∇φ‖ points into the environment. The rows: nᵀ v = 0 and, for a face with the axes
    x and y of the tool, d/dt (x·n) = d/dt (y·n) = 0, all by automatic differentiation.

    Inputs: ``X_WE`` (3×4), the believed pose of the surface.
    Source: LynchPark2017 §2.4.
    """

    space: TaskSpace
    X_WE: pin.SE3
    """Frame of the surface in which φ is written."""
    phi: SX
    """The function φ(p), growing into the environment."""
    p: SX
    """Symbol (3) of the point in ``phi`` [m]."""
    contact: pin.SE3
    """A pose X_EF in contact, at which the rows are tried."""
    face: bool = False
    """Whether a face around the point stays tangent (k = 3)."""
    name: str = "surface"
    _A: ca.Function = field(init=False, repr=False)

    def __post_init__(self) -> None:
        need_six_axes(self.space, "surface")
        phi = expression(self.phi, {"p": (self.p, (3, 1))}, f"{self.name}.phi")
        if phi.shape != (1, 1):
            raise InputError(f"{self.name}.phi: got shape {phi.shape}, need one number")
        gradient = ca.Function("gradient", [self.p], [ca.gradient(phi, self.p)])
        steep = np.array(gradient(self.contact.translation))
        if np.isfinite(steep).all() and not np.linalg.norm(steep) > 1e-12:
            raise InputError(f"constraint {self.name!r}: zero gradient at the contact")
        R, p = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3)
        slope = gradient(p)
        normal = slope / ca.sqrt(ca.sumsqr(slope))
        rows = [ca.horzcat(normal.T @ R, ca.SX.zeros(1, 3))]
        if self.face:
            rows.append(body_gradient(R[:, :2].T @ normal, R, p))
        A = ca.Function("A", [R, p], [ca.vertcat(*rows)])
        try_at(A, self.contact, self.name)
        object.__setattr__(self, "_A", A)

    @property
    def row_names(self) -> tuple[str, ...]:
        """Translation into the surface, rotations that tip the face."""
        return ("normal", "tip_x", "tip_y") if self.face else ("normal",)

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """The surface is pushed, never pulled."""
        return (True, False, False) if self.face else (True,)

    def inputs(self) -> dict[str, Array]:
        """Return the believed pose of the surface."""
        return pose_inputs(self.X_WE)

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the rows at the current pose."""

        def A(X_WF: SymbolicPose) -> SX:
            return self._A(*pose_in_environment(X_WF, u))

        return differentiate(A, motion)


def sphere(center: Vector, radius: float) -> tuple[SX, SX]:
    """Return φ = r − ‖p − c‖ and its symbol p: a ball of ``radius`` [m] about ``center`` (3) [m].

    Raises:
        InputError: a radius that is not positive, or a centre that is not finite.
    """
    p, r = ca.SX.sym("p", 3), float(positive(radius, (), "radius"))
    away = p - ca.SX(finite_array(center, (3,), "center"))
    return r - ca.sqrt(ca.sumsqr(away)), p


def cylinder(radius: float) -> tuple[SX, SX]:
    """Return φ = r − √(x² + y²) and its symbol p: a rod of ``radius`` [m] along z.

    Raises:
        InputError: a radius that is not positive.
    """
    p, r = ca.SX.sym("p", 3), float(positive(radius, (), "radius"))
    return r - ca.sqrt(ca.sumsqr(p[:2])), p


def saddle(a: float, b: float) -> tuple[SX, SX]:
    """Return φ = z − a x²/2 + b y²/2 and its symbol p: curvatures ``a``, −``b`` [1/m] at 0.

    Raises:
        InputError: a curvature that is not positive.
    """
    p = ca.SX.sym("p", 3)
    a, b = float(positive(a, (), "a")), float(positive(b, (), "b"))
    return p[2] - a * p[0] ** 2 / 2 + b * p[1] ** 2 / 2, p
