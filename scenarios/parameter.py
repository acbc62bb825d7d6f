"""Checks of a scenario's parameters that every scenario needs."""

from collections.abc import Mapping

from qpctrl.errors import InputError

Room = Mapping[str, tuple[float, float, str]]
"""Least and most of a parameter, and its unit, by its name."""


def need_within(scenario: object, room: Room) -> None:
    """Refuse parameters of a scenario with which it means nothing or never ends.

    Raises:
        InputError: one is below its least or above its most.
    """
    for name, (least, most, unit) in room.items():
        value = getattr(scenario, name)
        if value > most:
            raise InputError(f"{name}: got {value}, need at most {most:g} {unit}".rstrip())
        if not value >= least:
            raise InputError(f"{name}: got {value}, need at least {least:g} {unit}".rstrip())
