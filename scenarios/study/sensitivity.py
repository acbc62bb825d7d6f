"""Sensitivity: how much of what comes out of a study is due to which factor.

Variance-based indices of a number y of d independent factors x_i, uniform in the unit cube:

    S_i = V(E(y | x_i)) / V(y)            first order: by x_i alone
    T_i = E(V(y | all but x_i)) / V(y)    total: with all that it takes part in

and Morris's elementary effects e_i = Δy / Δx_i along trajectories through a grid: mean μ, mean of
the magnitudes μ*, standard deviation σ (of a linear, additive factor, zero).

Designs come from SALib. Nothing is averaged over or filled in for rollouts that diverged: the
block or trajectory of a y that is not finite is left out whole, and counted. The indices are then
those of the blocks where nothing diverges, so the share that does belongs beside them.
"""

from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from qpctrl.arrays import Matrix, Vector
from qpctrl.errors import InputError
from scenarios.study.rate import RESAMPLES, bootstrap_means, check_confidence, percentile_interval

FEWEST_BLOCKS = 8
FEWEST_TRAJECTORIES = 4
ROUND_OFF = 1e-12
"""Share of a spread, or of a magnitude, below which there is none."""


class SobolIndices(NamedTuple):
    """First-order and total indices, each (count) [1], with bootstrap percentile intervals.

    All are NaN where y is constant: no variance, no shares of it. Intervals alone are NaN where so
    few blocks vary that a resample may hold none of them.
    """

    first: Vector
    total: Vector
    first_low: Vector
    first_high: Vector
    total_low: Vector
    total_high: Vector
    blocks: int
    """Blocks of the design."""
    blocks_used: int
    """Those in which every y is finite."""


class MorrisEffects(NamedTuple):
    """Elementary effects, each (count) [unit of y / unit of the points]."""

    mu: Vector
    """Mean."""
    mu_star: Vector
    """Mean of the magnitudes."""
    sigma: Vector
    """Standard deviation, with n − 1."""
    mu_star_low: Vector
    mu_star_high: Vector
    """Bootstrap percentile interval of μ*, over trajectories."""
    trajectories: int
    """Trajectories of the design."""
    trajectories_used: int
    """Those in which every y is finite."""


def saltelli(count: int, size: int, seed: int) -> Matrix:
    """Return a scrambled Sobol design for first-order and total indices.

    A block is the count + 2 rows of one base point: a, then a with x_i of b for each i, then b.

    Args:
        count: number of factors d.
        size: number of base points, a power of two.
        seed: of the scrambling.

    Returns:
        Points (size · (count + 2) × count) in the unit cube, block after block.

    Raises:
        InputError: no factor, a size that is no power of two or below 8, a negative seed, or
            SALib is not installed.

    Source: Saltelli2010.
    """
    _check_design(count, seed)
    if size < FEWEST_BLOCKS or size & (size - 1):
        raise InputError(
            f"Sobol size: got {size}, need a power of two of at least {FEWEST_BLOCKS}; "
            f"nearest {nearest_power_of_two(size, FEWEST_BLOCKS)}"
        )
    problem, sampler = _problem(count), _salib("sobol")
    return np.asarray(sampler.sample(problem, size, calc_second_order=False, seed=seed))


def morris(count: int, trajectories: int, levels: int, seed: int) -> Matrix:
    """Return Morris trajectories, along which one factor after the other moves, each once.

    Args:
        count: number of factors.
        trajectories: number of trajectories, drawn at random.
        levels: of the grid, even; a step is levels / (2 (levels − 1)).
        seed: of the drawing.

    Returns:
        Points (trajectories · (count + 1) × count) in the unit cube, one trajectory after another.

    Raises:
        InputError: no factor, too few trajectories, odd levels, a negative seed, or SALib is not
            installed.

    Source: Morris1991.
    """
    _check_design(count, seed)
    if trajectories < FEWEST_TRAJECTORIES:
        raise InputError(f"trajectories: got {trajectories}, need at least {FEWEST_TRAJECTORIES}")
    if levels < 2 or levels % 2:
        raise InputError(f"levels: got {levels}, need an even number of at least 2")
    problem, sampler = _problem(count), _salib("morris")
    return np.asarray(sampler.sample(problem, trajectories, num_levels=levels, seed=seed))


def sobol_indices(
    values: ArrayLike,
    count: int,
    seed: int,
    *,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
) -> SobolIndices:
    """Return the indices of ``values`` at the points of `saltelli`.

    With y at a, at b and at a with x_i of b, y_i, counted from the mean of all:

        S_i V = E(y_b (y_i − y_a)),  T_i V = E((y_i − y_a)²) / 2,  V = V(y_a, y_b)

    The interval is of whole blocks drawn with replacement. It takes them for independent; points
    of a Sobol sequence are more even than that, so it is rather too wide.

    Args:
        values: y (blocks · (count + 2)), any unit, in the order of the design; NaN: diverged.
        count: number of factors.
        seed: of the resampling.
        confidence: probability of the interval.
        resamples: of the bootstrap.

    Raises:
        InputError: a number of values that is no whole number of blocks, fewer than 8 blocks
            without a diverged rollout, or bad parameters.

    Source: Saltelli2010 (table 2, b and f), EfronTibshirani1993 (chapter 13).
    """
    _check_design(count, seed)
    check_confidence(confidence)
    y = _grouped(values, count + 2, "blocks")
    used = y[np.isfinite(y).all(axis=1)]
    _check_enough(len(used), len(y), FEWEST_BLOCKS, "blocks")
    if np.ptp(used) <= ROUND_OFF * np.abs(used).max():
        none = np.full(count, np.nan)
        return SobolIndices(none, none, none, none, none, none, len(y), len(used))
    moments = _moments((used - used.mean()) / np.ptp(used))
    estimate = _indices(moments.mean(axis=0)[None])[0]
    drawn = _indices(bootstrap_means(moments, seed, resamples))
    low, high = percentile_interval(drawn, confidence)
    ends = (low[:count], high[:count], low[count:], high[count:])
    return SobolIndices(estimate[:count], estimate[count:], *ends, len(y), len(used))


