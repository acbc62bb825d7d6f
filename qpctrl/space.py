"""Task spaces: named axes of one frame, with their kinematics and inertia.

Λ⁻¹ = J M⁻¹ Jᵀ,  J̄ = M⁻¹ Jᵀ Λ,  η = J̄ᵀ h − Λ J̇v.
Source: Khatib1987; LynchPark2017 §8.6.
"""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from qpctrl.dynamics import Dynamics
from qpctrl.errors import InputError, unknown_name
from qpctrl.factor import Factor
from qpctrl.spatial import AXES, SX, SymbolicPose


@dataclass(frozen=True)
class TaskSpace:
    """Axes of the body twist of a frame, expressed in that frame.

    A planar arm uses ``("vx", "vy")``; everything holds for that n.
    """

    frame: str
    axes: tuple[str, ...] = AXES

    def __post_init__(self) -> None:
        for axis in self.axes:
            if axis not in AXES:
                raise unknown_name("axis", axis, AXES)
        if not self.axes or len(set(self.axes)) < len(self.axes):
            raise InputError(f"axes: got {self.axes}, need one or more different ones of {AXES}")

    @property
    def n(self) -> int:
        """Number of axes."""
        return len(self.axes)

    @property
    def index(self) -> list[int]:
        """Position of each axis among the six of a twist."""
        return [AXES.index(axis) for axis in self.axes]

    @property
    def turns(self) -> bool:
        """Whether an angular axis is among them."""
        return any(axis.startswith("w") for axis in self.axes)


class FrameMotion(NamedTuple):
    """Pose and twist of the frame of a task space."""

    space: TaskSpace
    X_WF: SymbolicPose
    V_full: SX
    """Body twist (6) [m/s, rad/s]."""

    @property
    def V(self) -> SX:
        """Twist along the axes of the space (n)."""
        return self.V_full[self.space.index]


class SpaceTerms:
    """Expressions of one task space at (q, v).

    Attributes:
        motion: pose and twist of the frame.
        J: Jacobian of the space's axes (n×nv).
        J_dot_v: drift (n) [m/s², rad/s²].
        Lambda_inv, Lambda: task-space inertia and its inverse (n×n), damped by ``mu``.
        task_inertia: JᵀΛJ (nv×nv), the part of M that the task space takes.
        mobility_left: 1 / Λ_ii (n), the mobility along an axis while the others are held, over
            the frame's mobility in all directions of the same unit; 0 at a singularity.
    """

    def __init__(self, space: TaskSpace, dynamics: Dynamics, M_factor: Factor, mu: SX) -> None:
        frame = dynamics.frame(space.frame)
        index = space.index
        self.space = space
        self.motion = FrameMotion(space, frame.X_WF, ca.densify(frame.J @ dynamics.v))
        self.J = ca.densify(frame.J[index, :])
        self.J_dot_v = ca.densify(frame.J_dot_v[index])
        mobility = M_factor.congruence(ca.densify(frame.J.T))
        self.Lambda_inv = mobility[index, index] + mu * ca.SX.eye(space.n)
        Lambda_inv = Factor(self.Lambda_inv)
        self.Lambda = Lambda_inv.congruence(ca.SX.eye(space.n))
        self.task_inertia = Lambda_inv.congruence(self.J)
        self.mobility_left = 1 / (ca.diag(self.Lambda) * _whole_mobility(mobility)[index])


def _whole_mobility(mobility: SX) -> SX:
    """Return, for each axis (6), the trace of the frame's mobility over the axes of its unit."""
    linear, angular = ca.trace(mobility[:3, :3]), ca.trace(mobility[3:, 3:])
    return ca.fmax(ca.vertcat(linear, linear, linear, angular, angular, angular), 1e-12)
