"""One mode, ready to run: buffers, tick function, solver and certificate."""

import math
from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from qpctrl import certificate
from qpctrl.arrays import Array, Vector
from qpctrl.compiled import CompileMode, compiled
from qpctrl.errors import InputError, unknown_name
from qpctrl.evaluator import Evaluator
from qpctrl.limit import torque_speed
from qpctrl.mode import Mode
from qpctrl.objective import Reference
from qpctrl.polish import Polish, active_set
from qpctrl.rank import dependent_rows
from qpctrl.report import ActiveLimit, TickReport, Yield
from qpctrl.robot import Robot
from qpctrl.solver import QpData, Solution, Solver
from qpctrl.status import Status
from qpctrl.tick import MATRICES, SINGULAR_MOBILITY, build_tick

ACTIVE_DUAL = 1e-8
"""A row counts as active when its dual is larger than this."""

SAME_TORQUE = 1e-6
"""Distance [Nm] within which a torque is said to be on a limit."""

WELL_POLISHED = 1e-12
"""KKT residual below which a polished solution is taken as it is."""

SINGULAR_DAMPING = 0.05
"""Damping μ at the singularity itself [1/kg, 1/(kg m²)]."""


@runtime_checkable
class TaskMemory(Protocol):
    """The part of the controller's memory that a tick reads."""

    @property
    def x(self) -> Vector:
        """Packed memory of the tasks."""

    @property
    def tau(self) -> Vector:
        """Torque sent last (nu) [Nm]."""

    @property
    def freeze(self) -> bool:
        """Whether integrators hold."""


