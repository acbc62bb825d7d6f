"""Levels solved one after the other, each on what those above leave free.

Of level i, x = xᵢ₋₁ + Q₁ s + Q₂ f: the columns of Q₁ are spanned by what of its rows is not fixed
yet, those of Q₂ are free after it. Its cost is ½ sᵀH s + gᵀs, with L Lᵀ = Q₁ᵀHᵢQ₁ positive
definite: with w = Lᵀs it is ½‖w − w₀‖², w₀ = −L⁻¹ Q₁ᵀ(Hᵢxᵢ₋₁ + gᵢ), and f is not in it.
Source: DeLasa2009 for a level on what those above leave free.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpstrf, dtrtrs

from qpctrl.arrays import Matrix, Vector
from qpctrl.priority.basis import Basis
from qpctrl.priority.piece import Piece, Point, minimiser
from qpctrl.solver import Solver

FLAT = 1e-12
"""Curvature over the largest of Hᵢ below which Hᵢ, rounded as it is, does not decide. Where W has
no more for some of G x, it is H x that the levels below keep. A row of which the levels above
leave a part between `RANK` and √FLAT is kept as it is, and the KKT residual shows it."""

PRESSING = 1e-11
"""Force of a limit over the largest term of Hᵢx + gᵢ below which it does not press; all forces in
the units of the variables."""


class Level(NamedTuple):
    """The cost of one level, ½ xᵀHx + gᵀx with H = GᵀWG and g = −GᵀWr."""

    H: Matrix
    """(n×n)."""
    g: Vector
    """(n)."""
    G: Matrix
    """What the level is about, G x → r (p×n); p may be 0."""


class Hard(NamedTuple):
    """Rows that all levels keep; those of C have length 1 in the units, bounds may be infinite."""

    units: Vector
    """Of the variables (n)."""
    A: Matrix
    b: Vector
    C: Matrix
    lb: Vector
    ub: Vector


class Press(NamedTuple):
    """The limits that press at a level; they stay active below."""

    z: Vector
    """Multipliers of C (r)."""
    force: Vector
    """Cᵀz (n)."""
    fixed: int
    """How many rows are fixed with the level's own ones, but without these limits."""


class Step(NamedTuple):
    """A solved level."""

    x: Vector
    rows: Matrix
    """What the levels below keep of it (p×n)."""
    residual: Vector
    """Hx + g (n)."""
    fixed: int
    """How many rows are fixed above it."""
    press: Press


class Cascade:
    """Solves level after level; the basis then has what all of them fixed."""

    def __init__(self, variables: int, inequalities: int, solver: Solver) -> None:
        self.basis = Basis(variables, inequalities)
        self._solver = solver

    def start(self, hard: Hard) -> Vector:
        """Fix the equalities and return the smallest x, in the units, that keeps them.

        Rows are called by their places among those of C, then A, then what the levels fix.
        """
        m, r = len(hard.b), len(hard.lb)
        self.basis.start(hard.units, hard.C)
        self.basis.fix(hard.A, np.arange(r, r + m))
        return self.basis.point(np.concatenate([hard.lb, hard.b]))

    def solve(self, level: Level, hard: Hard, x: Vector, place: int, *, keeps: bool) -> Step | None:
        """Return the level solved from x, or None where no point keeps the hard rows.

        Args:
            level: its cost.
            hard: what `start` was given.
            x: the answer of the level above (n).
            place: of the level's first row.
            keeps: whether x keeps the inequalities, up to round-off.
        """
        basis, fixed = self.basis, self.basis.size
        rows, own, L = self._fix(level, hard.units, place)
        Q1, Q2 = basis.Q[:, own], basis.Q[:, basis.size :]
        Hx, curvature = level.H @ x, np.vdot(L, L) / len(L) if len(L) else 1.0
        L = L / np.sqrt(curvature)
        w0 = -_forward(L, Q1.T @ (Hx + level.g)) / curvature
        W = _forward(L, basis.CQ[:, own].T).T
        largest = max(np.abs(Hx * hard.units).max(), np.abs(level.g * hard.units).max())
        point = self._minimiser(hard, x, w0, W, PRESSING * largest / curvature)
        if not (point.feasible or keeps):
            return None
        if point.feasible:
            s = dtrtrs(L, point.w, lower=1, trans=1)[0] if len(L) else point.w
            x = x + Q1 @ s + Q2 @ point.f
        return Step(x, rows, level.H @ x + level.g, fixed, self._press(curvature * point.z, hard))

    def _fix(self, level: Level, units: Vector, place: int) -> tuple[Matrix, np.ndarray, Matrix]:
        """Fix what the level cares for; return its rows, which columns of Q are Q₁, and L."""
        basis, k = self.basis, self.basis.size
        flat = FLAT * (level.H.diagonal() * units**2).max()
        parts = basis.fix(level.G, np.arange(place, place + len(level.G)))
        own = int(np.count_nonzero(parts > np.sqrt(FLAT)))
        columns, L = self._decided(level.H, k, own, flat)
        if len(L) == own:
            return level.G, columns, L
        basis.release(k)
        own = len(basis.fix(level.H, np.arange(place, place + len(level.H)), whole=True))
        return level.H, *self._decided(level.H, k, own, flat)

    def _decided(self, H: Matrix, k: int, own: int, flat: float) -> tuple[np.ndarray, Matrix]:
        """Return which of the columns k … k + own of Q H decides on, and L."""
        if own == 0:
            return np.arange(0), np.zeros((0, 0))
        Q1 = self.basis.Q[:, k : k + own]
        L, order, rank, _ = dpstrf(Q1.T @ H @ Q1, tol=flat, lower=1)
        return k + order[:rank] - 1, np.tril(L[:rank, :rank])

    def _minimiser(self, hard: Hard, x: Vector, w0: Vector, W: Matrix, least: float) -> Point:
        """Return the point of the level, in its coordinates."""
        value, F = hard.C @ x, self.basis.CQ[:, self.basis.size :]
        largest = max(1.0, np.abs(value).max(initial=0.0))
        piece = Piece(w0, W, F, hard.lb - value, hard.ub - value, largest, least)
        return minimiser(piece, self._solver)

    def _press(self, z: Vector, hard: Hard) -> Press:
        """Fix the limits that press."""
        pressed, fixed = z.nonzero()[0], self.basis.size
        if len(pressed) == 0:
            return Press(z, np.zeros(len(hard.units)), fixed)
        self.basis.fix(hard.C[pressed], pressed)
        return Press(z, z @ hard.C, fixed)


def _forward(L: Matrix, rhs: np.ndarray) -> np.ndarray:
    return dtrtrs(L, rhs, lower=1)[0] if rhs.size else rhs
