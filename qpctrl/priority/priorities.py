"""Strict priorities: one QP after the other, with limits among the hard rows of all.

    level i:   min ½ xᵀHᵢx + gᵢᵀx   s.t.   A x = b,   lb ≤ C x ≤ ub,   Gⱼx = Gⱼxⱼ for j < i

Hᵢ = GᵢᵀWᵢGᵢ, gᵢ = −GᵢᵀWᵢrᵢ; xᵢ is a minimiser and Gᵢxᵢ, the same for all of them, is what the level
attains. Those below keep it, and may do no more than choose among its minimisers.

Each level works on a basis of what those above leave free, where it separates what it cares for
from the rest; nothing is added to its cost. A limit that presses at a level, with a multiplier
that is not 0, is active at all its minimisers and is an equality from there on; the other limits
stay inequalities, which xᵢ satisfies. So no level finds the rows impossible that the first could
keep, however little room they leave.

Of each level the KKT residual is measured on the QP above as it stands, with multipliers of the
right signs. A level whose rows those above decide but for a part between `RANK` and √`FLAT` keeps
what it has of them and cannot decide on the rest; its residual shows that.

Source: Kanoun2011 for the cascade, Escande2014 for a basis refined from level to level.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from qpctrl.arrays import Array, Matrix, Vector
from qpctrl.errors import InputError
from qpctrl.limit import UNBOUNDED
from qpctrl.priority.basis import RANK, row_sizes
from qpctrl.priority.cascade import Cascade, Hard, Level, Step
from qpctrl.priority.certificate import kkt_residual, multipliers
from qpctrl.solver import ActiveSet, QpData, Solution, Solver

__all__ = ["Attained", "Level", "Priorities", "Ranked"]

FEASIBLE = 1e-9
"""Violation of a hard row, over the largest value of its kind or 1, beyond which x is no answer."""


class Attained(NamedTuple):
    """What one level attains, and its proof."""

    x: Vector
    """A minimiser of the level among those of the levels above (n)."""
    rows: Matrix
    """What the levels below keep: G, or H where a singular W leaves part of G x undecided."""
    value: Vector
    """``rows`` x."""
    residual: Vector
    """Hx + g = GᵀW(G x − r) (n): 0 where the level has all that it wants."""
    y: Vector
    """Multipliers of A and of the rows of the levels above, one after the other."""
    z: Vector
    """Multipliers of C (r); > 0 presses on ub, < 0 on lb."""
    kkt: float
    """Largest KKT residual of the level's QP."""


class Ranked(NamedTuple):
    """The lexicographic solution."""

    solution: Solution
    """x, y and z of the last level's QP; NaN and not feasible where no x keeps the hard rows, or
    a number is not finite."""
    levels: tuple[Attained, ...]
    """All levels in their order; none where there is no solution."""
    unique: bool
    """Whether rows, levels and the limits that press decide all of x."""

    @property
    def kkt(self) -> float:
        """Largest KKT residual of all levels; infinite where there is no solution."""
        return max((level.kkt for level in self.levels), default=np.inf)


