"""Configuration and velocity as a controller sees them: noisy and late."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from qpctrl.arrays import Matrix, Vector, non_negative
from qpctrl.errors import InputError
from scenarios.plant import Plant, PlantState


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class StateSensor:
    """What is wrong with the q and v that a controller gets; the noise is white."""

    noise_q: Vector | float = 0.0
    """Standard deviation of each configuration [rad or m]; of each joint (nq), or of all."""
    noise_v: Vector | float = 0.0
    """Standard deviation of each velocity [rad/s or m/s]; of each joint (nv), or of all."""
    latency: int = 0
    """Age of both [ticks]; before that many ticks they are those of the start."""

    def __post_init__(self) -> None:
        for name in ("noise_q", "noise_v"):
            value = getattr(self, name)
            object.__setattr__(self, name, non_negative(value, np.shape(value), name))
        if self.latency < 0:
            raise InputError(f"latency: got {self.latency}, need 0 ticks or more")


class Motion(NamedTuple):
    """How a robot moved, to be judged by."""

    q: Matrix
    """Configuration (ticks×nq) [rad or m]."""
    v: Matrix
    """Velocity (ticks×nv) [rad/s or m/s]."""


@final
class ObservedPlant:
    """A plant whose q and v are read with errors; all else that its state says stays as it is.

    Wrap it around everything that acts on the robot or needs its true motion: drives, torque
    errors, a `ForceSensor`. Encoders come inside of it.

    Attributes:
        truth: the state as it is, behind the sensors.
    """

    def __init__(self, plant: Plant, sensor: StateSensor, seed: int = 0) -> None:
        self._plant, self._sensor, self._seed = plant, sensor, seed

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq)."""
        self._rng = np.random.default_rng(self._seed)
        self._past: deque[tuple[Vector, Vector]] = deque(maxlen=self._sensor.latency + 1)
        self._motion: list[tuple[Vector, Vector]] = []
        return self._observe(self._plant.reset(q))

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period."""
        return self._observe(self._plant.step(tau))

    def motion(self) -> Motion:
        """Return the true motion since the start: a row for every tick, and one after the last."""
        q, v = (np.array(rows) for rows in zip(*self._motion, strict=True))
        return Motion(q, v)

    def _observe(self, state: PlantState) -> PlantState:
        self.truth = state
        self._motion.append((state.q, state.v))
        self._past.append((self._read(state.q, "noise_q"), self._read(state.v, "noise_v")))
        q, v = self._past[0]
        return state._replace(q=q, v=v)

    def _read(self, true: Vector, noise: str) -> Vector:
        size = getattr(self._sensor, noise)
        if not np.any(size):
            return true
        return true + non_negative(size, true.shape, noise) * self._rng.normal(size=true.shape)
