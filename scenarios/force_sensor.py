"""A force-torque sensor that is not perfect: bias, noise, and a delay."""

from collections import deque
from dataclasses import dataclass
from typing import final

import numpy as np

from qpctrl.arrays import Vector, Wrench, finite_array, non_negative
from qpctrl.errors import InputError
from scenarios.plant import Plant, PlantState


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ForceSensor:
    """What a sensor adds to the true wrench."""

    noise: float = 0.0
    """Standard deviation of each force [N]; moments get a tenth of the number [Nm]."""
    bias: Vector | float = 0.0
    """Constant error of the reading (6) [N, Nm]."""
    delay: int = 0
    """Age of the reading [ticks], beyond the one period of the plant."""

    def __post_init__(self) -> None:
        non_negative(self.noise, (), "force noise")
        object.__setattr__(self, "bias", finite_array(self.bias, (6,), "force bias"))
        if self.delay < 0:
            raise InputError(f"force delay: got {self.delay}, need 0 ticks or more")


@final
class SensedPlant:
    """A plant seen through a force-torque sensor; the true wrench stays beside the reading."""

    def __init__(self, plant: Plant, sensor: ForceSensor, seed: int = 0) -> None:
        self._plant, self._sensor, self._seed = plant, sensor, seed
        self._noise = sensor.noise * np.array([1, 1, 1, 0.1, 0.1, 0.1])
        self._start()

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq)."""
        self._start()
        return self._sense(self._plant.reset(q))

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period."""
        return self._sense(self._plant.step(tau))

    def _start(self) -> None:
        self._rng = np.random.default_rng(self._seed)
        self._past: deque[Wrench] = deque(maxlen=self._sensor.delay + 1)

    def _sense(self, state: PlantState) -> PlantState:
        self._past.append(state.wrench)
        reading = self._past[0] + self._sensor.bias
        if self._sensor.noise > 0:
            reading = reading + self._noise * self._rng.normal(size=6)
        return state._replace(wrench_meas=reading)
