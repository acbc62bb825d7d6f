"""A plant whose joints do not deliver what is asked of them: gain, bias and delay of torque.

Friction of the joints is the plants' own business (``joint_friction``, ``joint_damping``), since
only they know what torque holds a joint still.
"""

from collections import deque
from dataclasses import dataclass
from typing import final

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector, finite_array
from qpctrl.errors import InputError
from qpctrl.robot import Robot
from scenarios.plant import Plant, PlantState


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueError:
    """Delivered torque of a commanded one: gain τ + bias, some ticks late."""

    gain: Vector | float = 1.0
    """Torque delivered per torque asked for [1], 1 + error; of each joint (nv), or one of all."""
    bias: Vector | float = 0.0
    """Torque delivered beyond that [Nm or N]; of each joint (nv), or one of all."""
    delay: int = 0
    """Age of the command that is delivered [ticks]."""

    def __post_init__(self) -> None:
        for name in ("gain", "bias"):
            value = getattr(self, name)
            object.__setattr__(self, name, finite_array(value, np.shape(value), f"torque {name}"))
        if self.delay < 0:
            raise InputError(f"torque delay: got {self.delay}, need 0 ticks or more")


@final
class DisturbedPlant:
    """A plant that gets another torque than its controller asks for.

    Attributes:
        delivered: torque of the last period (nv) [Nm or N], as it acted.
    """

    def __init__(self, plant: Plant, error: TorqueError, robot: Robot) -> None:
        """Put ``error`` between the controller and ``plant``.

        Args:
            plant: the robot and its environment; with drives, the error is in what these are
                asked for.
            error: what becomes of a commanded torque.
            robot: the robot as the controller believes it to be. With a delay, the first periods
                get the torque that holds this robot at rest where it starts, as if it had been
                asked for: the torque from which a controller starts too.

        Raises:
            InputError: a gain or bias of another number of joints.
        """
        self._plant, self._robot, self._delay = plant, robot, error.delay
        self._gain = finite_array(error.gain, (robot.nv,), "torque gain")
        self._bias = finite_array(error.bias, (robot.nv,), "torque bias")
        self._asked: deque[Vector] = deque(maxlen=error.delay + 1)
        self.delivered: Vector = np.zeros(robot.nv)

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq)."""
        model, B = self._robot.model, self._robot.B
        gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
        hold = B @ np.linalg.lstsq(B, gravity, rcond=None)[0]
        self._asked.extend([hold] * (self._delay + 1))
        self.delivered = self._gain * hold + self._bias
        return self._plant.reset(q)

    def step(self, tau: Vector) -> PlantState:
        """Return the state one period after ``tau`` (nv) [Nm] was asked for."""
        self._asked.append(np.array(tau))
        self.delivered = self._gain * self._asked[0] + self._bias
        return self._plant.step(self.delivered)
