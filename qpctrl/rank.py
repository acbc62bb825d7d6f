"""Rows of A that depend on each other: found, named, dropped or refused."""

from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from scipy.linalg import null_space

from qpctrl.arrays import Array, Matrix, Vector
from qpctrl.constraint import Constraint, Selection
from qpctrl.errors import InputError, unknown_name
from qpctrl.evaluator import Evaluator
from qpctrl.mode import Mode
from qpctrl.robot import Robot
from qpctrl.tick import PIVOT_RATIO, Tick, build_tick

DependentRows = Literal["refuse", "drop"]

DEPENDENT_CONTACTS = 1e-9
"""Share of a row that is new among the rows before it below which it depends on them."""

DEGENERATE = 1e-10
"""Ratio of the Hessian's eigenvalues below which motion is undetermined."""


def dependent_rows(tick: Tick, row_pivots: Vector) -> tuple[str, ...]:
    """Return the names of the rows whose pivot ratios (k) say that they depend on others."""
    bad = ~(row_pivots > PIVOT_RATIO)
    if not bad.any():
        return ()
    first = int(np.argmax(bad))  # pivots after a vanishing one mean nothing
    return (tick.rows.constraint[first],)


def usable_tick(robot: Robot, mode: Mode, treatment: DependentRows, form: str) -> Tick:
    """Return the tick of a mode with independent rows, and all motion determined, at home.

    Raises:
        InputError: rows depend on each other and ``treatment`` is ``refuse``; or the Hessian is
            singular: dependent task axes, or no posture for the freedom that is left.
    """
    if treatment not in get_args(DependentRows):
        raise unknown_name("treatment of dependent rows", treatment, get_args(DependentRows))
    while True:
        tick = build_tick(robot, mode)
        terms = _at_home(robot, tick)
        names = _dependent(tick, terms)
        if not names:
            break
        if treatment == "refuse":
            raise InputError(
                f"mode {mode.name!r}: constraint row {names[0]} depends on the rows before it; "
                "remove it, or say dependent_rows='drop'"
            )
        mode = replace(mode, constraints=_without(mode.constraints, names[0]))
    _check_determined(robot, tick, terms)
    return tick if form == "reduced" else build_tick(robot, mode, form)


def _check_determined(robot: Robot, tick: Tick, terms: dict[str, Array]) -> None:
    H = terms["H"] + sum(terms[f"H_{i}"] for i in range(tick.upper_levels))
    if tick.searched:  # H may be flat where the equalities leave no choice
        Z = null_space(terms["A"])
        H = Z.T @ H @ Z
        size = np.sqrt(np.maximum(np.diag(H), np.finfo(float).tiny))
        H = H / np.outer(size, size)
    else:
        H = H[: robot.nv, : robot.nv]
    eigenvalues = np.linalg.eigvalsh(H)
    if not eigenvalues[0] > DEGENERATE * eigenvalues[-1]:
        raise InputError(
            f"mode {tick.mode.name!r}: its tasks leave motion undetermined at home; add a posture "
            "task, or remove task axes that depend on each other"
        )


def _dependent(tick: Tick, terms: dict[str, Array]) -> tuple[str, ...]:
    mode = tick.mode
    held = len({constraint.space for constraint in mode.constraints}) > 1 and mode.slack is None
    return dependent_rows(tick, terms["row_pivots"]) or (
        dependent_contacts(tick, terms["A"]) if held else ()
    )


def dependent_contacts(tick: Tick, A: Matrix) -> tuple[str, ...]:
    """Return the name of the first equality of the QP that depends on those before it, if any.

    Rows of different contacts may depend on each other where those of each do not: two arms that
    hold one box against two walls.

    Args:
        tick: names of the rows.
        A: the equalities (m×n), all finite.
    """
    rows: list[Vector] = []
    for name, row in zip(tick.rows.equality, A, strict=True):
        rest = row / max(float(np.linalg.norm(row)), np.finfo(float).tiny)
        for _ in range(2):  # Gram–Schmidt, twice is enough
            for known in rows:
                rest = rest - (known @ rest) * known
        size = float(np.linalg.norm(rest))
        if not size > DEPENDENT_CONTACTS:
            return (name,)
        rows.append(rest / size)
    return ()


def _at_home(robot: Robot, tick: Tick) -> dict[str, Array]:
    """Return the outputs of a tick at home, damped, so that a singular home is no matter."""
    evaluate = Evaluator(tick.function, matrices=tick.matrices)
    evaluate.inputs["q"][:] = robot.home
    evaluate.inputs["u"][:] = tick.inputs.vector()
    u = tick.inputs.views(evaluate.inputs["u"])
    u["mu"][...] = 1.0
    for name in u:
        if name.endswith(".weight"):
            u[name][...] = 1.0
    evaluate()
    return evaluate.outputs


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
