"""Rates and means over rollouts, with intervals that say how well they are known."""

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Int
from scipy.special import ndtr, ndtri, stdtrit

from qpctrl.arrays import Matrix, Vector
from qpctrl.errors import InputError

Groups: TypeAlias = Int[np.ndarray, " _"]

RESAMPLES = 1000
"""Bootstrap resamples: the ends of a 95 % interval are each the 25th from the end."""
LARGEST_BATCH = 1 << 22
"""Numbers that one batch of resamples holds, so that memory does not grow with them."""


class Rate(NamedTuple):
    """A share or a mean, and its confidence interval."""

    value: float
    low: float
    high: float


def wilson(count: int, of: int, confidence: float = 0.95, *, worth: float | None = None) -> Rate:
    """Return the share p = count / of with its Wilson score interval.

        (p + z²/2n ± z √(p (1 − p)/n + z²/4n²)) / (1 + z²/n)

    Of nothing (``of`` = 0) the share is NaN and the interval all of 0 to 1.

    Args:
        count: rollouts that did.
        of: all rollouts.
        confidence: probability that the interval covers the true share.
        worth: independent rollouts n that all of them are worth, see `effective_size`; not given:
            ``of``.

    Raises:
        InputError: a count outside 0 … of, a worth outside 0 … of, or a confidence outside 0 … 1.

    Source: Wilson1927.
    """
    check_confidence(confidence)
    if not 0 <= count <= of:
        raise InputError(f"rate: got {count} of {of}, need 0 <= count <= of")
    if of == 0:
        return Rate(float("nan"), 0.0, 1.0)
    n = of if worth is None else worth
    if not 0 < n <= of:
        raise InputError(f"rate: got {of} rollouts that are worth {n}, need 0 < worth <= {of}")
    share, z = count / of, float(ndtri((1 + confidence) / 2))
    centre, whole = share + z**2 / (2 * n), 1 + z**2 / n
    half = z * math.sqrt(share * (1 - share) / n + (z / (2 * n)) ** 2)
    low = (centre - half) / whole if count else 0.0
    return Rate(share, low, (centre + half) / whole if count < of else 1.0)


def effective_size(happened: Vector, groups: Groups) -> float:
    """Return how many independent rollouts those of shared draws are worth, for a share.

    The n at which p (1 − p)/n is the variance of the share p from group to group: all of them
    where each is a group, the number of groups where those of a group end alike.

    Two groups are added, one in which it always happens and one in which it never does: rollouts
    of a group are taken to end alike until more is known. So of few groups, or few failures, the
    interval of `wilson` is rather too wide.

    Args:
        happened: 0 or 1 (rollouts).
        groups: which draws each of them has (rollouts).

    Source: Kish1965 (design effect).
    """
    sums, sizes = _totals(happened[:, None].astype(np.float64), groups)
    usual = float(sizes.mean())
    hits, of = np.append(sums[:, 0], [usual, 0.0]), np.append(sizes, [usual, usual])
    share = hits.sum() / of.sum()
    variance = ((hits - share * of) ** 2).sum() / of.sum() ** 2
    effect = of.sum() * variance / (share * (1 - share))
    return len(happened) / max(1.0, float(effect))


def bootstrap_means(
    rows: Matrix, seed: int, resamples: int = RESAMPLES, *, groups: Groups | None = None
) -> Matrix:
    """Return the column means of ``rows`` drawn with replacement (resamples × columns).

    What shares draws is drawn together: rows of a group are not independent, groups are.

    Args:
        rows: finite numbers (n × columns).
        seed: of the resampling.
        resamples: how many.
        groups: which group each row is of (n); not given: each is one of its own.

    Raises:
        InputError: a negative seed, no resample, or groups of another number of rows.

    Source: FieldWelsh2007 (the cluster bootstrap).
    """
    if seed < 0:
        raise InputError(f"seed: got {seed}, need a number >= 0")
    if resamples < 1:
        raise InputError(f"resamples: got {resamples}, need at least 1")
    if groups is not None and groups.shape != (len(rows),):
        raise InputError(f"groups: got shape {groups.shape}, need one for each of {len(rows)} rows")
    sums, sizes = (rows, np.ones(len(rows))) if groups is None else _totals(rows, groups)
    n, rng = len(sizes), np.random.default_rng(seed)
    means = np.empty((resamples, rows.shape[1]))
    batch = max(1, LARGEST_BATCH // n)
    for start in range(0, resamples, batch):
        size = min(batch, resamples - start)
        drawn = rng.integers(n, size=(size, n)) + n * np.arange(size)[:, None]
        times = np.bincount(drawn.ravel(), minlength=size * n).reshape(size, n)
        means[start : start + size] = times @ sums / (times @ sizes)[:, None]
    return means


def percentile_interval(
    samples: Matrix, confidence: float, groups: int | None = None
) -> tuple[Vector, Vector]:
    """Return both ends, column by column, of what ``confidence`` of the samples lie between.

    A column with a NaN has NaN ends.

    Args:
        samples: of a bootstrap (resamples × columns).
        confidence: probability that the interval covers the true value, nearly.
        groups: how many n the samples are drawn from, at least 2. Means of few vary less than
            they should, by (n − 1)/n, and have Student's tails; with n the ends lie as far out
            as that takes, √(n/(n − 1)) t in place of z. Not given: as if they were many.

    Raises:
        InputError: a confidence outside 0 … 1, or fewer than two groups.

    Source: Hesterberg2015 (the expanded percentile interval).
    """
    check_confidence(confidence)
    tail = (1 - confidence) / 2
    if groups is not None:
        if groups < 2:
            raise InputError(f"groups: got {groups}, need at least 2 for an interval")
        tail = float(ndtr(math.sqrt(groups / (groups - 1)) * stdtrit(groups - 1, tail)))
    low, high = np.quantile(samples, [tail, 1 - tail], axis=0)
    return low, high


def check_confidence(confidence: float) -> None:
    """Refuse a probability that no interval has.

    Raises:
        InputError: a confidence outside 0 … 1.
    """
    if not 0 < confidence < 1:
        raise InputError(f"confidence: got {confidence}, need a number between 0 and 1")


def _totals(rows: Matrix, groups: Groups) -> tuple[Matrix, Vector]:
    """Return the sums of the rows of each group (groups × columns), and how many it has."""
    _, place = np.unique(groups, return_inverse=True)
    sizes = np.bincount(place).astype(np.float64)
    sums = np.zeros((len(sizes), rows.shape[1]))
    np.add.at(sums, place, rows)
    return sums, sizes
