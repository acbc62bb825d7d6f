"""Force-torque sensing: the sensor's reading, less the tool's weight and inertia.

The sensor sits between arm and tool and reads the wrench that the arm applies to the tool.
Newton–Euler for the tool gives what is left for the environment:
F_on_env = F_sensor − (Y A + V ×* Y V), with A the acceleration of the sensor frame including
gravity, as an accelerometer reads it.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector, Wrench


class ToolReading(NamedTuple):
    """What sensors in the sensor frame say, along its axes."""

    force: Vector
    """Force of the arm on the tool (3) [N]."""
    moment: Vector
    """Moment of the arm on the tool about the sensor's origin (3) [Nm]."""
    acceleration: Vector
    """Accelerometer (3) [m/s²]: acceleration of the origin less gravity."""
    angular_velocity: Vector
    """Gyro (3) [rad/s]."""
    angular_acceleration: Vector
    """Angular acceleration (3) [rad/s²]."""


class WrenchSensor:
    """Turns readings into the wrench on the environment in the tool frame."""

    def __init__(self, tool: pin.Inertia, X_ST: pin.SE3) -> None:
        """Describe the tool.

        Args:
            tool: inertia Y of everything beyond the sensor, in the sensor frame S.
            X_ST: pose of the tool frame T in S.
        """
        to_tool = X_ST.inverse().toDualActionMatrix()
        turning = np.stack([_gyroscopic(tool, i, j) for i, j in _PAIRS], axis=1)
        self._map = to_tool @ np.hstack([np.eye(6), -tool.matrix(), -turning])

    def wrench_on_env(self, reading: ToolReading) -> Wrench:
        """Return the wrench of robot on environment (6) [N, Nm], at T along its axes.

        Linear in forces and accelerations, and in the products ω_i ω_j of V ×* Y V.
        """
        x, y, z = reading.angular_velocity.tolist()
        products = (x * x, y * y, z * z, x * y, x * z, y * z)
        return self._map @ np.concatenate(
            (
                *(reading.force, reading.moment),
                *(reading.acceleration, reading.angular_acceleration, products),
            )
        )


_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _gyroscopic(tool: pin.Inertia, i: int, j: int) -> Wrench:
    """Return the coefficient (6) of ω_i ω_j in V ×* Y V, V = (0, ω)."""

    def wrench(*axes: int) -> Wrench:
        omega = np.zeros(3)
        omega[list(axes)] = 1.0
        V = pin.Motion(np.zeros(3), omega)
        return V.cross(tool * V).vector

    return wrench(i) if i == j else wrench(i, j) - wrench(i) - wrench(j)
