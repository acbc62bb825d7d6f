"""Whole control ticks, as a user's loop makes them."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from qpctrl import Measurement, Memory
from qpctrl.arrays import Vector
from qpctrl.compiled import CompileMode
from qpctrl.controller import Controller
from qpctrl.report import TickReport
from qpctrl.status import Status
from scenarios.bench.course import DT, Moment
from scenarios.bench.row import Row, Section
from scenarios.bench.timing import KNOWN, preemptions, timing

WARM = 20
"""Ticks at the start of each block that are not kept: the caches are another trial's there."""

CODE: dict[bool, CompileMode] = {True: "yes", False: "no"}
"""How a controller is told to run compiled, and interpreted."""

Pace = Literal["back to back", "sleep", "spin"]
"""When the next tick starts: at once; a period after the last, with the core asleep or awake."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """A controller and the ticks that it is given, over and over."""

    controller: Controller
    moments: Sequence[Moment]
    k: int
    compiled: bool
    ready_s: float = 0.0
    """Time that building the controller took [s], compiling included."""
    tau_max: Vector | None = None
    """Torque limits (nu) [Nm]; default: the robot's own."""

    @property
    def how(self) -> CompileMode:
        """How the controller is told to run."""
        return CODE[self.compiled]

    @property
    def mode(self) -> str:
        """Name of the only mode."""
        return next(iter(self.controller.engines))

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.controller.robot.nv

    def limited(self, tau_max: Vector) -> "Loop":
        """Return the same loop with other torque limits (nu) [Nm]."""
        return replace(self, tau_max=tau_max)

    def set_limits(self) -> None:
        """Give the controller this loop's torque limits; other loops may share it."""
        own = self.controller.robot.limits.tau_max
        inputs = self.controller.engines[self.mode].inputs
        inputs["limits.tau_max"][:] = own if self.tau_max is None else self.tau_max


class TickTrial:
    """Ticks of a loop, each timed from outside.

    What is timed: a `Measurement` is made from arrays that are there, and `Controller.step` is
    called with references that are there.

    Attributes:
        blocks: medians of its turns [ns].
    """

    def __init__(
        self, section: Section, name: str, loop: Loop, ticks: int, *, pace: Pace = "back to back"
    ) -> None:
        """Prepare the trial.

        Args:
            section: of its line in the results.
            name: of that line.
            loop: what to run.
            ticks: samples that are wanted.
            pace: when each tick starts.
        """
        self.section, self.name, self.loop, self.ticks = section, name, loop, ticks
        self._wait = WAITS[pace]
        self._memory = loop.controller.start(loop.mode, loop.moments[0].q)
        self._at = 0
        self.blocks: list[float] = []
        self._samples: list[int] = []
        self._lost: list[bool] = []
        self._seen = Seen()

    def run(self, count: int) -> None:
        """Take ``count`` samples, from where the last block ended."""
        loop, clock, keep = self.loop, time.perf_counter_ns, self._samples.append
        loop.set_limits()
        step, mode, moments, memory = loop.controller.step, loop.mode, loop.moments, self._memory
        length, wait, deadline = len(moments), self._wait, clock()
        for i in range(self._at, self._at + WARM + count):
            q, v, references = moments[i % length]
            now = i * DT
            deadline = wait(deadline)
            before = preemptions()
            started = clock()
            _, report, memory = step(mode, Measurement(now, q, v), references, memory)
            ended = clock()
            if i >= self._at + WARM:
                keep(ended - started)
                self._lost.append(preemptions() > before)
                self._seen.note(report)
        self._at, self._memory = self._at + WARM + count, memory
        self.blocks.append(float(np.median(self._samples[-count:])))

    def row(self) -> Row:
        """Return the figures of the samples so far."""
        loop, seen = self.loop, self._seen
        return Row(
            section=self.section,
            name=self.name,
            timing=timing(self._samples, self._lost if KNOWN else None),
            joints=loop.joints,
            k=loop.k,
            compiled=loop.compiled,
            facts={
                "kkt_max": seen.kkt,
                "solver_gap_max": seen.solver_gap,
                "limits_mean": seen.limits / len(self._samples),
                "fallback_ticks": seen.fallbacks,
                "ready_s": loop.ready_s,
                "note": loop.controller.engines[loop.mode].note,
            },
        )


class Seen:
    """What the reports of a trial's ticks say.

    Attributes:
        kkt: largest KKT residual.
        solver_gap: largest relative distance of the solver's own torque from the one sent.
        limits: active limits, all ticks together.
        fallbacks: ticks without a solution.
    """

    def __init__(self) -> None:
        self.kkt = self.solver_gap = 0.0
        self.limits = self.fallbacks = 0

    def note(self, report: TickReport) -> None:
        """Take in one report."""
        if report.status is not Status.OK:
            self.fallbacks += 1
            return
        self.kkt = max(self.kkt, report.kkt_residual)
        self.solver_gap = max(self.solver_gap, report.solver_gap)
        self.limits += len(report.active)


def torques(loop: Loop, ticks: int) -> np.ndarray:
    """Return the torques (ticks×nu) [Nm] that a loop sends, once it has settled."""
    loop.set_limits()
    memory, sent = _start(loop), []
    for i in range(-WARM * 5, ticks):
        q, v, references = loop.moments[i % len(loop.moments)]
        command, _, memory = loop.controller.step(
            loop.mode, Measurement(i * DT, q, v), references, memory
        )
        if i >= 0:
            sent.append(command.tau)
    return np.array(sent)


def _start(loop: Loop) -> Memory:
    return loop.controller.start(loop.mode, loop.moments[0].q)


def _at_once(deadline: int) -> int:
    return deadline


def _asleep(deadline: int) -> int:
    """Sleep until the next period begins, and return when that is [ns]."""
    following = _next(deadline)
    if (left := following - time.perf_counter_ns()) > 0:
        time.sleep(left / 1e9)
    return following


def _awake(deadline: int) -> int:
    """Wait for the next period without letting go of the core, and return when it is [ns]."""
    following, clock = _next(deadline), time.perf_counter_ns
    while clock() < following:
        pass
    return following


def _next(deadline: int) -> int:
    """Return the next multiple of the period after ``deadline`` that is not past [ns]."""
    period = round(DT * 1e9)
    return max(deadline + period, time.perf_counter_ns())


WAITS: dict[Pace, Callable[[int], int]] = {
    "back to back": _at_once,
    "sleep": _asleep,
    "spin": _awake,
}
