"""Compliant environments: springs that tie the tool down, a hand, a wall that it meets."""

from collections.abc import Callable
from typing import final

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Twist, Vector, Wrench, non_negative, positive


@final
class Springs:
    """Springs and dampers in all six directions, unloaded at the start: F = K log(X_WA⁻¹ X) + D V.

    The wrench acts along the axes of the tool; for the small deflections of a stiff spring
    that is the gradient of its energy.
    """

    def __init__(self, stiffness: Vector, damping: Vector) -> None:
        """Describe the springs.

        Args:
            stiffness: K (6) [N/m, Nm/rad] along and about the axes of the tool.
            damping: D (6) [N s/m, Nm s/rad] along and about the same axes.

        Raises:
            InputError: a stiffness that is not positive, or a negative damping.
        """
        self._K = positive(stiffness, (6,), "stiffness")
        self._D = non_negative(damping, (6,), "spring damping")
        self._X_AW = pin.SE3.Identity()

    def start(self, X_WF: pin.SE3) -> None:
        """Anchor the springs where the tool is."""
        self._X_AW = X_WF.inverse()

    def wrench(self, time: float, X_WF: pin.SE3, V: Twist) -> Wrench:
        """Return the wrench of robot on springs (6) [N, Nm]."""
        return self._K * pin.log6(self._X_AW * X_WF).vector + self._D * V

    def impedance(self) -> tuple[Vector, Vector]:
        """Return K (6) [N/m, Nm/rad] and D (6) [N s/m, Nm s/rad]."""
        return self._K, self._D


@final
class Hand:
    """A hand that pushes the tool with a wrench that is a function of time alone."""

    def __init__(self, push: Callable[[float], Wrench]) -> None:
        """Take ``push``: time [s] → wrench of hand on robot (6) [N, Nm] in the tool frame."""
        self._push = push

    def start(self, X_WF: pin.SE3) -> None:
        """Do nothing: a push knows no pose."""

    def wrench(self, time: float, X_WF: pin.SE3, V: Twist) -> Wrench:
        """Return the wrench of robot on hand (6) [N, Nm]."""
        return -self._push(time)

    def impedance(self) -> tuple[Vector, Vector]:
        """Return none (6) of either."""
        return np.zeros(6), np.zeros(6)


@final
class Grip:
    """A hand that holds the tool by a spring and a damper, and moves along the tool's x axis.

    F_x = K (x − x_h) + D (ẋ − ẋ_h), x from where the tool was at the start.
    """

    def __init__(
        self, motion: Callable[[float], tuple[float, float]], stiffness: float, damping: float
    ) -> None:
        """Describe the hand.

        Args:
            motion: time [s] → position x_h [m] and speed ẋ_h [m/s] of the hand.
            stiffness: K [N/m].
            damping: D [N s/m].
        """
        self._motion = motion
        self._K = float(positive(stiffness, (), "grip stiffness"))
        self._D = float(non_negative(damping, (), "grip damping"))
        self._X_AW = pin.SE3.Identity()

    def start(self, X_WF: pin.SE3) -> None:
        """Measure positions from where the tool is."""
        self._X_AW = X_WF.inverse()

    def wrench(self, time: float, X_WF: pin.SE3, V: Twist) -> Wrench:
        """Return the wrench of robot on hand (6) [N, Nm]."""
        x_h, x_h_dot = self._motion(time)
        x = float((self._X_AW * X_WF).translation[0])
        F = np.zeros(6)
        F[0] = self._K * (x - x_h) + self._D * (V[0] - x_h_dot)
        return F

    def impedance(self) -> tuple[Vector, Vector]:
        """Return K and D along x (6) [N/m, N s/m]."""
        along = np.eye(6)[0]
        return self._K * along, self._D * along


@final
class SpringWall:
    """A wall of known stiffness that a point of the tool pushes on, and that never pulls.

    The normal force is max(0, k δ + d δ̇) at the depth δ > 0 of the frame's origin, and the wall
    rubs with μ times that against v_t / max(‖v_t‖, ε), v_t the velocity along it: it does not
    hold a point that rests. A single point touches, so no moment acts at the frame's origin.
    """

    def __init__(
        self,
        X_WE: pin.SE3,
        stiffness: float,
        damping: float = 0.0,
        friction: float = 0.0,
        slip_speed: float = 1e-2,
    ) -> None:
        """Describe the wall.

        Args:
            X_WE: frame of the wall, origin on its surface, z axis into it.
            stiffness: k [N/m].
            damping: d [N s/m].
            friction: Coulomb friction μ [1].
            slip_speed: ε [m/s]; below it friction is a damper of μ f / ε, which an explicit step
                must be short enough for.

        Raises:
            InputError: stiffness or slip speed that are not positive, damping or friction below 0.
        """
        self._X_EW = X_WE.inverse()
        self._k = float(positive(stiffness, (), "wall stiffness"))
        self._d = float(non_negative(damping, (), "wall damping"))
        self._mu = float(non_negative(friction, (), "wall friction"))
        self._slip_speed = float(positive(slip_speed, (), "slip_speed"))
        self._normal = np.zeros(3)  # where the wall is touched, along the axes of the tool

    def start(self, X_WF: pin.SE3) -> None:
        """Do nothing: the wall is where it is."""

    def wrench(self, time: float, X_WF: pin.SE3, V: Twist) -> Wrench:
        """Return the wrench of robot on wall (6) [N, Nm]."""
        F, X_EF = np.zeros(6), self._X_EW * X_WF
        normal, depth = X_EF.rotation[2], float(X_EF.translation[2])
        self._normal = normal if depth > 0 else np.zeros(3)
        if depth > 0:
            rate = float(normal @ V[:3])
            push, v_t = max(0.0, self._k * depth + self._d * rate), V[:3] - rate * normal
            rub = self._mu * push / max(float(np.linalg.norm(v_t)), self._slip_speed)
            F[:3] = push * normal + rub * v_t
        return F

    def impedance(self) -> tuple[Vector, Vector]:
        """Return K and D (6) [N/m, N s/m] where it was last touched, else none.

        Along the axes of the tool no less than k n nᵀ and d n nᵀ: exact where n is an axis.
        """
        size = np.abs(self._normal)
        along = np.concatenate([size * size.sum(), np.zeros(3)])
        return self._k * along, self._d * along
