"""Rates and means over rollouts, with intervals that say how well they are known."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest

from qpctrl.arrays import Matrix, Vector
from qpctrl.errors import InputError

RESAMPLES = 1000
"""Bootstrap resamples: the ends of a 95 % interval are each the 25th from the end."""
LARGEST_BATCH = 1 << 22
"""Numbers that one batch of resamples holds, so that memory does not grow with them."""


class Rate(NamedTuple):
    """A share or a mean, and its confidence interval."""

    value: float
    low: float
    high: float


def wilson(count: int, of: int, confidence: float = 0.95) -> Rate:
    """Return the share count / of with its Wilson score interval.

    Of nothing (``of`` = 0) the share is NaN and the interval all of 0 to 1.

    Args:
        count: rollouts that did.
        of: all rollouts.
        confidence: probability that the interval covers the true share.

    Raises:
        InputError: a count outside 0 … of, or a confidence outside 0 … 1.

    Source: Wilson1927.
    """
    check_confidence(confidence)
    if not 0 <= count <= of:
        raise InputError(f"rate: got {count} of {of}, need 0 <= count <= of")
    if of == 0:
        return Rate(float("nan"), 0.0, 1.0)
    interval = binomtest(int(count), int(of)).proportion_ci(confidence, method="wilson")
    return Rate(count / of, float(interval.low), float(interval.high))


def bootstrap_mean(
    values: ArrayLike, seed: int, confidence: float = 0.95, resamples: int = RESAMPLES
) -> Rate:
    """Return the mean of ``values`` (rollouts) with its bootstrap percentile interval.

    Below some twenty values such an interval is too narrow.

    Args:
        values: one number a rollout; any unit.
        seed: of the resampling.
        confidence: probability that the interval covers the true mean, nearly.
        resamples: how many.

    Raises:
        InputError: fewer than two values, one that is not finite (a rollout that diverged has no
            mean: count it with `wilson`), or bad parameters.

    Source: EfronTibshirani1993 (chapter 13).
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or len(array) < 2:
        raise InputError(f"values: got shape {array.shape}, need at least 2 numbers in a row")
    if bad := int((~np.isfinite(array)).sum()):
        raise InputError(f"values: {bad} of {len(array)} are not finite; count them as diverged")
    means = bootstrap_means(array[:, None], seed, resamples)
    low, high = percentile_interval(means, confidence)
    return Rate(float(array.mean()), float(low[0]), float(high[0]))


def bootstrap_means(rows: Matrix, seed: int, resamples: int = RESAMPLES) -> Matrix:
    """Return the column means of ``rows`` drawn with replacement (resamples × columns).

    Args:
        rows: finite numbers (n × columns); a row is drawn whole.
        seed: of the resampling.
        resamples: how many.

    Raises:
        InputError: a negative seed, or no resample.
    """
    if seed < 0:
        raise InputError(f"seed: got {seed}, need a number >= 0")
    if resamples < 1:
        raise InputError(f"resamples: got {resamples}, need at least 1")
    n, rng = len(rows), np.random.default_rng(seed)
    means = np.empty((resamples, rows.shape[1]))
    batch = max(1, LARGEST_BATCH // n)
    for start in range(0, resamples, batch):
        size = min(batch, resamples - start)
        drawn = rng.integers(n, size=(size, n)) + n * np.arange(size)[:, None]
        times = np.bincount(drawn.ravel(), minlength=size * n).reshape(size, n)
        means[start : start + size] = times @ rows / n
    return means


def percentile_interval(samples: Matrix, confidence: float) -> tuple[Vector, Vector]:
    """Return both ends, column by column, of what ``confidence`` of the samples lie between.

    A column with a NaN has NaN ends.

    Raises:
        InputError: a confidence outside 0 … 1.
    """
    check_confidence(confidence)
    low, high = np.quantile(samples, [(1 - confidence) / 2, (1 + confidence) / 2], axis=0)
    return low, high


def check_confidence(confidence: float) -> None:
    """Refuse a probability that no interval has.

    Raises:
        InputError: a confidence outside 0 … 1.
    """
    if not 0 < confidence < 1:
        raise InputError(f"confidence: got {confidence}, need a number between 0 and 1")
