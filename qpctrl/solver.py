"""QP solvers behind one interface; the only module that knows proxsuite and qpsolvers.

``min ½ xᵀHx + gᵀx  s.t.  A x = b,  lb ≤ C x ≤ ub``, with Lagrangian
``… + yᵀ(A x − b) + zᵀ(C x)``: z > 0 presses on an upper bound, z < 0 on a lower one.
"""

import functools
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import proxsuite
import qpsolvers
from scipy.sparse import csc_matrix

from qpctrl.arrays import Matrix, Vector
from qpctrl.errors import unknown_name
from qpctrl.limit import UNBOUNDED

dense = proxsuite.proxqp.dense
SOLVED = proxsuite.proxqp.PROXQP_SOLVED
WARM_START = proxsuite.proxqp.WARM_START_WITH_PREVIOUS_RESULT

EPS = 1e-11
"""Absolute accuracy asked of proxsuite; its default (1e-5) is wrong by up to 1e-3 in torque."""

EPS_RELATIVE = 1e-13
"""Accuracy relative to the data, for QPs too large in number for the absolute one."""

DUALITY_GAP = 1e-9
"""Largest duality gap of proxsuite's answer [N²/kg]; without it an answer from before counts
as solved as long as it is inside the new bounds."""

MAX_ITERATIONS = 20
"""Iterations of proxsuite before it gives up, within half a millisecond; wiping needs 2 to 14."""


class QpData(NamedTuple):
    """One QP as arrays; rows bounded by ±1e20 are unbounded."""

    H: Matrix
    g: Vector
    A: Matrix
    b: Vector
    C: Matrix
    lb: Vector
    ub: Vector


class Solution(NamedTuple):
    """Primal and dual point of a QP."""

    x: Vector
    y: Vector
    z: Vector
    feasible: bool = True
    """False where the solver found that there is no solution."""


@runtime_checkable
class Solver(Protocol):
    """A solver for QPs of one size, called once a tick."""

    def solve(self, qp: QpData) -> Solution:
        """Return the solver's answer; accuracy is judged by the caller."""

    def reset(self) -> None:
        """Forget what earlier calls left behind: the next answer is that of a new solver."""


class ActiveSet:
    """daqp's dual active-set method, for ticks whose minimiser without inequalities violates one.

    The tick itself sees to the others. In a compiled one ``native/qp.c`` does both.
    Source: Goldfarb1983; Arnstrom2022.
    """

    def __init__(self) -> None:
        self._daqp = QpSolvers("daqp")

    def solve(self, qp: QpData) -> Solution:
        """Return the solution."""
        return self._daqp.solve(qp)

    def reset(self) -> None:
        """Forget nothing: every call starts afresh."""


class ProxSuite:
    """ProxQP on one object: initialised once, then updated and warm-started.

    A QP that it cannot finish in `MAX_ITERATIONS` goes to daqp, whose active-set method settles
    in bounded time whether there is a solution at all.
    Source: Bambade2022; Arnstrom2022.
    """

    def __init__(self) -> None:
        self._qp: Any = None
        self._results: Any = None
        self._point: tuple[Any, Any, Any] = (None, None, None)
        self._last_resort = QpSolvers("daqp")

    def solve(self, qp: QpData) -> Solution:
        """Return the solution, started from the last one."""
        if self._qp is None:
            self._start(qp)
        else:
            self._qp.update(*qp)
        self._qp.solve()
        if self._results.info.status != SOLVED:
            self._qp = None
            return self._last_resort.solve(qp)
        x, y, z = self._point
        return Solution(x.copy(), y.copy(), z.copy())

    def reset(self) -> None:
        """Forget the last solution: the next QP is started afresh."""
        self._qp = None

    def _start(self, qp: QpData) -> None:
        self._qp = solver = dense.QP(len(qp.g), len(qp.b), len(qp.lb))
        solver.settings.eps_abs = EPS
        solver.settings.eps_rel = EPS_RELATIVE
        solver.settings.check_duality_gap = True  # or a limit that is widened goes unnoticed
        solver.settings.eps_duality_gap_abs = DUALITY_GAP
        solver.settings.max_iter = MAX_ITERATIONS
        solver.settings.max_iter_in = MAX_ITERATIONS
        solver.settings.initial_guess = WARM_START
        solver.settings.compute_timings = False
        solver.init(*qp)
        self._results = solver.results
        self._point = self._results.x, self._results.y, self._results.z  # views


class QpSolvers:
    """Any installed back-end of qpsolvers, by its name there."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._sparse = name not in qpsolvers.dense_solvers

    def solve(self, qp: QpData) -> Solution:
        """Return the back-end's solution."""
        fixed = qp.lb == qp.ub  # as two inequalities they would depend on each other
        upper, lower = (qp.ub < UNBOUNDED) & ~fixed, (qp.lb > -UNBOUNDED) & ~fixed
        G = np.vstack([qp.C[upper], -qp.C[lower]])
        h = np.concatenate([qp.ub[upper], -qp.lb[lower]])
        A, b = np.vstack([qp.A, qp.C[fixed]]), np.concatenate([qp.b, qp.ub[fixed]])
        H, G, A = (csc_matrix(m) if self._sparse else m for m in (qp.H, G, A))
        rows = (A, b) if len(b) else (None, None)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what they say is in the outcome
                found = qpsolvers.solve_problem(qpsolvers.Problem(H, qp.g, G, h, *rows), self._name)
        except (qpsolvers.exceptions.QPError, ValueError):
            return _nothing(qp)
        if found.x is None or not found.found:
            return _nothing(qp)
        z = np.zeros(len(qp.lb))
        dual = np.zeros(len(h)) if found.z is None else np.asarray(found.z)
        z[upper] += dual[: upper.sum()]
        z[lower] -= dual[upper.sum() :]
        y = np.zeros(len(b)) if found.y is None else np.asarray(found.y)
        z[fixed] = y[len(qp.b) :]
        return Solution(np.asarray(found.x), y[: len(qp.b)], z)

    def reset(self) -> None:
        """Forget nothing: every call starts afresh."""


def _nothing(qp: QpData) -> Solution:
    nan = np.full(len(qp.g), np.nan)
    return Solution(nan, np.full(len(qp.b), np.nan), np.full(len(qp.lb), np.nan), feasible=False)


NEED_STRICT_CONVEXITY = frozenset({"quadprog"})
"""Back-ends that cannot solve the full form, whose Hessian has a zero block for τ."""


@functools.cache
def solver_names() -> tuple[str, ...]:
    """Return the names that `make_solver` accepts on this machine."""
    return (
        "active-set",
        "proxsuite",
        *(name for name in qpsolvers.available_solvers if name != "proxqp"),
    )


def make_solver(name: str) -> Solver:
    """Return a solver by name, one of `solver_names`.

    Raises:
        InputError: no such solver here.
    """
    if name not in solver_names():
        raise unknown_name("solver", name, solver_names())
    backends: dict[str, Callable[[], Solver]] = {"active-set": ActiveSet, "proxsuite": ProxSuite}
    return backends.get(name, functools.partial(QpSolvers, name))()
