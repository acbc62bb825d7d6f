"""Force-torque sensing: the sensor's reading, less the tool's weight and inertia.

The sensor sits between arm and tool and reads the wrench that the arm applies to the tool.
Newton–Euler for the tool gives what is left for the environment:
F_on_env = F_sensor − (Y A + V ×* Y V), with A the acceleration of the sensor frame including
gravity, as an accelerometer reads it.
"""

from typing import NamedTuple

import casadi as ca
import pinocchio as pin

from qpctrl.arrays import Matrix, Vector, Wrench
from qpctrl.evaluator import Evaluator
from qpctrl.spatial import SX, force_cross


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
    """Angular acceleration (3) [rad/s²], along the axes of the world."""
    R_SW: Matrix
    """Orientation of the world in the sensor frame (3×3)."""


class WrenchSensor:
    """Turns readings into the wrench on the environment in the tool frame."""

    def __init__(self, tool: pin.Inertia, X_ST: pin.SE3, reading: ToolReading) -> None:
        """Describe the tool and the sensors.

        Args:
            tool: inertia Y of everything beyond the sensor, in the sensor frame S.
            X_ST: pose of the tool frame T in S.
            reading: where the sensors write what they say, to be read in place.
        """
        self._evaluate = Evaluator(_wrench_function(tool, X_ST), shared=reading._asdict())
        self._wrench: Wrench = self._evaluate.outputs["wrench"]

    def wrench_on_env(self) -> Wrench:
        """Return the wrench of robot on environment (6) [N, Nm], at T along its axes."""
        self._evaluate()
        return self._wrench.copy()


def _wrench_function(tool: pin.Inertia, X_ST: pin.SE3) -> ca.Function:
    """Return the wrench as a function of the fields of a `ToolReading`."""
    sizes = dict.fromkeys(ToolReading._fields, (3, 1)) | {"R_SW": (3, 3)}
    read = {name: SX.sym(name, *size) for name, size in sizes.items()}
    V = ca.vertcat(SX.zeros(3), read["angular_velocity"])
    A = ca.vertcat(read["acceleration"], read["R_SW"] @ read["angular_acceleration"])
    Y = SX(tool.matrix())
    rest = ca.vertcat(read["force"], read["moment"]) - (Y @ A + force_cross(V, Y @ V))
    F = ca.densify(SX(X_ST.inverse().toDualActionMatrix()) @ rest)
    return ca.Function("wrench", list(read.values()), [F], list(read), ["wrench"], {"cse": True})
