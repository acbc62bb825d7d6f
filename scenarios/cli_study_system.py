"""The command ``qpctrl study system [NAME]``: what a study can set, vary and measure."""

import dataclasses
import json

from rich.table import Table

from qpctrl.errors import unknown_name
from scenarios.command import parse
from scenarios.console import console
from scenarios.study.system import System
from scenarios.study.systems import SYSTEMS


@dataclasses.dataclass(frozen=True, kw_only=True)
class Showing:
    """Flags of ``study system``."""

    json: bool = False
    """Print JSON."""


def system_command(arguments: list[str]) -> bool:
    """Print the systems, or the parameters, controllers and measures of one.

    Args:
        arguments: ``system``, a name if one is wanted, and flags.

    Raises:
        InputError: an unknown system or flag.
    """
    rest = arguments[1:]
    name = rest.pop(0) if rest and not rest[0].startswith("-") else None
    given = parse(
        Showing,
        rest,
        prog="qpctrl study system [NAME]",
        description="Say what a study can set, vary and measure.\n\n"
        "Example: qpctrl study system wipe",
    )
    if name is None:
        found = {known: system.summary for known, system in SYSTEMS.items()}
        print(json.dumps(found, indent=2, ensure_ascii=False)) if given.json else _print_all(found)
        return True
    if name not in SYSTEMS:
        raise unknown_name("system", name, SYSTEMS)
    if given.json:
        print(json.dumps(_plain(SYSTEMS[name]), indent=2, ensure_ascii=False))
    else:
        _print_one(SYSTEMS[name])
    return True


def _print_all(found: dict[str, str]) -> None:
    table = Table("system", "what it is", box=None, header_style="bold")
    for name, summary in found.items():
        table.add_row(name, summary)
    console().print(table)


def _print_one(system: System) -> None:
    out = console()
    out.print(f"[bold]{system.name}[/]: {system.summary}", "")
    heads = ("parameter", "unit", "usual", "from", "to", "what it is")
    table = Table(*heads, box=None, header_style="bold")
    for name, p in system.parameters.items():
        if p.choices:
            table.add_row(name, "", p.choices[int(p.usual)], "", "", f"{p.words}: {_or(p.choices)}")
        else:
            numbers = (f"{value:g}" for value in (p.usual, p.low, p.high))
            table.add_row(name, p.unit, *numbers, p.words)
    out.print(table, "")
    for head, found in (("controller", system.controllers), ("measure", system.measures)):
        table = Table(head, "what it is", box=None, header_style="bold")
        for name, words in found.items():
            table.add_row(name, words)
        out.print(table, "")


def _plain(system: System) -> dict[str, object]:
    return {
        "name": system.name,
        "summary": system.summary,
        "parameters": {name: dataclasses.asdict(p) for name, p in system.parameters.items()},
        "controllers": dict(system.controllers),
        "measures": dict(system.measures),
    }


def _or(names: tuple[str, ...]) -> str:
    return " or ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]
