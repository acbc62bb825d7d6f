"""One problem that qpctrl, TSID and placo can all state: a point at rest presses and turns.

The origin of the tool rests on a plane, held there by friction: three rows, v_x = v_y = v_z = 0.
It presses with a constant force along the normal while the tool turns about it, and the posture
leans towards home. The states are computed beforehand, so that every controller answers the same
ticks; they satisfy the contact, and the tool turns off its reference by about a hundredth of a
radian, so that feedback has something to do.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Matrix, Rotation, Vector
from qpctrl.errors import InputError
from qpctrl.robot import Robot

DT = 1e-3
"""Period of the loop [s]."""
TICKS = 4000
"""Ticks from home and back to it; the path has no end."""
FORCE = 30.0
"""Force on the environment [N], along the normal, into it."""
FRICTION = 0.6
"""Each of two tangential forces is at most this times the normal force."""
SMALLEST, LARGEST = 1.0, 200.0
"""Bounds on the normal force [N]."""
SWING = 0.25
"""How far the tool turns [rad], about each axis."""
ELBOW = 0.5
"""How fast the joints would move along the path [rad] where the tool leaves them free."""
LEAD = 0.01
"""How far the reference is from where the tool is [rad]."""

MOTION_GAINS = (400.0, 40.0)
"""K_p [1/s²] and K_d [1/s] of the orientation."""
POSTURE_GAINS = (20.0, 9.0)
"""K_p [1/s²] and K_d [1/s] of the posture."""

_SETTLED = 1e-13
_STEPS = 20
_STEP = 1e-4
"""Step [s] of the differences that give the reference's velocity and acceleration."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """What every controller is given: states, and what the tool shall follow, tick by tick."""

    robot: Robot
    frame: str
    """Frame of the tool."""
    X_WE: pin.SE3
    """Frame of the environment; its z axis points into it."""
    q: Matrix
    """Configurations (ticks×nq) [rad]."""
    v: Matrix
    """Velocities (ticks×nv) [rad/s]; the origin of the tool is at rest in all of them."""
    R_WD: Array
    """Orientation that the tool shall have (ticks×3×3)."""
    omega: Matrix
    """Its angular velocity (ticks×3) [rad/s], in the world."""
    alpha: Matrix
    """Its angular acceleration (ticks×3) [rad/s²], in the world."""

    @property
    def ticks(self) -> int:
        """Number of ticks."""
        return len(self.q)

    @property
    def normal(self) -> Vector:
        """Normal (3) of the environment in the world, out of it."""
        return -self.X_WE.rotation[:, 2]


class Turn(NamedTuple):
    """How a frame is turned, and turns, in the world."""

    R: Rotation
    omega: Vector
    alpha: Vector


class Sweep(NamedTuple):
    """How the tool turns, out and back, and what it shall follow meanwhile."""

    R_home: Rotation
    period: float
    """Of the whole way [s]."""
    size: float
    """How far it goes, over the usual."""

    def way(self, time: float) -> tuple[float, float]:
        """Return how far along, 0 to 1, and its rate [1/s]; at rest where it turns back."""
        w = 2 * np.pi / self.period
        return (1 - np.cos(w * time)) / 2, w * np.sin(w * time) / 2

    def turned(self, s: float) -> Rotation:
        """Return the rotation in the world, from home, at ``s`` of the way."""
        angle = self.size * SWING * np.sin(np.pi * s * np.array([2.0, 3.0, 1.0]))
        R: Rotation = pin.exp3(angle)
        return R

    def turning(self, s: float) -> Vector:
        """Return its derivative by ``s`` (3) [rad], in the world."""
        before, after = self.turned(s - _STEP), self.turned(s + _STEP)
        turn: Vector = pin.log3(after @ before.T) / (2 * _STEP)
        return turn

    def reference(self, time: float) -> Turn:
        """Return what the tool shall follow: where it is, and some way off; smooth, periodic."""
        early, now, late = (self._wanted(time + step) for step in (-_STEP, 0.0, _STEP))
        first, second = pin.log3(now @ early.T) / _STEP, pin.log3(late @ now.T) / _STEP
        return Turn(now, (first + second) / 2, (second - first) / _STEP)

    def _wanted(self, time: float) -> Rotation:
        angle = 2 * np.pi * time / self.period
        off = np.array([np.sin(3 * angle), np.cos(2 * angle), np.sin(angle)])
        R: Rotation = self.turned(self.way(time)[0]) @ pin.exp3(self.size * LEAD * off)
        return R @ self.R_home


