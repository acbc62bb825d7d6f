"""A factor of a study: one uncertain quantity with its signed range."""

import math
from dataclasses import dataclass

from qpctrl.errors import InputError


@dataclass(frozen=True)
class Factor:
    """One quantity that a study varies between ``low`` and ``high``."""

    name: str
    unit: str
    """Unit of its values, as it stands in column names: ``deg``, ``m``, ``N``, ``1``."""
    low: float
    """Smallest value [unit]; it may be negative."""
    high: float
    """Largest value [unit]."""

    def __post_init__(self) -> None:
        for side, value in (("low", self.low), ("high", self.high)):
            if not math.isfinite(value):
                raise InputError(f"factor {self.name!r}: {side} is {value}, need a finite number")
        if not self.low < self.high:
            raise InputError(
                f"factor {self.name!r}: got low {self.low:g} and high {self.high:g} {self.unit}, "
                "need low < high"
            )

    @property
    def column(self) -> str:
        """Name of its column in a table of rollouts."""
        return f"{self.name}_{self.unit}"
