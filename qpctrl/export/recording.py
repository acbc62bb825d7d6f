"""A recorded run, for the replay of an exported controller: doubles, as replay.c describes them."""

from collections.abc import Iterator

import numpy as np

from qpctrl.arrays import Vector
from qpctrl.controller import Controller
from qpctrl.export.meaning import PRIVATE
from qpctrl.memory import Measurement
from qpctrl.report import Command

MARK, VERSION = 1234.5, 2.0
"""First numbers of a recording; replay.c has the same."""


class Recording:
    """What a controller read and sent, tick by tick.

    Attributes:
        ticks: how many there are.
        modes: the modes they were in, in the order of the first visit.
        fallback_ticks: how many of them sent the fallback torque.
    """

    def __init__(self, controller: Controller, mode: str, q: Vector) -> None:
        """Record the start, before or after ``controller.start(mode, q)``."""
        self._engines = controller.engines
        self._number = {name: i for i, name in enumerate(controller.engines)}
        self._own = {name: _public(controller, name) for name in controller.engines}
        robot, u = controller.robot, self._inputs(mode)
        head = [MARK, VERSION, robot.nq, robot.nv, robot.nu, len(self._number)]
        self._parts: list[Vector] = [np.array([*head, self._number[mode], len(u)]), u, q.copy()]
        self._parts.append(controller.start(mode, q).tau.copy())
        self._before: tuple[str, Vector] | None = None
        self.ticks = self.fallback_ticks = 0
        self.modes: dict[str, None] = {}

    def add(self, mode: str, measurement: Measurement, command: Command) -> None:
        """Append the tick that was just computed from the references that are loaded."""
        time, q, v, contact = measurement
        u, last = self._inputs(mode), self._before
        spans = [(0, len(u))]
        if last is not None and last[0] == mode:
            spans = list(_runs((u.view(np.int64) != last[1].view(np.int64)) & self._own[mode]))
        head = [self._number[mode], time, contact.closed, command.fallback]
        self._parts += [np.array(head, float), q.copy(), v.copy(), command.tau.copy()]
        self._parts.append(np.array([len(spans)], float))
        for start, stop in spans:
            self._parts += [np.array([start, stop - start], float), u[start:stop]]
        self._before = mode, u
        self.ticks += 1
        self.fallback_ticks += command.fallback
        self.modes.setdefault(mode)

    def data(self) -> bytes:
        """Return the recording."""
        return np.concatenate(self._parts).tobytes()

    def _inputs(self, mode: str) -> Vector:
        return self._engines[mode].parts.inputs["u"].copy()


def _public(controller: Controller, mode: str) -> np.ndarray:
    """Return which inputs of a mode are not the controller's own."""
    layout = controller.engines[mode].tick.inputs
    public = np.ones(layout.size, dtype=bool)
    for name in PRIVATE:
        public[layout.place(name)] = False
    return public


def _runs(changed: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield begin and end of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], changed, [False]))))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
