"""C99 as text: identifiers, literals, comments, tables."""

import re
from collections.abc import Iterable

from qpctrl.errors import InputError

_SYSTEM = """
assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign
stdarg stdatomic stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar
wchar wctype aio alloca ar cpio dirent dlfcn endian fcntl features fnmatch ftw glob grp iconv
langinfo libgen malloc memory monetary mqueue netdb poll pthread pwd regex sched search semaphore
spawn strings syslog tar termios ulimit unistd utime values wordexp
"""
TAKEN = frozenset({*_SYSTEM.split(), "qpctrl", "replay"})
"""Names whose header would hide one of the system, and two that are used here."""


def identifier(name: str) -> str:
    """Return a C identifier made from ``name``: what cannot be in one becomes ``_``."""
    word = re.sub(r"[^0-9A-Za-z]+", "_", name).strip("_")
    return word if word and not word[0].isdigit() else f"n{word}"


class Identifiers:
    """Identifiers that differ in more than their case, each for one name."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = {word.lower() for word in taken}

    def add(self, name: str) -> str:
        """Return an identifier for ``name`` that was not given before."""
        word = candidate = identifier(name)
        number = 1
        while candidate.lower() in self._taken:
            number += 1
            candidate = f"{word}_{number}"
        self._taken.add(candidate.lower())
        return candidate


def check_name(name: str) -> None:
    """Refuse what cannot stand in front of C identifiers and file names.

    Raises:
        InputError: it cannot.
    """
    if not re.fullmatch(r"[A-Za-z][0-9A-Za-z_]{0,40}", name):
        raise InputError(
            f"name: got {name!r}, need a letter followed by at most 40 letters, digits or '_'"
        )
    if name.lower() in TAKEN:
        raise InputError(f"name: {name!r} is that of a system header or of the export itself")


def comment(text: str) -> str:
    """Return a comment of one line."""
    inside = " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *")
    return f"/* {inside} */"


def string(text: str) -> str:
    """Return a string literal."""
    plain = "".join(
        chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f"\\{byte:03o}"
        for byte in text.encode()
    )
    return f'"{plain}"'


def table(kind: str, name: str, items: Iterable[object]) -> str:
    """Return the definition of a constant array; C has none without items, so one is put in."""
    values = [str(item) for item in items] or ["{0}" if kind.startswith("qpctrl_") else "0"]
    lines, line = [], "   "
    for value in values:
        if len(line) + len(value) + 2 > 98:
            lines.append(line)
            line = "   "
        line += f" {value},"
    body = "\n".join([*lines, line])
    return f"static const {kind} {name}[] = {{\n{body}\n}};\n"


def strings(name: str, texts: Iterable[str]) -> str:
    """Return the definition of a constant array of strings."""
    return table("char *const", name, map(string, texts))
