"""The compliant plant whose tool is tied to springs in every direction."""

from qpctrl.arrays import Vector
from qpctrl.robot import Robot
from scenarios.environment import Springs
from scenarios.plant_compliant import CompliantPlant


def SpringPlant(
    robot: Robot,
    frame: str,
    *,
    stiffness: Vector,
    damping: Vector,
    payload: float = 0.0,
    dt: float = 1e-3,
    substeps: int = 2,
) -> CompliantPlant:
    """Return the plant; see `Springs` and `CompliantPlant`."""
    springs = Springs(stiffness, damping)
    return CompliantPlant(robot, frame, springs, payload=payload, dt=dt, substeps=substeps)
