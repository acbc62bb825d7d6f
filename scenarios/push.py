"""A hand that pushes an arm in one direction after the other, and what a linear answer would be."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import polars as pl
from scipy.signal import StateSpace, lsim

from qpctrl.arrays import Matrix, Vector, Wrench
from qpctrl.robot import Robot
from scenarios.environment import Hand
from scenarios.joint_level import JointLevel
from scenarios.metric import column, rms_norm
from scenarios.panel import Panel
from scenarios.path import glide
from scenarios.plant import Plant
from scenarios.plant_compliant import CompliantPlant
from scenarios.record import WRENCH
from scenarios.report_trace import Curve, curve_figure

RAMP_TIME = 0.2  # s, of each push to rise and to fall
AXES = ("x", "y", "z")


class Window(NamedTuple):
    """One push."""

    phase: str
    start: float
    """Start [s]."""
    wrench: Wrench
    """Wrench of the hand on the robot (6) [N, Nm] at its height."""


@dataclass(frozen=True, kw_only=True)
class Pushes:
    """Six pushes along and about the axes of the tool, one at a time, with rests between them."""

    force: float
    """Height of the pushes along an axis [N]."""
    moment: float
    """Height of the pushes about an axis [Nm]."""
    hold: float
    """Time of each push with its ramps [s]."""
    rest: float
    """Time of the rest after it [s]."""

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        """The pushes, in order."""
        heights = np.diag([self.force] * 3 + [self.moment] * 3)
        names = [f"push {axis}" for axis in AXES] + [f"twist {axis}" for axis in AXES]
        return tuple(
            Window(name, i * (self.hold + self.rest), height)
            for i, (name, height) in enumerate(zip(names, heights, strict=True))
        )

    @property
    def duration(self) -> float:
        """Time of all pushes and rests [s]."""
        return len(self.windows) * (self.hold + self.rest)

    def phase(self, time: float) -> str:
        """Return the name of the push, or ``rest``, at ``time`` [s]."""
        for window in self.windows:
            if window.start <= time < window.start + self.hold:
                return window.phase
        return "rest"

    def plant(self, joints: JointLevel, frame: str) -> Plant:
        """Return the arm with a hand on its ``frame``, moved by its joints."""
        arm = CompliantPlant(
            joints.robot,
            frame,
            Hand(self.wrench),
            dt=joints.dt,
            substeps=1,
            armature=joints.armature,
        )
        return joints.drive(arm)

    def wrench(self, time: float) -> Wrench:
        """Return the wrench of the hand on the robot (6) [N, Nm] at ``time`` [s]."""
        i = min(int(time / (self.hold + self.rest)), len(self.windows) - 1)
        window = self.windows[i]
        t = time - window.start
        rise = glide(t, RAMP_TIME).s - glide(t - self.hold + RAMP_TIME, RAMP_TIME).s
        return rise * window.wrench


class Answer(NamedTuple):
    """Motion of a linear system."""

    x: Matrix
    """Displacement (samples×n) [m, rad]."""
    x_dot: Matrix
    """Velocity (samples×n) [m/s, rad/s]."""


def linear_answer(time: Vector, wrench: Matrix, M: Matrix, B: Matrix, K: Matrix) -> Answer:
    """Return the motion of M ẍ + B ẋ + K x = f for a sampled f (samples×n), from rest.

    Args:
        time: samples [s], equally spaced.
        wrench: f (samples×n) [N, Nm].
        M: mass (n×n) [kg, kg m²].
        B: damping (n×n) [N s/m, Nm s/rad].
        K: stiffness (n×n) [N/m, Nm/rad].
    """
    n = len(M)
    still, one = np.zeros((n, n)), np.eye(n)
    A = np.block([[still, one], [-np.linalg.solve(M, K), -np.linalg.solve(M, B)]])
    drive = np.vstack([still, np.linalg.inv(M)])
    system = StateSpace(A, drive, np.eye(2 * n), np.zeros((2 * n, n)))
    _, state, _ = lsim(system, wrench, time)
    return Answer(state[:, :n], state[:, n:])


def inertia_at_home(robot: Robot, frame: str) -> Matrix:
    """Return Λ (6×6) [kg, kg m, kg m²] of ``frame`` at home, by pinocchio."""
    data, q = robot.model.createData(), robot.home
    upper = np.triu(pin.crba(robot.model, data, q))
    M = upper + np.triu(upper, 1).T
    local = pin.ReferenceFrame.LOCAL
    J = pin.computeFrameJacobian(robot.model, data, q, robot.frame_id(frame), local)
    return np.asarray(np.linalg.inv(J @ np.linalg.solve(M, J.T)))


def displacement(table: pl.DataFrame, task: str) -> Matrix:
    """Return x (ticks×6) [m, rad], from the reference of ``task`` to the tool, in its axes."""
    return -np.stack([column(table, f"{task}.X_e.{i}") for i in range(6)], axis=1)


def pushed(table: pl.DataFrame) -> Matrix:
    """Return the true wrench of the hand on the robot (ticks×6) [N, Nm]."""
    return -np.stack([column(table, f"wrench.{name}") for name in WRENCH], axis=1)


def static_gap(x: Matrix, expected: Matrix, time: Vector, plan: Pushes) -> float:
    """Return how far x is from its expected end in each push [1], the largest of the six.

    Args:
        x: displacement (ticks×6) [m, rad].
        expected: what it should be at the end of each push (6×6) [m, rad], one row a push.
        time: time of each tick [s].
        plan: the pushes.
    """
    gaps = []
    for window, wanted in zip(plan.windows, expected, strict=True):
        end = int(np.searchsorted(time, window.start + plan.hold - RAMP_TIME)) - 1
        gaps.append(float(np.abs(x[end] - wanted).max() / np.abs(wanted).max()))
    return max(gaps)


def answer_gap(x: Matrix, model: Matrix) -> float:
    """Return RMS(x − model) / RMS(model), the larger of translations and rotations."""
    parts = (slice(0, 3), slice(3, 6))
    return max(rms_norm((x - model)[:, part]) / rms_norm(model[:, part]) for part in parts)


def push_panels(table: pl.DataFrame, task: str, model: Matrix) -> tuple[Panel, ...]:
    """Return displacement over the model's and the pushes themselves."""
    x, f = displacement(table, task), pushed(table)

    def compared(part: slice, scale: float, words: str) -> list[Curve]:
        found = [Curve(f"{words} {a}", scale * y) for a, y in zip(AXES, x[:, part].T, strict=True)]
        return found + [
            Curve(f"model, {a}", scale * y, dashed=True)
            for a, y in zip(AXES, model[:, part].T, strict=True)
        ]

    shift = compared(slice(0, 3), 1e3, "along")
    turn = compared(slice(3, 6), float(np.degrees(1.0)), "about")
    force = [Curve(f"f{axis}", y) for axis, y in zip(AXES, f[:, :3].T, strict=True)]
    moment = [Curve(f"m{axis}", y) for axis, y in zip(AXES, f[:, 3:].T, strict=True)]
    words = "From the reference to the tool, in the tool's axes. Dashed: the linear model."
    return (
        Panel("shift", "Displacement", words, curve_figure(table, "displacement", "mm", shift)),
        Panel("turn", "Rotation", words, curve_figure(table, "rotation", "deg", turn)),
        Panel(
            "force",
            "Force of the hand",
            "On the robot, in the tool's axes.",
            curve_figure(table, "force", "N", force),
            half=True,
        ),
        Panel(
            "moment",
            "Moment of the hand",
            "On the robot, in the tool's axes.",
            curve_figure(table, "moment", "Nm", moment),
            half=True,
        ),
    )
