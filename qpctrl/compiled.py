"""CasADi functions as machine code: the same numbers, once the library is seen to give them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, get_args

import casadi as ca
import numpy as np

from qpctrl.arrays import Vector
from qpctrl.compiler import NotCompiledError, generate, one_line
from qpctrl.errors import InputError, unknown_name
from qpctrl.library import recalled_or_built

CompileMode = Literal["auto", "yes", "no"]
"""``auto``: interpret what cannot be compiled; ``yes``: that is an error; ``no``: interpret."""

AGREEMENT = 1e-6
"""Largest difference, relative or absolute, at the points where a library is tried. The same
operations give the same bits; another libm may round otherwise, and Λ amplifies that."""

T = TypeVar("T")


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
        cache: folder of kept libraries, as in `qpctrl.library`.

    Raises:
        InputError: ``compile="yes"`` and it cannot be done, or an unknown ``compile``.
    """

    def load(library: Path) -> ca.Function:
        return load_function(function, library)

    made, note = compile_or_not(
        function.name(), lambda: recalled_or_built(generate([function]), load, cache), compile
    )
    return Compiled(made or function, made is not None, note)


def compile_or_not(
    name: str, build: Callable[[], tuple[T, str]], compile: CompileMode
) -> tuple[T | None, str]:
    """Return what ``build`` returns and its note; or none, and why ``name`` is interpreted.

    Raises:
        InputError: ``compile="yes"`` and it cannot be done, or an unknown ``compile``.
    """
    if compile not in get_args(CompileMode):
        raise unknown_name("compile", compile, get_args(CompileMode))
    if compile == "no":
        return None, "interpreted, as asked for"
    try:
        return build()
    except (NotCompiledError, OSError) as error:
        reason = one_line(error)
        if compile == "yes":
            raise InputError(
                f"{name!r} cannot be compiled: {reason}; set $CC to a C compiler "
                "that works, or allow compile='auto'"
            ) from error
        return None, f"interpreted: {reason}"


def load_function(function: ca.Function, library: Path) -> ca.Function:
    """Return the function of that name in a library, once it is seen to do what this one does.

    Raises:
        NotCompiledError: it does not.
    """
    external = ca.external(function.name(), str(library))
    if _signature(external) != _signature(function):
        raise NotCompiledError(f"{library} has other inputs or outputs")
    expected, found = _trial(function), _trial(external)
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
