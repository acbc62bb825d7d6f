"""A tick with strict priorities: its levels on the buffers of its parts."""

import numpy as np

from qpctrl.arrays import Vector
from qpctrl.limit import UNBOUNDED
from qpctrl.parts import TickParts
from qpctrl.priority import Level, Priorities, Ranked
from qpctrl.solver import Solution, Solver


class RankedTick:
    """Solves the levels of a tick, with limits and without.

    The last level sees what the others attain as equalities. Their force on it, rowsᵀ y, is added
    to its gradient g in the buffers: then the certificate of the tick judges it like any QP.
    """

    def __init__(self, parts: TickParts, solver: Solver) -> None:
        self._terms, self._qp = parts.terms, parts.qp
        n, m, r = (len(values) for values in parts.point)
        self._m = m
        self._priorities = Priorities(n, m, r, solver)
        self.pressing = np.zeros(r)
        self._open = np.full(r, UNBOUNDED)
        upper = range(parts.upper_levels)
        levels = [Level(*(self._terms[f"{part}_{i}"] for part in "HgG")) for i in upper]
        self._levels = [*levels, Level(self._qp.H, self._qp.g, np.eye(n))]

    def solve(self) -> tuple[Solution, float, bool]:
        """Return the solution, the largest residual of all levels, and whether no limit binds.

        ``x_eq`` in the buffers is the solution without limits afterwards, and `pressing` the duals
        of the limits, each that of the highest level at which it presses.
        """
        qp, levels = self._qp, self._levels
        found = self._priorities.solve(levels, qp.A, qp.b, qp.C, -self._open, self._open)
        self._terms["x_eq"][:] = found.solution.x
        Cx = qp.C @ found.solution.x
        free = bool((qp.lb <= Cx).all() and (Cx <= qp.ub).all())
        self.pressing[:] = 0.0
        if not free:
            found = self._priorities.solve(levels, *qp[2:])
        if not found.solution.feasible:
            return found.solution, np.inf, False
        for level in reversed(found.levels):
            pressed = level.z != 0.0
            self.pressing[pressed] = level.z[pressed]
        return self._of_last(found), found.kkt, free

    def _of_last(self, found: Ranked) -> Solution:
        """Return the last level's solution, with the force of the levels above in its gradient."""
        x, y, z = found.solution[:3]
        kept = y[self._m :]
        force: Vector = np.zeros(len(x))
        start = 0
        for level in found.levels[:-1]:
            stop = start + len(level.rows)
            force += level.rows.T @ kept[start:stop]
            start = stop
        self._qp.g[:] += force
        return Solution(x, y[: self._m], z)