def pose_problem(robot: Robot, frame: str, ticks: int = TICKS, size: float = 1.0) -> Problem:
    """Return the problem of an arm, from its home out and back.

    Args:
        robot: the arm; with six joints or more.
        frame: frame of its tool.
        ticks: how many; even, and 100 or more.
        size: how far it goes, over the usual; in less time the same way needs more torque.

    Raises:
        InputError: too few joints or ticks, or a path that the arm cannot follow.
    """
    if robot.nv < 6:
        raise InputError(f"robot {robot.name!r}: has {robot.nv} joints, need 6 or more")
    if ticks < 100 or ticks % 2:
        raise InputError(f"ticks: got {ticks}, need an even number >= 100")
    X_WE = robot.pose(robot.home, frame)
    path = Sweep(X_WE.rotation, ticks * DT, size)
    out = list(_follow(robot, frame, X_WE, path))
    states = [*out, *((q, -v) for q, v in out[-2:0:-1])]
    turns = [path.reference(i * DT) for i in range(ticks)]
    return Problem(
        robot=robot,
        frame=frame,
        X_WE=X_WE,
        q=np.array([q for q, _ in states]),
        v=np.array([v for _, v in states]),
        R_WD=np.array([turn.R for turn in turns]),
        omega=np.array([turn.omega for turn in turns]),
        alpha=np.array([turn.alpha for turn in turns]),
    )


def _follow(
    robot: Robot, frame: str, X_WE: pin.SE3, path: Sweep
) -> Iterator[tuple[Vector, Vector]]:
    """Yield q and v (nv each) of the way out: half of the ticks, and one."""
    arm = _Arm(robot, frame)
    q, before = np.array(robot.home), 0.0
    for i in range(round(path.period / DT) // 2 + 1):
        s, rate = path.way(i * DT)
        if i:
            q = q + arm.slope(q, (before + s) / 2, path) * (s - before)
        X_WD = pin.SE3(path.turned(s) @ X_WE.rotation, X_WE.translation)
        for _ in range(_STEPS):
            X_WF, J = arm.place(q)
            turn = pin.log3(X_WD.rotation @ X_WF.rotation.T)
            e = np.concatenate((X_WD.translation - X_WF.translation, turn))
            if np.abs(e).max() < _SETTLED:
                break
            q = q + np.linalg.pinv(J) @ e
        else:
            raise InputError(f"robot {robot.name!r}: cannot turn its tool about a point at home")
        yield q.copy(), arm.slope(q, s, path) * rate
        before = s


class _Arm:
    """An arm and its tool."""

    def __init__(self, robot: Robot, frame: str) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        self._frame = robot.frame_id(frame)

    def place(self, q: Vector) -> tuple[pin.SE3, Matrix]:
        """Return the pose of the tool, and its Jacobian (6×nv) in the axes of the world."""
        pin.framesForwardKinematics(self._model, self._data, q)
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.computeFrameJacobian(self._model, self._data, q, self._frame, world)
        return self._data.oMf[self._frame], np.array(J)

    def slope(self, q: Vector, s: float, path: Sweep) -> Vector:
        """Return dq/ds (nv): the origin of the tool rests, the tool turns, the elbow moves."""
        _, J = self.place(q)
        back = np.linalg.pinv(J)
        free = path.size * ELBOW * np.cos(2 * np.pi * s + np.arange(len(q)))
        along: Vector = back @ np.concatenate((np.zeros(3), path.turning(s)))
        return along + free - back @ (J @ free)
