"""A wrong hinge: where the handle goes, and what the hybrid law presses with meanwhile.

The believed freedom is a turn n_b about the believed hinge, the true one a turn n_t about the true
hinge (body twists at the handle); the set-point F_d has n_b · F_d = 0. At rest, or slow, the law
with an integral leaves W = F_d + β n_b, and a hinge without friction asks for n_t · W = 0, so

    W = F_d − (n_t · F_d) / (n_t · n_b) n_b,     K_p (n_bᵀ Λ n_b) (n_b · X_e) = β ‖n_b‖⁴

It is the wrench across the set-point that is wrong: a force along the believed way of the handle
and a moment about the believed axis. Positions across the believed way are not fed back, so a wrong
radius builds up no force. Laws without integral: `scenarios.study.systems.equilibrium`.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Matrix, Twist, Vector, Wrench
from scenarios.guided import axis_frame
from scenarios.study.system import Setting
from scenarios.study.systems.equilibrium import Loop, Place, Rest, rest

UP = np.array([0.0, 0.0, 1.0])


class Door(NamedTuple):
    """A grasped door, and how the controller believes it to be."""

    X_W0: pin.SE3
    """Pose of the handle while the door is closed."""
    X_WE: pin.SE3
    """Believed hinge: z along its axis, upwards; x towards the closed handle."""
    X_WE_true: pin.SE3
    """True hinge, along its own axes."""
    force: float
    """Set-point away from the believed hinge [N]."""

    def push(self, X_WF: pin.SE3) -> Wrench:
        """Return the set-point (6) [N, Nm] in the axes of the handle at ``X_WF``."""
        push = np.zeros(6)
        push[:3] = self.force * (X_WF.rotation.T @ outward(self.X_WE, X_WF))
        return push

    def opening(self, X_WE: pin.SE3) -> Twist:
        """Return the spatial twist (6) of the handle, in the world, at 1 rad/s of a hinge."""
        twist: Twist = X_WE.act(pin.Motion(np.zeros(3), -UP)).vector
        return twist

    def opened(self, angle: float) -> pin.SE3:
        """Return the pose of the handle where the true door is open by ``angle`` [rad]."""
        return pin.exp6(angle * self.opening(self.X_WE_true)) * self.X_W0

    def way(self, X_WE: pin.SE3, X_WF: pin.SE3) -> Vector:
        """Return the direction (3) in the world into which a hinge lets the handle at X_WF go."""
        way: Vector = np.cross(-X_WE.rotation[:, 2], X_WF.translation - X_WE.translation)
        return way / np.linalg.norm(way)

    def normal_error(self, angle: float) -> float:
        """Return the angle [rad] between true and believed way of the handle, open by ``angle``."""
        X_WF = self.opened(angle)
        return angle_between(self.way(self.X_WE_true, X_WF), self.way(self.X_WE, X_WF))


def closed_door(X_WF: pin.SE3, setting: Setting) -> Door:
    """Return the closed door that is held in the pose ``X_WF``, hinged at the side of the tool."""
    p = X_WF.translation
    sideways = np.cross(UP, X_WF.rotation[:, 2])
    hinge_at = p + setting["radius"] * sideways / np.linalg.norm(sideways)
    X_WE = axis_frame(hinge_at, UP, p - hinge_at)
    tilt = np.radians([setting["tilt_x"], setting["tilt_y"], 0.0])
    offset = np.array([setting["offset_x"], setting["offset_y"], 0.0])
    X_WE_true = X_WE * pin.SE3(pin.exp3(tilt), offset)
    return Door(X_WF, X_WE, X_WE_true, setting["force"])


def at_rest(door: Door, angle: float, Lambda_inv: Matrix, loop: Loop) -> Rest:
    """Return wrench and pose where the handle is asked to open the believed door by ``angle``.

    Args:
        door: the door.
        angle: asked for [rad].
        Lambda_inv: mobility (6×6) of the handle at rest, in its own axes.
        loop: the controller.
    """
    place = Place(
        Lambda_inv=Lambda_inv,
        believed=lambda X_WF: rows(door.X_WE, X_WF),
        true=lambda X_WF: rows(door.X_WE_true, X_WF),
        X_WF=door.opened(angle),
        X_WD=pin.exp6(angle * door.opening(door.X_WE)) * door.X_W0,
    )
    return rest(place, loop)


def rows(X_WE: pin.SE3, X_WF: pin.SE3) -> Matrix:
    """Return the rows (5×6) of a hinge at ``X_WE`` on the body twist of the handle at ``X_WF``."""
    A: Matrix = X_WE.actInv(X_WF).toActionMatrix()[:5]
    return A


def outward(X_WE: pin.SE3, X_WF: pin.SE3) -> Vector:
    """Return the direction (3) in the world from the axis of a hinge to the handle at ``X_WF``."""
    z = X_WE.rotation[:, 2]
    out = X_WF.translation - X_WE.translation
    out = out - z * z.dot(out)
    return out / np.linalg.norm(out)


def turned(X_WF: pin.SE3, door: Door) -> float:
    """Return by what angle [rad] the handle has turned about the true axis."""
    turn = pin.log3(X_WF.rotation @ door.X_W0.rotation.T)
    return float(-turn @ door.X_WE_true.rotation[:, 2])


def angle_between(a: Vector, b: Vector) -> float:
    """Return the angle [rad] between two directions (3)."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
