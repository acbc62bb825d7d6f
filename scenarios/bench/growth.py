"""How the cost of a tick's parts grows with the number of joints: t ~ n^p."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from scenarios.bench.part_trial import CALL, DYNAMICS, WHOLE
from scenarios.bench.row import Row

CUBIC = 3.0
"""Power that no part should pass."""
SHARES = (CALL, DYNAMICS)
"""What other parts hold, or hold themselves."""
GOAL_US = 60.0
"""What a tick of the largest arm should take [µs]."""


@dataclass(frozen=True, kw_only=True)
class Growth:
    """One part over the number of joints."""

    part: str
    compiled: bool
    joints: tuple[int, ...]
    median_us: tuple[float, ...]
    powers: tuple[float, ...]
    """From each number of joints to the next."""
    power: float
    """Of all of them together, by least squares."""


def power(n: tuple[float, float], t: tuple[float, float]) -> float:
    """Return p in t ~ n^p through two points."""
    return math.log(t[1] / t[0]) / math.log(n[1] / n[0])


def fitted_power(n: Sequence[float], t: Sequence[float]) -> float:
    """Return p in t ~ n^p, by least squares of the logarithms."""
    return float(np.polyfit(np.log(n), np.log(t), 1)[0])


def growth(rows: Sequence[Row]) -> list[Growth]:
    """Return the growth of each part that was timed with two numbers of joints or more."""
    found = []
    for compiled in (True, False):
        own = [row for row in rows if row.section == "part" and row.compiled is compiled]
        for part in dict.fromkeys(row.name for row in own):
            points = sorted((row.joints, row.median_us) for row in own if row.name == part)
            if len(points) > 1:
                found.append(_of(part, compiled, points))
    return found


def _of(part: str, compiled: bool, points: list[tuple[int, float]]) -> Growth:
    joints, t = zip(*points, strict=True)
    pairs = zip(pairwise(joints), pairwise(t), strict=True)
    return Growth(
        part=part,
        compiled=compiled,
        joints=joints,
        median_us=t,
        powers=tuple(power(one, other) for one, other in pairs),
        power=fitted_power(joints, t),
    )


def in_the_way(found: Sequence[Growth], compiled: bool) -> str:
    """Return in words what a tick of the largest arm takes, and which part takes most of it."""
    own = {one.part: one for one in found if one.compiled is compiled}
    if WHOLE not in own:
        return ""
    whole = own.pop(WHOLE)
    largest, tick = whole.joints[-1], whole.median_us[-1]
    reached = [one for one in own.values() if one.joints[-1] == largest]
    parts = {one.part: one.median_us[-1] for one in reached if one.part not in SHARES}
    said = f"{largest} joints: {tick:.1f} µs a tick"
    if largest >= 38:
        said += f", {'within' if tick <= GOAL_US else 'above'} {GOAL_US:g} µs"
    if parts:
        first = max(parts, key=lambda name: parts[name])
        share = 100 * parts[first] / tick
        said += f"; most of it, {parts[first]:.1f} µs ({share:.0f} %), is {first}"
    fast = [one.part for one in found if one.compiled is compiled and one.power > CUBIC]
    return f"{said}; faster than n³: {', '.join(fast) or 'nothing'}"
