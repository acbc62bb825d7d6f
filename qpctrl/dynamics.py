"""Rigid-body dynamics as CasADi expressions: M, h, and frame kinematics.

Newton–Euler recursion and composite rigid bodies in body coordinates.
Source: Featherstone2008, chapters 5 and 6.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl.robot import Robot, floats
from qpctrl.spatial import (
    SX,
    SymbolicPose,
    compose,
    force_cross,
    force_to_parent,
    inverse,
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


class Centroid(NamedTuple):
    """The momentum about the centre of mass C, in the axes of the world."""

    mass: float
    """Mass of all that moves [kg]."""
    p_WC: SX
    """Centre of mass (3) [m]."""
    A_G: SX
    """Momentum matrix (6×nv): ``h_G = A_G v`` [kg m/s, kg m²/s]."""
    A_G_dot_v: SX
    """Drift (6) [N, Nm]: ``ḣ_G = A_G a + Ȧ_G v``."""


class Dynamics:
    """Symbolic dynamics of a robot at the symbols ``q`` (nq) and ``v`` (nv).

    Attributes:
        q, v: the symbols.
        coordinates: the coordinate in q that each velocity changes (nv); 0 for floating bodies.
        M: mass matrix (nv×nv) with armature [kg m², kg m, kg].
        h: bias (nv) [Nm or N], Coriolis and gravity.
    """

    def __init__(self, robot: Robot) -> None:
        model = robot.model
        self._robot = robot
        self._parents = [int(parent) for parent in model.parents]
        self.q = ca.SX.sym("q", robot.nq)
        self.v = ca.SX.sym("v", robot.nv)
        self.coordinates = coordinates(robot, self.q)
        joints = range(1, model.njoints)
        world = SymbolicPose(ca.SX.eye(3), ca.SX(3, 1))  # index 0, as in pinocchio
        self._columns = [[], *(list(range(j.idx_v, j.idx_v + j.nv)) for j in model.joints[1:])]
        self._S: list[SX] = [ca.SX(6, 0), *(_axes(model.joints[i]) for i in joints)]
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
            for column, S in zip(self._columns[joint], ca.horzsplit(self._S[joint]), strict=True):
                J[:, column] = motion_to_child(X, S)
            X = compose(self._X[joint], X)
            joint = self._parents[joint]
        return FrameKinematics(X, J, drift)

    def relative(self, name: str, other: str) -> FrameKinematics:
        """Return the kinematics of frame ``name`` as seen from frame ``other``.

        V = V_F − Ad_{X_FB} V_B, in the axes of F; what is fixed in B turns with −V, seen from F.
        """
        F, B = self.frame(name), self.frame(other)
        X_BF = compose(inverse(B.X_WF), F.X_WF)
        carried = ca.horzcat(*(motion_to_child(X_BF, column) for column in ca.horzsplit(B.J)))
        J = F.J - carried
        drift = F.J_dot_v - motion_to_child(X_BF, B.J_dot_v)
        return FrameKinematics(X_BF, J, drift + motion_cross(J @ self.v, carried @ self.v))

    def centroid(self) -> Centroid:
        """Return centre of mass and momentum. Source: Orin2013."""
        X_W = [self._X[0]]
        for i in range(1, len(self._X)):
            X_W.append(compose(X_W[self._parents[i]], self._X[i]))
        bodies = [
            self._composite[i].in_parent(X_W[i])
            for i in range(1, len(X_W))
            if self._parents[i] == 0
        ]
        mass = sum((body.mass for body in bodies), ca.SX(0))
        p_WC = sum((body.moment for body in bodies), ca.SX(3, 1)) / mass
        A_G = ca.SX(6, self._robot.nv)
        for i in range(1, len(X_W)):
            for column, S in zip(self._columns[i], ca.horzsplit(self._S[i]), strict=True):
                momentum = force_to_parent(X_W[i], self._composite[i].momentum(S))
                A_G[:, column] = _about(p_WC, momentum)
        weight = mass * ca.SX(np.array(self._robot.model.gravity.linear))
        drift = _about(p_WC, self._lifting) + ca.vertcat(weight, ca.SX(3, 1))
        return Centroid(float(mass), p_WC, A_G, drift)

    def _placement(self, i: int) -> SymbolicPose:
        placement = self._robot.model.jointPlacements[i]
        fixed = SymbolicPose(_sparse(placement.rotation), _sparse(placement.translation))
        at = self._robot.model.joints[i].idx_q
        if len(self._columns[i]) > 1:
            return compose(fixed, SymbolicPose(_turn(self.q[at + 3 : at + 7]), self.q[at : at + 3]))
        linear, angular = self._S[i][:3], self._S[i][3:]
        angle = self.q[at]
        K = skew(angular)  # Rodrigues; zero for a prismatic joint
        R = ca.SX.eye(3) + ca.sin(angle) * K + (1 - ca.cos(angle)) * (K @ K)
        return compose(fixed, SymbolicPose(ca.sparsify(R), linear * angle))

    def _velocities(self) -> tuple[list[SX], list[SX]]:
        V, drift = [ca.SX(6, 1)], [ca.SX(6, 1)]
        for i in range(1, len(self._X)):
            joint_velocity = self._S[i] @ self.v[self._columns[i]]
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
        h = ca.SX(self._robot.nv, 1)
        for i in reversed(range(1, len(self._X))):
            h[self._columns[i]] = self._S[i].T @ forces[i]
            parent = self._parents[i]
            forces[parent] = forces[parent] + force_to_parent(self._X[i], forces[i])
        self._lifting = forces[0]  # on all bodies, about the origin of the world
        return ca.densify(h)

    def _composite_rigid_body(self) -> SX:
        self._composite = composite = list(self._Y)
        M = ca.SX(self._robot.nv, self._robot.nv)
        for i in reversed(range(1, len(self._X))):
            for column, S in zip(self._columns[i], ca.horzsplit(self._S[i]), strict=True):
                force = composite[i].momentum(S)
                M[self._columns[i], column] = self._S[i].T @ force
                j = i
                while self._parents[j] > 0:
                    force = force_to_parent(self._X[j], force)
                    j = self._parents[j]
                    shared = self._S[j].T @ force
                    M[self._columns[j], column], M[column, self._columns[j]] = shared, shared.T
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


def coordinates(robot: Robot, q: SX) -> SX:
    """Return the entry of ``q`` (nq) that each velocity changes (nv); 0 for floating bodies."""
    return ca.vertcat(*(ca.SX(0) if at is None else q[at] for at in robot.coordinates))


def _about(p: SX, F: SX) -> SX:
    """Return the wrench or momentum ``F`` (6), about the origin, about the point ``p`` (3)."""
    return ca.vertcat(F[:3], F[3:] - ca.cross(p, F[:3]))


def _turn(quaternion: SX) -> SX:
    """Return the rotation of a quaternion (x, y, z, w), whatever its length."""
    u, w = quaternion[:3], quaternion[3]
    K = skew(u)
    return ca.SX.eye(3) + 2 / ca.sumsqr(quaternion) * (w * K + K @ K)


def _axes(joint: pin.JointModel) -> SX:
    """Return the motion subspace (6×nv) of a joint."""
    if floats(joint):
        return ca.SX.eye(6)
    data = joint.createData()
    joint.calc(data, np.zeros(1))
    return _sparse(np.asarray(data.S).reshape(6))


def _sparse(array: np.ndarray) -> SX:
    array = np.asarray(array, dtype=np.float64)
    return ca.sparsify(ca.SX(np.where(np.abs(array) < _ROUND_OFF, 0.0, array)))
