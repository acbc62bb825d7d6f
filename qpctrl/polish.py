"""The exact solution on an active set: one linear solve on preallocated arrays.

A solver's answer points to the active set and is accurate to its own tolerance, in bits that
may differ from run to run. The KKT system on that set gives the answer to round-off, and the
same bits for every solver and every run.
"""

import numpy as np
from scipy.linalg.lapack import dgesv, dgetrs

from qpctrl.arrays import Vector
from qpctrl.solver import QpData, Solution

CORRECTIONS = 2
"""Steps of iterative refinement; after one the full form is off by up to 1e-10, relative."""


SINGULAR = 1e-15
"""Smallest pivot over the largest below which a system has no unique solution."""


class Polish:
    """Solves the KKT system of a QP with some inequalities held as equalities."""

    def __init__(self, variables: int, equalities: int, inequalities: int) -> None:
        self._n, self._m = variables, equalities
        size = variables + equalities + inequalities
        self._K, self._rhs = np.zeros((size, size)), np.zeros(size)

    def on_active_set(self, qp: QpData, rough: Solution) -> Solution:
        """Return the solution on the active set that ``rough`` points to."""
        upper, lower = active_set(qp, rough)
        return self._solve(qp, (upper | lower).nonzero()[0], np.where(upper, qp.ub, qp.lb))

    def without_inequalities(self, qp: QpData) -> Solution:
        """Return the solution with the equalities alone."""
        return self._solve(qp, np.empty(0, dtype=np.intp), qp.ub)

    @staticmethod
    def _is_singular(factors: np.ndarray) -> bool:
        """Return whether rows depend on each other, but for round-off."""
        pivots = np.abs(factors.diagonal())
        return bool(pivots.min() < SINGULAR * pivots.max())

    def _solve(self, qp: QpData, active: np.ndarray, bound: Vector) -> Solution:
        n, m = self._n, self._n + self._m
        size = m + len(active)
        K, rhs = self._K[:size, :size], self._rhs[:size]
        K[:n, :n], K[n:m, :n], K[:n, n:m] = qp.H, qp.A, qp.A.T
        rhs[:n], rhs[n:m] = qp.g, qp.b
        rhs[:n] *= -1.0
        if len(active):
            K[m:, :n] = rows = qp.C[active]
            K[:n, m:] = rows.T
            rhs[m:] = bound[active]
        z = np.zeros(len(bound))
        factors, pivots, point, info = dgesv(K, rhs)
        if info or self._is_singular(factors):
            point.fill(np.nan)
        else:
            for _ in range(CORRECTIONS):
                point += dgetrs(factors, pivots, rhs - K @ point)[0]
        z[active] = point[m:]
        return Solution(point[:n], point[n:m], z)


def active_set(qp: QpData, rough: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Return which upper and which lower bounds are active at a point.

    A bound counts as active where its dual is larger than its slack; whether that guess was
    right is judged by the residuals.
    """
    Cx = qp.C @ rough.x
    return rough.z > qp.ub - Cx, -rough.z > Cx - qp.lb
