"""A brief record: of each tick the numbers that a rollout is judged by, and no words.

Its columns have the names of the full record (`scenarios.record`) and the same values.
"""

from typing import TypeAlias

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix, Vector
from qpctrl.controller import Controller
from scenarios.record import WRENCH, Tick

SCALARS = ("time", "law_gap", "textbook_gap", "curvature", "kkt_residual")

Row: TypeAlias = tuple[tuple[float, ...], Vector, Vector, Vector, Vector, Vector, Vector]
"""Scalars, KKT residuals and vectors of one tick, packed when all are there."""


class BriefRecord:
    """Collects the state, the wrenches and the tasks' signals of every tick."""

    def __init__(self, controller: Controller) -> None:
        """Prepare the columns for the modes of ``controller``."""
        self._robot = controller.robot
        self._signals = {
            mode: [f"{name}.{i}" for name, n in engine.tick.signals.items() for i in range(n)]
            for mode, engine in controller.engines.items()
        }
        self._rows: dict[str, list[Row]] = {mode: [] for mode in self._signals}
        self._order: dict[str, list[int]] = {mode: [] for mode in self._signals}
        self._words: list[tuple[str, str, str]] = []
        self._marks: list[tuple[bool, bool, bool]] = []

    def add(self, tick: Tick) -> None:
        """Append one tick."""
        state, report = tick.state, tick.report
        self._order[report.mode].append(len(self._words))
        scalars = (state.time, report.law_gap, report.textbook_gap, report.curvature)
        vectors = (state.q, state.v, state.wrench_meas, state.wrench, report.signals)
        self._rows[report.mode].append((scalars, report.kkt, *vectors))
        directive = tick.directive
        self._words.append((directive.phase, directive.contact.name, report.status.name))
        self._marks.append((tick.command.fallback, state.touching, report.saturated))

    def table(self) -> pl.DataFrame:
        """Return one row a tick; what a mode does not have is NaN in its ticks."""
        joints = self._robot.joint_names
        common = [
            *SCALARS,
            *(f"{name}.{joint}" for name in ("q", "v") for joint in joints),
            *(f"{name}.{axis}" for name in ("wrench_meas", "wrench") for axis in WRENCH),
        ]
        own = dict.fromkeys(name for names in self._signals.values() for name in names)
        place = {name: i for i, name in enumerate((*common, *own))}
        values = np.full((len(place), len(self._words)), np.nan)
        for mode, rows in self._rows.items():
            if rows:
                columns = [place[name] for name in (*common, *self._signals[mode])]
                values[np.ix_(columns, self._order[mode])] = _packed(rows).T
        words = zip(("phase", "contact", "status"), zip(*self._words, strict=True), strict=False)
        marks = zip(
            ("fallback", "touching", "saturated"), zip(*self._marks, strict=True), strict=False
        )
        kinds = dict.fromkeys(("phase", "contact", "status"), pl.String)
        return pl.DataFrame(
            {
                **{name: list(column) for name, column in words},
                **{name: list(column) for name, column in marks},
                **dict(zip(place, values, strict=True)),
            },
            schema_overrides=kinds,
        )


def _packed(rows: list[Row]) -> Matrix:
    """Return the numbers of ticks (ticks×columns)."""
    scalars, kkt, *vectors = zip(*rows, strict=True)
    largest = np.concatenate(kkt).reshape(len(rows), -1).max(axis=1, keepdims=True)
    blocks = (np.concatenate(vector).reshape(len(rows), -1) for vector in vectors)
    return np.hstack((np.array(scalars), largest, *blocks))
