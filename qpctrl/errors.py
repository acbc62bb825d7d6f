"""Errors of the public boundary: what was got, what is allowed, what to try."""

import difflib
from collections.abc import Iterable


class QpctrlError(Exception):
    """Base of every error that qpctrl raises on purpose."""


class InputError(QpctrlError, ValueError):
    """An argument, name or file that cannot be used as given."""


class ModelMismatchError(QpctrlError):
    """Two engines disagree on the dynamics of one robot."""


def unknown_name(kind: str, got: str, allowed: Iterable[str]) -> InputError:
    """Return the error for an unknown name, with the nearest valid one."""
    names = sorted(allowed)
    near = difflib.get_close_matches(got, names, n=1, cutoff=0.0)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return InputError(f"unknown {kind} {got!r}; allowed: {', '.join(names)}{hint}")


def reason_of(error: Exception) -> str:
    """Return in one line why a file could not be used: what the system says, else the error."""
    return getattr(error, "strerror", None) or " ".join(str(error).split())
