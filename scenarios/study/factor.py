"""A factor of a study: one uncertain quantity, its signed range and its distribution."""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from scipy.special import ndtr, ndtri

from qpctrl.arrays import Vector
from qpctrl.errors import InputError, unknown_name

Distribution = Literal["uniform", "log-uniform", "normal"]

SIGMAS = 3.0
"""Half of the range over the standard deviation of a normal factor, which is cut at its ends."""


@dataclass(frozen=True)
class Factor:
    """One quantity that a study varies, between ``low`` and ``high`` or over given values."""

    name: str
    unit: str
    """Unit of its values, as it stands in column names: ``deg``, ``m``, ``N``, ``1``."""
    low: float
    """Smallest value [unit]; it may be negative."""
    high: float
    """Largest value [unit]."""
    distribution: Distribution = "uniform"
    """Of its values in a random design; ``normal`` has its mean in the middle of the range and
    a standard deviation of a sixth of it."""
    whole: bool = field(default=False, kw_only=True)
    """Whether only whole numbers make sense."""
    values: tuple[float, ...] = field(default=(), kw_only=True)
    """The only values it takes [unit], if they are given one by one."""

    def __post_init__(self) -> None:
        kinds = get_args(Distribution)
        if self.distribution not in kinds:
            raise unknown_name(f"factor {self.name!r}: distribution", self.distribution, kinds)
        if len(set(self.values)) < len(self.values):
            raise InputError(f"factor {self.name!r}: the same value twice, need each once")
        for side, value in (("low", self.low), ("high", self.high)):
            if not math.isfinite(value):
                raise InputError(f"factor {self.name!r}: {side} is {value}, need a finite number")
        if not self.low < self.high and len(self.values) != 1:
            raise InputError(
                f"factor {self.name!r}: got low {self.low:g} and high {self.high:g} {self.unit}, "
                "need low < high"
            )
        if self.distribution == "log-uniform" and self.low <= 0:
            raise InputError(
                f"factor {self.name!r}: got low {self.low:g} {self.unit}, need more than 0 where "
                "the distribution is log-uniform"
            )
        if self.values and self.distribution != "uniform":
            raise InputError(f"factor {self.name!r}: got a distribution beside values, need one")

    @property
    def column(self) -> str:
        """Name of its column in a table of rollouts."""
        return f"{self.name}_{self.unit}"

    def levels(self, count: int) -> Vector:
        """Return its given values, or ``count`` values from low to high, both included.

        They are equally spaced, in the logarithm where the distribution is log-uniform; whole
        numbers are rounded and stand once.
        """
        if self.values:
            return np.array(self.values)
        if self.distribution == "log-uniform":
            found = np.geomspace(self.low, self.high, count)
        else:
            found = np.linspace(self.low, self.high, count)
        return np.unique(np.round(found)) if self.whole else found

    def at(self, share: Vector) -> Vector:
        """Return the values below which ``share`` (0 to 1) of its distribution lies."""
        if self.values:
            place = np.minimum(np.floor(share * len(self.values)).astype(int), len(self.values) - 1)
            return np.array(self.values)[place]
        if self.whole:  # each number has the cell that is rounded to it
            found = np.floor(self._at(share, self.low - 0.5, self.high + 0.5) + 0.5)
        else:
            found = self._at(share, self.low, self.high)
        return np.clip(found, self.low, self.high)

    def _at(self, share: Vector, low: float, high: float) -> Vector:
        if self.distribution == "log-uniform":
            return low * np.exp(share * math.log(high / low))
        if self.distribution == "normal":
            tail = float(ndtr(-SIGMAS))
            score = ndtri(tail + share * (1 - 2 * tail))
            return (low + high) / 2 + score * (high - low) / (2 * SIGMAS)
        return low + share * (high - low)
