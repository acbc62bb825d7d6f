"""What a plant is: torque in, one period later a state with a measured wrench."""

from typing import NamedTuple, Protocol

from qpctrl.arrays import Vector, Wrench


class PlantState(NamedTuple):
    """What the sensors of a plant say after a period."""

    time: float
    """Time [s]."""
    q: Vector
    """Configuration (nq) [rad or m]."""
    v: Vector
    """Velocity (nv) [rad/s or m/s]."""
    wrench_meas: Wrench
    """Robot on environment (6) [N, Nm], in the tool frame; one period old."""
    wrench: Wrench
    """The same without the sensor's errors."""
    touching: bool
    """Whether tool and environment touch, as the plant knows it."""


class Plant(Protocol):
    """A simulated robot and its environment."""

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq), with time 0."""

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period."""
