"""The record of a run: one row a tick, written to Parquet in one piece.

The numbers of a tick are copied into a sheet, so that nothing of the tick is kept alive. A full
sheet is sorted into columns, and a piece of these becomes a piece of the table.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from enum import Enum
from itertools import chain, groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from qpctrl.arrays import Vector
from qpctrl.controller import Controller
from qpctrl.engine import Engine
from qpctrl.errors import InputError
from qpctrl.layout import Layout
from qpctrl.report import Command, TickReport
from qpctrl.robot import Robot
from qpctrl.status import Status
from scenarios.plant import JointReading, PlantState
from scenarios.scenario import Directive

SHEET = 256  # ticks that are sorted at once
PIECE = 16 * SHEET  # ticks in one piece of the table
WORDS = ("phase", "mode", "contact", "status", "active", "explanation")
MARKS = ("fallback", "touching", "saturated")
GAPS = ("law_gap", "textbook_gap", "unexplained_gap", "curvature")  # as a report lists them
SCALARS = ("time", *GAPS, "damping", "kkt_residual", "tick_us")
OF_LAWS = ("tau_qp", "tau_hybrid", "tau_textbook")
DELIVERED = ("tau_delivered", "tau_meas")
ELECTRIC, LIMITED = ("current", "voltage"), "motor_limited"  # of joints with drives
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
NOTED = (*WORDS[:4], *MARKS, LIMITED, "time", "tick_us")
"""What a tick leaves besides arrays."""


class Tick(NamedTuple):
    """Everything known at one tick."""

    directive: Directive
    state: PlantState
    command: Command
    report: TickReport
    tick_us: float
    """Time that the controller took [µs]."""
    joints: JointReading | None = None
    """What the drives did in the period that follows; none where joints are ideal."""


class Sorting(NamedTuple):
    """What becomes of the rows that one mode has in a sheet."""

    rows: list[Vector]
    """All rows of the sheet, as long as this mode fills them."""
    runs: list[tuple[slice, slice]]
    """Columns of the table, by number, and where in a row their values are."""
    kkt: slice
    """Residuals, the largest of which is in the table."""
    damping: int
    """Where in the numbers of a report its damping is."""


class Record:
    """Collects ticks and turns them into pieces of a table now and then."""

    def __init__(
        self,
        controller: Controller,
        *,
        driven: bool = False,
        contacts: Sequence[str] = (),
        only: Collection[str] | None = None,
    ) -> None:
        """Prepare the columns.

        Args:
            controller: its robot names the joints, its modes the multipliers and signals.
            contacts: names of the contacts whose wrenches the plant measures one by one.
            driven: whether the joints have drives, whose readings come with every tick.
            only: quantities to keep: names of columns up to their dot, ``lam`` and ``signals``
                for those that modes have of their own, without ``active`` and ``explanation``;
                default: all.
        """
        robot, engines = controller.robot, controller.engines
        self._B, self._driven, self._only = robot.B, driven, only
        sizes = {"q": robot.nq, "v": robot.nv, "wrench_meas": 6, "wrench": 6, "tau": robot.nu}
        sizes |= dict.fromkeys((*DELIVERED, *ELECTRIC) if driven else (), robot.nu)
        sizes |= {"contact": 6 * len(contacts)} if contacts else {}
        self._measured = Layout({name: np.zeros(size) for name, size in sizes.items()})
        common = _common_columns(robot, driven, contacts)
        places = {mode: self._places(engine, common) for mode, engine in engines.items()}
        common = {name: columns for name, columns in common.items() if self._keeps(name)}
        self._names = tuple(dict.fromkeys(chain(*common.values(), *places.values())))
        number = {name: i for i, name in enumerate(self._names)}
        self._columns = {
            name: slice(number[columns[0]], number[columns[-1]] + 1)
            for name, columns in common.items()
        }
        longest = max(engine.format.layout.size for engine in engines.values())
        self._sheet = np.zeros((SHEET, self._measured.size + longest))
        self._sortings = {
            mode: self._sorting(engine.format.layout, number, places[mode])
            for mode, engine in engines.items()
        }
        self._pieces: list[pl.DataFrame] = []
        self._start_piece()

    def add(self, tick: Tick) -> None:
        """Append one tick.

        Raises:
            InputError: a reading of drives where none is expected, or none where one is.
        """
        directive, state, command, report, tick_us, joints = tick
        if (joints is None) is self._driven and self._keeps("tau_delivered"):
            found, start = ("none", "one") if joints is None else ("one", "none")
            raise InputError(f"joint reading: got {found} in a tick, need {start} as at the start")
        noted, mode, saturated = self._noted, report.mode, report.saturated
        sorting, arrays = self._sortings[mode], (state.q, state.v, state.wrench_meas, state.wrench)
        readings = joints[:4] if joints is not None and self._driven else ()  # torques, electric
        row = sorting.rows[len(noted)]
        each = state.contacts
        np.concatenate((*arrays, command.tau, *readings, *each, report.numbers), out=row)
        eventful = saturated or command.fallback or report.numbers[sorting.damping] > 0
        if eventful and self._only is None:
            self._eventful.append((len(noted), report))
        noted.append(
            (
                *(directive.phase, mode, report.contact, report.status),
                *(command.fallback, state.touching, saturated),
                *(joints is not None and joints.limited, state.time, tick_us),
            )
        )
        if len(noted) == self._room:
            self._sort()

    def table(self) -> pl.DataFrame:
        """Return one row a tick; vector columns are named ``quantity.component``."""
        self._sort()
        self._finish_piece()
        return pl.concat(self._pieces, rechunk=False)

    def _keeps(self, quantity: str) -> bool:
        return self._only is None or quantity in self._only

    def _places(self, engine: Engine, common: Mapping[str, Sequence[str]]) -> dict[str, int]:
        """Return the columns whose values stand in the rows of a mode, and where there."""
        tick, layout, measured = engine.tick, engine.format.layout, self._measured
        reported: dict[str, Sequence[str]] = {
            "gaps": GAPS if engine.format.has_law else GAPS[:1],
            **{name: common[name] for name in ("damping", *OF_LAWS)},
            "lam": [f"lam.{row}" for row in tick.rows.constraint],
            "wrench": [f"qp.{c.name}.{axis}" for c in tick.contacts for axis in _wrench(c.axes)],
            "margin": [f"margin.{limit}" for c in tick.contacts for limit in c.limits],
            "signals": [f"{name}.{i}" for name, n in tick.signals.items() for i in range(n)],
        }
        sources = [
            *((name, measured.place(name).start, common[name]) for name in measured.names),
            *(
                (name, measured.size + layout.place(name).start, reported[name])
                for name in reported
            ),
        ]
        return {
            column: start + i
            for name, start, columns in sources
            for i, column in enumerate(columns)
            if name not in DELIVERED and self._keeps(column if name == "gaps" else name)
        }

    def _sorting(
        self, layout: Layout, number: Mapping[str, int], places: Mapping[str, int]
    ) -> Sorting:
        first, kkt = self._measured.size, layout.place("kkt")
        return Sorting(
            rows=[row[: first + layout.size] for row in self._sheet],
            runs=_runs((number[name], place) for name, place in places.items()),
            kkt=slice(first + kkt.start, first + kkt.stop),
            damping=layout.place("damping").start,
        )

    def _start_piece(self) -> None:
        self._values = np.empty((len(self._names), PIECE))
        marks = (*MARKS, LIMITED) if self._driven else MARKS
        self._words: dict[str, list[str]] = {name: [] for name in WORDS if self._keeps(name)}
        self._marks: dict[str, list[bool]] = {name: [] for name in marks if self._keeps(name)}
        self._start_sheet(0)

    def _start_sheet(self, sorted_ticks: int) -> None:
        self._sorted, self._room = sorted_ticks, min(SHEET, PIECE - sorted_ticks)
        self._noted: list[tuple[Any, ...]] = []
        self._eventful: list[tuple[int, TickReport]] = []

    def _finish_piece(self) -> None:
        """Turn the columns into a piece of the table."""
        values = self._values[:, : self._sorted]
        kinds = dict.fromkeys(self._words, pl.String) | dict.fromkeys(self._marks, pl.Boolean)
        numbers = dict(zip(self._names, values, strict=True))
        table = pl.DataFrame({**self._words, **self._marks, **numbers}, schema_overrides=kinds)
        self._pieces.append(table.select("time", pl.exclude("time")))
        self._start_piece()

    def _sort(self) -> None:
        """Sort the sheet into columns, and finish a piece that is full then."""
        count = len(self._noted)
        if not count:
            return
        values = self._values[:, self._sorted : self._sorted + count]
        noted = dict(zip(NOTED, zip(*self._noted, strict=True), strict=True))
        values.fill(np.nan)  # and so stays what a mode does not have
        begin = 0
        for mode, run in groupby(noted["mode"]):
            end, sorting = begin + len(list(run)), self._sortings[mode]
            rows, into = self._sheet[begin:end], values[:, begin:end]
            for columns, places in sorting.runs:
                into[columns] = rows[:, places].T
            if "kkt_residual" in self._columns:
                into[self._columns["kkt_residual"]] = rows[:, sorting.kkt].max(axis=1)
            begin = end
        for name in ("time", "tick_us"):
            if name in self._columns:
                values[self._columns[name]] = noted[name]
        for name in DELIVERED:  # ideal joints deliver and measure what is commanded
            if name in self._columns:
                torque = self._sheet[:count, self._measured.place(name if self._driven else "tau")]
                values[self._columns[name]] = self._B @ torque.T
        self._sort_words(noted, count)
        self._start_sheet(self._sorted + count)
        if not self._room:
            self._finish_piece()

    def _sort_words(self, noted: Mapping[str, Sequence[Any]], count: int) -> None:
        """Append the words and marks of the sheet; most ticks have nothing to explain."""
        active, explanation = [""] * count, [""] * count
        for i, report in self._eventful:
            active[i] = ", ".join(limit.name for limit in report.active)
            explanation[i] = report.explain()
        words = {
            **{"phase": noted["phase"], "mode": noted["mode"]},
            **{name: _names(noted[name]) for name in ("contact", "status")},
            **{"active": active, "explanation": explanation},
        }
        for name, column in self._words.items():
            column.extend(words[name])
        for name, marks in self._marks.items():
            marks.extend(noted[name])


def _wrench(axes: Sequence[str]) -> list[str]:
    """Return the names of the parts of a wrench along some axes of a twist."""
    return [axis.replace("v", "f").replace("w", "m") for axis in axes]


def _common_columns(robot: Robot, driven: bool, contacts: Sequence[str]) -> dict[str, list[str]]:
    """Return the columns of each quantity that every mode has."""
    joints, actuators = robot.joint_names, robot.actuator_names
    parts = {
        **{"q": robot.configuration_names, "v": joints},
        **dict.fromkeys(("tau", *OF_LAWS), actuators),
        **dict.fromkeys(DELIVERED, joints),
        **dict.fromkeys(ELECTRIC if driven else (), actuators),
        **dict.fromkeys(("wrench_meas", "wrench"), WRENCH),
    }
    vectors = {name: [f"{name}.{part}" for part in own] for name, own in parts.items()}
    if contacts:
        vectors["contact"] = [f"contact.{name}.{part}" for name in contacts for part in WRENCH]
    return {**{name: [name] for name in SCALARS}, **vectors}


def _runs(pairs: Iterable[tuple[int, int]]) -> list[tuple[slice, slice]]:
    """Return pairs of numbers as pairs of slices, in each of which both go up by one."""
    runs: list[tuple[int, int, int]] = []
    for pair in pairs:
        first, second, length = runs[-1] if runs else (*pair, 0)
        if runs and pair == (first + length, second + length):
            runs[-1] = (first, second, length + 1)
        else:
            runs.append((*pair, 1))
    return [(slice(i, i + length), slice(j, j + length)) for i, j, length in runs]


def _names(members: Iterable[Enum]) -> list[str]:
    """Return the name of each member; most are the same as the one before."""
    runs = ((member.name, len(list(run))) for member, run in groupby(members))
    return [name for name, length in runs for _ in range(length)]


def fallback_count(table: pl.DataFrame) -> int:
    """Return how many ticks sent the fallback torque."""
    return int((table["status"] != Status.OK.name).sum())


def write_parquet(table: pl.DataFrame, path: Path) -> None:
    """Write the table; every byte but the timing columns repeats from run to run."""
    table.write_parquet(path, compression="zstd", statistics=False, row_group_size=2 * PIECE)
