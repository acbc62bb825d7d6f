"""The control tick: measurement and references in, torque and report out."""

import math
from collections.abc import Mapping, Sequence

from qpctrl.arrays import Vector, positive
from qpctrl.certificate import KKT_TOLERANCE
from qpctrl.compiled import CompileMode
from qpctrl.engine import Engine
from qpctrl.errors import InputError, unknown_name
from qpctrl.law import Law
from qpctrl.memory import Measurement, Memory, remember
from qpctrl.mode import Mode
from qpctrl.native_step import UNTRIED, dispatch
from qpctrl.objective import Reference
from qpctrl.qp import FORMS
from qpctrl.rank import DependentRows, usable_tick
from qpctrl.report import Command, TickReport
from qpctrl.robot import Robot
from qpctrl.solver import NEED_STRICT_CONVEXITY, make_solver
from qpctrl.status import LIMITED


class Controller:
    """A whole-body controller for one robot and a set of modes.

    Frozen data in, frozen data out: all that one tick leaves to the next is in `Memory`, but
    for the solver's warm start and the references of tasks that are not given again; `reset`
    forgets these.
    """

    def __init__(
        self,
        robot: Robot,
        modes: Sequence[Mode],
        *,
        dt: float = 1e-3,
        solver: str = "active-set",
        form: str = "reduced",
        law: Law = "qp",
        dependent_rows: DependentRows = "refuse",
        kkt_tolerance: float = KKT_TOLERANCE,
        compile: CompileMode = "no",
    ) -> None:
        """Build the tick of every mode.

        Args:
            robot: the robot as the controller believes it to be.
            modes: the sets of constraints and tasks to switch between.
            dt: period of the loop [s].
            solver: ``active-set``, ``proxsuite`` or an installed back-end of qpsolvers.
            form: ``reduced`` or ``full``.
            law: whose torque is sent; all of them are computed and compared.
            dependent_rows: ``refuse`` or ``drop`` rows of A that depend on others at home.
            kkt_tolerance: largest residual of a tick that is accepted.
            compile: whether the ticks run as generated C, compiled once (`qpctrl.compiled`); with
                ``active-set`` a whole tick then is one call.

        Raises:
            InputError: a name, gain, matrix or mode that cannot be used.
        """
        _check_choices(form, solver, law, modes)
        self.robot, self.dt, self.law = robot, float(positive(dt, (), "dt")), law
        self.kkt_tolerance = float(positive(kkt_tolerance, (), "kkt_tolerance"))
        self.engines: dict[str, Engine] = {}
        for mode in modes:
            self.engines[mode.name] = Engine(
                robot,
                usable_tick(robot, mode, dependent_rows, form),
                solver=make_solver(solver),
                dt=self.dt,
                law=law,
                tolerance=self.kkt_tolerance,
                compile=compile,
            )
            if law == "textbook" and not self.engines[mode.name].tick.has_law:
                raise InputError(
                    f"mode {mode.name!r} has no textbook law: it needs one task space, one motion "
                    "task and every joint driven; use law 'qp' or 'hybrid'"
                )

        quick = {name: engine.quick for name, engine in self.engines.items() if engine.quick}
        if quick and type(self).step is Controller.step:
            vars(self)["step"] = dispatch(quick, self._finish)  # the method below, in C

    @property
    def interpreted(self) -> str:
        """Why ticks that were to be compiled are not, in one line; empty where they are."""
        notes = dict.fromkeys(engine.note for engine in self.engines.values())
        return "; ".join(note for note in notes if note.startswith("interpreted:"))

    def start(self, mode: str, q: Vector) -> Memory:
        """Return the memory of a controller that holds still at ``q`` (nq) in ``mode``.

        The first tick may change the torque that holds there by ``tau_rate`` times the period.
        """
        engine, q = self._engine(mode), self.robot.configuration(q, "q")
        return remember(mode, engine.holding_torque(q), q, engine.tick.memory.vector())

    def reset(self) -> None:
        """Forget warm starts, references and changed inputs of every mode.

        A run from a new `start` then gives the same bits as that of a new controller.
        """
        for engine in self.engines.values():
            engine.reset()

    def step(
        self,
        mode: str,
        measurement: Measurement,
        references: Mapping[str, Reference],
        memory: Memory,
    ) -> tuple[Command, TickReport, Memory]:
        """Return the torque of this tick, its report, and the memory for the next.

        Never raises on bad numbers: NaN and stale measurements, infeasible limits and
        inaccurate solutions send the fallback torque and are counted.

        Args:
            mode: name of the active mode.
            measurement: state of the robot.
            references: what each task, by name, shall follow. A task left out keeps its last
                reference, but the first tick in a mode needs one for every motion task.
            memory: what the last tick, or `start`, returned.

        Raises:
            InputError: unknown mode, task or input name, an array of the wrong shape, or no
                reference where one is needed.
        """
        return self._finish(UNTRIED, mode, measurement, references, memory)

    def _finish(
        self,
        code: int,
        mode: str,
        measurement: Measurement,
        references: Mapping[str, Reference],
        memory: Memory,
    ) -> tuple[Command, TickReport, Memory]:
        """Do what C has not done: it came to ``code``, or tried nothing."""
        engine = self._engine(mode)
        if code > LIMITED:
            return engine.hold(code, measurement, memory)
        if memory.mode != mode or memory.time == -math.inf:
            engine.demand(references)
        if memory.mode != mode:
            memory = self._carried(memory, engine)
        return engine.step(measurement, references, memory)

    def _engine(self, mode: str) -> Engine:
        if mode not in self.engines:
            raise unknown_name("mode", mode, self.engines)
        return self.engines[mode]

    def _carried(self, memory: Memory, engine: Engine) -> Memory:
        """Return the memory in a new mode, with what both modes' tasks share taken over."""
        layout = engine.tick.memory
        x = layout.vector()
        old = self.engines[memory.mode].tick.memory.views(memory.x)
        for name, view in layout.views(x).items():
            if name in old and old[name].shape == view.shape:
                view[...] = old[name]
        carried = remember(engine.tick.mode.name, memory.tau, memory.q, x)
        return memory._replace(mode=carried.mode, packed=carried.packed, sizes=carried.sizes)


def _check_choices(form: str, solver: str, law: str, modes: Sequence[Mode]) -> None:
    if form not in FORMS:
        raise unknown_name("form", form, FORMS)
    if form == "full" and solver in NEED_STRICT_CONVEXITY:
        raise InputError(
            f"solver {solver!r} cannot solve the full form, whose Hessian is singular in τ; "
            "use form 'reduced' or another solver"
        )
    if law not in ("qp", "hybrid", "textbook"):
        raise unknown_name("law", law, ("qp", "hybrid", "textbook"))
    if not modes:
        raise InputError("controller: need at least one mode")
    if len({mode.name for mode in modes}) < len(modes):
        names = ", ".join(mode.name for mode in modes)
        raise InputError(f"controller: names of modes must differ, got {names}")
