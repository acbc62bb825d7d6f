"""The QP in both forms, from the same terms.

    min  Σ w/2 ‖J a + J̇v − a_cmd‖²_Λ + Σ w/2 ‖Aᵀλ − F_cmd‖²_{Λ⁻¹} + Σ w/2 ‖a − a_post‖²_{M_N}
    s.t. M a + h + Jᵀ Aᵀ λ = B τ,   A (J a + J̇v) + Ȧ V = v̇_c,   bounds on τ and a,
          λ ≥ 0 where the contact is one-sided, W Aᵀ λ ≤ what it can carry

A mode with `slack` has no constraint rows; ½ w_s ‖A (J a + J̇v) + Ȧ V − v̇_c‖²_{S⁻¹} is among its
costs in a.

`full` has x = (a, τ, λ). `reduced` has x = (a, λ): the driven part of the dynamics turns the
torque bounds into rows, and what B leaves undriven stays as an equality.
"""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from qpctrl.arrays import Matrix
from qpctrl.contact import WrenchRows
from qpctrl.factor import Factor
from qpctrl.limit import UNBOUNDED, Bounds
from qpctrl.spatial import SX


class QpExpressions(NamedTuple):
    """``min ½ xᵀHx + gᵀx  s.t.  A x = b,  lb ≤ C x ≤ ub``, and how x gives the torque.

    The first nu rows of C are those of the torque: τ = C[:nu] x + t.
    """

    H: SX
    g: SX
    A: SX
    b: SX
    C: SX
    lb: SX
    ub: SX
    t: SX
    x_eq: SX
    """Minimiser without the inequalities."""
    y_eq: SX
    """Its multipliers of the equalities."""


class RowNames(NamedTuple):
    """What each row of the QP is."""

    constraint: tuple[str, ...]
    """The k rows of A in the order of λ; among the equalities unless they have slack."""
    equality: tuple[str, ...]
    inequality: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class QpTerms:
    """Costs and physics of one tick, before they are arranged into a form."""

    H_a: SX
    """Hessian of the motion and posture costs in a (nv×nv)."""
    g_a: SX
    H_lam: SX
    """Hessian of the force costs in λ (k×k)."""
    g_lam: SX
    M: SX
    h: SX
    """Bias with known external wrenches (nv) [Nm]."""
    AJ: SX
    """Constraint rows on joint acceleration (k×nv), all constraints stacked."""
    b_c: SX
    """v̇_c − Ȧ V − A J̇v (k)."""
    slack: bool
    """Whether ``AJ a − b_c`` is a cost, part of H_a and g_a, and not zero."""
    searched: bool
    """Whether the minimiser without inequalities is left out, zeros in its place."""
    B: Matrix
    torque: Bounds
    acceleration: Bounds
    contact: WrenchRows
    """Limits on λ (rows×k), all spaces together."""
    unilateral: tuple[bool, ...]
    joint_names: tuple[str, ...]
    actuator_names: tuple[str, ...]
    constraint_rows: tuple[str, ...]
    contact_rows: tuple[str, ...]

    @property
    def nv(self) -> int:
        """Number of accelerations."""
        return len(self.joint_names)

    @property
    def k(self) -> int:
        """Number of constraint rows."""
        return len(self.constraint_rows)

    @property
    def held(self) -> int:
        """Number of constraint rows that are equalities."""
        return 0 if self.slack else self.k

    @property
    def nu(self) -> int:
        """Number of torques."""
        return len(self.actuator_names)


def reduced_qp(terms: QpTerms) -> tuple[QpExpressions, RowNames]:
    """Return the QP in (a, λ)."""
    driven, held = np.linalg.pinv(terms.B), terms.held
    undriven = complement(terms.B)
    dynamics = ca.horzcat(terms.M, terms.AJ.T)
    T, t = ca.SX(driven) @ dynamics, ca.SX(driven) @ terms.h
    rows = ca.horzcat(terms.AJ[:held, :], ca.SX.zeros(held, terms.k))
    A = ca.vertcat(rows, ca.SX(undriven) @ dynamics)
    b = ca.vertcat(terms.b_c[:held, :], -(ca.SX(undriven) @ terms.h))
    torque = Bounds(terms.torque.lb - t, terms.torque.ub - t)
    x, y = _without_inequalities(terms, A, b)
    qp = _arrange(terms, ca.SX(0, 0), A, b, T, torque)
    return qp._replace(t=t, x_eq=x, y_eq=y), _names(
        terms, tuple(f"undriven {i}" for i in range(len(undriven)))
    )


