"""A CasADi function as machine code: compiled once, kept on disk, found again by its content.

A kept library is a file ``KEY.DIGEST.so``. KEY is the hash of all it was made from, DIGEST the
SHA-256 of its bytes: it appears in one step, and one that was changed gives itself away.
"""

import contextlib
import errno
import os
import stat
import tempfile
import time
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import casadi as ca
import numpy as np

from qpctrl.arrays import Vector
from qpctrl.compiler import NotCompiledError, find_compiler, generate, one_line
from qpctrl.errors import InputError, unknown_name

CompileMode = Literal["auto", "yes", "no"]
"""``auto``: interpret what cannot be compiled; ``yes``: that is an error; ``no``: interpret."""

AGREEMENT = 1e-6
"""Largest difference, relative or absolute, at the points where a library is tried. The same
operations give the same bits; another libm may round otherwise, and Λ amplifies that."""


class Compiled(NamedTuple):
    """A function, and how it came about."""

    function: ca.Function
    is_compiled: bool
    note: str
    """One line: what compiled it and where it is kept, or why it is interpreted."""


def compiled(
    function: ca.Function, *, compile: CompileMode = "auto", cache: Path | None = None
) -> Compiled:
    """Return ``function`` as machine code: the same inputs, outputs, names and numbers.

    It has values only: derivatives are taken before. Compiling takes seconds; a kept library
    is found in little more time than it takes to write the C code.

    Args:
        function: what to compile, by ``$CC``, else cc, gcc or clang.
        compile: what to do where that cannot be done.
        cache: folder of kept libraries; by default ``$QPCTRL_CACHE``, else
            ``$XDG_CACHE_HOME/qpctrl``, else ``~/.cache/qpctrl``. Its libraries are run: where
            it cannot be used, or anyone may write to it, nothing is kept.

    Raises:
        InputError: ``compile="yes"`` and it cannot be done, or an unknown ``compile``.
    """
    if compile not in get_args(CompileMode):
        raise unknown_name("compile", compile, get_args(CompileMode))
    if compile == "no":
        return Compiled(function, False, "interpreted, as asked for")
    try:
        return _recalled_or_built(function, cache)
    except (NotCompiledError, OSError) as error:
        reason = one_line(error)
        if compile == "yes":
            raise InputError(
                f"{function.name()!r} cannot be compiled: {reason}; set $CC to a C compiler "
                "that works, or allow compile='auto'"
            ) from error
        return Compiled(function, False, f"interpreted: {reason}")


def _recalled_or_built(function: ca.Function, cache: Path | None) -> Compiled:
    started = time.perf_counter()
    source, compiler = generate(function), find_compiler()
    key, by = compiler.key(source), f"compiled by {compiler.identity}"
    folder, refused = None, ""
    try:
        folder = _cache_folder(cache)
        if found := _recall(function, folder, key):
            return Compiled(found, True, f"{by}, kept in {folder}")
    except OSError as error:
        folder, refused = None, one_line(error)
    with tempfile.TemporaryDirectory(prefix="qpctrl-", ignore_cleanup_errors=True) as private:
        library = compiler.build(source, Path(private))
        library = library.rename(library.with_name(f"{key}.{_digest(library)}.so"))
        by += f" in {time.perf_counter() - started:.1f} s"
        try:
            if folder:
                _keep(library, folder)
                if found := _recall(function, folder, key):
                    return Compiled(found, True, f"{by}, kept in {folder}")
                refused = f"{folder}: libraries cannot be loaded from there"
        except OSError as error:
            refused = one_line(error)
        external = _load(function, library)  # stays when its file goes
        return Compiled(external, True, f"{by}, not kept: {refused}")


def _cache_folder(cache: Path | None) -> Path:
    """Return the folder of kept libraries; OSError where it cannot be used."""
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    base = base if base.is_absolute() else Path("~/.cache")  # relative ones are to be ignored
    try:
        folder = Path(cache or os.environ.get("QPCTRL_CACHE") or base / "qpctrl").expanduser()
    except RuntimeError as error:
        raise OSError(str(error)) from error
    folder = folder.absolute()
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_mode & stat.S_IWOTH:
        raise PermissionError(errno.EPERM, "anyone may write there", str(folder))
    return folder


def _recall(function: ca.Function, folder: Path, key: str) -> ca.Function | None:
    """Return the kept library that can be trusted; remove those that cannot."""
    for library in sorted(folder.glob(f"{key}.*.so")):
        try:
            return _load(function, library)
        except NotCompiledError:
            with contextlib.suppress(OSError):
                library.unlink()
    return None


def _keep(library: Path, folder: Path) -> None:
    """Put a copy of a library into ``folder``, whole or not at all."""
    handle, name = tempfile.mkstemp(dir=folder, prefix="half-written-")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(library.read_bytes())
            file.flush()
            os.fsync(handle)
        Path(name).replace(folder / library.name)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _load(function: ca.Function, library: Path) -> ca.Function:
    """Return a library as a function, once it is seen to do what ``function`` does."""
    try:
        if library.name.split(".")[1] != _digest(library):
            raise NotCompiledError(f"{library} was changed")
        external = ca.external(function.name(), str(library))
        if _signature(external) != _signature(function):
            raise NotCompiledError(f"{library} has other inputs or outputs")
        expected, found = _trial(function), _trial(external)
    except (OSError, RuntimeError) as error:
        reason = one_line(str(error).rpartition(f"Error code: {library}: ")[2])
        raise NotCompiledError(f"the library cannot be loaded: {reason}") from error
    if not np.allclose(found, expected, rtol=AGREEMENT, atol=AGREEMENT, equal_nan=True):
        raise NotCompiledError("the compiled code gives other numbers than the interpreted")
    return external


def _signature(function: ca.Function) -> tuple[Any, ...]:
    inputs = [function.sparsity_in(i).serialize() for i in range(function.n_in())]
    outputs = [function.sparsity_out(i).serialize() for i in range(function.n_out())]
    return function.name_in(), function.name_out(), inputs, outputs


def _trial(function: ca.Function) -> Vector:
    """Return all outputs at a random point, and where nothing is a number."""
    rng = np.random.default_rng(0)
    patterns = [function.sparsity_in(i) for i in range(function.n_in())]
    random = [ca.DM(pattern, rng.uniform(0.1, 1, pattern.nnz())) for pattern in patterns]
    missing = [ca.DM(pattern, np.full(pattern.nnz(), np.nan)) for pattern in patterns]
    outputs = [*function.call(random), *function.call(missing)]
    return np.concatenate([np.zeros(0), *(output.nonzeros() for output in outputs)])


def _digest(library: Path) -> str:
    return sha256(library.read_bytes()).hexdigest()
