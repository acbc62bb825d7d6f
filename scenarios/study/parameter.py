"""A parameter of a system that a study can set or vary: its unit, usual value and bounds."""

import math
from dataclasses import dataclass

from qpctrl.errors import InputError, unknown_name


@dataclass(frozen=True)
class Parameter:
    """One number that a system takes."""

    unit: str
    """As it stands in column names: ``deg``, ``m``, ``N``, ``1``."""
    usual: float
    """Value where a study says nothing [unit]."""
    low: float
    """Smallest value that the system can use [unit]."""
    high: float
    """Largest value [unit]."""
    words: str
    """What it is."""
    whole: bool = False
    """Whether only whole numbers make sense."""
    choices: tuple[str, ...] = ()
    """Names of its values 0, 1, 2 …, where it is a choice and no quantity."""

    def value(self, given: float | str, name: str) -> float:
        """Return a value that is given by number or, for a choice, by name.

        Raises:
            InputError: no number, out of bounds, broken where it must be whole, or an unknown
                choice.
        """
        if isinstance(given, str) and self.choices:
            if given not in self.choices:
                raise unknown_name(f"value of {name!r}", given, self.choices)
            return float(self.choices.index(given))
        value = number(given, f"parameter {name!r}")
        if not self.low <= value <= self.high:
            allowed = ", ".join(self.choices) or f"{self.low:g} to {self.high:g} {self.unit}"
            raise InputError(f"parameter {name!r}: got {value:g}, need {allowed}")
        if self.whole and value != round(value):
            raise InputError(f"parameter {name!r}: got {value:g}, need a whole number")
        return value


def number(given: object, where: str) -> float:
    """Return a finite number as a float.

    Raises:
        InputError: it is none; the message begins with ``where``.
    """
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise InputError(f"{where}: got {given!r}, need a number")
    try:
        value = float(given)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise InputError(f"{where}: got {value}, need a finite number")
    return value


def choice(words: str, *choices: str) -> Parameter:
    """Return a parameter that is one of ``choices``, the first by default."""
    return Parameter("choice", 0.0, 0.0, len(choices) - 1.0, words, whole=True, choices=choices)
