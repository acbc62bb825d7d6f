"""LDLᵀ factorisation of symmetric positive definite expressions."""

import casadi as ca

from qpctrl.spatial import SX


class Factor:
    """``matrix = L D Lᵀ``, kept for solving; never an explicit inverse.

    Attributes:
        pivots: ``D`` (size); the ratio of a pivot to its diagonal entry falls to 0 when that
            row depends on the rows before it.
    """

    def __init__(self, matrix: SX) -> None:
        self.pivots, self._LT, self._order = ca.ldl(ca.densify(matrix), False)
        diagonal = ca.diag(matrix)
        self.pivot_ratios = ca.if_else(diagonal > 0, self.pivots / diagonal, 0)

    def solve(self, rhs: SX) -> SX:
        """Return ``matrix⁻¹ rhs``."""
        return ca.ldl_solve(ca.densify(rhs), self.pivots, self._LT, self._order)

    def congruence(self, B: SX) -> SX:
        """Return ``Bᵀ matrix⁻¹ B``, symmetric, at half the cost of solving."""
        half = self._forward(B)
        scaled = half / ca.repmat(self.pivots, 1, B.shape[1])
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
                row = row - self._LT[j, i] * rows[j]
            rows.append(row)
        return ca.vertcat(*rows)
