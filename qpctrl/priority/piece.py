"""One level in coordinates of its own: a QP whose cost does not see all variables.

    min ½‖w − w₀‖²   s.t.   lo ≤ W w + F f ≤ hi

w is what the level cares for; f, what it leaves free, may be any that lets w be the best one.

The active set starts from the rows that w₀ violates and takes in what is violated and lets go what
has a multiplier of the wrong sign, all at once, until there is neither. Where that comes to no
end, a solver finds another start, of the QP with ε/2 ‖f‖² in its cost; where that is not enough
either, a primal active-set method walks on from its point, at last with bounds moved apart. What
is returned solves the linear equations of the level itself on the active set, without either.

Source: Hintermueller2003 for the corrections, Nocedal2006 §16.5 for the walk.
"""

from typing import NamedTuple

import numpy as np

from qpctrl.arrays import Matrix, Vector
from qpctrl.polish import active_set
from qpctrl.priority.basis import RANK, factorised
from qpctrl.solver import QpData, Solver

ROUND_OFF = 1e-12
"""A violation over the largest row value or 1 that is none."""

PASSES = 8
"""Corrections of an active set before it is given up."""

STEPS = 200
"""Steps of a walk before it is given up."""

APART = 1e-8
"""Least room, over the largest row value or 1, that a second walk adds to bounds, to each another:
no more of them meet in a point than it has coordinates, and no walk goes in circles."""

GOLDEN = (5.0**0.5 - 1.0) / 2.0
"""Its multiples, modulo 1, are all different."""

PROXIMITY = 1e-5
"""ε, over the mean curvature of the level's cost."""


class Piece(NamedTuple):
    """The data of one level; bounds may be infinite."""

    w0: Vector
    W: Matrix
    F: Matrix
    lo: Vector
    hi: Vector
    size: float
    """Size of a row's value against which round-off is judged."""
    least: float
    """Multiplier up to which a row does not press."""


class Point(NamedTuple):
    """An answer; ``z`` > 0 presses on ``hi``, < 0 on ``lo``."""

    w: Vector
    f: Vector
    z: Vector
    settled: bool
    """Whether signs and bounds are right: it is the minimiser."""
    feasible: bool = True
    """False where the solver found that no point keeps all rows."""


def minimiser(piece: Piece, solver: Solver) -> Point:
    """Return the minimiser, or a point that is not settled where its active set is not found."""
    n, f0 = len(piece.w0), np.zeros(piece.F.shape[1])
    value = piece.W @ piece.w0
    if (side := _violated(piece, value)).any():
        piece = _free_rows(piece)
        side = _violated(piece, value)
    if not side.any():
        return Point(piece.w0, f0, np.zeros(len(side)), settled=True)
    few = np.count_nonzero(side) <= n + len(f0)
    if few and (found := _corrected(piece, side, f0)):
        return found
    qp = _with_proximity(piece)
    rough = solver.solve(qp)
    if not rough.feasible:
        return Point(piece.w0, f0, np.zeros(len(side)), settled=False, feasible=False)
    upper, lower = active_set(qp, rough)
    if found := _corrected(piece, upper.astype(np.int8) - lower, f0):
        return found
    w, f = rough.x[:n], rough.x[n:]
    point = _walked(piece, w, f, 0.0)
    if point.settled or not (other := _walked(piece, w, f, APART)).settled:
        return point
    return other


def _free_rows(piece: Piece) -> Piece:
    """Return the level without the bounds of rows on which it has no effect."""
    W, F = piece.W, piece.F
    idle = np.einsum("ij,ij->i", W, W) + np.einsum("ij,ij->i", F, F) <= RANK**2
    lo, hi = np.where(idle, -np.inf, piece.lo), np.where(idle, np.inf, piece.hi)
    return piece._replace(lo=lo, hi=hi)


def _with_proximity(piece: Piece) -> QpData:
    n, size = len(piece.w0), len(piece.w0) + piece.F.shape[1]
    H, g = np.eye(size), np.zeros(size)
    H[n:] *= PROXIMITY
    g[:n] = -piece.w0
    C = np.hstack([piece.W, piece.F])
    return QpData(H, g, np.zeros((0, size)), np.zeros(0), C, piece.lo, piece.hi)