def full_qp(terms: QpTerms) -> tuple[QpExpressions, RowNames]:
    """Return the QP in (a, τ, λ), dynamics and all."""
    nu, k, held = terms.nu, terms.k, terms.held
    select = ca.horzcat(ca.SX.zeros(nu, terms.nv), ca.SX.eye(nu), ca.SX.zeros(nu, k))
    A = ca.vertcat(
        ca.horzcat(terms.AJ[:held, :], ca.SX.zeros(held, nu + k)),
        ca.horzcat(terms.M, -ca.SX(terms.B), terms.AJ.T),
    )
    b = ca.vertcat(terms.b_c[:held, :], -terms.h)
    reduced, _ = reduced_qp(terms)
    a, lam = ca.vertsplit(reduced.x_eq, [0, terms.nv, terms.nv + k])
    tau = reduced.C[:nu, :] @ reduced.x_eq + reduced.t
    y_c, y_undriven = ca.vertsplit(reduced.y_eq, [0, held, held + terms.nv - nu])
    y = ca.vertcat(y_c, ca.SX(complement(terms.B)).T @ y_undriven)
    qp = _arrange(terms, ca.SX.zeros(nu, nu), A, b, select, terms.torque)
    dynamics = tuple(f"dynamics {name}" for name in terms.joint_names)
    whole = qp._replace(t=ca.SX.zeros(nu), x_eq=ca.vertcat(a, tau, lam), y_eq=y)
    return whole, _names(terms, dynamics)


FORMS = {"reduced": reduced_qp, "full": full_qp}
"""The forms of the QP, by name."""


def _arrange(
    terms: QpTerms, H_tau: SX, A: SX, b: SX, torque_rows: SX, torque: Bounds
) -> QpExpressions:
    size = terms.nv + H_tau.shape[0] + terms.k
    pushes = [i for i, one_sided in enumerate(terms.unilateral) if one_sided]
    identity = ca.SX.eye(size)
    lam_rows = identity[[size - terms.k + i for i in pushes], :]
    contact = terms.contact
    contact_rows = ca.horzcat(ca.SX(contact.W.shape[0], size - terms.k), contact.W)
    open_end = UNBOUNDED * ca.SX.ones(len(pushes))
    return QpExpressions(
        H=ca.diagcat(terms.H_a, H_tau, terms.H_lam),
        g=ca.vertcat(terms.g_a, ca.SX.zeros(H_tau.shape[0]), terms.g_lam),
        A=A,
        b=b,
        C=ca.vertcat(torque_rows, identity[: terms.nv, :], lam_rows, contact_rows),
        lb=ca.vertcat(
            *(torque.lb, terms.acceleration.lb, ca.SX.zeros(len(pushes))),
            -UNBOUNDED * ca.SX.ones(contact.W.shape[0]),
        ),
        ub=ca.vertcat(torque.ub, terms.acceleration.ub, open_end, contact.ub),
        t=ca.SX(0, 0),
        x_eq=ca.SX(0, 0),
        y_eq=ca.SX(0, 0),
    )


def _without_inequalities(terms: QpTerms, A: SX, b: SX) -> tuple[SX, SX]:
    """Return x = (a, λ) and multipliers of the reduced form with its equalities alone.

    With H = diag(H_a, H_λ):  y = −(A H⁻¹ Aᵀ)⁻¹ (b + A H⁻¹ g),  x = −H⁻¹ (g + Aᵀ y).
    """
    nv = terms.nv
    if terms.searched:
        return ca.SX.zeros(nv + terms.k), ca.SX.zeros(A.shape[0])
    H_a = Factor(terms.H_a)
    H_lam = Factor(terms.H_lam) if terms.k else None

    def solve(rhs: SX) -> SX:
        a, lam = ca.vertsplit(rhs, [0, nv, nv + terms.k])
        return ca.vertcat(H_a.solve(a), H_lam.solve(lam)) if H_lam else H_a.solve(a)

    g = ca.vertcat(terms.g_a, terms.g_lam)
    if A.shape[0] == 0:
        x, y = -solve(g), ca.SX(0, 1)
    else:
        S = H_a.congruence(A[:, :nv].T)
        if H_lam:
            S = S + H_lam.congruence(A[:, nv:].T)
        y = -Factor(S).solve(b + A @ solve(g))
        x = -solve(g + A.T @ y)
    return x, y


def _names(terms: QpTerms, dynamics: tuple[str, ...]) -> RowNames:
    rows = terms.constraint_rows
    pushes = zip(rows, terms.unilateral, strict=True)
    inequality = (
        *(f"torque {name}" for name in terms.actuator_names),
        *(f"acceleration {name}" for name in terms.joint_names),
        *(f"unilateral {row}" for row, one_sided in pushes if one_sided),
        *(f"contact {row}" for row in terms.contact_rows),
    )
    return RowNames(rows, rows[: terms.held] + dynamics, inequality)


def complement(B: Matrix) -> Matrix:
    """Return rows (nv−nu × nv) that span what B does not drive."""
    left, _, _ = np.linalg.svd(B)
    return np.ascontiguousarray(left[:, B.shape[1] :].T)
