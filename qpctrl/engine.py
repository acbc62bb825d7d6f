"""One mode, ready to run: a tick on preallocated buffers, from measurement to report."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qpctrl.arrays import Array, Vector
from qpctrl.certificate import KKT_TOLERANCE
from qpctrl.compiled import CompileMode, compiled
from qpctrl.errors import InputError, unknown_name
from qpctrl.law import Law
from qpctrl.limit import UNBOUNDED
from qpctrl.memory import Measurement, Memory, remember
from qpctrl.native_step import QuickStep, quick_step
from qpctrl.native_tick import NativeTick, native_library
from qpctrl.objective import Reference
from qpctrl.parts import Runner, TickParts, build_functions
from qpctrl.python_tick import PythonTick
from qpctrl.rank import dependent_contacts, dependent_rows
from qpctrl.report import Command, ReportFormat, TickReport
from qpctrl.robot import Robot
from qpctrl.solver import ActiveSet, QpData, QpSolvers, Solver
from qpctrl.status import BY_CODE, LIMITED, Status
from qpctrl.tick import Tick

OK = Status.OK

new = tuple.__new__  # of a named tuple; its own constructor takes a quarter of a microsecond more


_NO_PLACES: tuple[dict[str, Any], dict[str, Array]] = ({}, {})


class Engine:
    """The tick of one mode on preallocated buffers.

    Attributes:
        tick: the graph and its names.
        parts: the functions on their buffers.
        runner: runs them.
        terms: outputs of the graph by name; overwritten every tick.
        qp: the QP among those outputs.
        inputs: its named inputs as writable views; gains and limits may be changed between
            ticks.
        quick: does what `step` does, where nothing is unusual; none where it is not compiled.
        note: one line: what compiled the tick, or why it is interpreted.
    """

    def __init__(
        self,
        robot: Robot,
        tick: Tick,
        *,
        solver: Solver,
        dt: float,
        law: Law,
        tolerance: float,
        compile: CompileMode,
    ) -> None:
        self.tick = tick
        self._solver, self._dt = solver, dt
        functions = build_functions(robot, self.tick)
        if isinstance(solver, ActiveSet) and not tick.upper_levels:
            self.parts = TickParts(robot, self.tick, functions)
            library, self.note = native_library(functions, compile)
        else:
            made = {name: compiled(f, compile=compile) for name, f in functions.items()}
            self.parts = TickParts(robot, self.tick, {name: m.function for name, m in made.items()})
            library, self.note = None, made["tick"].note
        self.runner: Runner = (
            PythonTick(self.parts, solver, law, tolerance)
            if library is None
            else NativeTick(self.parts, law, tolerance, library)
        )
        self._solve = self.runner.solve
        self._bind(robot)
        self.quick: QuickStep | None = None
        if isinstance(self.runner, NativeTick):
            self.quick, why = quick_step(self.runner, self.parts, self.format, self._sizes)
            self.note += f"; called through Python: {why}" if self.quick is None else ""
        self.reset()

    def _bind(self, robot: Robot) -> None:
        """Keep at hand what every tick needs."""
        parts, layout = self.parts, self.parts.layout
        self.terms, self.qp = parts.terms, parts.qp
        self._u = parts.inputs["u"]
        self._q, self._v = _quick(parts.inputs["q"]), _quick(parts.inputs["v"])
        self._last, self._clock = _quick(parts.last), _quick(parts.clock)
        self._floats = robot.floats
        self._nu, self._remembered = robot.nu, len(parts.last)
        self._sizes = robot.nu, robot.nq, self.tick.memory.size
        self.inputs = parts.u
        self._places: dict[str, tuple[dict[str, Any], dict[str, Array]]] = {}
        for name, array in self.inputs.items():
            task, dot, own = name.partition(".")
            vectors, others = self._places.setdefault(task, ({}, {})) if dot else ({}, {})
            if array.ndim == 1:
                vectors[own] = _quick(array)
            else:
                others[own] = array
        self._numbers = parts.numbers
        self._has_rows = self.tick.mode_rows > 0
        self._name = self.tick.mode.name
        self.format = ReportFormat(
            mode=self._name,
            layout=layout,
            owners=tuple(row.partition(" ")[2] for row in self.tick.rows.inequality),
            gives=self.tick.gives,
            has_law=self.tick.has_law,
            contacts=self.tick.contacts,
        )

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
        for task, _, _ in self.tick.mode.tasks:
            if task.needs_reference and task.name not in references:
                raise InputError(
                    f"mode {self.tick.mode.name!r} is entered without a reference for task "
                    f"{task.name!r}"
                )

    def step(
        self, measurement: Measurement, references: Mapping[str, Reference], memory: Memory
    ) -> tuple[Command, TickReport, Memory]:
        """Return the torque of this tick, its report, and the memory for the next.

        Raises:
            InputError: unknown task or input, or an array of the wrong shape.
        """
        time, q, v, contact = measurement
        try:
            self._q[:], self._v[:] = q, v
        except (TypeError, ValueError):  # no vectors of float64, or too long
            self._put_state(q, v)
        self._last[:] = memory.packed[: self._remembered]
        clock = self._clock
        clock[0], clock[1], clock[2] = time, memory.time, memory.freeze
        for task, reference in references.items():
            self._refer(task, reference)
        code = self._solve()
        if code > LIMITED:
            return self.hold(code, measurement, memory)
        numbers = self._numbers.copy()
        limited = code == LIMITED
        freeze = limited or (self._has_rows and not contact.closed)
        fallbacks = memory.fallback_ticks
        return (
            new(Command, (numbers[: self._nu], False)),
            new(TickReport, (self.format, numbers, OK, contact, limited, ())),
            new(Memory, (self._name, numbers, self._sizes, time, contact, freeze, fallbacks)),
        )

    def calls(self) -> dict[str, Callable[[], object]]:
        """Return the parts of the tick, each as a call that repeats it on the data of the last.

        ``graph``, ``QP`` and ``certificate``; of a tick in C also ``call``, which is all of them,
        and ``nothing``, which shows what calling takes.
        """
        return self.runner.calls()

    def holding_torque(self, q: Vector) -> Vector:
        """Return the torque (nu) [Nm] that holds the arm at rest in ``q`` (nq), within limits.

        The limit on its rate is around the torque that holds without limits.
        """
        hold = self.parts.fallback
        if self._floats and self._has_rows and (carried := self._carried_torque(q)) is not None:
            return carried
        hold.inputs["q"][:], hold.inputs["v"][:] = q, 0.0
        hold()
        self.inputs["limits.tau_last"][:] = hold.outputs["held"]
        hold()
        return hold.outputs["tau"].copy()

    def _carried_torque(self, q: Vector) -> Vector | None:
        """Return the torque (nu) [Nm] that holds up a floating robot in ``q`` (nq), if one does.

        Of all multipliers with which nothing accelerates and every limit holds, those of least
        size; limits on the rate of the torque do not count where nothing was sent before.
        """
        parts, kept = self.parts, self._u.copy()
        x, before = parts.inputs["x"], parts.inputs["x"].copy()
        x[:] = self.tick.memory.vector()
        own = self.tick.inputs.views(self.tick.inputs.vector())
        for task in self.tick.mode.tasks:  # what one of them measured last is of no matter here
            for name in task.task.inputs():
                self.inputs[f"{task.task.name}.{name}"][...] = own[f"{task.task.name}.{name}"]
        self._q[:], self._v[:] = q, np.zeros(len(self._v))
        free = {"limits.tau_rate": UNBOUNDED / self._dt, "limits.tau_last": 0.0, "mu": 0.0}
        for name, value in free.items():
            self.inputs[name][...] = value
        parts.tick()
        self._u[:], x[:] = kept, before
        (H, _, A, b, C, lb, ub), nv = parts.qp, len(self._v)
        held = self.tick.mode_rows if self.tick.mode.slack is None else 0
        n, rows = len(H) - nv, np.r_[: self._nu, self._nu + nv : len(lb)]  # none on a, which is 0
        limits = C[rows, nv:], lb[rows], ub[rows]
        least = QpData(np.eye(n), np.zeros(n), A[held:, nv:], b[held:], *limits)
        found = QpSolvers("daqp").solve(least)
        T, t = parts.torque_map
        left = least.C @ found.x
        size = KKT_TOLERANCE * max(1.0, float(np.abs(found.x).max()))
        held_up = (left <= least.ub + size).all() and (left >= least.lb - size).all()
        return T[:, nv:] @ found.x + t if held_up else None  # daqp may not see that none does

    def _refer(self, task: str, reference: Reference) -> None:
        """Write what a task shall follow into the buffers."""
        vectors, others = self._places.get(task, _NO_PLACES)
        for name, value in reference.arrays.items():
            try:
                if name in vectors:
                    vectors[name][:] = value
                elif value.shape == others[name].shape:
                    others[name][...] = value
                else:
                    self._put(f"{task}.{name}", value)
            except (AttributeError, KeyError, TypeError, ValueError):  # no array, or no such input
                self._put(f"{task}.{name}", value)

    def _put_state(self, q: ArrayLike, v: ArrayLike) -> None:
        for name, value in (("q", q), ("v", v)):
            _assign(name, self.parts.inputs[name], value)

    def _put(self, name: str, value: ArrayLike) -> None:
        if name not in self.inputs or "." not in name:
            raise unknown_name("task input", name, self.inputs)
        _assign(name, self.inputs[name], value)

    def hold(
        self, code: int, measurement: Measurement, memory: Memory
    ) -> tuple[Command, TickReport, Memory]:
        """Return the fallback torque, the report of a tick without a solution, and memory.

        Args:
            code: what the tick that is in the buffers came to.
            measurement: that of the tick.
            memory: what the tick before it returned.
        """
        known, parts = self.runner.hold(), self.parts
        time = measurement.time if known else memory.time
        status, layout = BY_CODE[code], self.format.layout
        numbers = np.full(len(parts.numbers), np.nan)
        layout.view(numbers, "time")[:] = measurement.time
        layout.view(numbers, "damping")[:] = parts.u["mu"]
        rows = status is Status.DEPENDENT_ROWS
        names = dependent_rows(self.tick, self.terms["row_pivots"]) if rows else ()
        unsolved = (Status.INACCURATE, Status.INFEASIBLE)
        if status in unsolved and self.tick.searched:
            names = dependent_contacts(self.tick, self.terms["A"])
            status = Status.DEPENDENT_ROWS if names else status
        tau, q = parts.named["tau"].copy(), parts.named["q"]
        after = remember(self._name, tau, q, memory.x, time)._replace(
            contact=measurement.contact, freeze=True, fallback_ticks=memory.fallback_ticks + 1
        )
        report = TickReport(self.format, numbers, status, measurement.contact, False, names)
        return Command(tau, fallback=True), report, after


def _assign(name: str, place: Array, value: ArrayLike) -> None:
    if np.shape(value) != place.shape:
        raise InputError(f"{name}: got shape {np.shape(value)}, need {place.shape}")
    place[...] = value


def _quick(array: Array) -> Any:
    """Return a view that takes vectors of its own length and kind, and no others, in no time."""
    return memoryview(array)  # type: ignore[arg-type]
