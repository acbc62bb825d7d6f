"""The steps of the plants that integrate their own equations: explicit Runge–Kutta schemes."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

from qpctrl.arrays import Vector

FINE = 2e-4
"""Longest period [s] for which a step of two stages is exact enough."""

Accelerate: TypeAlias = Callable[[float, Vector, Vector], Vector]
"""(time, q, v) → acceleration (nv), called once for each stage, in the order of the stages."""

Step: TypeAlias = Callable[[Accelerate, float, Vector, Vector, float], tuple[Vector, Vector]]
"""(accelerate, t, q, v, h) → q and v (nv each) after the step h [s] from time t [s]."""


class Scheme(NamedTuple):
    """A step, and how it integrates what is known at its stages."""

    step: Step
    """The step."""
    weights: tuple[float, ...]
    """Weight of each stage in an integral over the step, up to their common sum."""

    def integral(self, rates: Sequence[float], h: float) -> float:
        """Return ∫ rate dt over a step of ``h`` [s] from the rates at its stages."""
        weighted = sum(w * rate for w, rate in zip(self.weights, rates, strict=True))
        return h / sum(self.weights) * weighted


def choose_scheme(period: float) -> Scheme:
    """Return the midpoint rule for a ``period`` [s] of at most `FINE`, else Runge–Kutta's."""
    return MIDPOINT if period <= FINE else CLASSICAL


def runge_kutta(
    accelerate: Accelerate, t: float, q: Vector, v: Vector, h: float
) -> tuple[Vector, Vector]:
    """Return q and v (nv each) after the classical step ``h`` [s] from time ``t`` [s]; order 4.

    Args:
        accelerate: (time, q, v) → acceleration (nv), called once for each of the four stages.
        t: time at the start [s].
        q: configuration there (nv) [rad or m].
        v: velocity there (nv) [rad/s or m/s].
        h: length of the step [s].
    """
    a1 = accelerate(t, q, v)
    a2 = accelerate(t + h / 2, q + h / 2 * v, v + h / 2 * a1)
    a3 = accelerate(t + h / 2, q + h / 2 * v + h**2 / 4 * a1, v + h / 2 * a2)
    a4 = accelerate(t + h, q + h * v + h**2 / 2 * a2, v + h * a3)
    return q + h * v + h**2 / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def midpoint(
    accelerate: Accelerate, t: float, q: Vector, v: Vector, h: float
) -> tuple[Vector, Vector]:
    """Return the same after a step of the explicit midpoint rule: two stages, order 2.

    A step of an undamped oscillation of rate ω [rad/s] lets its energy grow by (h ω)⁴/4 of it.
    """
    a1 = accelerate(t, q, v)
    v2 = v + h / 2 * a1
    a2 = accelerate(t + h / 2, q + h / 2 * v, v2)
    return q + h * v2, v + h * a2


CLASSICAL = Scheme(runge_kutta, (1.0, 2.0, 2.0, 1.0))
MIDPOINT = Scheme(midpoint, (0.0, 1.0))
