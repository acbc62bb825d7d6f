"""A tick as machine code: generated functions, active set and order of steps in one C call."""

import ctypes
from collections.abc import Callable, Mapping
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args

import casadi as ca
import numpy as np

from qpctrl.arrays import Array
from qpctrl.compiled import CompileMode, compile_or_not, load_function
from qpctrl.compiler import generate
from qpctrl.evaluator import Evaluator
from qpctrl.law import Law
from qpctrl.library import recalled_or_built
from qpctrl.parts import TickParts
from qpctrl.report import ACTIVE_DUAL

SOURCES = ("qp.h", "tick.h", "linear.h", "qp.c", "tick.c")
"""Files of the folder ``native``, in the order in which they make one text."""

_INT, _DOUBLE, _POINTER = ctypes.c_int, ctypes.c_double, ctypes.c_void_p
_LONG = ctypes.c_longlong


class _Call(ctypes.Structure):
    """``qpctrl_call``."""

    _fields_ = tuple((name, _POINTER) for name in ("code", "arg", "res", "iw", "w"))


_SIZES = ("nq", "nv", "nu", "n", "m", "r", "k", "n_u", "n_x", "law", "searched")
_CALLS = ("tick", "certificate", "explanation", "fallback", "limited")
_ARRAYS = (
    *("clock", "q", "v", "last", "u", "u_mu", "u_freeze", "u_tau_last"),
    *("H", "g", "A", "b", "C", "lb", "ub", "t", "x_eq", "y_eq", "damping_wanted", "dependent"),
    *("point_x", "point_y", "point_z", "rough"),
    *("tau", "tau_qp", "tau_solver", "tau_hybrid", "tau_textbook", "time", "q_out"),
    *("lam", "kkt", "z", "damping", "fallback_q", "fallback_v", "limited_tau", "limited_v"),
    *("work", "iwork"),
)

_QP = (
    *("H", "g", "A", "b", "C", "lb", "ub", "x_eq", "y_eq"),
    *("point_x", "point_y", "point_z", "rough", "work", "iwork"),
)
"""Arguments of ``qpctrl_qp`` after its sizes."""


class _Tick(ctypes.Structure):
    """``qpctrl_tick``."""

    _fields_ = (
        *((name, _INT) for name in _SIZES),
        ("tolerance", _DOUBLE),
        ("active_dual", _DOUBLE),
        *((name, _Call) for name in _CALLS),
        *((name, _POINTER) for name in _ARRAYS),
    )


class NativeTick:
    """Runs a tick in C, on the buffers of its parts."""

    def __init__(self, parts: TickParts, law: Law, tolerance: float, library: ctypes.PyDLL) -> None:
        self._kept: list[object] = [parts, library]  # what C holds pointers to
        sizes = (len(values) for values in parts.point)
        n, m, r = sizes
        work = np.zeros(max(library.qpctrl_qp_work(n, m, r), 1))
        iwork = np.zeros(max(library.qpctrl_qp_iwork(n, m, r), 1), dtype=np.intc)
        given = {
            **{name: len(parts.inputs[name[1]]) for name in ("nq", "nv")},
            "nu": len(parts.named["tau"]),
            **{"n": n, "m": m, "r": r, "k": len(parts.named["lam"])},
            "n_u": len(parts.inputs["u"]),
            "n_x": len(parts.inputs["x"]),
            **{"law": get_args(Law).index(law), "searched": int(parts.searched)},
            **{"tolerance": tolerance, "active_dual": ACTIVE_DUAL},
            **{name: self._call(library, name, getattr(parts, name)) for name in _CALLS},
            **{name: _address(array) for name, array in tick_arrays(parts).items()},
            **{"work": _address(work), "iwork": _address(iwork)},
        }
        given["rough"] = _address(rough := np.zeros(n))
        self._kept += [work, iwork, rough]
        tick = _Tick(**given)
        self._library, self._tick = library, tick
        self._kept.append(tick)
        self.owner: object = self._kept
        pointer = ctypes.addressof(tick)
        library.qpctrl_solve.argtypes = library.qpctrl_hold.argtypes = (_POINTER,)
        self.solve = partial(library.qpctrl_solve, pointer)
        self._hold = partial(library.qpctrl_hold, pointer)

    def hold(self) -> bool:
        """Write the fallback torque; return whether the measured configuration is believed."""
        return bool(self._hold())

    @property
    def addresses(self) -> tuple[int, int]:
        """Return where the tick and the function that solves it are in memory."""
        solve = ctypes.cast(self._library.qpctrl_solve, _POINTER).value
        return ctypes.addressof(self._tick), solve or 0

    def calls(self) -> dict[str, Callable[[], object]]:
        """Return the parts of a tick as calls; ``call`` is all of them, ``nothing`` none.

        They work on memory of this object, which must live longer.
        """
        library, tick = self._library, self._tick
        generated = ctypes.PYFUNCTYPE(_INT, *(_POINTER,) * 4, _INT)
        qp = ctypes.PYFUNCTYPE(_INT, *(_INT,) * 3, *(_POINTER,) * len(_QP), _INT)
        work = ctypes.PYFUNCTYPE(_INT, *(_INT,) * 3)

        def one(name: str) -> Callable[[], object]:
            call = getattr(tick, name)
            function = generated((name, library))
            return partial(function, call.arg, call.res, call.iw, call.w, 0)

        sizes = tick.n, tick.m, tick.r
        places = (getattr(tick, name) for name in _QP)
        return {
            "call": self.solve,
            "graph": one("tick"),
            "QP": partial(qp(("qpctrl_qp", library)), *sizes, *places, 0),
            "certificate": one("certificate"),
            "nothing": partial(work(("qpctrl_qp_work", library)), *sizes),
        }

    def _call(self, library: ctypes.PyDLL, name: str, function: Evaluator) -> _Call:
        sizes = [_LONG() for _ in range(4)]
        getattr(library, f"{name}_work")(*(ctypes.byref(size) for size in sizes))
        n_arg, n_res, n_iw, n_w = (max(size.value, 1) for size in sizes)
        arg, res = (_POINTER * n_arg)(), (_POINTER * n_res)()
        arg[: len(function.inputs)] = [_address(array) for array in function.inputs.values()]
        res[: len(function.outputs)] = [_address(array) for array in function.outputs.values()]
        iw, w = (_LONG * n_iw)(), (_DOUBLE * n_w)()
        self._kept += [arg, res, iw, w]
        code = ctypes.cast(getattr(library, name), _POINTER).value
        return _Call(code, *(ctypes.addressof(part) for part in (arg, res, iw, w)))


