"""Designs: which values of its factors a study visits. One row a point, one column a factor."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import qmc

from qpctrl.arrays import Matrix
from qpctrl.errors import InputError
from scenarios.study.factor import Factor


def one_at_a_time(
    factors: Sequence[Factor], levels: int, centre: Mapping[str, float] | None = None
) -> Matrix:
    """Return equally spaced levels of each factor while the others keep their centre.

    Args:
        factors: what varies.
        levels: points along each factor, both ends included.
        centre: value of each factor while another varies; default: the middle of its range.

    Returns:
        Points (levels · factors × factors) in the factors' units.

    Raises:
        InputError: fewer than two levels.
    """
    if levels < 2:
        raise InputError(f"levels: got {levels}, need at least 2")
    centre = centre or {}
    middle = [centre.get(f.name, (f.low + f.high) / 2) for f in factors]
    points = np.tile(np.array(middle, dtype=np.float64), (len(factors) * levels, 1))
    for i, factor in enumerate(factors):
        points[i * levels : (i + 1) * levels, i] = np.linspace(factor.low, factor.high, levels)
    return points


def sobol(factors: Sequence[Factor], size: int, seed: int) -> Matrix:
    """Return a scrambled Sobol design.

    Args:
        factors: what varies.
        size: number of points, a power of two.
        seed: of the scrambling.

    Returns:
        Points (size × factors) in the factors' units.

    Raises:
        InputError: a size that is no power of two, or a negative seed.
    """
    if size < 2 or size & (size - 1):
        raise InputError(f"Sobol size: got {size}, need a power of two; nearest {_nearest(size)}")
    if seed < 0:
        raise InputError(f"seed: got {seed}, need a number >= 0")
    low, high = np.array([[f.low, f.high] for f in factors], dtype=np.float64).T
    sampler = qmc.Sobol(d=len(factors), scramble=True, rng=np.random.default_rng(seed))
    return low + (high - low) * sampler.random(size)


def _nearest(size: int) -> int:
    """Return the power of two nearest to ``size``, at least 2; the smaller of two as near."""
    if size <= 2:
        return 2
    below: int = 1 << (size.bit_length() - 1)
    return below if size - below <= 2 * below - size else 2 * below
