"""Designs: which values of its factors a study visits. One row a point, one column a factor."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.stats import qmc

from qpctrl.arrays import Matrix
from qpctrl.errors import InputError, unknown_name
from scenarios.study import sensitivity
from scenarios.study.factor import Factor

Kind = Literal["levels", "map", "sobol", "indices", "morris"]

MOST_POINTS = 10_000_000
"""Points that a design may have; they are held in memory."""
MORRIS_LEVELS = 8
"""Levels of the grid on which Morris trajectories walk."""


@dataclass(frozen=True, kw_only=True)
class Design:
    """How the points of a study lie in the ranges of its factors."""

    kind: Kind = "levels"
    """``levels``: one factor at a time, the others at their usual value. ``map``: every level of
    each factor with every level of the others. ``sobol``: scrambled Sobol points. ``indices``:
    Sobol points in the arrangement that gives first-order and total indices. ``morris``:
    trajectories that screen many factors."""
    size: int = 9
    """levels and map: values of each factor; sobol: points; indices: base points, each of which
    makes factors + 2; both a power of two; morris: trajectories of factors + 1 points."""

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise unknown_name("design", self.kind, get_args(Kind))
        if self.size < 2:
            raise InputError(f"design {self.kind}: got size {self.size}, need at least 2")

    def group(self, row: int, count: int) -> int:
        """Return which rows share their random numbers, so that a difference is a factor's.

        All rows of levels and maps do, those of one block of ``indices`` and of one trajectory
        of ``morris``; points of ``sobol`` are on their own.

        Args:
            row: of the design.
            count: number of factors.
        """
        size = {"sobol": 1, "indices": count + 2, "morris": count + 1}.get(self.kind)
        return 0 if size is None else row // size

    def points(self, factors: Sequence[Factor], usual: Mapping[str, float], seed: int) -> Matrix:
        """Return the points (points × factors) in the factors' units.

        Args:
            factors: what varies.
            usual: value of each factor while another varies alone; where it has none in its
                range, the middle of that.
            seed: of random designs.

        Raises:
            InputError: a size or seed that cannot be used.
        """
        if not factors:
            return np.zeros((1, 0))
        count = self._count(factors)
        if count > MOST_POINTS:
            raise InputError(
                f"design {self.kind}: size {self.size} makes {count} points, need at most "
                f"{MOST_POINTS}"
            )
        if self.kind == "levels":
            return one_at_a_time(factors, self.size, usual)
        if self.kind == "map":
            grid = np.meshgrid(*(f.levels(self.size) for f in factors), indexing="ij")
            return np.column_stack([values.ravel() for values in grid])
        shares = {"sobol": _sobol, "indices": sensitivity.saltelli, "morris": _morris}[self.kind]
        unit = shares(len(factors), self.size, seed)
        return np.column_stack([f.at(unit[:, i]) for i, f in enumerate(factors)])

    @property
    def needs_salib(self) -> bool:
        """Whether its points come from SALib."""
        return self.kind in ("indices", "morris")

    def _count(self, factors: Sequence[Factor]) -> int:
        """Return how many points there are, at most."""
        levels = [len(f.values) or self.size for f in factors]
        return {
            "levels": sum(levels),
            "map": math.prod(levels),
            "sobol": self.size,
            "indices": self.size * (len(factors) + 2),
            "morris": self.size * (len(factors) + 1),
        }[self.kind]


def one_at_a_time(factors: Sequence[Factor], levels: int, usual: Mapping[str, float]) -> Matrix:
    """Return the levels of each factor (points × factors) while the others keep their usual value.

    Args:
        factors: what varies.
        levels: points along each factor, both ends included.
        usual: value of each factor while another varies.
    """
    centre = [_centre(f, usual.get(f.name, math.nan)) for f in factors]
    blocks = []
    for i, factor in enumerate(factors):
        values = factor.levels(levels)
        block = np.tile(np.array(centre), (len(values), 1))
        block[:, i] = values
        blocks.append(block)
    return np.vstack(blocks)


def _centre(factor: Factor, usual: float) -> float:
    """Return its usual value if the factor takes it, else the one in the middle."""
    if usual in factor.values or (not factor.values and factor.low <= usual <= factor.high):
        return usual
    middle = factor.levels(3)
    return float(middle[len(middle) // 2])


def _sobol(count: int, size: int, seed: int) -> Matrix:
    """Return scrambled Sobol points (size × count) in the unit cube."""
    if size & (size - 1):
        nearest = sensitivity.nearest_power_of_two(size)
        raise InputError(f"Sobol size: got {size}, need a power of two; nearest {nearest}")
    return qmc.Sobol(d=count, scramble=True, rng=np.random.default_rng(seed)).random(size)


def _morris(count: int, size: int, seed: int) -> Matrix:
    return sensitivity.morris(count, size, MORRIS_LEVELS, seed)
