"""Shared libraries made from C code: compiled once, kept on disk, found again by their content.

A kept library is a file ``KEY.DIGEST.so``. KEY is the hash of all it was made from, DIGEST the
SHA-256 of its bytes: it appears in one step, and one that was changed gives itself away.
"""

import contextlib
import errno
import os
import stat
import tempfile
import time
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

from qpctrl.compiler import NotCompiledError, find_compiler, one_line

Loaded = TypeVar("Loaded")
Load = Callable[[Path], Loaded]
"""Loads a library and tries it; NotCompiledError where it cannot be trusted."""


def recalled_or_built(
    source: str, load: Load[Loaded], cache: Path | None, options: tuple[str, ...] = ()
) -> tuple[Loaded, str]:
    """Return the loaded library of ``source``, and in one line how it came about.

    Args:
        source: C code.
        load: loads the library; a kept one that it refuses is removed and built anew.
        cache: folder of kept libraries; by default ``$QPCTRL_CACHE``, else
            ``$XDG_CACHE_HOME/qpctrl``, else ``~/.cache/qpctrl``. Its libraries are run: where
            it cannot be used, or anyone may write to it, nothing is kept.
        options: flags of the compiler beside its own.

    Raises:
        NotCompiledError: there is no compiler that works, or its library cannot be trusted.
        OSError: there is no place to compile in.
    """
    started, compiler = time.perf_counter(), find_compiler()
    compiler = compiler._replace(flags=(*compiler.flags, *options))
    key, by = compiler.key(source), f"compiled by {compiler.identity}"
    folder, refused = None, ""
    try:
        folder = _cache_folder(cache)
        if found := _recall(load, folder, key):
            return found[0], f"{by}, kept in {folder}"
    except OSError as error:
        folder, refused = None, one_line(error)
    with tempfile.TemporaryDirectory(prefix="qpctrl-", ignore_cleanup_errors=True) as private:
        library = compiler.build(source, Path(private))
        library = library.rename(library.with_name(f"{key}.{_digest(library)}.so"))
        by += f" in {time.perf_counter() - started:.1f} s"
        try:
            if folder:
                _keep(library, folder)
                if found := _recall(load, folder, key):
                    return found[0], f"{by}, kept in {folder}"
                refused = f"{folder}: libraries cannot be loaded from there"
        except OSError as error:
            refused = one_line(error)
        return _load(load, library), f"{by}, not kept: {refused}"  # stays when its file goes


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


def _recall(load: Load[Loaded], folder: Path, key: str) -> tuple[Loaded] | None:
    """Return the kept library that can be trusted; remove those that cannot."""
    for library in sorted(folder.glob(f"{key}.*.so")):
        try:
            return (_load(load, library),)
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


def _load(load: Load[Loaded], library: Path) -> Loaded:
    """Return a library, loaded, once it is seen to be what it was."""
    try:
        if library.name.split(".")[1] != _digest(library):
            raise NotCompiledError(f"{library} was changed")
        return load(library)
    except (AttributeError, OSError, RuntimeError) as error:  # the first: no such symbol
        reason = one_line(str(error).rpartition(f"Error code: {library}: ")[2])
        raise NotCompiledError(f"the library cannot be loaded: {reason}") from error


def _digest(library: Path) -> str:
    return sha256(library.read_bytes()).hexdigest()
