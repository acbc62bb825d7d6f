"""Paths on a plane, travelled at constant speed with smooth starts and stops."""

from typing import NamedTuple

import numpy as np

from qpctrl.arrays import Matrix, Vector


class PlanarMotion(NamedTuple):
    """Sampled motion in a plane; each row is one sample."""

    p: Matrix
    """Position (samples×2) [m]."""
    v: Matrix
    """Velocity (samples×2) [m/s]."""
    a: Matrix
    """Acceleration (samples×2) [m/s²]."""


def wiping_loops(
    speed: float, duration: float, dt: float, *, radius: float = 0.08, sway: float = 0.12
) -> PlanarMotion:
    """Return overlapping circles that sway sideways, as a hand wipes a board.

    c(u) = (r cos u, r sin u − w cos νu), with w ν chosen so that neighbouring circles overlap
    by half, and u̇ = s / |c′(u)| for the travelled speed s(t), which ramps up and down in half a
    second (or a quarter of the duration). However long it lasts, the path stays within r of
    ±w.

    Args:
        speed: speed along the path [m/s].
        duration: time from standstill to standstill [s].
        dt: sampling period [s].
        radius: radius r of a circle [m].
        sway: largest distance w of its centre from the middle [m].
    """
    time = np.arange(round(duration / dt) + 1) * dt
    s, s_dot = _trapezoid(time, speed, min(0.5, duration / 4))
    nu = radius / (2 * np.pi * sway)

    def slope(u: Vector) -> Matrix:
        return np.stack(
            [-radius * np.sin(u), radius * np.cos(u) + sway * nu * np.sin(nu * u)], axis=-1
        )

    travelled = np.concatenate([[0.0], np.cumsum((s[1:] + s[:-1]) / 2 * dt)])
    turns = 1.3 * travelled[-1] / (2 * np.pi * radius) + 1
    fine = np.linspace(0.0, 2 * np.pi * turns, round(20_000 * turns))
    rate = np.linalg.norm(slope(fine), axis=-1)
    length = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(fine))])
    u = np.interp(travelled, length, fine)
    c1 = slope(u)
    c2 = np.stack(
        [-radius * np.cos(u), -radius * np.sin(u) + sway * nu**2 * np.cos(nu * u)], axis=-1
    )
    norm = np.linalg.norm(c1, axis=-1)
    u_dot = s / norm
    u_ddot = s_dot / norm - s * u_dot * (c1 * c2).sum(-1) / norm**3
    return PlanarMotion(
        p=np.stack([radius * np.cos(u), radius * np.sin(u) - sway * np.cos(nu * u)], axis=-1),
        v=c1 * u_dot[:, None],
        a=c2 * u_dot[:, None] ** 2 + c1 * u_ddot[:, None],
    )


class Glide(NamedTuple):
    """A straight move of unit length at one time: fraction done and its derivatives."""

    s: float
    s_dot: float
    s_ddot: float


def glide(t: float, duration: float) -> Glide:
    """Return the quintic from rest to rest at time ``t`` of ``duration`` [s]."""
    x = min(max(t / duration, 0.0), 1.0)
    return Glide(
        x**3 * (10 - 15 * x + 6 * x * x),
        30 * x**2 * (1 - x) ** 2 / duration,
        60 * x * (1 - x) * (1 - 2 * x) / duration**2,
    )


def _trapezoid(time: Vector, speed: float, ramp: float) -> tuple[Vector, Vector]:
    """Return speed and acceleration that rise and fall as quintics."""
    rise = np.array([glide(t, ramp) for t in time])
    fall = np.array([glide(t - (time[-1] - ramp), ramp) for t in time])
    return speed * (rise[:, 0] - fall[:, 0]), speed * (rise[:, 1] - fall[:, 1])
