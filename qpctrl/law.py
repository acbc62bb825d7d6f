"""The closed forms: projector, constrained dynamics, `textbook` and `hybrid` laws.

    S = A Λ⁻¹ Aᵀ,  P = I − Aᵀ S⁻¹ A Λ⁻¹
    λ = S⁻¹ [A Λ⁻¹ (F − η) + Ȧ V − v̇_c]
    textbook:  τ = h + Jᵀ (P Λ a_cmd + (I−P) F_cmd − Λ J̇v) + Nᵀ M a_post
    hybrid:    τ = textbook − Jᵀ Aᵀ S⁻¹ (Ȧ V − v̇_c)

Source: LynchPark2017 §11.6.2; the last term is derived in docs/formulation.md.
"""

from typing import Literal, NamedTuple

import casadi as ca

from qpctrl.constraint.pfaffian import PfaffianRows
from qpctrl.factor import Factor
from qpctrl.space import SpaceTerms
from qpctrl.spatial import SX

Law = Literal["qp", "hybrid", "textbook"]
"""Whose torque is sent."""


class Split:
    """The task space of size n, divided by k constraint rows.

    Attributes:
        A, A_dot_V, v_c, v_c_dot: the rows (k×n, k, k, k).
        S: mobility of the constrained directions (k×k).
        P: projector (n×n) on wrenches that move the frame; I − P keeps those that press.
    """

    def __init__(self, rows: PfaffianRows, Lambda_inv: SX) -> None:
        self.A, self.A_dot_V, self.v_c, self.v_c_dot = rows
        self._Lambda_inv = Lambda_inv
        self.S = self.A @ Lambda_inv @ self.A.T
        self._S = Factor(self.S) if self.k else None
        identity = ca.SX.eye(Lambda_inv.shape[0])
        self.P = identity - self.A.T @ self._solve(self.A @ Lambda_inv)

    @property
    def k(self) -> int:
        """Number of rows."""
        return int(self.A.shape[0])

    @property
    def pivot_ratios(self) -> SX:
        """Near 0 for a row that depends on the rows before it (k)."""
        return self._S.pivot_ratios if self._S else ca.SX(0, 1)

    @property
    def curvature_wrench(self) -> SX:
        """Aᵀ S⁻¹ (Ȧ V − v̇_c) (n) [N, Nm]: what the textbook law presses too much."""
        return self.held_wrench(self.A_dot_V - self.v_c_dot)

    def multiplier(self, F_cmd: SX) -> SX:
        """Return λ (k) that the hybrid law produces for the commanded wrench (n)."""
        return self._solve(self.A @ self._Lambda_inv @ F_cmd)

    def held_wrench(self, acceleration: SX) -> SX:
        """Return Aᵀ S⁻¹ x (n) [N, Nm], the wrench that changes A V̇ by ``acceleration`` x (k)."""
        return self.A.T @ self._solve(acceleration)

    def held_inertia(self, J: SX) -> SX:
        """Return Jᵀ Aᵀ S⁻¹ A J (nv×nv), the part of M that A's rows hold."""
        return self._S.congruence(ca.densify(self.A @ J)) if self._S else ca.SX(*(2 * J.shape[1:]))

    def _solve(self, rhs: SX) -> SX:
        return self._S.solve(rhs) if self._S else ca.SX(0, rhs.shape[1])


class LawTorque(NamedTuple):
    """Both closed forms at one state."""

    textbook: SX
    """τ (nv) [Nm] of the law as printed."""
    hybrid: SX
    """τ (nv) [Nm] without its curvature error."""
    curvature: SX
    """textbook − hybrid (nv) [Nm]."""
    a: SX
    """Acceleration (nv) that the hybrid law produces."""
    lam: SX
    """Multiplier λ (k) that the hybrid law produces."""


class LawTerms(NamedTuple):
    """What the closed forms need."""

    terms: SpaceTerms
    split: Split
    M_factor: Factor
    h: SX
    """Bias with known external wrenches (nv) [Nm]."""
    M_N: SX
    """Null-space inertia Nᵀ M (nv×nv)."""
    a_cmd: SX
    """Commanded acceleration (n) [m/s², rad/s²]."""
    F_cmd: SX
    """Commanded wrench on the environment (n) [N, Nm]."""
    a_post: SX
    """Commanded posture acceleration (nv) [rad/s²]."""


def closed_forms(law: LawTerms) -> LawTorque:
    """Return `textbook` and `hybrid` for one task space and B = I."""
    terms, P = law.terms, law.split.P
    lam = law.split.multiplier(law.F_cmd)
    moving = P @ (terms.Lambda @ law.a_cmd)
    pressing = law.split.A.T @ lam  # (I − P) F_cmd
    posture = law.M_N @ law.a_post
    textbook = law.h + terms.J.T @ (moving + pressing - terms.Lambda @ terms.J_dot_v) + posture
    curvature = terms.J.T @ law.split.curvature_wrench
    hybrid = textbook - curvature
    a = law.M_factor.solve(hybrid - law.h - terms.J.T @ (law.split.A.T @ lam))
    return LawTorque(textbook, hybrid, curvature, a, lam)
