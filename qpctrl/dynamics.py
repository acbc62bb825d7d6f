"""Rigid-body dynamics as CasADi expressions: M, h, and frame kinematics.

Newton–Euler recursion and composite rigid bodies in body coordinates.
Source: Featherstone2008, chapters 5 and 6.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

from qpctrl.robot import Robot
from qpctrl.spatial import (
    SX,
    SymbolicPose,
    compose,
    force_cross,
    force_to_parent,
    motion_cross,
    motion_to_child,
    skew,
)

_ROUND_OFF = 1e-12  # placements closer to 0 than this are 0: fewer instructions


class FrameKinematics(NamedTuple):
    """Kinematics of one frame F, in F's own coordinates."""

    X_WF: SymbolicPose
    J: SX
    """Body Jacobian (6×nv): ``V = J v``."""
    J_dot_v: SX
    """Drift (6) [m/s², rad/s²]: ``V̇ = J a + J̇ v``."""


class Dynamics:
    """Symbolic dynamics of a robot at the symbols ``q`` (nq) and ``v`` (nv).

    Attributes:
        q, v: the symbols.
        M: mass matrix (nv×nv) with armature [kg m², kg m, kg].
        h: bias (nv) [Nm or N], Coriolis and gravity.
    """

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        self._robot = robot
        self._parents = [int(parent) for parent in model.parents]
        self.q = ca.SX.sym("q", robot.nv)
        self.v = ca.SX.sym("v", robot.nv)
        joints = range(1, model.njoints)
        world = SymbolicPose(ca.SX.eye(3), ca.SX(3, 1))  # index 0, as in pinocchio
        self._S: list[SX] = [ca.SX(6, 1), *(_axis(model.joints[i]) for i in joints)]
        self._X: list[SymbolicPose] = [world, *(self._placement(i) for i in joints)]
        bodies = [ca.SX(6, 6), *(_sparse(model.inertias[i].matrix()) for i in joints)]
        self._Y = [_inertia(Y) for Y in bodies]
        self._V, self._drift = self._velocities()
        self.M = self._composite_rigid_body() + ca.diag(ca.SX(np.array(model.armature)))
        self.h = self._newton_euler(np.array(model.gravity.linear))

    def frame(self, name: str) -> FrameKinematics:
        """Return pose, body Jacobian and drift of frame ``name``."""
        frame = self._robot.model.frames[self._robot.frame_id(name)]
        X_JF = SymbolicPose(_sparse(frame.placement.rotation), _sparse(frame.placement.translation))
        joint = int(frame.parentJoint)
        drift = motion_to_child(X_JF, self._drift[joint])
        J = ca.SX(6, self._robot.nv)
        X = X_JF
        while joint > 0:
            J[:, joint - 1] = motion_to_child(X, self._S[joint])
            X = compose(self._X[joint], X)
            joint = self._parents[joint]
        return FrameKinematics(X, J, drift)

    def _placement(self, i: int) -> SymbolicPose:
        placement = self._robot.model.jointPlacements[i]
        fixed = SymbolicPose(_sparse(placement.rotation), _sparse(placement.translation))
        linear, angular = self._S[i][:3], self._S[i][3:]
        angle = self.q[i - 1]
        K = skew(angular)  # Rodrigues; zero for a prismatic joint
        R = ca.SX.eye(3) + ca.sin(angle) * K + (1 - ca.cos(angle)) * (K @ K)
        return compose(fixed, SymbolicPose(ca.sparsify(R), linear * angle))

    def _velocities(self) -> tuple[list[SX], list[SX]]:
        V, drift = [ca.SX(6, 1)], [ca.SX(6, 1)]
        for i in range(1, len(self._X)):
            joint_velocity = self._S[i] * self.v[i - 1]
            V.append(motion_to_child(self._X[i], V[self._parents[i]]) + joint_velocity)
            carried = motion_to_child(self._X[i], drift[self._parents[i]])
            drift.append(carried + motion_cross(V[i], joint_velocity))
        return V, drift

    def _newton_euler(self, gravity: np.ndarray) -> SX:
        lift = [ca.vertcat(ca.SX(-gravity), ca.SX.zeros(3))]
        forces = [ca.SX(6, 1)]
        for i in range(1, len(self._X)):
            lift.append(motion_to_child(self._X[i], lift[self._parents[i]]))
            momentum = self._Y[i].momentum(self._V[i])
            inertial = self._Y[i].momentum(self._drift[i] + lift[i])
            forces.append(inertial + force_cross(self._V[i], momentum))
        h = [ca.SX(0)] * (len(self._X) - 1)
        for i in reversed(range(1, len(self._X))):
            h[i - 1] = ca.dot(self._S[i], forces[i])
            parent = self._parents[i]
            forces[parent] = forces[parent] + force_to_parent(self._X[i], forces[i])
        return ca.vertcat(*h)

    def _composite_rigid_body(self) -> SX:
        composite = list(self._Y)
        M = ca.SX(self._robot.nv, self._robot.nv)
        for i in reversed(range(1, len(self._X))):
            force = composite[i].momentum(self._S[i])
            M[i - 1, i - 1] = ca.dot(self._S[i], force)
            j = i
            while self._parents[j] > 0:
                force = force_to_parent(self._X[j], force)
                j = self._parents[j]
                M[i - 1, j - 1] = M[j - 1, i - 1] = ca.dot(self._S[j], force)
            if (parent := self._parents[i]) > 0:
                composite[parent] = composite[parent].plus(composite[i].in_parent(self._X[i]))
        return M


