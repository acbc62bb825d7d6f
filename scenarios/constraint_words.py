"""The numbers of a constraint table in words: equations, directions, poses."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector
from qpctrl.spatial import AXES
from scenarios.constraint_table import (
    ILL_CONDITIONED,
    NEGLIGIBLE,
    ConstraintTable,
    Equations,
    Row,
    condition,
)
from scenarios.record import WRENCH

DIRECTIONS = ("along x", "along y", "along z", "about x", "about y", "about z")

TWIST_UNITS, WRENCH_UNITS = ("m/s", "rad/s"), ("N", "Nm")
"""Of a direction along and about an axis, or of a row of A and its λ."""


class Direction(NamedTuple):
    """What is set and what can be chosen in one of the six directions."""

    name: str
    natural: str
    """The equation that the environment sets."""
    artificial: str
    """The component that is for the task to choose."""


def number(value: float) -> str:
    """Return a number with four digits; round-off is 0."""
    return "0" if abs(value) < NEGLIGIBLE else f"{value:.4g}"


def numbers(values: Sequence[float] | Vector) -> str:
    """Return numbers between brackets."""
    return f"({', '.join(map(number, values))})"


def terms(coefficients: Vector, letters: Sequence[str], first: int) -> str:
    """Return a sum as ``fz + 0.3 fx``, without its zeros and with direction ``first`` in front."""
    text = ""
    for i in sorted(range(6), key=lambda i: i != first):
        size = number(abs(coefficients[i]))
        if size != "0":
            sign = " - " if coefficients[i] < 0 else " + "
            text += sign + ("" if size == "1" else f"{size} ") + letters[i]
    return text.removeprefix(" + ").strip()


def equations(given: Equations, letters: Sequence[str]) -> list[str]:
    """Return each equation in letters, the direction that it is solved for in front."""
    found = zip(given.rows, given.right, given.solved, strict=True)
    return [f"{terms(row, letters, i)} = {number(right)}" for row, right, i in found]


def pushes(table: ConstraintTable) -> list[str]:
    """Return what can only be pushed, as ``fz ≥ 0``."""
    return [_inequality(row) for row in table.push]


def directions(table: ConstraintTable) -> list[Direction]:
    """Return the natural and the artificial constraint of each of the six directions."""
    twist = dict(zip(table.twist.solved, equations(table.twist, AXES), strict=True))
    wrench = dict(zip(table.wrench.solved, equations(table.wrench, WRENCH), strict=True))
    sides = {text[:2]: text[2:] for text in pushes(table) if len(text.split()) == 3}
    found = []
    for i, name in enumerate(DIRECTIONS):
        chosen = WRENCH[i] if i in twist else AXES[i]
        side = f",{sides[chosen]} (can only be pushed)" if chosen in sides else ""
        found.append(Direction(name, (twist | wrench)[i], f"{chosen} = any{side}"))
    return found


def components(values: Vector, letters: Sequence[str], units: tuple[str, str]) -> str:
    """Return the components (6) that are not zero, with their units, as ``vx = 0.2 m/s``."""
    parts = [
        f"{letters[i]} = {number(value)} {units[i // 3]}"
        for i, value in enumerate(values)
        if number(value) != "0"
    ]
    return ", ".join(parts)


def place(X_EF: pin.SE3) -> str:
    """Return a pose in the frame E; a turn as its rotation vector."""
    turn = numbers(np.degrees(pin.log3(X_EF.rotation)))
    turned = "" if turn == "(0, 0, 0)" else f", turned by {turn}°"
    return f"{numbers(X_EF.translation)} m in E{turned}"


def units(row: Row) -> tuple[str, str]:
    """Return the unit of a row of A V, and that of its λ."""
    return TWIST_UNITS[row.angular], WRENCH_UNITS[row.angular]


def conditioned(table: ConstraintTable) -> str:
    """Return the condition of S, and a warning where it is bad."""
    found = condition(table.S)
    verdict = ": ill-conditioned" if found > ILL_CONDITIONED else ""
    return f"condition {number(found)}{verdict}"


def textbook_error(table: ConstraintTable, robot: str) -> str:
    """Return what the textbook law presses too much on the example motion with that robot."""
    error = components(table.excess, WRENCH, WRENCH_UNITS)
    return f"{error} with {robot}" if error else "none: it agrees with the QP"


def _inequality(row: Vector) -> str:
    """Return ``row · F ≥ 0`` in letters, its largest positive term in front."""
    negative = not (row > NEGLIGIBLE).any()
    row = -row if negative else row
    first = int(row.argmax())
    return f"{terms(row / row[first], WRENCH, first)} {'≤' if negative else '≥'} 0"
