"""What a plant is: torque in, one period later a state with a measured wrench."""

from typing import NamedTuple, Protocol

from qpctrl.arrays import Vector, Wrench


class JointReading(NamedTuple):
    """What the drives of the joints say of the last period."""

    tau_delivered: Vector
    """What arrived of the torque asked for (nu) [Nm or N], its mean over the period: torque on
    the joint and on the inertia that the controller takes for the joint's own."""
    tau_meas: Vector
    """Torque that the joint's own sensor reads (nu) [Nm or N]."""
    current: Vector
    """Current of the motor (nu) [A]."""
    voltage: Vector
    """Voltage at the motor (nu) [V]."""
    limited: bool
    """Whether a motor met its limit of current or voltage in the period."""


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
    joints: JointReading | None = None
    """What the drives say; none where joints deliver just what is asked. A plant with drives
    gives a reading with every state, that of `Plant.reset` included."""
    contacts: tuple[Wrench, ...] = ()
    """True wrench (6) [N, Nm] of robot on environment at each contact that the experiment names."""


class Plant(Protocol):
    """A simulated robot and its environment."""

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq), with time 0."""

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period."""


class SteppedPlant(Plant, Protocol):
    """A plant that can run faster than its sensors are read; ``step`` is ``advance`` and ``read``.

    What drives the joints may then have a shorter period than the controller.
    """

    def advance(self, tau: Vector) -> tuple[Vector, Vector]:
        """Let ``tau`` (nv) [Nm] act for one period of the plant, and read no sensor.

        Returns:
            q (nq) [rad or m] and v (nv) [rad/s or m/s]; the next call may overwrite them.
        """

    def read(self) -> PlantState:
        """Return what the sensors say; the wrench is that of the start of the last period."""
