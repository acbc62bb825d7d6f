"""The way into a compiled tick that is written in C too: from Python's objects to Python's objects.

It needs the headers of Python and numpy when it is compiled; without them `Engine` does the same,
in 3 µs more.
"""

import ctypes
import functools
import platform
import struct
import sysconfig
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from qpctrl.arrays import Array
from qpctrl.compiler import NotCompiledError, one_line
from qpctrl.errors import InputError
from qpctrl.library import recalled_or_built
from qpctrl.memory import Measurement, Memory
from qpctrl.native_tick import NativeTick
from qpctrl.objective import Reference
from qpctrl.parts import TickParts
from qpctrl.report import Command, ReportFormat, TickReport
from qpctrl.status import Status

QuickStep = Callable[
    [Measurement, Mapping[str, Reference], Memory], tuple[Command, TickReport, Memory] | int
]
"""Runs a tick; a number where it has no solution, where it is the first one in its mode, or where
what was given is not plain arrays of the right shape: then Python shall look at it."""

UNTRIED = -1
"""The number of a tick that was not tried."""

PLACE = struct.Struct("@Pinn")
"""``place`` of native/python.c: address, dimensions, rows, columns."""


def quick_step(
    native: NativeTick, parts: TickParts, format: ReportFormat, sizes: tuple[int, int, int]
) -> tuple[QuickStep | None, str]:
    """Return the way into a tick; none where it cannot be compiled, and why.

    Args:
        native: the tick.
        parts: its buffers.
        format: of its reports.
        sizes: of what its memory holds.
    """
    library, why = _library()
    if library is None:
        return None, why
    places: dict[str, dict[str, bytes]] = {}
    for name, array in parts.u.items():
        task, dot, own = name.partition(".")
        if dot:
            places.setdefault(task, {})[own] = _place(array)
    given = (
        *(native.owner, places, format.mode, format, sizes),
        *(Status.OK, Command, TickReport, Memory),
        *(parts.numbers.ctypes.data, len(parts.numbers), len(parts.last)),
        format.layout.place("lam").stop > format.layout.place("lam").start,
    )
    step: QuickStep = library.qpctrl_bind(*native.addresses, given)
    return step, ""


def dispatch(quick: Mapping[str, QuickStep], slow: Callable[..., object]) -> Callable[..., Any]:
    """Return ``step(mode, measurement, references, memory)`` of a controller, in C.

    Args:
        quick: what `quick_step` returns, by mode.
        slow: takes the same after the code of what the tick came to, −1 where it was not tried.
    """
    library, why = _library()
    if library is None:
        raise InputError(why)
    made: Callable[..., Any] = library.qpctrl_dispatch((dict(quick), slow))
    return made


def _place(array: Array) -> bytes:
    rows, columns = (*array.shape, 1, 1)[:2]
    return PLACE.pack(array.ctypes.data, array.ndim, rows, columns)


@functools.cache
def _library() -> tuple[ctypes.PyDLL | None, str]:
    """Return the library, which serves every tick of the process; or none, and why."""
    native = files("qpctrl") / "native"
    tick, python = ((native / name).read_text("utf-8") for name in ("tick.h", "python.c"))
    source = tick + python.replace('#include "tick.h"', "")
    headers = (sysconfig.get_path("include"), np.get_include())
    options = (
        *(f"-I{folder}" for folder in headers),
        f"-DMADE_FOR={platform.python_version()}-numpy-{np.__version__}",
    )
    try:
        return recalled_or_built(source, _load, None, options)
    except (NotCompiledError, OSError) as error:
        return None, one_line(error)


def _load(library: Path) -> ctypes.PyDLL:
    loaded = ctypes.PyDLL(str(library))
    loaded.qpctrl_bind.restype = loaded.qpctrl_dispatch.restype = ctypes.py_object
    loaded.qpctrl_dispatch.argtypes = (ctypes.py_object,)
    loaded.qpctrl_bind.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.py_object)
    return loaded
