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