class Priorities:
    """Solves lexicographic QPs of one size."""

    def __init__(
        self, variables: int, equalities: int, inequalities: int, solver: Solver | None = None
    ) -> None:
        """Allocate for n variables, m equalities and r two-sided inequalities.

        Args:
            variables: n.
            equalities: m.
            inequalities: r.
            solver: what finds the active set where a few corrections do not; daqp if not given.
        """
        self._n, self._m, self._r = variables, equalities, inequalities
        self._cascade = Cascade(variables, inequalities, ActiveSet() if solver is None else solver)

    def solve(
        self, levels: Sequence[Level], A: Matrix, b: Vector, C: Matrix, lb: Vector, ub: Vector
    ) -> Ranked:
        """Return the solution.

        Args:
            levels: from the highest priority to the lowest.
            A: equality rows (m×n), which may depend on each other.
            b: (m).
            C: inequality rows (r×n).
            lb: lower bounds (r); −1e20 and less are none.
            ub: upper bounds (r).

        Raises:
            InputError: no level, or an array of the wrong shape.
        """
        self._check(levels, A, b, C, lb, ub)
        data = (A, b, C, *(part for level in levels for part in level))
        if not (_finite(*data) and (lb <= ub).all()):
            return self._nothing()
        units = _units(A, C)
        sizes = row_sizes(C * units)
        lo, hi = np.where(lb > -UNBOUNDED, lb, -np.inf), np.where(ub < UNBOUNDED, ub, np.inf)
        hard = Hard(units, A, b, C / sizes[:, None], lo / sizes, hi / sizes)
        steps = self._steps(levels, hard)
        if not steps or not _keeps(hard, steps[-1].x):
            return self._nothing()
        attained = self._proved(levels, steps, hard, sizes)
        last = attained[-1]
        solution = Solution(last.x, last.y, last.z)
        return Ranked(solution, attained, unique=self._cascade.basis.size == self._n)

    def _steps(self, levels: Sequence[Level], hard: Hard) -> list[Step]:
        """Return the levels solved one after the other; none where the first cannot be."""
        x, place = self._cascade.start(hard), self._r + self._m
        steps: list[Step] = []
        for level in levels:
            step = self._cascade.solve(level, hard, x, place, keeps=bool(steps))
            if step is None:
                return []
            steps.append(step)
            x, place = step.x, place + len(step.rows)
        return steps

    def _proved(
        self, levels: Sequence[Level], steps: Sequence[Step], hard: Hard, sizes: Vector
    ) -> tuple[Attained, ...]:
        """Return what each level attains, with the multipliers and the residual of its QP."""
        r = self._r
        rows = np.vstack([hard.A, *(step.rows for step in steps)])
        values = [step.rows @ step.x for step in steps]
        b = np.concatenate([hard.b, *values])
        attained: list[Attained] = []
        end = self._m
        for i, (level, step) in enumerate(zip(levels, steps, strict=True)):
            force = step.residual + step.press.force
            above = [upper.press for upper in steps[:i]]
            found = multipliers(
                self._cascade.basis, force, step.fixed, step.press.z, above, r + end
            )
            z, y = found[:r], found[r:]
            qp = QpData(level.H, level.g, rows[:end], b[:end], *hard[3:])
            kkt = kkt_residual(qp, step.x, y, z)
            attained.append(
                Attained(step.x, step.rows, values[i], step.residual, y, z / sizes, kkt)
            )
            end += len(step.rows)
        return tuple(attained)

    def _check(self, levels: Sequence[Level], *hard: Array) -> None:
        """Refuse arrays that do not fit together."""
        n, m, r = self._n, self._m, self._r
        if not levels:
            raise InputError("levels: got none, need at least one")
        needed = [*zip(Hard._fields[1:], hard, ((m, n), (m,), (r, n), (r,), (r,)), strict=True)]
        for i, (H, g, G) in enumerate(levels):
            needed += [(f"level {i}, H", H, (n, n)), (f"level {i}, g", g, (n,))]
            needed += [(f"level {i}, G", G, (len(G), n))]
        for name, got, shape in needed:
            if got.shape != shape:
                raise InputError(f"{name}: got shape {got.shape}, need {shape}")

    def _nothing(self) -> Ranked:
        x, y, z = (np.full(size, np.nan) for size in (self._n, self._m, self._r))
        return Ranked(Solution(x, y, z, feasible=False), (), unique=False)


def _finite(*arrays: Array) -> bool:
    return math.isfinite(sum(float(array.sum()) for array in arrays))


def _units(A: Matrix, C: Matrix) -> Vector:
    """Return units of the variables in which all have like parts in the hard rows (n)."""
    parts = np.zeros(A.shape[1])
    for squares in (A * A, C * C):
        sizes = squares.sum(axis=1)
        parts += (1.0 / np.where(sizes > 0.0, sizes, 1.0)) @ squares
    largest = parts.max(initial=0.0)
    return 1.0 / np.sqrt(np.where(parts > RANK**2 * largest, parts, largest or 1.0))


def _keeps(hard: Hard, x: Vector) -> bool:
    """Return whether x keeps the hard rows."""
    Ax, Cx = hard.A @ x, hard.C @ x
    off = np.abs(Ax - hard.b).max(initial=0.0) / max(1.0, np.abs(hard.b).max(initial=0.0))
    over = np.maximum(Cx - hard.ub, hard.lb - Cx).max(initial=0.0)
    return bool(max(off, over / max(1.0, np.abs(Cx).max(initial=0.0))) <= FEASIBLE)
