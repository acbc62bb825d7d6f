"""Bisection for the place where a property is lost."""

from collections.abc import Callable


def boundary(holds: Callable[[float], bool], low: float, high: float, tolerance: float) -> float:
    """Return where ``holds`` turns false between ``low`` and ``high``, ± half of ``tolerance``.

    Args:
        holds: the property; true at ``low`` and false at ``high``.
        low: lower end.
        high: upper end.
        tolerance: width of the last interval, in the same unit.
    """
    while high - low > tolerance:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return (low + high) / 2