def _violated(piece: Piece, value: Vector) -> np.ndarray:
    """Return 1 for rows above their bounds, −1 for rows below, else 0."""
    slack = ROUND_OFF * max(piece.size, np.abs(value).max(initial=0.0))
    return (value > piece.hi + slack).astype(np.int8) - (value < piece.lo - slack)


def _corrected(piece: Piece, side: np.ndarray, f0: Vector) -> Point | None:
    """Correct an active set (1 upper, −1 lower) until it is the right one, or give up."""
    most = len(piece.w0) + len(f0)
    for _ in range(PASSES):
        point = _on_active_set(piece, side, f0)
        violated = _violated(piece, piece.W @ point.w + piece.F @ point.f)
        wrong = side * point.z < 0.0
        if not (violated.any() or wrong.any()):
            return point
        side = np.where(violated != 0, violated, np.where(wrong, 0, side))
        if violated.any() and np.count_nonzero(side) > most:
            break  # more than any point needs: that leads away
    return None


def _walked(piece: Piece, w: Vector, f: Vector, apart: float) -> Point:
    """Walk from a point that keeps all rows to the minimiser, from active set to active set.

    ``apart`` moves bounds out by different amounts, as long as the active set is sought.
    """
    f0, rows = f, np.arange(len(piece.lo))
    side = np.zeros(len(rows), dtype=np.int8)
    room = apart * piece.size * (1.0 + rows * GOLDEN % 1.0)
    lo, hi = piece.lo - room, piece.hi + room
    wider = piece._replace(lo=lo, hi=hi)
    for _ in range(STEPS):
        point = _on_active_set(wider, side, f)
        dw, df = point.w - w, point.f - f
        value, rate = piece.W @ w + piece.F @ f, piece.W @ dw + piece.F @ df
        meets = (side == 0) & (np.abs(rate) > ROUND_OFF * max(piece.size, np.abs(rate).max()))
        left = np.where(rate > 0, hi, lo) - value
        reach = np.divide(left, rate, out=np.full(len(rows), np.inf), where=meets)
        first = int(reach.argmin())
        step = min(max(reach[first], 0.0), 1.0)
        w, f = w + step * dw, f + step * df
        push = side * point.z
        if step < 1.0:
            side[first] = np.sign(rate[first])
        elif push.min() < 0.0:
            side[push.argmin()] = 0
        elif apart:
            return _corrected(piece, side, f0) or point._replace(settled=False)
        else:
            return point
    return Point(w, f, np.zeros(len(side)), settled=False)


def _on_active_set(piece: Piece, side: np.ndarray, f0: Vector) -> Point:
    """Return the minimiser with some rows held at a bound, f as near to f₀ as they let it be.

    It is settled if the other rows keep their bounds and no z has the wrong sign.

    W w + F f = c,  w − w₀ + Wᵀμ = 0,  Fᵀμ = 0. Rows B of F are independent, the others are
    Xᵀ times them; so μ_B = −X μ_N, and K w = k with K = W_N − Xᵀ W_B decides w and μ_N.
    """
    active = side.nonzero()[0]
    W, F, w0 = piece.W[active], piece.F[active], piece.w0
    c = np.where(side > 0, piece.hi, piece.lo)[active]
    of_f = factorised(F.T)
    B, N = of_f.order[: of_f.rank], of_f.order[of_f.rank :]
    X = of_f.solved(of_f.packed[: of_f.rank, of_f.rank :])
    K, k = W[N] - X.T @ W[B], c[N] - X.T @ c[B]
    of_w = factorised(K.T)
    chosen = of_w.order[: of_w.rank]
    y = of_w.solved(K[chosen] @ w0 - k[chosen], transposed=True)
    w = w0 - of_w.spanned(y)
    mu = np.zeros(len(active))
    mu[N[chosen]] = of_w.solved(y)
    mu[B] = -X @ mu[N]
    step = of_f.solved(c[B] - W[B] @ w - F[B] @ f0, transposed=True)
    mu[np.abs(mu) <= piece.least] = 0.0
    z = np.zeros(len(side))
    z[active] = mu
    return Point(w, f0 + of_f.spanned(step), z, settled=True)
