"""Path accuracy and path repeatability in the manner of ISO 9283.

A command path is run n times. At each of its points c_i, the plane normal to the command path
cuts the attained paths at g_ij, j = 1 … n, whose barycentre is ḡ_i. Then

    AT_p = max_i |ḡ_i − c_i|
    RT_p = max_i (l̄_i + 3 S_i),  l_ij = |g_ij − ḡ_i|,  S_i² = Σ_j (l_ij − l̄_i)² / (n − 1)

Lag along the path counts in neither: it stays in the time, not in the plane. The standard asks for
10 cycles, a path in its test cube, and a payload; what is taken from it here are the criteria.

Source: ISO9283 (§8.2, §8.3).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from qpctrl.arrays import Matrix, finite_array
from qpctrl.errors import InputError

Paths = Float[np.ndarray, "_ _ 3"]
FOLLOWED = 0.9
"""Least share of its points that every cycle passes, for a path to be called followed."""
ROUND_OFF = 1e-12
"""Height above a plane, over the size of the path, that is none: so ends are met exactly."""


class PathCriteria(NamedTuple):
    """How far the mean of the attained paths is from the command, and how far they scatter.

    Both are NaN where a cycle does not follow the path: where it passes less than 90 % of the
    points, since it stops, lags too far, or strays.
    """

    accuracy: float
    """AT_p [m]."""
    repeatability: float
    """RT_p [m]."""
    points: int
    """Points of the command path."""
    points_used: int
    """Those whose normal plane every cycle crosses; the others have no g_ij."""


def cycles(p: ArrayLike, period_ticks: int, start: int = 0) -> Paths:
    """Return the whole cycles of a motion that repeats (cycles × period_ticks × 3) [m].

    Args:
        p: positions (ticks × 3) [m].
        period_ticks: ticks of one cycle.
        start: tick at which the first one begins; what is left at the end is cut off.

    Raises:
        InputError: not ticks × 3 finite numbers, or no whole cycle.
    """
    array = np.asarray(p, dtype=np.float64)
    array = finite_array(array, (len(array) if array.ndim else 1, 3), "positions")
    if period_ticks < 1 or start < 0:
        raise InputError(f"cycles: got period {period_ticks} and start {start}, need >= 1 and >= 0")
    count = (len(array) - start) // period_ticks
    if count < 1:
        raise InputError(
            f"cycles: got {len(array)} ticks, need {start + period_ticks} for one from tick {start}"
        )
    return array[start : start + count * period_ticks].reshape(count, period_ticks, 3)


def path_criteria(
    attained: ArrayLike, commanded: ArrayLike, *, closed: bool = False
) -> PathCriteria:
    """Return path accuracy AT_p and path repeatability RT_p.

    An attained path is the line through its points. Of its cuts with a normal plane the first
    counts on the way from the tick of the command towards the plane, at most half a cycle away.

    Args:
        attained: positions (cycles × points × 3) [m], at the ticks of ``commanded``.
        commanded: positions (points × 3) [m] of one cycle, in the same frame.
        closed: whether each cycle goes on where the one before ends, as `cycles` cuts them; a
            path that lags is then followed into the next cycle.

    Raises:
        InputError: fewer than two cycles or points, wrong shapes, numbers that are not finite, or
            a command path that stands still or turns back.

    Source: ISO9283 (§8.2, §8.3).
    """
    a, c = _checked(attained, commanded)
    g, cut = _cuts(a, c, _tangents(c, closed=closed), closed=closed)
    used = np.asarray(cut.all(axis=0))
    if used.sum() < FOLLOWED * len(c):
        return PathCriteria(np.nan, np.nan, len(c), int(used.sum()))
    g, c = g[:, used], c[used]
    g_mean = g.mean(axis=0)
    l = np.linalg.norm(g - g_mean, axis=2)  # noqa: E741 (the standard's letter)
    return PathCriteria(
        accuracy=float(np.linalg.norm(g_mean - c, axis=1).max()),
        repeatability=float((l.mean(axis=0) + 3 * l.std(axis=0, ddof=1)).max()),
        points=len(used),
        points_used=len(c),
    )


def _checked(attained: ArrayLike, commanded: ArrayLike) -> tuple[Paths, Matrix]:
    a, c = np.asarray(attained, dtype=np.float64), np.asarray(commanded, dtype=np.float64)
    if c.ndim != 2 or c.shape[1] != 3 or len(c) < 2:
        raise InputError(f"commanded: got shape {c.shape}, need at least 2 points × 3")
    if a.ndim != 3 or len(a) < 2:
        raise InputError(f"attained: got shape {a.shape}, need at least 2 cycles × points × 3")
    for name, array in (("attained", a), ("commanded", c)):
        if not np.isfinite(array).all():
            raise InputError(f"{name}: {(~np.isfinite(array)).sum()} numbers are not finite")
    return finite_array(a, (len(a), *c.shape), "attained"), c


def _tangents(c: Matrix, *, closed: bool) -> Matrix:
    """Return the unit tangents (points × 3) of the command path, by central differences."""
    ends = (c[-1:], c[:1]) if closed else (c[:1], c[-1:])
    step = np.concatenate([c[1:], ends[1]]) - np.concatenate([ends[0], c[:-1]])
    length = np.linalg.norm(step, axis=1)
    if not length.all():
        point = int(np.argmin(length))
        raise InputError(f"commanded: the path stands still or turns back at point {point}")
    return step / length[:, None]


def _cuts(a: Paths, c: Matrix, t: Matrix, *, closed: bool) -> tuple[Paths, Bool[np.ndarray, "_ _"]]:
    """Return g (cycles × points × 3), and where there is one (cycles × points).

    With heights s of a segment's two ends above the plane, it cuts the plane where s changes sign;
    below the plane the search goes on forward, above it backward, and so never returns.
    """
    n, m = a.shape[:2]
    line = a.reshape(n * m, 3)
    cycle, point = (x.ravel() for x in np.indices((n, m)))
    tick = cycle * m + point
    first = np.maximum(tick - m // 2, 0 if closed else cycle * m)
    last = np.minimum(tick + m // 2, n * m - 2 if closed else cycle * m + m - 2)
    k = np.minimum(tick, last)  # the segment from k to k + 1
    g, cut = np.full((n * m, 3), np.nan), np.zeros(n * m, dtype=bool)
    open_, flat = np.arange(n * m), ROUND_OFF * np.ptp(c, axis=0).max()
    while len(open_):
        i, seg = point[open_], k[open_]
        s = [np.einsum("ij,ij->i", line[seg + end] - c[i], t[i]) for end in (0, 1)]
        s = [np.where(np.abs(height) <= flat, 0, height) for height in s]
        hit = s[0] * s[1] <= 0
        share = np.divide(s[0], s[0] - s[1], out=np.zeros_like(s[0]), where=s[0] != s[1])[hit]
        start, stop = line[seg[hit]], line[seg[hit] + 1]
        g[open_[hit]] = start + share[:, None] * (stop - start)
        cut[open_[hit]] = True
        seg = seg + np.where(s[0] < 0, 1, -1)
        stay = ~hit & (seg >= first[open_]) & (seg <= last[open_])
        k[open_[stay]] = seg[stay]
        open_ = open_[stay]
    return g.reshape(n, m, 3), cut.reshape(n, m)
