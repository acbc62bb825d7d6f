"""Typed flags from dataclasses, with every refusal as one line."""

import dataclasses
import re
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

    _check_each_once(kind, args)
    with parse_errors.on_parse_error(refuse):
        return tyro.cli(
            kind,
            args=list(args),
            prog=prog,
            description=description,
            config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
        )


def _check_each_once(kind: type, args: Sequence[str]) -> None:
    """Refuse a flag that is there twice, or a list without values: both would be dropped."""
    given = [text.split("=")[0].replace("_", "-") for text in args if text.startswith("--")]
    for flag in given:
        if given.count(flag) > 1:
            raise InputError(f"{flag}: got it twice; give all its values after one {flag}")
    lists = [f"--{f.name.replace('_', '-')}" for f in _fields(kind) if "tuple" in str(f.type)]
    for text, following in zip(args, (*args[1:], "--"), strict=False):
        if text.replace("_", "-") in lists and following.startswith("--"):
            raise InputError(f"{text}: needs a value")


def _fields(kind: type) -> list[dataclasses.Field[object]]:
    """Return the fields of a dataclass, those of nested dataclasses included."""
    found: list[dataclasses.Field[object]] = []
    for field in dataclasses.fields(kind):
        nested = isinstance(field.type, type) and dataclasses.is_dataclass(field.type)
        found += _fields(field.type) if nested else [field]  # type: ignore[arg-type]
    return found


def merged(name: str, parts: dict[str, type], own: type) -> type:
    """Return a dataclass with the fields of ``own`` and one field for each of ``parts``."""
    fields = [(key, part, dataclasses.field(default_factory=part)) for key, part in parts.items()]
    return dataclasses.make_dataclass(name, fields, bases=(own,), frozen=True, kw_only=True)


def flags(kind: type) -> list[str]:
    """Return the flags of a dataclass, nested dataclasses included."""
    return [f"--{field.name.replace('_', '-')}" for field in _fields(kind)]


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
        return where + _what_fits(" ".join(str(event.message).split()))
    if isinstance(event, parse_errors.BadValue):
        return f"{event.argument.display_name()}: needs a value"
    if isinstance(event, parse_errors.MissingArgs):
        names = ", ".join(item.arg.display_name() for item in event.missing_arguments)
        return f"missing {names}"
    return " ".join(type(event).__name__.split("_"))


def _what_fits(said: str) -> str:
    """Return what tyro says of a value that may be left out too, without how it tried."""
    found = re.match(r"no type matching .* instantiated from \['(.*?)'\]", said)
    kinds = [name for name in re.findall(r"<class '(\w+)'>", said) if name != "NoneType"]
    if not found or not kinds:
        return said
    words = {"int": "a whole number", "float": "a number"}
    return f"got {found[1]!r}, need {' or '.join(words.get(kind, kind) for kind in kinds)}"


def interactive() -> bool:
    """Return whether a person watches the progress."""
    return sys.stderr.isatty()
