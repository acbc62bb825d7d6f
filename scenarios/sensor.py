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
            tool: inertia of everything beyond the sensor, in the sensor frame S.
            X_ST: pose of the tool frame T in S.
        """
        self._Y, self._X_TS = tool, X_ST.inverse()

    def wrench_on_env(self, reading: ToolReading) -> Wrench:
        """Return the wrench of robot on environment (6) [N, Nm], at T along its axes."""
        V = pin.Motion(np.zeros(3), reading.angular_velocity)
        A = pin.Motion(reading.acceleration, reading.angular_acceleration)
        inertial = self._Y * A + V.cross(self._Y * V)
        measured = pin.Force(reading.force, reading.moment)
        return self._X_TS.act(measured - inertial).vector
