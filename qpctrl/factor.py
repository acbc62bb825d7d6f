"""LDLᵀ factorisation of symmetric positive definite expressions."""

import casadi as ca

from qpctrl.spatial import SX


class Factor:
    """``matrix = L D Lᵀ``, kept for solving; never an explicit inverse.

    Every pivot is divided by once: a division takes as long as many multiplications.

    Attributes:
        pivots: ``D`` (size); the ratio of a pivot to its diagonal entry falls to 0 when that
            row depends on the rows before it.
    """

    def __init__(self, matrix: SX) -> None:
        matrix, size = ca.densify(matrix), matrix.shape[0]
        self._L = ca.SX.eye(size)
        pivots: list[SX] = []
        inverse_pivots: list[SX] = []
        for j in range(size):
            scaled = [self._L[j, p] * pivots[p] for p in range(j)]
            pivots.append(_less(matrix[j, j], scaled, self._L[j, :j]))
            inverse_pivots.append(_inverse(pivots[j]))
            for i in range(j + 1, size):
                rest = _less(matrix[i, j], scaled, self._L[i, :j])
                self._L[i, j] = rest * inverse_pivots[j]
        self.pivots, self._inverse_pivots = ca.vertcat(*pivots), ca.vertcat(*inverse_pivots)
        diagonal = ca.diag(matrix)
        self.pivot_ratios = ca.if_else(diagonal > 0, self.pivots / diagonal, 0)

    def solve(self, rhs: SX) -> SX:
        """Return ``matrix⁻¹ rhs``."""
        rows = ca.vertsplit(self._forward(ca.densify(rhs)))
        rows = [row * self._inverse_pivots[i] for i, row in enumerate(rows)]
        for i in reversed(range(len(rows))):
            for j in range(i + 1, len(rows)):
                rows[i] = rows[i] - self._L[j, i] * rows[j]
        return ca.vertcat(ca.SX(0, rhs.shape[1]), *rows)

    def congruence(self, B: SX) -> SX:
        """Return ``Bᵀ matrix⁻¹ B``, symmetric, at half the cost of solving."""
        half = self._forward(B)
        scaled = half * ca.repmat(self._inverse_pivots, 1, B.shape[1])
        product = ca.SX(B.shape[1], B.shape[1])
        for i in range(B.shape[1]):
            for j in range(i + 1):
                product[i, j] = product[j, i] = ca.dot(half[:, i], scaled[:, j])
        return ca.densify(product)

    def _forward(self, B: SX) -> SX:
        """Return ``L⁻¹ B``; zeros of B that stay zero cost nothing."""
        rows: list[SX] = []
        for i in range(B.shape[0]):
            row = B[i, :]
            for j in range(i):
                row = row - self._L[i, j] * rows[j]
            rows.append(row)
        return ca.vertcat(*rows)


def _inverse(pivot: SX) -> SX:
    """Return 1/pivot in a form that CasADi does not turn back into one division each."""
    return 2 / (2 * pivot)


def _less(start: SX, scaled: list[SX], row: SX) -> SX:
    for p, value in enumerate(scaled):
        start = start - value * row[p]
    return start
