"""Compliant environments: springs that tie the tool down, a hand that pushes or holds it."""

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