def morris_effects(
    points: Matrix,
    values: ArrayLike,
    seed: int,
    *,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
) -> MorrisEffects:
    """Return the elementary effects of ``values`` at the points of `morris`.

    Args:
        points: the design (trajectories · (count + 1) × count), in the unit cube, so that effects
            are those of the whole range, or in any other unit.
        values: y, one for each row, any unit; NaN: diverged.
        seed: of the resampling.
        confidence: probability of the interval.
        resamples: of the bootstrap.

    Raises:
        InputError: not a Morris design, another number of values, fewer than 4 trajectories
            without a diverged rollout, or bad parameters.

    Source: Morris1991, Campolongo2007 (μ*).
    """
    check_confidence(confidence)
    trajectories = _trajectories(points)
    count = trajectories.shape[2]
    y = _grouped(values, count + 1, "trajectories")
    if len(y) != len(trajectories):
        raise InputError(f"values: got {y.size}, need {len(points)}, one for each point")
    finite = np.isfinite(y).all(axis=1)
    used = int(finite.sum())
    _check_enough(used, len(y), FEWEST_TRAJECTORIES, "trajectories")
    steps = np.diff(trajectories[finite], axis=1)  # (trajectory, step, factor)
    factor = np.abs(steps).argmax(axis=2)
    slope = np.diff(y[finite], axis=1) / steps.sum(axis=2)
    effects = np.empty_like(slope)
    np.put_along_axis(effects, factor, slope, axis=1)
    magnitudes = np.abs(effects)
    low, high = percentile_interval(bootstrap_means(magnitudes, seed, resamples), confidence)
    sigma = effects.std(axis=0, ddof=1)
    return MorrisEffects(
        effects.mean(axis=0), magnitudes.mean(axis=0), sigma, low, high, len(y), used
    )


def _moments(y: Matrix) -> Matrix:
    """Return the terms whose means make the indices (blocks × 2 + 2 count), block by block."""
    a, b, mixed = y[:, :1], y[:, -1:], y[:, 1:-1]
    step = mixed - a
    return np.hstack([(a + b) / 2, (a**2 + b**2) / 2, b * step, step**2 / 2])


def _indices(means: Matrix) -> Matrix:
    """Return S, then T (rows × 2 count), for each row of mean moments; NaN without variance."""
    mu, square = means[:, :1], means[:, 1:2]
    variance = square - mu**2
    varies = variance > ROUND_OFF * np.maximum(square, mu**2)
    return means[:, 2:] / np.where(varies, variance, np.nan)


def _trajectories(points: Matrix) -> Matrix:
    """Return the points, trajectory by trajectory (trajectories × count + 1 × count)."""
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] == 0 or len(array) % (array.shape[1] + 1):
        raise InputError(
            f"points: got shape {array.shape}, need trajectories · (count + 1) × count"
        )
    count = array.shape[1]
    array = array.reshape(-1, count + 1, count)
    moved = np.diff(array, axis=1) != 0
    if not ((moved.sum(axis=1) == 1).all() and (moved.sum(axis=2) == 1).all()):
        raise InputError("points: no Morris design; each factor must move once, one at a time")
    return array


def _grouped(values: ArrayLike, size: int, name: str) -> Matrix:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or len(array) % size:
        raise InputError(f"values: got shape {array.shape}, need {name} of {size} in a row")
    return array.reshape(-1, size)


def _check_enough(used: int, of: int, fewest: int, name: str) -> None:
    if used < fewest:
        raise InputError(
            f"{name}: {used} of {of} hold finite values only, need at least {fewest}; "
            "too many rollouts diverged, or the design is too small"
        )


def _check_design(count: int, seed: int) -> None:
    if count < 1:
        raise InputError(f"factors: got {count}, need at least 1")
    if seed < 0:
        raise InputError(f"seed: got {seed}, need a number >= 0")


def nearest_power_of_two(size: int, least: int = 2) -> int:
    """Return the power of two nearest to ``size``, at least ``least``; of two the smaller."""
    below: int = 1 << max(size.bit_length() - 1, 0)
    return max(least, below if size - below <= 2 * below - size else 2 * below)


def _problem(count: int) -> dict[str, object]:
    """Return the unit cube as SALib knows it."""
    names = [f"x{i}" for i in range(count)]
    return {"num_vars": count, "names": names, "bounds": [[0.0, 1.0]] * count}


def _salib(name: str) -> ModuleType:
    try:
        from SALib.sample import morris as morris_sampler
        from SALib.sample import sobol as sobol_sampler
    except ImportError as error:
        message = "Sobol indices and Morris screening need the extra"
        raise InputError(f"{message}: pip install 'qpctrl[studies]'") from error
    return {"morris": morris_sampler, "sobol": sobol_sampler}[name]
