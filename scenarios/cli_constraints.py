"""The command ``qpctrl constraints NAME``: the textbook's table of a contact."""

import dataclasses
import json
import re
import textwrap
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Column, Table

from qpctrl.errors import unknown_name
from qpctrl.spatial import AXES
from scenarios.command import parse
from scenarios.console import console
from scenarios.constraint_catalogue import ENTRIES
from scenarios.constraint_table import ConstraintTable, condition, constraint_table
from scenarios.constraint_words import (
    TWIST_UNITS,
    components,
    conditioned,
    directions,
    equations,
    number,
    numbers,
    place,
    pushes,
    textbook_error,
    units,
)
from scenarios.record import WRENCH
from scenarios.robot_file import load_robot

ROBOT = "fr3"
"""The arm whose inertia enters S and the error of the textbook law."""

USAGE = f"""usage: qpctrl constraints [NAME] [--json] [--help]

{textwrap.fill(f"names: {', '.join(ENTRIES)}", 100, subsequent_indent=" " * 7)}

example:
  qpctrl constraints hinge
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Explaining:
    """Flags of ``constraints``."""

    json: bool = False
    """Print JSON."""


def constraints_command(arguments: list[str]) -> bool:
    """Print the table of one constraint, or the names of all.

    Raises:
        InputError: an unknown name, or flags that cannot be used.
    """
    if arguments and arguments[0] in ("-h", "--help"):
        print(USAGE, end="")
        return True
    names = arguments[:1] if arguments and not arguments[0].startswith("-") else []
    for name in names:
        if name not in ENTRIES:
            raise unknown_name("constraint", name, ENTRIES)
    given = parse(
        Explaining,
        arguments[len(names) :],
        prog=" ".join(["qpctrl constraints", *names]),
        description="Print what the environment sets and what the task may choose, for twist and "
        "wrench; the rows of A in numbers, and how well they are conditioned.\n\n"
        f"Example: qpctrl constraints {names[0] if names else 'hinge'} --json",
    )
    if not names:
        _print_names(as_json=given.json)
        return True
    table = constraint_table(ENTRIES[names[0]], load_robot(ROBOT))
    if given.json:
        print(json.dumps(_plain(names[0], table), indent=2, ensure_ascii=False))
    else:
        _print_table(names[0], table)
    return True


def _print_names(*, as_json: bool) -> None:
    words = {name: entry.words for name, entry in ENTRIES.items()}
    if as_json:
        print(json.dumps(words, indent=2, ensure_ascii=False))
        return
    table = Table("constraint", "k", "what it is", box=None, header_style="bold")
    for name, entry in ENTRIES.items():
        table.add_row(name, str(entry.k), re.split(r"[:,]|\.$", words[name])[0])
    console().print(table)
    console().print("\nqpctrl constraints NAME explains one of them")


def _print_table(name: str, table: ConstraintTable) -> None:
    out = console()
    out.print(f"[bold]{name}[/], k = {len(table.rows)}")
    out.print(f"{escape(ENTRIES[name].words)}\n")
    out.print(_lines(_setting(name, table)))
    out.print()
    out.print(_directions(table))
    out.print()
    out.print(_lines(_facts(table)))
    if table.rows:
        out.print("\nA, row by row, along the axes of the tool:")
        out.print(_rows(table))


def _setting(name: str, table: ConstraintTable) -> dict[str, str]:
    """Return how to read the directions."""
    entry, origin = ENTRIES[name], "the tool" if table.about_tool else "E"
    return {
        "frame E": entry.axes,
        "tool": f"at {place(entry.X_EF)}",
        "twist v, w": f"m/s, rad/s, along the axes of E, about the origin of {origin}",
        "wrench f, m": "N, Nm, along the same; of the robot on the environment",
    }


def _facts(table: ConstraintTable) -> dict[str, str]:
    """Return what is said below the directions."""
    k, moving = len(table.rows), table.twist.right.any()
    facts = {
        f"twist, A V = {'v_c' if moving else '0'}": ", ".join(equations(table.twist, AXES)),
        "wrench, N F = 0": ", ".join(equations(table.wrench, WRENCH)),
        "environment": f"moves, v_c = {numbers([r.v_c for r in table.rows])}" if moving else "",
        "one-sided": ", ".join(pushes(table)),
        "rank of A": f"k = {k}, free motions 6 - k = {6 - k}",
    }
    if k:
        sizes = ", ".join(map(number, table.singular_values))
        facts |= {
            "singular values": f"{sizes}; condition {number(condition(table.A))}",
            "S = A Λ⁻¹ Aᵀ": f"of {ROBOT} at home: {conditioned(table)}, in SI units",
            "example motion": components(table.V, AXES, TWIST_UNITS) or "none: it cannot move",
            "Ȧ V on it": f"{numbers([row.A_dot_V for row in table.rows])} m/s², rad/s²",
            "textbook's error": textbook_error(table, ROBOT),
        }
    return {label: text for label, text in facts.items() if text}


def _lines(facts: dict[str, str]) -> Table:
    found = Table.grid(padding=(0, 2, 0, 0))
    found.add_column(min_width=16)
    for label, text in facts.items():
        found.add_row(f"[bold]{label}[/]", text)
    return found


def _directions(table: ConstraintTable) -> Table:
    found = Table(
        Column("direction", min_width=16),
        "natural: set by the environment",
        "artificial: for the task to choose",
        box=None,
        header_style="bold",
        padding=(0, 2, 0, 0),
    )
    for direction in directions(table):
        found.add_row(direction.name, f"[cyan]{direction.natural}[/]", direction.artificial)
    return found


def _rows(table: ConstraintTable) -> Table:
    numeric = (Column(name, justify="right") for name in (*AXES, "v_c", "Ȧ V"))
    found = Table(
        Column("row", min_width=16),
        *numeric,
        *("A V", "λ", "one-sided"),
        box=None,
        header_style="bold",
        padding=(0, 2, 0, 0),
    )
    for row in table.rows:
        shown = (*row.A, row.v_c, row.A_dot_V)
        side = "yes, λ ≥ 0" if row.unilateral else "no"
        found.add_row(row.name, *map(number, shown), *units(row), side)
    return found


def _plain(name: str, table: ConstraintTable) -> dict[str, Any]:
    """Return the table as JSON knows it."""
    entry, k = ENTRIES[name], len(table.rows)
    return {
        "constraint": name,
        "words": entry.words,
        "k": k,
        "free_motions": 6 - k,
        "E": entry.axes,
        "origin": "tool" if table.about_tool else "environment",
        "directions": [direction._asdict() for direction in directions(table)],
        "twist": equations(table.twist, AXES),
        "wrench": equations(table.wrench, WRENCH),
        "one_sided": pushes(table),
        "N": _rounded(table.wrench.rows),
        "X_EF": _rounded(entry.X_EF.homogeneous),
        "rows": [
            {
                "name": row.name,
                "unit": units(row)[0],
                "lambda_unit": units(row)[1],
                "A": _rounded(row.A),
                "unilateral": row.unilateral,
                "v_c": _rounded(row.v_c),
                "A_dot_V": _rounded(row.A_dot_V),
            }
            for row in table.rows
        ],
        "V": _rounded(table.V),
        "singular_values": _rounded(table.singular_values),
        "condition": condition(table.A) if k else None,
        "S_condition": condition(table.S) if k else None,
        "textbook_error": _rounded(table.excess),
        "robot": ROBOT,
    }


def _rounded(values: Any) -> Any:
    """Return numbers as lists, without round-off."""
    return (np.round(values, 12) + 0.0).tolist()