class _Inertia(NamedTuple):
    """Inertia of bodies that move as one: ten numbers, of which four are its mass and moment."""

    mass: SX
    """Mass [kg]."""
    moment: SX
    """First moment m c (3) [kg m] of the centre of mass."""
    about: SX
    """Rotational inertia (3×3) [kg m²] about the origin."""

    def momentum(self, V: SX) -> SX:
        """Return momentum (6) [kg m/s, kg m²/s] of the twist ``V`` (6), or force of its rate."""
        v, w = V[:3], V[3:]
        linear = self.mass * v - skew(self.moment) @ w
        return ca.vertcat(linear, self.about @ w + skew(self.moment) @ v)

    def in_parent(self, X: SymbolicPose) -> "_Inertia":
        """Return the same bodies in the axes in which the pose of this frame is ``X``."""
        turned = X.R @ self.moment
        moved = turned + self.mass * X.p
        half = X.R @ self.about
        about = ca.SX(3, 3)
        for i in range(3):
            for j in range(i + 1):
                about[i, j] = about[j, i] = ca.dot(half[i, :], X.R[j, :])
        shift = skew(X.p) @ skew(turned) + skew(moved) @ skew(X.p)
        for i in range(3):
            for j in range(i + 1):
                about[i, j] = about[j, i] = about[i, j] - shift[i, j]
        return _Inertia(self.mass, moved, about)

    def plus(self, other: "_Inertia") -> "_Inertia":
        """Return both together."""
        return _Inertia(*(mine + theirs for mine, theirs in zip(self, other, strict=True)))


def _inertia(Y: SX) -> _Inertia:
    moment = ca.vertcat(Y[5, 1], Y[3, 2], Y[4, 0])
    return _Inertia(Y[0, 0], moment, Y[3:, 3:])


def _axis(joint: object) -> SX:
    data = joint.createData()  # type: ignore[attr-defined]
    joint.calc(data, np.zeros(1))  # type: ignore[attr-defined]
    return _sparse(np.asarray(data.S).reshape(6))


def _sparse(array: np.ndarray) -> SX:
    array = np.asarray(array, dtype=np.float64)
    return ca.sparsify(ca.SX(np.where(np.abs(array) < _ROUND_OFF, 0.0, array)))
