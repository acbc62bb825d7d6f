"""Typed flags from dataclasses, with every refusal as one line."""

import dataclasses
import sys
from collections.abc import Sequence
from typing import NoReturn, TypeVar

import tyro
from tyro import _errors as parse_errors  # private; pyproject pins the minor version

from qpctrl.errors import InputError, unknown_name

T = TypeVar("T")


def parse(kind: type[T], args: Sequence[str], *, prog: str, description: str) -> T:
    """Return ``kind``, a dataclass, filled from flags ``--field value``.

    Args:
        kind: dataclass whose fields, with their docstrings, become flags.
        args: the command line after ``prog``.
        prog: what stands before the flags, for help.
        description: what the command does, with an example.

    Raises:
        InputError: an unknown flag or a value that does not fit; one line.
    """

    def refuse(event: parse_errors.ParseErrorEvent) -> NoReturn:
        raise InputError(_message(event, kind))

    with parse_errors.on_parse_error(refuse):
        return tyro.cli(
            kind,
            args=list(args),
            prog=prog,
            description=description,
            config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
        )


def merged(name: str, parts: dict[str, type], own: type) -> type:
    """Return a dataclass with the fields of ``own`` and one field for each of ``parts``."""
    fields = [(key, part, dataclasses.field(default_factory=part)) for key, part in parts.items()]
    return dataclasses.make_dataclass(name, fields, bases=(own,), frozen=True, kw_only=True)


def flags(kind: type) -> list[str]:
    """Return the flags of a dataclass, nested dataclasses included."""
    found: list[str] = []
    for field in dataclasses.fields(kind):
        if isinstance(field.type, type) and dataclasses.is_dataclass(field.type):
            found += flags(field.type)
        else:
            found.append("--" + field.name.replace("_", "-"))
    return found


def _message(event: parse_errors.ParseErrorEvent, kind: type) -> str:
    if isinstance(event, parse_errors.UnrecognizedArgs):
        token = event.tokens[0].split("=")[0]
        if token.startswith("-"):
            return str(unknown_name("flag", token, [*flags(kind), "--help"]))
        return f"unexpected argument {token!r}; flags are written --name value"
    if isinstance(event, parse_errors.InvalidChoice):
        name = event.argument.display_name()
        return str(unknown_name(f"value of {name}", event.value, event.choices))
    if isinstance(event, parse_errors.InstantiationFailure):
        where = f"{event.argument.display_name()}: " if event.argument else ""
        return where + " ".join(str(event.message).split())
    if isinstance(event, parse_errors.BadValue):
        return f"{event.argument.display_name()}: needs a value"
    if isinstance(event, parse_errors.MissingArgs):
        names = ", ".join(item.arg.display_name() for item in event.missing_arguments)
        return f"missing {names}"
    return " ".join(type(event).__name__.split("_"))


def interactive() -> bool:
    """Return whether a person watches the progress."""
    return sys.stderr.isatty()
