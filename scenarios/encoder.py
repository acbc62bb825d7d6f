"""Joint encoders with a finite number of counts; velocity is the difference of two readings."""

from typing import final

import numpy as np

from qpctrl.arrays import Vector, positive
from scenarios.plant import Plant, PlantState


@final
class EncodedPlant:
    """A plant whose configuration is read by encoders.

    Attributes:
        truth: the state as it is, behind the encoders.
    """

    def __init__(self, plant: Plant, resolution: float, dt: float) -> None:
        """Read ``plant`` in steps of ``resolution`` [rad or m], every ``dt`` [s]."""
        self._plant = plant
        self._resolution = float(positive(resolution, (), "encoder resolution"))
        self._dt = float(positive(dt, (), "dt"))
        self._last: Vector = np.empty(0)

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq)."""
        self.truth = self._plant.reset(q)
        self._last = self._read(self.truth.q)
        return self.truth._replace(q=self._last)

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period."""
        self.truth = self._plant.step(tau)
        q = self._read(self.truth.q)
        v, self._last = (q - self._last) / self._dt, q
        return self.truth._replace(q=q, v=v)

    def _read(self, q: Vector) -> Vector:
        return self._resolution * np.round(q / self._resolution)