class Engine:
    """The tick of one mode on preallocated buffers.

    Attributes:
        tick: the function and its names.
        terms: its outputs by name; overwritten every tick.
        qp: the QP among those outputs.
        inputs: its named inputs as writable views; gains and limits may be changed between
            ticks.
    """

    def __init__(
        self,
        robot: Robot,
        mode: Mode,
        *,
        form: str,
        solver: Solver,
        dt: float,
        tolerance: float,
        compile: CompileMode,
    ) -> None:
        self.tick = build_tick(robot, mode, form)
        self._robot, self._solver, self._tolerance = robot, solver, tolerance
        function = compiled(self.tick.function, compile=compile).function
        self._evaluate = Evaluator(function, matrices=MATRICES)
        self.terms = self._evaluate.outputs
        sizes = (len(self.terms["g"]), len(self.terms["b"]), len(self.terms["lb"]))
        self._polish = Polish(*sizes)
        self._point = np.zeros(sum(sizes))
        x, y, z = np.split(self._point, np.cumsum(sizes[:2]))
        check = compiled(certificate.build_certificate(self.tick), compile=compile).function
        self._certify = Evaluator(check, {**self.terms, "x": x, "y": y, "z": z})
        self._u = self._evaluate.inputs["u"]
        self.inputs = self.tick.inputs.views(self._u)
        self._dt = dt
        self.reset()
        self.qp = QpData(*(self.terms[name] for name in QpData._fields))
        self._torque_rows = self.terms["C"][: robot.nu]
        self._k = self.tick.mode_rows

    def reset(self) -> None:
        """Forget references, changed inputs and the solver's warm start."""
        self._u[:] = self.tick.inputs.vector()
        self.inputs["dt"][...] = self._dt
        self._solver.reset()

    def demand(self, references: Mapping[str, Reference]) -> None:
        """Refuse to enter the mode without the references that have no safe default.

        Raises:
            InputError: a motion task has no reference.
        """
        for task, _ in self.tick.mode.tasks:
            if task.needs_reference and task.name not in references:
                raise InputError(
                    f"mode {self.tick.mode.name!r} is entered without a reference for task "
                    f"{task.name!r}"
                )

    def load(
        self, q: Vector, v: Vector, references: Mapping[str, Reference], memory: TaskMemory
    ) -> None:
        """Write state, references and memory into the buffers.

        Raises:
            InputError: unknown task or input, or an array of the wrong shape.
        """
        state = self._evaluate.inputs
        _put(state, "q", q)
        _put(state, "v", v)
        state["x"][:] = memory.x
        self.inputs["limits.tau_last"][:] = memory.tau
        self.inputs["freeze"][...] = memory.freeze
        self.inputs["mu"][...] = 0.0
        for task, reference in references.items():
            for key, value in reference.arrays().items():
                _put(self.inputs, f"{task}.{key}", value)

    def solve(self, time: float) -> TickReport:
        """Return the report of the tick that was loaded."""
        if not math.isfinite(float(self._u @ self._u)):
            return self.refuse(time, Status.NOT_FINITE)
        self._evaluate()
        damping = self._damp()
        if self.terms["dependent"][0]:
            names = dependent_rows(self.tick, self.terms["row_pivots"])
            return self.refuse(time, Status.DEPENDENT_ROWS, names)
        rough = self._solver.solve(self.qp)
        if not rough.feasible:
            return self.refuse(time, Status.INFEASIBLE)
        solution, kkt = self._polished(rough)
        if not kkt <= self._tolerance:
            return self.refuse(time, Status.INACCURATE)
        return self._report(time, rough, solution, damping)

    def memory_after(self) -> Vector:
        """Return the tasks' memory after the tick that was solved."""
        return self.terms["memory"].copy()

    def refuse(self, time: float, status: Status, rows: tuple[str, ...] = ()) -> TickReport:
        """Return the report of a tick without a solution."""
        nan = np.full(self._robot.nu, np.nan)
        return TickReport(
            time=time,
            mode=self.tick.mode.name,
            status=status,
            tau_qp=nan,
            tau_hybrid=nan,
            tau_textbook=nan,
            lam=np.full(self._k, np.nan),
            kkt=np.full(4, np.nan),
            law_gap=math.nan,
            tau_solver=nan,
            textbook_gap=math.nan,
            unexplained_gap=math.nan,
            curvature=math.nan,
            active=(),
            yields=(),
            damping=float(self.inputs["mu"]),
            dependent_rows=rows,
            signals=np.full(self.terms["signals"].shape, np.nan),
        )

    def _damp(self) -> float:
        """Evaluate again with a damped Λ⁻¹ where its smallest pivot is too small."""
        if not self.terms["singular"][0]:
            return 0.0
        smallest = float(self.terms["mobility_left"].min())
        share = smallest / SINGULAR_MOBILITY if smallest > 0 else 0.0  # NaN where Λ is
        closeness = 1.0 - share
        damping = max(SINGULAR_DAMPING * closeness**2, SINGULAR_DAMPING * 1e-6)
        self.inputs["mu"][...] = damping
        self._evaluate()
        return damping

    def _polished(self, rough: Solution) -> tuple[Solution, float]:
        """Return the polished solution and its residual; the solver's own if that is better."""
        if not rough.z.dot(rough.z) or not np.any(active_set(self.qp, rough)):
            none = np.zeros(len(rough.z))
            polished = Solution(self.terms["x_eq"].copy(), self.terms["y_eq"], none)
            if (kkt := self._residual(polished)) <= WELL_POLISHED:
                return polished, kkt
        polished = self._polish.on_active_set(self.qp, rough)
        if (kkt := self._residual(polished)) <= WELL_POLISHED:
            return polished, kkt
        if (rough_kkt := self._residual(rough)) <= kkt:
            return rough, rough_kkt
        return polished, self._residual(polished)

    def _residual(self, solution: Solution) -> float:
        """Return the KKT residual of a point, which the certificate then refers to."""
        inputs, out = self._certify.inputs, self._certify.outputs
        inputs["x"][:], inputs["y"][:], inputs["z"][:] = solution[:3]
        self._certify()
        if not math.isfinite(self._point.dot(self._point) + out["tau"].dot(out["tau"])):
            return math.inf  # the maximum in the certificate passes over NaN
        return max(out["kkt"].tolist())

    def _report(
        self, time: float, rough: Solution, solution: Solution, damping: float
    ) -> TickReport:
        out, terms = self._certify.outputs, self.terms
        gaps = out["gaps"].tolist()
        if not self.tick.has_law:
            gaps[1:] = [math.nan] * 3
        z = solution.z
        active = np.flatnonzero(np.abs(z) > ACTIVE_DUAL) if z.dot(z) else ()
        return TickReport(
            time=time,
            mode=self.tick.mode.name,
            status=Status.OK,
            tau_qp=out["tau"].copy(),
            tau_hybrid=terms["tau_hybrid"].copy(),
            tau_textbook=terms["tau_textbook"].copy(),
            lam=solution.x[len(solution.x) - self._k :],
            kkt=out["kkt"].copy(),
            law_gap=gaps[0],
            tau_solver=self._torque_rows @ rough.x + terms["t"],
            textbook_gap=gaps[1],
            unexplained_gap=gaps[2],
            curvature=gaps[3],
            active=tuple(self._active(int(i), float(z[i])) for i in active),
            yields=self._yields(solution.x) if len(active) else (),
            damping=damping,
            dependent_rows=(),
            signals=terms["signals"].copy(),
        )

    def _active(self, row: int, dual: float) -> ActiveLimit:
        kind, _, owner = self.tick.rows.inequality[row].partition(" ")
        u, nu = self.inputs, self._robot.nu
        if kind == "torque":
            kind = self._torque_limit(row, 1.0 if dual > 0 else -1.0)
        elif kind == "acceleration":
            i = row - nu
            r_v, v = u["limits.rates"][1], self._evaluate.inputs["v"][i]
            bound = self.terms["ub" if dual > 0 else "lb"][row]
            by_speed = r_v * (np.copysign(u["limits.v_max"][i], dual) - v)
            kind = "velocity" if abs(bound - by_speed) < 1e-9 * (1 + abs(bound)) else "position"
        return ActiveLimit(f"{kind} {owner}", dual)

    def _torque_limit(self, row: int, side: float) -> str:
        """Return what bounds the torque of actuator ``row`` from above (1) or below (−1)."""
        u, tau = self.inputs, self._certify.outputs["tau"]
        if side * tau[row] > u["limits.tau_max"][row] - SAME_TORQUE:
            return "torque"
        v_a = self._robot.B.T @ self._evaluate.inputs["v"]
        line = torque_speed(side, u["limits.tau_stall"], u["limits.tau_droop"], v_a)
        on_line = side * tau[row] > side * line[row] - SAME_TORQUE  # or beyond it, at ∓tau_max
        return "torque-speed" if on_line else "torque rate"

    def _yields(self, x: Vector) -> tuple[Yield, ...]:
        give = self.terms["G"] @ (x - self.terms["x_law"])
        return tuple(
            Yield(measure.task, give[measure.rows].copy(), measure.axes, measure.units)
            for measure in self.tick.gives
        )


def _put(inputs: Mapping[str, Array], name: str, value: ArrayLike) -> None:
    place = inputs.get(name)
    if place is None:
        raise unknown_name("task input", name, inputs)
    shape = value.shape if isinstance(value, np.ndarray) else np.shape(value)
    if shape != place.shape:
        raise InputError(f"{name}: got shape {shape}, need {place.shape}")
    place[...] = value
