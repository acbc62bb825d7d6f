"""Rows of A that depend on each other: found, named, dropped or refused."""

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from qpctrl.arrays import Vector
from qpctrl.constraint import Constraint, Selection
from qpctrl.errors import InputError, unknown_name
from qpctrl.evaluator import Evaluator
from qpctrl.mode import Mode
from qpctrl.robot import Robot
from qpctrl.tick import PIVOT_RATIO, Tick, build_tick

DependentRows = Literal["refuse", "drop"]


def dependent_rows(tick: Tick, row_pivots: Vector) -> tuple[str, ...]:
    """Return the names of the rows whose pivot ratios (k) say that they depend on others."""
    bad = ~(row_pivots > PIVOT_RATIO)
    if not bad.any():
        return ()
    first = int(np.argmax(bad))  # pivots after a vanishing one mean nothing
    return (tick.rows.equality[first],)


def independent(robot: Robot, mode: Mode, treatment: DependentRows) -> Mode:
    """Return ``mode`` with independent rows at the robot's home configuration.

    Raises:
        InputError: rows depend on each other and ``treatment`` is ``refuse``.
    """
    if treatment not in get_args(DependentRows):
        raise unknown_name("treatment of dependent rows", treatment, get_args(DependentRows))
    while names := _dependent_at_home(robot, mode):
        if treatment == "refuse":
            raise InputError(
                f"mode {mode.name!r}: constraint row {names[0]} depends on the rows before it; "
                "remove it, or say dependent_rows='drop'"
            )
        mode = replace(mode, constraints=_without(mode.constraints, names[0]))
    return mode


def _dependent_at_home(robot: Robot, mode: Mode) -> tuple[str, ...]:
    if not mode.constraints:
        return ()
    tick = build_tick(robot, mode)
    evaluate = Evaluator(tick.function)
    evaluate.inputs["q"][:] = robot.home
    evaluate.inputs["u"][:] = tick.inputs.vector()
    tick.inputs.views(evaluate.inputs["u"])["mu"][...] = 1.0  # a singular home has rows like others
    evaluate()
    return dependent_rows(tick, evaluate.outputs["row_pivots"])


def _without(constraints: tuple[Constraint, ...], row: str) -> tuple[Constraint, ...]:
    kept: list[Constraint] = []
    for constraint in constraints:
        keep = tuple(
            i for i, name in enumerate(constraint.row_names) if f"{constraint.name}.{name}" != row
        )
        if len(keep) == len(constraint.row_names):
            kept.append(constraint)
        elif keep:
            kept.append(Selection(whole=constraint, keep=keep))
    return tuple(kept)
