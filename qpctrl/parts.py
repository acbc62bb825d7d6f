"""The functions of one mode's tick, bound to shared buffers: what a tick is run on."""

from collections.abc import Callable, Mapping
from typing import Protocol

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, Vector
from qpctrl.certificate import build_certificate
from qpctrl.evaluator import Evaluator
from qpctrl.explanation import build_explanation
from qpctrl.fallback import build_fallback, build_limited
from qpctrl.outcome import outcome_layout
from qpctrl.robot import Robot
from qpctrl.solver import QpData
from qpctrl.tick import MATRICES, Tick


class Runner(Protocol):
    """Runs the tick whose inputs are in the buffers."""

    def solve(self) -> int:
        """Solve it and return the code of its outcome, an index of `qpctrl.status.BY_CODE`."""

    def hold(self) -> bool:
        """Write the fallback torque; return whether the measured configuration is believed."""

    def calls(self) -> dict[str, Callable[[], object]]:
        """Return the parts of a tick, each as a call that repeats it on the data of the last."""


def build_functions(robot: Robot, tick: Tick) -> dict[str, ca.Function]:
    """Return the functions of a tick by name, in the order in which it needs them."""
    functions = (
        tick.function,
        build_certificate(tick),
        build_explanation(robot, tick),
        build_fallback(tick.model),
        build_limited(robot, tick.inputs),
    )
    return {function.name(): function for function in functions}


class TickParts:
    """The functions of one tick on buffers that each of them reads and writes in place.

    Attributes:
        clock: time of this and of the last good measurement [s], and whether integrators hold.
        last: what the last tick left: torque (nu) [Nm], configuration (nq), memory of the tasks.
        tau_last, q_last: the first two of it.
        tick, certificate, explanation, fallback, limited: the functions.
        inputs: the arguments q, v, u, x of `tick`, by name.
        terms: its results, by name.
        qp: the QP among them.
        whole_point, point: solution (x, y, z) of the QP in one array, and its three parts.
        searched: whether the minimiser without inequalities is to be found, see `Tick.searched`.
        upper_levels: how many priorities there are above the lowest.
        layout, numbers: all that the tick leaves behind, in one vector (`qpctrl.outcome`).
        named: its parts by name.
        u: the named inputs among the argument u.
    """

    def __init__(self, robot: Robot, tick: Tick, made: Mapping[str, ca.Function]) -> None:
        """Bind the functions.

        Args:
            robot: the robot as the controller believes it to be.
            tick: names and graph of the tick.
            made: what `build_functions` returns, as it is or compiled.
        """
        self.searched = tick.searched
        self.upper_levels = tick.upper_levels
        self.layout = outcome_layout(robot, tick)
        self.numbers = self.layout.vector()
        self.named = self.layout.views(self.numbers)
        kept = ("tau_hybrid", "tau_textbook", "memory", "signals")
        self.clock, self.last = np.zeros(3), np.zeros(robot.nu + robot.nq + tick.memory.size)
        self.tau_last, self.q_last, x_last = np.split(self.last, [robot.nu, robot.nu + robot.nq])
        shared = {key: self.named[key] for key in kept} | {"x": x_last}
        self.tick = Evaluator(made["tick"], shared, tick.matrices)
        self.inputs, self.terms = self.tick.inputs, self.tick.outputs
        self.u = tick.inputs.views(self.inputs["u"])
        self.qp = QpData(*(self.terms[name] for name in QpData._fields))
        sizes = [len(self.terms[name]) for name in ("g", "b", "lb")]
        self.whole_point = np.zeros(sum(sizes))
        x, y, z = np.split(self.whole_point, np.cumsum(sizes[:2]))
        self.point = x, y, z
        judged = {**self.named, **self.inputs, **self.terms, "tau": self.named["tau_qp"]}
        judged |= {"x": x, "y": y, "z": z}
        if tick.searched:  # the graph does not know what would be without limits
            judged["x_law"] = self.terms["x_eq"]
        self.certificate = Evaluator(made["certificate"], judged)
        self.explanation = Evaluator(made["explanation"], judged, MATRICES)
        sent = {"u": self.inputs["u"]}
        self.fallback = Evaluator(made["fallback"], {**sent, "tau": self.named["tau"]})
        self.limited = Evaluator(made["limited"], {**sent, "limited": self.named["tau"]})

    @property
    def torque_map(self) -> tuple[Array, Vector]:
        """T (nu×n) and t (nu) with τ = T x + t."""
        return self.terms["C"][: len(self.terms["t"])], self.terms["t"]
