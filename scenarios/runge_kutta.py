"""The classical Runge–Kutta step of the plants that integrate their own equations."""

from collections.abc import Callable

from qpctrl.arrays import Vector


def runge_kutta(
    accelerate: Callable[[float, Vector, Vector], Vector], t: float, q: Vector, v: Vector, h: float
) -> tuple[Vector, Vector]:
    """Return q and v (nv each) after the step ``h`` [s] from time ``t`` [s].

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
