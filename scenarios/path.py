"""Paths on a plane, travelled at constant speed with smooth starts and stops; laid out ahead."""

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Matrix, Vector
from tasks import MotionReference

RAMP = 0.5
"""Longest time [s] in which a path gathers speed, and loses it."""


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
    nu = radius / (2 * np.pi * sway)

    def place(u: Vector) -> Matrix:
        return np.stack([radius * np.cos(u), radius * np.sin(u) - sway * np.cos(nu * u)], axis=-1)

    def slope(u: Vector) -> Matrix:
        return np.stack(
            [-radius * np.sin(u), radius * np.cos(u) + sway * nu * np.sin(nu * u)], axis=-1
        )

    def bend(u: Vector) -> Matrix:
        return np.stack(
            [-radius * np.cos(u), -radius * np.sin(u) + sway * nu**2 * np.cos(nu * u)], axis=-1
        )

    return _travel(_Curve(place, slope, bend, radius), ramped(speed, duration, dt))


def advancing_loops(
    speed: float, length: float, dt: float, *, radius: float = 0.08, pitch: float = 0.2
) -> PlanarMotion:
    """Return circles that advance along −y, as a hand wipes a long board.

    c(u) = (r cos u, r sin u − p u / 2π), travelled as `wiping_loops` are; at the end their centre
    has advanced by ``length``.

    Args:
        speed: speed along the path [m/s].
        length: way of the centre [m].
        dt: sampling period [s].
        radius: radius r of a circle [m].
        pitch: way p of the centre in one turn [m].
    """
    drift, turns = pitch / (2 * np.pi), length / pitch

    def place(u: Vector) -> Matrix:
        return np.stack([radius * np.cos(u), radius * np.sin(u) - drift * u], axis=-1)

    def slope(u: Vector) -> Matrix:
        return np.stack([-radius * np.sin(u), radius * np.cos(u) - drift], axis=-1)

    def bend(u: Vector) -> Matrix:
        return np.stack([-radius * np.cos(u), -radius * np.sin(u)], axis=-1)

    u = np.linspace(0.0, 2 * np.pi * turns, round(20_000 * turns) + 2)
    way = float(np.trapezoid(np.linalg.norm(slope(u), axis=-1), u))
    travelled = ramped(speed, _ramped_duration(speed, way), dt)
    return _travel(_Curve(place, slope, bend, radius), travelled)


class _Curve(NamedTuple):
    """A curve that goes in circles, and its derivatives, each a function of u (samples×2) [m]."""

    place: Callable[[Vector], Matrix]
    slope: Callable[[Vector], Matrix]
    bend: Callable[[Vector], Matrix]
    radius: float
    """Radius of the circles [m]."""


def _travel(curve: _Curve, along: "Glide[Vector]") -> PlanarMotion:
    """Return a curve on which one moves ``along`` its length [m]: u̇ = s / |c′(u)|."""
    travelled, s, s_dot = along
    turns = 1.3 * travelled[-1] / (2 * np.pi * curve.radius) + 1
    fine = np.linspace(0.0, 2 * np.pi * turns, round(20_000 * turns))
    rate = np.linalg.norm(curve.slope(fine), axis=-1)
    length = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(fine))])
    u = np.interp(travelled, length, fine)
    c1, c2 = curve.slope(u), curve.bend(u)
    norm = np.linalg.norm(c1, axis=-1)
    u_dot = s / norm
    u_ddot = s_dot / norm - s * u_dot * (c1 * c2).sum(-1) / norm**3
    return PlanarMotion(
        p=curve.place(u),
        v=c1 * u_dot[:, None],
        a=c2 * u_dot[:, None] ** 2 + c1 * u_ddot[:, None],
    )


Number = TypeVar("Number", float, Vector)


class Glide(NamedTuple, Generic[Number]):
    """A straight move of unit length at one time, or at many: fraction done and derivatives."""

    s: Number
    s_dot: Number
    s_ddot: Number


