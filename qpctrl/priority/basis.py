"""Rows that are fixed one after the other, and what they leave free.

    E Q = (T 0),   Q orthogonal, T lower triangular

E are the independent ones of the rows fixed so far; the columns of Q behind the first ones span
what they leave free. To fix more rows turns these alone: what is fixed stays, to round-off.
Source: Escande2014, whose hierarchical complete orthogonal decomposition this is.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgeqp3, dormqr, dtrtrs

from qpctrl.arrays import Array, Matrix, Vector

RANK = 1e-11
"""Part of a row, over its size, below which other rows imply it."""

BLOCK = 64
"""Columns of workspace that LAPACK gets per row of what it turns."""


class Factors(NamedTuple):
    """``M P = Q R``: the first ``rank`` of the exchanged columns of M (n×p) are independent."""

    packed: Matrix
    """R on and above the diagonal, Householder vectors below it (n×p)."""
    tau: Vector
    order: np.ndarray
    """Which column of M stands where (p)."""
    rank: int

    def turned(self, M: Matrix) -> Matrix:
        """Return M Q; an M that is contiguous in columns is overwritten."""
        k = self.rank
        if k == 0 or M.shape[0] == 0:
            return M
        work = BLOCK * M.shape[0]
        return dormqr("R", "N", self.packed[:, :k], self.tau[:k], M, work, overwrite_c=1)[0]

    def spanned(self, y: Vector) -> Vector:
        """Return Q₁ y (n), with Q₁ the first ``rank`` columns of Q."""
        k, n = self.rank, self.packed.shape[0]
        padded = np.zeros((n, 1), order="F")
        padded[:k, 0] = y
        if k == 0:
            return padded[:, 0]
        return dormqr("L", "N", self.packed[:, :k], self.tau[:k], padded, BLOCK)[0][:, 0]

    def solved(self, rhs: Array, *, transposed: bool = False) -> Array:
        """Return R₁₁⁻¹ rhs or R₁₁⁻ᵀ rhs."""
        k = self.rank
        return dtrtrs(self.packed[:k, :k], rhs, trans=int(transposed))[0] if rhs.size else rhs


def factorised(M: Matrix) -> Factors:
    """Return the factors of M (n×p), whose columns have sizes near 1 unless others imply them."""
    n, p = M.shape
    if n == 0 or p == 0:
        return Factors(M, np.zeros(0), np.arange(p), 0)
    packed, order, tau, _, _ = dgeqp3(M)
    rank = int(np.count_nonzero(np.abs(packed.diagonal()) > RANK))
    return Factors(packed, tau, order - 1, rank)


class Basis:
    """The rows fixed so far, their basis Q (n×n), and other rows C on that basis (r×n).

    Q = D U with U orthogonal: the variables are measured in units D of their own.
    """

    def __init__(self, variables: int, rows: int) -> None:
        n = variables
        self._n, self.size = n, 0
        self._turned = np.zeros((n + rows, n), order="F")
        self._T = np.zeros((n, n), order="F")
        self._place = np.zeros(n, dtype=np.intp)

    def start(self, units: Vector, C: Matrix) -> None:
        """Fix nothing; take the units (n), and C (r×n) as the rows to carry along."""
        self.size = 0
        self._turned[: self._n] = np.diag(units)
        self._turned[self._n :] = C * units

    @property
    def Q(self) -> Matrix:
        """The basis (n×n); fixed rows act on its first ``size`` columns alone."""
        return self._turned[: self._n]

    @property
    def CQ(self) -> Matrix:
        """The rows C on the basis (r×n)."""
        return self._turned[self._n :]

    def fix(self, rows: Matrix, places: np.ndarray, *, whole: bool = False) -> Vector:
        """Fix the independent ones of some rows (p×n).

        Args:
            rows: the rows.
            places: where `multipliers` puts those of each row (p).
            whole: judge them against the largest of them, not each against its own size.

        Returns:
            What part of each row that was fixed is not implied by those before, falling.
        """
        k, on_basis = self.size, rows @ self.Q
        sizes = row_sizes(on_basis)
        if whole:
            sizes[:] = sizes.max(initial=0.0)
        factors = factorised((on_basis[:, k:] / sizes[:, None]).T)
        new, chosen = k + factors.rank, factors.order[: factors.rank]
        self._turned[:, k:] = factors.turned(self._turned[:, k:])
        self._T[k:new, :k] = on_basis[chosen, :k]
        self._T[k:new, k:new] = rows[chosen] @ self.Q[:, k:new]
        self._place[k:new] = places[chosen]
        self.size = new
        return np.abs(factors.packed.diagonal()[: factors.rank])

    def release(self, size: int) -> None:
        """Leave free again what was fixed after the first ``size`` rows."""
        self.size = size

    def point(self, rhs: Vector) -> Vector:
        """Return the smallest x (n), in the units, with E x = rhs; its values are by place."""
        k = self.size
        if k == 0:
            return np.zeros(self._n)
        return self.Q[:, :k] @ dtrtrs(self._T[:k, :k], rhs[self._place[:k]], lower=1)[0]

    def multipliers(self, force: Vector, size: int, into: Vector) -> None:
        """Add to ``into``, by place, the λ of the first ``size`` rows with Eᵀλ = −force (n)."""
        if size == 0:
            return
        T = self._T[:size, :size]
        into[self._place[:size]] -= dtrtrs(T, force @ self.Q[:, :size], lower=1, trans=1)[0]


def row_sizes(M: Matrix) -> Vector:
    """Return the length of each row, or 1 where it is 0."""
    sizes = np.sqrt(np.einsum("ij,ij->i", M, M))
    return np.where(sizes > 0, sizes, 1.0)
