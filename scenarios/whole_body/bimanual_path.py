"""Where a carried box goes: straight legs, a lying eight in the air, a ring on the table."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector
from scenarios.guided import Stroke
from scenarios.path import glide
from tasks import MotionReference

AXIS = np.array([0.0, 0.6, 0.8])
"""Unit vector in the world about which the box is turned while it is carried."""

STILL = Stroke(0.0, 0.0, 0.0)


class Place(NamedTuple):
    """Where the middle of the box's lowest face is, against the middle of the table."""

    p: Vector
    """Position (3) [m], along the axes of the world."""
    p_dot: Vector
    """Velocity (3) [m/s]."""
    p_ddot: Vector
    """Acceleration (3) [m/s²]."""
    turn: Stroke = STILL
    """Angle [rad] about `AXIS`, and its derivatives."""

    def reference(self, X_WT: pin.SE3) -> MotionReference:
        """Return pose, body twist and its derivative of the face; ``X_WT``: table, z down."""
        R_WD = pin.exp3(self.turn.s * AXIS) @ X_WT.rotation
        omega, omega_dot = self.turn.s_dot * AXIS, self.turn.s_ddot * AXIS
        v_dot = self.p_ddot - np.cross(omega, self.p_dot)  # of the body components
        return MotionReference(
            X_WD=pin.SE3(R_WD, X_WT.translation + self.p),
            V_des=np.concatenate([R_WD.T @ self.p_dot, R_WD.T @ omega]),
            V_dot_des=np.concatenate([R_WD.T @ v_dot, R_WD.T @ omega_dot]),
        )


Path: TypeAlias = Callable[[float], Place]
"""Place at a time [s] from its start."""


def stay(p: Vector) -> Path:
    """Return no motion at ``p`` (3) [m]."""
    return lambda t: Place(p, np.zeros(3), np.zeros(3))


def straight(start: Vector, end: Vector, duration: float) -> Path:
    """Return the way from ``start`` to ``end`` (3) [m] in ``duration`` [s], from rest to rest."""

    def at(t: float) -> Place:
        s, s_dot, s_ddot = glide(t, duration)
        way = end - start
        return Place(start + s * way, s_dot * way, s_ddot * way)

    return at


def sink(start: Vector, speed: float, ramp: float = 0.1) -> Path:
    """Return the way down from ``start`` (3) [m] at ``speed`` [m/s], without an end."""

    def at(t: float) -> Place:
        x = min(t / ramp, 1.0)
        s = speed * (ramp * (x**3 - x**4 / 2) + max(t - ramp, 0.0))
        s_dot, s_ddot = speed * x * x * (3 - 2 * x), speed * 6 * x * (1 - x) / ramp
        down = np.array([0.0, 0.0, -1.0])
        return Place(start + s * down, s_dot * down, s_ddot * down)

    return at


def eight(start: Vector, size: tuple[float, float, float], turn: float, duration: float) -> Path:
    """Return a lying eight that rises and sinks twice and turns to both sides.

    p = start + (a sin φ, b sin 2φ, c (1 − cos 2φ)/2), angle = turn · sin φ, φ from 0 to 2π.

    Args:
        start: its crossing (3) [m].
        size: a, b, c [m].
        turn: largest angle [rad].
        duration: time from rest to rest [s].
    """
    a, b, c = size

    def at(t: float) -> Place:
        phi, rate, change = (2 * np.pi * part for part in glide(t, duration))
        s1, c1, s2, c2 = np.sin(phi), np.cos(phi), np.sin(2 * phi), np.cos(2 * phi)
        p = np.array([a * s1, b * s2, c * (1 - c2) / 2])
        slope = np.array([a * c1, 2 * b * c2, c * s2])
        bend = np.array([-a * s1, -4 * b * s2, 2 * c * c2])
        stroke = Stroke(turn * s1, turn * c1 * rate, turn * (c1 * change - s1 * rate**2))
        return Place(start + p, slope * rate, slope * change + bend * rate**2, stroke)

    return at


def ring(start: Vector, radius: float, duration: float) -> Path:
    """Return a circle on the table from ``start`` (3) [m] to the side +x and back, once round."""

    def at(t: float) -> Place:
        phi, rate, change = (2 * np.pi * part for part in glide(t, duration))
        out = np.array([np.cos(phi), np.sin(phi), 0.0])
        along = np.array([-np.sin(phi), np.cos(phi), 0.0])
        back = radius * (np.array([1.0, 0.0, 0.0]) - out)
        v = -radius * along
        return Place(start + back, v * rate, v * change + radius * out * rate**2)

    return at