def glide(t: float, duration: float) -> Glide[float]:
    """Return the quintic from rest to rest at time ``t`` of ``duration`` [s]."""
    return _quintic(min(max(t / duration, 0.0), 1.0), duration)


def glides(times: Vector, duration: float) -> Glide[Vector]:
    """Return what `glide` returns at each of ``times`` [s]."""
    return _quintic(np.clip(times / duration, 0.0, 1.0), duration)


def _quintic(x: Number, duration: float) -> Glide[Number]:
    return Glide(
        x**3 * (10 - 15 * x + 6 * x * x),
        30 * x**2 * (1 - x) ** 2 / duration,
        60 * x * (1 - x) * (1 - 2 * x) / duration**2,
    )


def ramped(speed: float, duration: float, dt: float) -> Glide[Vector]:
    """Return a way [m] from rest to rest at a constant speed [m/s], and its derivatives.

    The speed rises and falls as quintics, each of half a second or a quarter of the duration.
    """
    time = np.arange(round(duration / dt) + 1) * dt
    ramp = min(RAMP, duration / 4)
    rise, fall = glides(time, ramp), glides(time - (time[-1] - ramp), ramp)
    s, s_dot = speed * (rise.s - fall.s), speed * (rise.s_dot - fall.s_dot)
    way = np.concatenate([[0.0], np.cumsum((s[1:] + s[:-1]) / 2 * dt)])
    return Glide(way, s, s_dot)


def _ramped_duration(speed: float, way: float) -> float:
    """Return the duration [s] for which `ramped` goes ``way`` [m]."""
    full = way / speed + RAMP
    return full if full >= 4 * RAMP else way / (0.75 * speed)


class Track(NamedTuple):
    """A motion laid out ahead, one row a period; it goes on as fast as it ends."""

    X_WD: Array
    """Poses [R p] (periods×3×4) [1, m]."""
    V_des: Matrix
    """Body twists (periods×6) [m/s, rad/s]."""
    V_dot_des: Matrix
    """Their derivatives (periods×6) [m/s², rad/s²]."""
    dt: float
    """Period [s]."""
    comes_to_rest: bool
    """Whether it ends at rest."""

    def at(self, t: float) -> MotionReference:
        """Return the reference of the period that begins next to ``t`` [s]."""
        X_WD, V_des, V_dot_des, dt, comes_to_rest = self
        i, last = round(t / dt), len(V_des) - 1
        if 0 <= i <= last:
            return MotionReference(X_WD=X_WD[i], V_des=V_des[i], V_dot_des=V_dot_des[i])
        if i < 0 or comes_to_rest:
            return self.at(0.0 if i < 0 else last * dt)
        end = X_WD[last].copy()
        end[:, 3] += end[:, :3] @ ((i - last) * dt * V_des[last, :3])
        return MotionReference(X_WD=end, V_des=V_des[last], V_dot_des=V_dot_des[last])


def lay_out(X_WE: pin.SE3, p_E: Matrix, v_E: Matrix, a_E: Matrix, dt: float) -> Track:
    """Return the track of a frame that keeps the orientation of E, a frame at rest.

    Args:
        X_WE: pose of E in the world.
        p_E: positions (periods×3) [m], along the axes of E.
        v_E: velocities (periods×3) [m/s].
        a_E: accelerations (periods×3) [m/s²].
        dt: period [s].
    """
    rows = np.zeros((len(p_E), 24))  # in the order of a task's inputs: poses column by column
    X_WD = rows[:, :12].reshape(-1, 4, 3).transpose(0, 2, 1)
    V_des, V_dot_des = rows[:, 12:18], rows[:, 18:]
    X_WD[:, :, :3], X_WD[:, :, 3] = X_WE.rotation, X_WE.translation + p_E @ X_WE.rotation.T
    V_des[:, :3], V_dot_des[:, :3] = v_E, a_E
    return Track(X_WD, V_des, V_dot_des, dt, comes_to_rest=not v_E[-1].any())
