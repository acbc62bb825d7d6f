"""Rows of A that depend on each other: found, named, dropped or refused."""

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from qpctrl.arrays import Array, Vector
from qpctrl.constraint import Constraint, Selection
from qpctrl.errors import InputError, unknown_name
from qpctrl.evaluator import Evaluator
from qpctrl.mode import Mode
from qpctrl.robot import Robot
from qpctrl.tick import MATRICES, PIVOT_RATIO, Tick, build_tick

DependentRows = Literal["refuse", "drop"]

DEGENERATE = 1e-10
"""Ratio of the Hessian's eigenvalues below which motion is undetermined."""


def dependent_rows(tick: Tick, row_pivots: Vector) -> tuple[str, ...]:
    """Return the names of the rows whose pivot ratios (k) say that they depend on others."""
    bad = ~(row_pivots > PIVOT_RATIO)
    if not bad.any():
        return ()
    first = int(np.argmax(bad))  # pivots after a vanishing one mean nothing
    return (tick.rows.constraint[first],)


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


def check_determined(robot: Robot, mode: Mode) -> None:
    """Refuse a mode whose tasks leave some motion undetermined at the robot's home.

    Raises:
        InputError: the Hessian in a is singular: dependent task axes, or no posture for the
            freedom that is left.
    """
    _, terms = _at_home(robot, mode)
    eigenvalues = np.linalg.eigvalsh(terms["H"][: robot.nv, : robot.nv])
    if not eigenvalues[0] > DEGENERATE * eigenvalues[-1]:
        raise InputError(
            f"mode {mode.name!r}: its tasks leave motion undetermined at home; add a posture task, "
            "or remove task axes that depend on each other"
        )


def _dependent_at_home(robot: Robot, mode: Mode) -> tuple[str, ...]:
    if not mode.constraints:
        return ()
    tick, terms = _at_home(robot, mode)
    return dependent_rows(tick, terms["row_pivots"])


def _at_home(robot: Robot, mode: Mode) -> tuple[Tick, dict[str, Array]]:
    """Return the tick and its outputs at home, damped, so that a singular home is no matter."""
    tick = build_tick(robot, mode)
    evaluate = Evaluator(tick.function, matrices=MATRICES)
    evaluate.inputs["q"][:] = robot.home
    evaluate.inputs["u"][:] = tick.inputs.vector()
    u = tick.inputs.views(evaluate.inputs["u"])
    u["mu"][...] = 1.0
    for name in u:
        if name.endswith(".weight"):
            u[name][...] = 1.0
    evaluate()
    return tick, evaluate.outputs


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
