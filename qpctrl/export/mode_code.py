"""What C has to know about one mode: its functions, its sizes, and the places of its numbers."""

from collections.abc import Iterable
from typing import NamedTuple, get_args

import casadi as ca
import numpy as np

from qpctrl.controller import Controller
from qpctrl.export.meaning import demanded
from qpctrl.export.place import Places
from qpctrl.law import Law
from qpctrl.layout import Layout
from qpctrl.native_tick import tick_arrays
from qpctrl.parts import TickParts, build_functions
from qpctrl.report import ACTIVE_DUAL

SHOWN = ("tau_qp", "tau_hybrid", "tau_textbook", "lam", "kkt", "gaps", "z", "kind", "damping")
"""What a tick leaves behind that the report of an exported controller shows."""


class Span(NamedTuple):
    """Numbers of one vector that go to another."""

    start: int
    to: int
    length: int


class ModeCode:
    """One mode, laid out for C.

    Attributes:
        word: identifier of the mode.
        tick: names of its inputs and rows.
        functions: its generated functions by their names in ``qpctrl_tick``; in C their names
            begin with those of controller and mode.
        bound: places of the arguments and results of each of them.
        pointers: places of what the pointers of ``qpctrl_tick`` lead to, by name.
        numbers: other places, counts and marks of its entry in the table of modes, by name.
        sizes: the members of ``qpctrl_tick`` that are numbers, by name.
        qp: variables, equalities and inequalities of its QP.
        inputs: defaults of its inputs, packed.
        demanded: names of the inputs without which it must not be entered.
        size: length of the vector that holds all its numbers.
    """

    def __init__(self, controller: Controller, mode: str, prefix: str, word: str) -> None:
        """Lay the mode out.

        Args:
            controller: what is exported.
            mode: name of the mode.
            prefix: what the names of the exported controller begin with.
            word: identifier of the mode.
        """
        robot, self.word = controller.robot, word
        self.tick = tick = controller.engines[mode].tick
        made = build_functions(robot, tick)
        self.functions: dict[str, ca.Function] = {
            name: function.expand(f"{prefix}_{word}_{name}") for name, function in made.items()
        }
        parts = TickParts(robot, tick, made)
        rough = np.zeros(len(parts.terms["g"]))
        arrays = {**tick_arrays(parts), "rough": rough}
        evaluators = {name: getattr(parts, name) for name in made}
        bound = {n: [*e.inputs.values(), *e.outputs.values()] for n, e in evaluators.items()}
        everything = [parts.clock, parts.last, parts.numbers, *arrays.values()]
        places = Places([*everything, *(array for of in bound.values() for array in of)])
        self.size = places.size
        self.bound = {name: [places.of(array) for array in of] for name, of in bound.items()}
        self.pointers = {name: places.of(array) for name, array in arrays.items()}
        self.inputs = tick.inputs.vector()
        tick.inputs.view(self.inputs, "dt")[...] = controller.dt
        self.demanded = demanded(tick.mode)
        self.numbers = {
            "has_rows": int(tick.mode_rows > 0),
            "held": places.of(parts.fallback.outputs["held"]),
            **{"outcome": places.of(parts.numbers), "n_outcome": len(parts.numbers)},
            **{name: places.of(parts.named[name]) for name in SHOWN},
            "row_pivots": places.of(parts.terms["row_pivots"]),
        }
        n, m, r = (len(values) for values in parts.point)
        self.qp = n, m, r
        self.sizes: dict[str, float] = {
            **{
                "nq": robot.nq,
                "nv": robot.nv,
                "nu": robot.nu,
                "n": n,
                "m": m,
                "r": r,
                "k": tick.mode_rows,
            },
            **{"n_u": len(self.inputs), "n_x": tick.memory.size},
            **{
                "searched": int(parts.searched),
                "law": get_args(Law).index(controller.law),
                "tolerance": controller.kkt_tolerance,
            },
            "active_dual": ACTIVE_DUAL,
        }

    @property
    def demanded_spans(self) -> list[Span]:
        """Where the demanded inputs lie."""
        return joined(_span(self.tick.inputs, self.tick.inputs, name) for name in self.demanded)

    def carried_from(self, other: "ModeCode") -> list[Span]:
        """Return the memory of another mode's tasks that this one takes over by name."""
        old, new = other.tick.memory, self.tick.memory
        shapes = ({n: v.shape for n, v in of.views(of.vector()).items()} for of in (old, new))
        before, after = shapes
        return joined(
            _span(old, new, name) for name in new.names if before.get(name) == after[name]
        )


def joined(spans: Iterable[Span]) -> list[Span]:
    """Return spans of which none begins where the one before ends; empty ones are left out."""
    found: list[Span] = []
    for span in spans:
        last = found[-1] if found else Span(-1, -1, 0)
        if (last.start + last.length, last.to + last.length) == (span.start, span.to):
            found[-1] = last._replace(length=last.length + span.length)
        elif span.length:
            found.append(span)
    return found


def _span(old: Layout, new: Layout, name: str) -> Span:
    start, to = old.place(name), new.place(name)
    return Span(start.start, to.start, to.stop - to.start)
