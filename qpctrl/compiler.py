"""The C compiler of this machine, and a CasADi function as a shared library made by it."""

import contextlib
import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import casadi as ca

from qpctrl.errors import QpctrlError

COMPILERS = ("cc", "gcc", "clang")
"""Looked for on PATH, in this order, where ``$CC`` is not set."""

FLAGS = ("-O2", "-ffp-contract=off", "-fPIC", "-shared")
"""-O2 takes 1.6 times as long to compile and saves a tenth of a call. Without fused multiply-adds
every operation rounds as in the interpreter; they would save 0.4 µs in the tick of a 7-joint
arm, and change its numbers by 6e-12."""

TIME_LIMIT = 120.0
"""A compiler that takes longer hangs [s]."""


class NotCompiledError(QpctrlError):
    """Why there is no library: one line."""


class Compiler(NamedTuple):
    """A compiler and how it is called."""

    command: tuple[str, ...]
    identity: str
    """First line of what it says about its version."""
    flags: tuple[str, ...]
    cpu: str
    """Model and features of the processor that the code is for; empty if for any."""

    def key(self, source: str) -> str:
        """Return the hash of all that the library of ``source`` depends on."""
        made_from = (
            source,
            self.identity,
            *self.command[1:],
            *self.flags,
            self.cpu,
            platform.machine(),
            sys.platform,
            ca.CasadiMeta.version(),
        )
        return sha256("\0".join(made_from).encode()).hexdigest()

    def build(self, source: str, folder: Path) -> Path:
        """Return the library of ``source``, compiled in ``folder``.

        Raises:
            NotCompiledError: the compiler fails, hangs, or writes nothing.
            OSError: nothing can be written to ``folder``.
        """
        (folder / "code.c").write_text(source, encoding="utf-8")
        _run((*self.command, *self.flags, "code.c", "-o", "code.so", "-lm"), folder)
        library = folder / "code.so"
        if not library.is_file():
            raise NotCompiledError(f"{self.command[0]} wrote no library")
        return library


def find_compiler() -> Compiler:
    """Return the compiler that ``$CC`` names, or the first of `COMPILERS`.

    Raises:
        NotCompiledError: there is none, or it cannot be run.
    """
    asked = os.environ.get("CC", "").strip()
    try:
        candidates = [shlex.split(asked)] if asked else [[name] for name in COMPILERS]
    except ValueError as error:
        raise NotCompiledError(f"$CC is {asked!r}: {error}") from error
    for name, *options in candidates:
        if program := shutil.which(name):
            command = (str(Path(program).absolute()), *options)
            cpu = _cpu()
            native = ("-march=native",) if cpu else ()
            now = ("-Wl,-z,now",) if sys.platform == "linux" else ()  # all symbols, or no load
            flags = (*FLAGS, *native, *now)
            return Compiler(command, one_line(_run((*command, "--version"))), flags, cpu)
    if asked:
        raise NotCompiledError(f"$CC is {asked!r}, which is no program that can be run")
    raise NotCompiledError(f"no C compiler: none of {', '.join(COMPILERS)} is on PATH")


def generate(functions: Sequence[ca.Function]) -> str:
    """Return the C code of some functions, which can be found in it by their names.

    Raises:
        NotCompiledError: CasADi cannot write one of them as C.
    """
    name = functions[0].name()
    try:
        generator = ca.CodeGenerator(name)
        for function in functions:
            generator.add(function)
        return _with_inline_extremes(str(generator.dump()))
    except RuntimeError as error:
        raise NotCompiledError(f"no C code: {one_line(error, name)}") from error


def _with_inline_extremes(code: str) -> str:
    """Return generated code whose maxima and minima are not calls into libm, half of its time."""
    for name, sign in (("fmax", ">"), ("fmin", "<")):
        larger = f"double m = x {sign} y ? x : y; return y != y ? x : m;"  # what libm says of NaN
        code = code.replace(f"return {name}(x, y);", larger)
        head = f"casadi_real casadi_{name}(casadi_real x, casadi_real y)"
        code = code.replace(head, f"static inline {head}")
    return code


def one_line(text: object, word: str = "") -> str:
    """Return the first line that holds ``word``, else the first one, cut to 200 characters."""
    if isinstance(text, OSError) and text.strerror:
        text = f"{text.filename}: {text.strerror}" if text.filename else text.strerror
    lines = [line.strip() for line in str(text).splitlines() if line.strip()]
    return next((line for line in lines if word in line), lines[0] if lines else "")[:200]


def _cpu() -> str:
    """Return model and features of an x86 processor on Linux, else nothing."""
    found = {}
    with contextlib.suppress(OSError), Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
        for line in lines:
            name, colon, value = line.partition(":")
            if not colon:
                break  # the next processor
            found[name.strip()] = value.strip()
    return f"{found.get('model name')}: {found['flags']}" if "flags" in found else ""


def _run(command: tuple[str, ...], folder: Path | None = None) -> str:
    """Return what a command printed; it and its children end within `TIME_LIMIT`."""
    temporary = {"TMPDIR": str(folder)} if folder else {}
    try:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, "LC_ALL": "C", **temporary},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,  # a group of processes that can be ended as one
        )
    except OSError as error:
        raise NotCompiledError(f"{command[0]} cannot be run: {error.strerror}") from error
    with process:
        try:
            printed, _ = process.communicate(timeout=TIME_LIMIT)
        except BaseException as error:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            if isinstance(error, subprocess.TimeoutExpired):
                late = f"{command[0]} had not finished after {TIME_LIMIT:g} s"
                raise NotCompiledError(late) from error
            raise
    if process.returncode:
        failed = f"{command[0]} failed with code {process.returncode}"
        raise NotCompiledError(f"{failed}: {one_line(printed, 'error')}")
    return printed
