"""A force-torque sensor that is not perfect: gain, bias, noise, a low-pass and a delay."""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import numpy as np

from qpctrl.arrays import Vector, Wrench, finite_array, non_negative, positive
from qpctrl.errors import InputError
from scenarios.plant import Plant, PlantState

NOISE_BLOCK = 256
"""Ticks whose noise is drawn at once."""


@final
class WrenchNoise:
    """White noise of a wrench, tick by tick."""

    def __init__(self, force: float, seed: int) -> None:
        """Describe the noise.

        Args:
            force: standard deviation of each force [N]; moments get a tenth of the number [Nm].
            seed: of its random numbers.
        """
        self._size, self._seed = force * np.array([1, 1, 1, 0.1, 0.1, 0.1]), seed
        self.restart()

    def restart(self) -> None:
        """Begin anew: the same numbers come again."""
        self._rng = np.random.default_rng(self._seed)
        self._drawn: Iterator[Wrench] = iter(())

    def draw(self) -> Wrench:
        """Return the noise of the next tick (6) [N, Nm]."""
        noise = next(self._drawn, None)
        if noise is None:
            self._drawn = iter(self._size * self._rng.normal(size=(NOISE_BLOCK, 6)))
            return next(self._drawn)
        return noise


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ForceSensor:
    """What a sensor makes of the true wrench F: low-pass of (gain F + bias + noise), late."""

    gain: Vector | float = 1.0
    """Reading per true wrench [1], 1 + error; of each axis (6), or one of all."""
    noise: float = 0.0
    """Standard deviation of each force [N]; moments get a tenth of the number [Nm]."""
    bias: Vector | float = 0.0
    """Constant error of the reading (6) [N, Nm]."""
    cutoff: float = 0.0
    """Cut-off of the first-order low-pass of the reading, noise included [Hz]; 0: none."""
    delay: int = 0
    """Age of the reading [ticks], beyond the one period of the plant."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "gain", positive(self.gain, (6,), "force gain"))
        non_negative(self.noise, (), "force noise")
        object.__setattr__(self, "bias", finite_array(self.bias, (6,), "force bias"))
        non_negative(self.cutoff, (), "force cutoff")
        if self.delay < 0:
            raise InputError(f"force delay: got {self.delay}, need 0 ticks or more")


@final
class SensedPlant:
    """A plant seen through a force-torque sensor; the true wrench stays beside the reading."""

    def __init__(self, plant: Plant, sensor: ForceSensor, seed: int = 0) -> None:
        self._plant, self._sensor = plant, sensor
        self._noise = WrenchNoise(sensor.noise, seed)
        self._start()

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq); the low-pass starts on its reading."""
        self._start()
        return self._sense(self._plant.reset(q))

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period."""
        return self._sense(self._plant.step(tau))

    def _start(self) -> None:
        self._noise.restart()
        self._past: deque[Wrench] = deque(maxlen=self._sensor.delay + 1)
        self._smooth: Wrench | None = None
        self._time = 0.0

    def _sense(self, state: PlantState) -> PlantState:
        self._past.append(state.wrench)
        reading = self._sensor.gain * self._past[0] + self._sensor.bias
        if self._sensor.noise > 0:
            reading = reading + self._noise.draw()
        if self._sensor.cutoff > 0:
            reading = self._filtered(reading, state.time)
        return state._replace(wrench_meas=reading)

    def _filtered(self, reading: Wrench, time: float) -> Wrench:
        """Return the output (6) of the low-pass at ``time`` [s], its input held until then."""
        if self._smooth is None:
            self._smooth = reading
        follow = 1 - math.exp(-2 * math.pi * self._sensor.cutoff * (time - self._time))
        self._smooth = self._smooth + follow * (reading - self._smooth)
        self._time = time
        return self._smooth
