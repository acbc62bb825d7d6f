"""Proof of a level: multipliers of its own QP, and how well they and its point satisfy it.

The QP of level i has the rows A and those of the levels above as equalities, C as inequalities.
A limit that presses at a level above presses for good; below it was worked with as an equality,
whose multiplier may have the wrong sign. What is added to put that right is the balance of forces
at the level above, Cᵀz + Aᵀy + Σ Gⱼᵀyⱼ = 0, as often as it takes.
"""

from collections.abc import Sequence

import numpy as np

from qpctrl.arrays import Array, Vector
from qpctrl.priority.basis import Basis
from qpctrl.priority.cascade import Press
from qpctrl.solver import QpData


def multipliers(
    basis: Basis, force: Vector, fixed: int, z: Vector, above: Sequence[Press], rows: int
) -> Vector:
    """Return the multipliers of a level's QP: of C (r), then of A and of the levels above.

    Args:
        basis: what is fixed; its rows are called by their places in the result.
        force: H x + g + Cᵀz (n), which the first ``fixed`` rows hold.
        fixed: number of rows fixed above the level.
        z: multipliers of C at this level (r).
        above: the levels above, from the first.
        rows: length of the result.
    """
    found = np.zeros(rows)
    found[: len(z)] = z
    basis.multipliers(force, fixed, found)
    for press in reversed(above):
        pressed = press.z.nonzero()[0]
        if len(pressed) == 0:
            continue
        share = found[pressed] / press.z[pressed]
        if share.min() >= 0:
            continue
        balance = np.zeros(rows)
        balance[: len(press.z)] = press.z
        basis.multipliers(press.force, press.fixed, balance)
        found -= share.min() * balance
        found[pressed[share.argmin()]] = 0.0
    return found


def kkt_residual(qp: QpData, x: Vector, y: Vector, z: Vector) -> float:
    """Return the largest of four residuals: stationarity, equality, inequality, complementarity.

    Bounds that are none are infinite.
    Each is its largest entry over the largest of the terms that it balances, or over 1 where
    those are smaller, as in `build_certificate`.
    """
    Ax, Cx = qp.A @ x, qp.C @ x
    terms = np.stack([qp.H @ x, qp.g, y @ qp.A, z @ qp.C])
    above, below = qp.ub - Cx, Cx - qp.lb
    slack = np.where(z > 0, above, below)
    push = z * np.where(np.isfinite(slack), slack, 1.0)
    return max(
        _largest(terms.sum(axis=0)) / max(1.0, _largest(terms)),
        _largest(Ax - qp.b) / max(1.0, _largest(Ax), _largest(qp.b)),
        -np.minimum(above, below).min(initial=0.0) / max(1.0, _largest(Cx)),
        _largest(push) / max(1.0, _largest(z)),
    )


def _largest(values: Array) -> float:
    return float(np.abs(values).max(initial=0.0))
