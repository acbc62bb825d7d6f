"""The parts of a control tick, each timed on the data of the tick that was just made."""

import time
from collections.abc import Callable, Mapping

import casadi as ca
import numpy as np

from qpctrl import Measurement
from qpctrl.compiled import compiled
from qpctrl.dynamics import Dynamics
from qpctrl.engine import Engine
from qpctrl.evaluator import Evaluator
from qpctrl.robot import Robot
from scenarios.bench.course import DT
from scenarios.bench.row import Row
from scenarios.bench.tick_trial import WARM, Loop
from scenarios.bench.timing import timing

WHOLE, PYTHON, DYNAMICS = "whole tick", "Python around them", "dynamics alone"

CALL = "call"
"""Name among an engine's calls of the one that runs all others in their order."""

EMPTY = "nothing"
"""Name of the one that does nothing: what calling takes."""

IDLE = "idle"
"""The same of a function of CasADi that does nothing."""

WORDS = {
    WHOLE: "Controller.step, from measurement and references to torque, report and memory",
    PYTHON: "writing state and references, reading torque, report and memory",
    CALL: "graph, QP, certificate in one call",
    "graph": "M, h, J, J̇v, errors, constraint, QP data, both laws, next memory",
    DYNAMICS: "M, h, J, J̇v of the tool; a share of the graph",
    "QP": "the solution of the QP and its multipliers",
    "certificate": "KKT residuals, torque, gaps to both laws",
    "explanation": "which limit binds and what gave way; only where one binds",
}
"""What each part is."""


def dynamics_function(robot: Robot, frame: str) -> ca.Function:
    """Return (q, v) → (M, h, J, J_dot_v) with M, J of full size, and J, J̇v those of ``frame``."""
    dynamics = Dynamics(robot)
    tool = dynamics.frame(frame)
    outputs = [ca.densify(x) for x in (dynamics.M, dynamics.h, tool.J, tool.J_dot_v)]
    names = ["M", "h", "J", "J_dot_v"]
    return ca.Function(
        "dynamics", [dynamics.q, dynamics.v], outputs, ["q", "v"], names, {"cse": True}
    )


class PartTrial:
    """Ticks of a loop, and after each of them its parts once more, one by one."""

    name = "parts"

    def __init__(self, loop: Loop, frame: str, ticks: int) -> None:
        """Prepare the trial.

        Args:
            loop: what to run.
            frame: frame of the tool, for the dynamics.
            ticks: samples of each part that are wanted.
        """
        self.loop, self.ticks = loop, ticks
        engine = loop.controller.engines[loop.mode]
        function = dynamics_function(loop.controller.robot, frame)
        function = compiled(function, compile=loop.how).function
        self._dynamics, idle = Evaluator(function), Evaluator(_idle())
        self._calls: dict[str, Callable[[], object]] = {
            **calls_of(engine),
            DYNAMICS: self._dynamics,
            IDLE: idle,
        }
        self._memory = loop.controller.start(loop.mode, loop.moments[0].q)
        self._at = 0
        self._samples: dict[str, list[int]] = {name: [] for name in (WHOLE, *self._calls)}

    def run(self, count: int) -> None:
        """Take ``count`` samples of each part."""
        loop, clock = self.loop, time.perf_counter_ns
        loop.set_limits()
        step, mode, moments = loop.controller.step, loop.mode, loop.moments
        memory, state = self._memory, self._dynamics.inputs
        for i in range(self._at, self._at + WARM + count):
            q, v, references = moments[i % len(moments)]
            now, took = i * DT, {}
            started = clock()
            _, _, memory = step(mode, Measurement(now, q, v), references, memory)
            took[WHOLE] = clock() - started
            state["q"][:], state["v"][:] = q, v
            for name, call in self._calls.items():
                started = clock()
                call()
                took[name] = clock() - started
            if i >= self._at + WARM:
                for name, span in took.items():
                    self._samples[name].append(span)
        self._at, self._memory = self._at + WARM + count, memory

    def rows(self) -> list[Row]:
        """Return a line for each part; Python is what of the whole the calls do not explain."""
        samples = {name: np.array(spans) for name, spans in self._samples.items()}
        whole = samples.pop(WHOLE)
        off = self._calling(samples)
        samples = {name: spans - off[name] for name, spans in samples.items()}
        inside = samples[CALL] if CALL in samples else _together(samples)
        named = {WHOLE: whole, PYTHON: whole - inside, **samples}
        return [
            Row(
                section="part",
                name=name,
                timing=timing(spans),
                joints=self.loop.joints,
                k=self.loop.k,
                compiled=self.loop.compiled,
                facts={"words": WORDS.get(name, ""), "taken_off_us": off.get(name, 0.0) / 1e3},
            )
            for name, spans in named.items()
        ]

    def _calling(self, samples: dict[str, np.ndarray]) -> dict[str, float]:
        """Take the empty calls out of the samples; return what calling each part takes [ns].

        Nothing is taken off where parts are called like this in the tick itself.
        """
        idle = float(np.median(samples.pop(IDLE)))
        empty = float(np.median(samples.pop(EMPTY))) if EMPTY in samples else 0.0
        off = dict.fromkeys(samples, empty)
        return off | {CALL: 0.0, DYNAMICS: idle if self.loop.compiled else 0.0}


def calls_of(engine: Engine) -> dict[str, Callable[[], object]]:
    """Return the parts of an engine's tick as calls that repeat them on its data."""
    offered: Callable[[], dict[str, Callable[[], object]]] | None = getattr(engine, "calls", None)
    return {} if offered is None else offered()


def _idle() -> ca.Function:
    x = ca.SX.sym("x")
    return ca.Function("idle", [x], [x], ["x"], ["y"])


def _together(samples: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the sum of what a tick needs, where it is not one call."""
    return sum(
        (spans for name, spans in samples.items() if name not in (DYNAMICS, "explanation")),
        start=np.zeros(1),
    )
