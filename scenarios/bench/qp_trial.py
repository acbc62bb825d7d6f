"""A solver alone, on the QPs of ticks that were made before."""

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from qpctrl import Measurement
from qpctrl.arrays import Array
from qpctrl.certificate import build_certificate
from qpctrl.evaluator import Evaluator
from qpctrl.solver import QpData, Solution, Solver, make_solver
from scenarios.bench.course import DT
from scenarios.bench.part_trial import EMPTY, calls_of
from scenarios.bench.row import Row
from scenarios.bench.tick_trial import WARM, Loop
from scenarios.bench.timing import timing


class Problem(NamedTuple):
    """One tick's QP, and what its certificate needs besides."""

    qp: QpData
    free: Solution
    """Its minimiser without the inequalities."""
    terms: dict[str, Array]


def problems(loop: Loop, count: int) -> tuple[Problem, ...]:
    """Return the QPs of ``count`` ticks in a row, once the loop has settled."""
    loop.set_limits()
    engine, moments = loop.controller.engines[loop.mode], loop.moments
    memory = loop.controller.start(loop.mode, moments[0].q)
    found = []
    for i in range(WARM + count):
        q, v, references = moments[i % len(moments)]
        _, _, memory = loop.controller.step(
            loop.mode, Measurement(i * DT, q, v), references, memory
        )
        if i >= WARM:
            terms = {name: value.copy(order="K") for name, value in engine.terms.items()}
            qp = QpData(*(terms[name] for name in QpData._fields))
            free = Solution(terms["x_eq"], terms["y_eq"], np.zeros(len(qp.lb)))
            found.append(Problem(qp, free, terms))
    return tuple(found)


class QpTrial:
    """A solver on given problems, over and over; it may start from its last answer."""

    def __init__(
        self, name: str, solver: str, loop: Loop, given: Sequence[Problem], ticks: int
    ) -> None:
        """Prepare the trial.

        Args:
            name: of its line in the results.
            solver: name of the solver.
            loop: whose problems they are.
            given: the problems.
            ticks: samples that are wanted.
        """
        self.name, self.ticks = name, ticks
        self._loop, self._given = loop, given
        self._solver: Solver = make_solver(solver)
        self._at = 0
        self._samples: list[int] = []

    def run(self, count: int) -> None:
        """Take ``count`` samples."""
        solve, given, clock = self._solver.solve, self._given, time.perf_counter_ns
        for i in range(self._at, self._at + WARM + count):
            qp = given[i % len(given)].qp
            started = clock()
            solve(qp)
            ended = clock()
            if i >= self._at + WARM:
                self._samples.append(ended - started)
        self._at += WARM + count

    def row(self) -> Row:
        """Return the figures of the samples so far, and the accuracy over all problems."""
        loop = self._loop
        return Row(
            section="solver",
            name=self.name,
            timing=timing(self._samples),
            joints=loop.joints,
            k=loop.k,
            compiled=False,
            facts={"kkt_max": self._residual()},
        )

    def _residual(self) -> float:
        """Return the largest KKT residual of the solver's own answers."""
        engine = self._loop.controller.engines[self._loop.mode]
        check = Evaluator(build_certificate(engine.tick))
        worst = 0.0
        for problem in self._given:
            answer = self._solver.solve(problem.qp)
            given = {**problem.terms, **answer._asdict()}
            for name, place in check.inputs.items():
                place[...] = given[name].reshape(place.shape)
            check()
            worst = max(worst, float(np.max(check.outputs["kkt"])))
        return worst


class InnerQpTrial:
    """The solver inside a compiled tick, once more on the QP of each tick that was just made."""

    def __init__(self, name: str, loop: Loop, ticks: int) -> None:
        """Prepare the trial; the loop's engine offers the calls ``QP`` and `EMPTY`.

        Args:
            name: of its line in the results.
            loop: whose ticks they are.
            ticks: samples that are wanted.
        """
        self.name, self.ticks, self._loop = name, ticks, loop
        self._memory = loop.controller.start(loop.mode, loop.moments[0].q)
        self._at, self._kkt = 0, 0.0
        self._samples: list[int] = []
        self._empty: list[int] = []

    def run(self, count: int) -> None:
        """Take ``count`` samples."""
        loop, clock, memory = self._loop, time.perf_counter_ns, self._memory
        loop.set_limits()
        calls = calls_of(loop.controller.engines[loop.mode])
        solve, nothing, moments = calls["QP"], calls[EMPTY], loop.moments
        for i in range(self._at, self._at + WARM + count):
            q, v, references = moments[i % len(moments)]
            _, report, memory = loop.controller.step(
                loop.mode, Measurement(i * DT, q, v), references, memory
            )
            started = clock()
            solve()
            between = clock()
            nothing()
            ended = clock()
            if i >= self._at + WARM:
                self._samples.append(between - started)
                self._empty.append(ended - between)
                self._kkt = max(self._kkt, report.kkt_residual)
        self._at, self._memory = self._at + WARM + count, memory

    def row(self) -> Row:
        """Return the figures of the samples so far, less what calling takes."""
        loop = self._loop
        return Row(
            section="solver",
            name=self.name,
            timing=timing(np.array(self._samples) - np.median(self._empty)),
            joints=loop.joints,
            k=loop.k,
            compiled=True,
            facts={"kkt_max": self._kkt},
        )