def tick_arrays(parts: TickParts) -> Mapping[str, Array]:
    """Return the arrays of ``qpctrl_tick`` by name, as far as the parts own them."""
    x, y, z = parts.point
    torques = ("tau", "tau_qp", "tau_solver", "tau_hybrid", "tau_textbook")
    numbers = (*torques, "lam", "kkt", "z", "time")
    held, limited = parts.fallback.inputs, parts.limited.inputs
    return {
        **{name: parts.inputs[name] for name in "qvu"},
        **{"clock": parts.clock, "last": parts.last, "u_mu": parts.u["mu"]},
        **{"u_freeze": parts.u["freeze"], "u_tau_last": parts.u["limits.tau_last"]},
        **{name: parts.terms[name] for name in (*parts.qp._fields, "t", "x_eq", "y_eq")},
        **{"damping_wanted": parts.terms["damping"], "dependent": parts.terms["dependent"]},
        **{"point_x": x, "point_y": y, "point_z": z},
        **{name: parts.named[name] for name in numbers},
        **{"q_out": parts.named["q"], "damping": parts.named["damping"]},
        **{"fallback_q": held["q"], "fallback_v": held["v"]},
        **{"limited_tau": limited["tau"], "limited_v": limited["v"]},
    }


def native_source(functions: Mapping[str, ca.Function]) -> str:
    """Return the C code of a tick: the generated functions and the files of ``native``.

    Raises:
        NotCompiledError: CasADi cannot write a function as C.
    """
    folder = files("qpctrl") / "native"
    texts = [(folder / name).read_text(encoding="utf-8") for name in SOURCES]
    own = (line for text in texts for line in text.splitlines() if '#include "' not in line)
    return generate(list(functions.values())) + "\n".join(own) + "\n"


def native_library(
    functions: Mapping[str, ca.Function], compile: CompileMode, cache: Path | None = None
) -> tuple[ctypes.PyDLL | None, str]:
    """Return the library of a tick and how it came about; none where it is interpreted.

    Raises:
        InputError: ``compile="yes"`` and it cannot be done, or an unknown ``compile``.
    """

    def load(library: Path) -> ctypes.PyDLL:
        for function in functions.values():
            load_function(function, library)
        return ctypes.PyDLL(str(library))  # holds the interpreter's lock: it is never long

    def build() -> tuple[Any, str]:
        return recalled_or_built(native_source(functions), load, cache)

    return compile_or_not("tick", build, compile)


def _address(array: np.ndarray) -> int:
    return int(array.ctypes.data)
