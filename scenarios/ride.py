"""The way of a board that is carried along, heaves and rocks, and what a tool sees of it."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, Twist, Vector
from qpctrl.constraint import EnvironmentMotion
from scenarios.guided import Stroke, ThereAndBack
from scenarios.metric import column
from scenarios.path import glide

ROCK_AXIS = np.array([0.8, 0.6, 0.0])  # in the plane of the board, so that it tips both ways
EASE = 1.0  # s, in which heave and rock grow at the start and fade at the end


class Carried(NamedTuple):
    """Pose and motion of the board, in its own axes."""

    X_WE: pin.SE3
    """Pose of the board."""
    V: Twist
    """Its body twist (6) [m/s, rad/s]."""
    V_dot: Twist
    """The derivative of that (6) [m/s², rad/s²]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ride:
    """The way of the board: along its y axis and back, heaving and rocking meanwhile."""

    X_WE_start: pin.SE3
    """Pose at rest, until it sets off."""
    start: float
    """Time at which it sets off [s]."""
    carry: ThereAndBack
    """Way along y."""
    heave: float
    """Amplitude along z [m]."""
    rock: float
    """Amplitude about `ROCK_AXIS` [rad], a quarter of a period ahead of the heave."""
    frequency: float
    """Frequency of both [Hz]."""
    duration: float
    """Time from rest to rest [s]."""

    def at(self, time: float) -> Carried:
        """Return where the board is at ``time`` [s], and how it moves."""
        t = time - self.start
        along, up, turn = self.carry.at(t), self._sway(t, 0.0), self._sway(t, np.pi / 2)
        p, p_dot, p_ddot = (
            np.array([0.0, y, self.heave * z]) for y, z in zip(along, up, strict=True)
        )
        angle, omega, omega_dot = (self.rock * x * ROCK_AXIS for x in turn)
        R = pin.exp3(angle)
        v = R.T @ p_dot
        v_dot = R.T @ p_ddot - pin.skew(omega) @ v
        X_WE = self.X_WE_start * pin.SE3(R, p)
        return Carried(X_WE, np.concatenate([v, omega]), np.concatenate([v_dot, omega_dot]))

    def shift(self, time: float) -> EnvironmentMotion:
        """Return the same as the displacement D = X_WE X_WE(0)⁻¹ from the start."""
        X_WE, V, V_dot = self.at(time)
        Ad = self.X_WE_start.action
        D = X_WE * self.X_WE_start.inverse()
        return EnvironmentMotion(X_shift=D, V_env=Ad @ V, V_dot_env=Ad @ V_dot)

    def _sway(self, t: float, phase: float) -> Stroke:
        """Return a sine of amplitude 1 that grows at the start and fades at the end."""
        rise, fall = glide(t, EASE), glide(t - (self.duration - EASE), EASE)
        e, e_dot, e_ddot = (a - b for a, b in zip(rise, fall, strict=True))
        w = 2 * np.pi * self.frequency
        s, c = np.sin(w * t + phase), np.cos(w * t + phase)
        return Stroke(e * s, e_dot * s + e * w * c, e_ddot * s + 2 * e_dot * w * c - e * w**2 * s)


@dataclass(frozen=True, kw_only=True, eq=False)
class Eight:
    """A figure of eight on the board: x = h sin 2θ, y = w sin θ."""

    height: float
    """Half height h, along x of E [m]."""
    width: float
    """Half width w, along y of E [m]."""

    def at(self, angle: Stroke) -> tuple[Vector, Vector, Vector]:
        """Return position, velocity and acceleration (3 each) in E for θ and its derivatives."""
        size = np.array([self.height, self.width, 0.0])
        turns, theta = np.array([2.0, 1.0, 0.0]), angle.s
        p = size * np.sin(turns * theta)
        slope = size * turns * np.cos(turns * theta)
        bend = -(turns**2) * p
        return p, slope * angle.s_dot, bend * angle.s_dot**2 + slope * angle.s_ddot


def seen_from_board(table: pl.DataFrame, ride: Ride) -> tuple[Matrix, Vector]:
    """Return the tool's position (ticks×3) [m] in E, and its tilt (ticks) [rad] against E."""
    columns = np.stack([column(table, f"motion.X_WF.{i}") for i in range(12)], axis=1)
    p_E, z_E = np.zeros((len(table), 3)), np.zeros((len(table), 3))
    for i, (t, X_WF) in enumerate(zip(column(table, "time").tolist(), columns, strict=True)):
        X_WE = ride.at(t).X_WE
        p_E[i], z_E[i] = X_WE.actInv(X_WF[9:]), X_WE.rotation.T @ X_WF[6:9]
    return p_E, np.hypot(z_E[:, 0], z_E[:, 1])


def board_speed(table: pl.DataFrame, ride: Ride) -> Matrix:
    """Return v_c (ticks×3) [m/s, rad/s] at the tool: along z, about x and about y of E."""
    p_E, _ = seen_from_board(table, ride)
    V = np.array([ride.at(t).V for t in column(table, "time").tolist()])
    along = V[:, :3] + np.cross(V[:, 3:], p_E)
    return np.column_stack([along[:, 2], V[:, 3], V[:, 4]])
