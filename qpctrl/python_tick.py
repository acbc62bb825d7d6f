"""A tick in Python, with any solver: the order of steps that native/tick.c has in C."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from qpctrl.arrays import Vector
from qpctrl.law import Law
from qpctrl.parts import TickParts
from qpctrl.polish import Polish, active_set
from qpctrl.priority import Level, Priorities
from qpctrl.ranked_tick import RankedTick
from qpctrl.report import ACTIVE_DUAL
from qpctrl.solver import ActiveSet, QpData, Solution, Solver
from qpctrl.status import BY_CODE, LIMITED, Status

WELL_POLISHED = 1e-12
"""KKT residual below which a polished solution is taken as it is."""

SOLVED = 0
INACCURATE, INFEASIBLE, NOT_FINITE, STALE, DEPENDENT_ROWS = (
    BY_CODE.index(status)
    for status in (
        *(Status.INACCURATE, Status.INFEASIBLE, Status.NOT_FINITE),
        *(Status.STALE, Status.DEPENDENT_ROWS),
    )
)


class PythonTick:
    """Runs a tick step by step."""

    def __init__(self, parts: TickParts, solver: Solver, law: Law, tolerance: float) -> None:
        self._parts, self._solver, self._law, self._tolerance = parts, solver, law, tolerance
        self._polish = Polish(*(len(values) for values in parts.point))
        self._torque_map = parts.torque_map
        self._ranked = RankedTick(parts, solver) if parts.upper_levels else None
        self._second: Priorities | None = None
        self._starts_free = isinstance(solver, ActiveSet)
        self._is_free = False  # whether it is the minimiser without inequalities, seen at once
        self._none = np.zeros(len(parts.point[2]))

    def solve(self) -> int:
        """Solve the tick whose inputs are loaded and return its code."""
        parts, u = self._parts, self._parts.inputs["u"]
        q, v, (time, last_time, freeze) = parts.inputs["q"], parts.inputs["v"], parts.clock.tolist()
        if not math.isfinite(q.dot(q) + v.dot(v) + time):
            return NOT_FINITE
        if time <= last_time:
            return STALE
        parts.u["limits.tau_last"][:], parts.u["freeze"][...] = parts.tau_last, freeze
        if not math.isfinite(u.dot(u)):
            return NOT_FINITE
        self._evaluate()
        if parts.terms["dependent"][0]:
            return DEPENDENT_ROWS
        if self._ranked is not None:
            return self._solve_ranked(self._ranked)
        free = self._free()
        if parts.searched and not np.isfinite(free.x).all():
            return INACCURATE  # as in C, which finds no unique minimiser
        self._is_free = self._starts_free and self._residual(free) <= WELL_POLISHED
        if self._is_free:
            return self._note(free)
        rough = self._solver.solve(_convex(parts.qp) if parts.searched else parts.qp)
        if not rough.feasible and parts.searched:
            rough = self._second_opinion()
        if not rough.feasible:
            return INFEASIBLE
        if not self._polished(rough, free) <= self._tolerance:
            return INACCURATE
        return self._note(rough)

    def hold(self) -> bool:
        """Write the fallback torque, from the newest state that can be believed."""
        parts = self._parts
        q_last, (time, last, _) = parts.q_last, parts.clock.tolist()
        parts.u["limits.tau_last"][:] = parts.tau_last
        q, v = parts.inputs["q"], parts.inputs["v"]
        known = bool(time > last and math.isfinite(time) and np.isfinite(q).all())
        held = parts.fallback.inputs
        held["q"][:] = parts.named["q"][:] = q if known else q_last
        if known and np.isfinite(v).all():
            held["v"][:] = v
        elif known and len(q) == len(v):
            held["v"][:] = (q - q_last) / (time - last)  # zero after a start, whose time is −∞
        else:
            held["v"][:] = 0.0  # no damping along a velocity nobody knows
        parts.fallback()
        return known

    def calls(self) -> dict[str, Callable[[], object]]:
        """Return the parts of a tick without active limits as calls."""
        parts, solve = self._parts, partial(self._solver.solve, self._parts.qp)
        qp: dict[str, Callable[[], object]] = {} if self._starts_free else {"QP": solve}
        return {"graph": parts.tick, **qp, "certificate": parts.certificate}

    def _evaluate(self) -> None:
        """Evaluate the graph; near a singularity once more, with a damped Λ⁻¹."""
        parts = self._parts
        parts.u["mu"][...] = 0.0
        parts.tick()
        damping = parts.terms["damping"][0]
        parts.named["damping"][0] = damping
        if damping > 0:
            parts.u["mu"][...] = damping
            parts.tick()

    def _second_opinion(self) -> Solution:
        """Return what the levels' solver finds, where the first one finds no solution."""
        qp = self._parts.qp
        if self._second is None:
            n, m, r = (len(values) for values in self._parts.point)
            self._second = Priorities(n, m, r)
        return self._second.solve([Level(qp.H, qp.g, np.eye(len(qp.g)))], *qp[2:]).solution

    def _solve_ranked(self, ranked: RankedTick) -> int:
        """Solve level after level; the residual is the largest of all levels."""
        parts = self._parts
        rough, kkt, self._is_free = ranked.solve()
        self._show_law(parts.terms["x_eq"])
        if not rough.feasible:
            return INFEASIBLE
        if not max(self._residual(rough), kkt) <= self._tolerance:
            return INACCURATE
        parts.named["kkt"][0] = max(parts.named["kkt"][0], kkt)
        parts.point[2][:] = ranked.pressing  # judged; what binds is told by all levels
        return self._note(rough)

    def _free(self) -> Solution:
        """Return the minimiser without inequalities: that of the graph, or found here."""
        parts, terms = self._parts, self._parts.terms
        if not parts.searched:
            return Solution(terms["x_eq"], terms["y_eq"], self._none)
        free = self._polish.without_inequalities(parts.qp)
        terms["x_eq"][:], terms["y_eq"][:] = free.x, free.y
        self._show_law(free.x)
        return free

    def _show_law(self, x: Vector) -> None:
        """Write the torque of a comparator that was searched for."""
        T, t = self._torque_map
        self._parts.named["tau_hybrid"][:] = self._parts.named["tau_textbook"][:] = T @ x + t

    def _polished(self, rough: Solution, free: Solution) -> float:
        """Put the polished solution into the buffers, or the solver's own if that is better.

        Returns its KKT residual.
        """
        qp = self._parts.qp
        unlimited = not (rough.z.any() or np.any(active_set(qp, rough)))
        if unlimited and (kkt := self._residual(free)) <= WELL_POLISHED:
            return kkt
        polished = self._polish.on_active_set(qp, rough)
        if (kkt := self._residual(polished)) <= WELL_POLISHED:
            return kkt
        if (rough_kkt := self._residual(rough)) <= kkt:
            return rough_kkt
        return self._residual(polished)

    def _residual(self, solution: Solution) -> float:
        """Return the KKT residual of a point, which then is in the buffers."""
        parts = self._parts
        (x, y, z), out = parts.point, parts.certificate.outputs
        x[:], y[:], z[:] = solution[:3]
        parts.certificate()
        whole, tau = parts.whole_point, out["tau"]
        if not math.isfinite(whole.dot(whole) + tau.dot(tau)):
            return math.inf  # the maximum in the certificate passes over NaN
        return float(max(out["kkt"].tolist()))

    def _note(self, rough: Solution) -> int:
        """Write what the tick leaves behind and return its code."""
        parts, named = self._parts, self._parts.named
        x, _, z = parts.point
        if self._is_free:
            named["tau_solver"][:] = named["tau_qp"]
        else:
            T, t = self._torque_map
            named["tau_solver"][:] = T @ rough.x + t
        named["lam"][:] = x[len(x) - len(named["lam"]) :]
        named["z"][:] = z
        named["time"][0] = parts.clock[0]
        named["q"][:] = parts.inputs["q"]
        if self._law == "qp":
            named["tau"][:] = named["tau_qp"]
        else:
            parts.limited.inputs["tau"][:] = named[f"tau_{self._law}"]
            parts.limited.inputs["v"][:] = parts.inputs["v"]
            parts.limited()
        if not self._is_free and z.any() and np.abs(z).max() > ACTIVE_DUAL:
            parts.explanation()
            return LIMITED
        return SOLVED


def _convex(qp: QpData) -> QpData:
    """Return a QP with the same solution whose Hessian is positive definite everywhere.

    To ½ xᵀHx + gᵀx is added ½ s ‖A x − b‖², which is zero where the equalities hold.
    """
    s = np.trace(qp.H) / max(float(np.vdot(qp.A, qp.A)), 1e-12)
    return qp._replace(H=qp.H + s * (qp.A.T @ qp.A), g=qp.g - s * (qp.A.T @ qp.b))
