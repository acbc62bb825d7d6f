"""The record of a run: one row a tick, written to Parquet in one piece."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

from qpctrl.arrays import Vector
from qpctrl.controller import Controller
from qpctrl.errors import InputError
from qpctrl.report import Command, TickReport
from qpctrl.status import Status
from qpctrl.tick import Tick as ControlTick
from scenarios.plant import JointReading, PlantState
from scenarios.scenario import Directive

PIECE = 4096  # ticks in one piece of the table
SCALARS = (
    *("time", "law_gap", "textbook_gap", "unexplained_gap"),
    *("curvature", "damping", "kkt_residual", "tick_us"),
)
WORDS = ("phase", "mode", "contact", "status", "active", "explanation")
MARKS = ("fallback", "touching", "saturated")
ELECTRIC, LIMITED = ("current", "voltage"), "motor_limited"  # of joints with drives
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


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


class Record:
    """Collects ticks, one packed row each, and turns them into table pieces now and then."""

    def __init__(self, controller: Controller, *, driven: bool = False) -> None:
        """Prepare the columns.

        Args:
            controller: its robot names the joints, its modes the multipliers and signals.
            driven: whether the joints have drives, whose readings come with every tick.
        """
        robot = controller.robot
        joints, actuators = robot.joint_names, robot.actuator_names
        vectors = {
            **dict.fromkeys(("q", "v"), joints),
            **dict.fromkeys(("tau", "tau_qp", "tau_hybrid", "tau_textbook"), actuators),
            **dict.fromkeys(("tau_delivered", "tau_meas"), joints),
            **dict.fromkeys(ELECTRIC if driven else (), actuators),
            **dict.fromkeys(("wrench_meas", "wrench"), WRENCH),
        }
        self._common = [*SCALARS, *(f"{name}.{part}" for name, v in vectors.items() for part in v)]
        self._own = {mode: _own_columns(e.tick) for mode, e in controller.engines.items()}
        self._mark_names = (*MARKS, LIMITED) if driven else MARKS
        self._B, self._driven = robot.B, driven
        self._pieces: list[pl.DataFrame] = []
        self._start_piece()

    def add(self, tick: Tick) -> None:
        """Append one tick.

        Raises:
            InputError: a reading of drives where none is expected, or none where one is.
        """
        if len(self._rows) == PIECE:
            self._finish_piece()
        command, report, state, joints = tick.command, tick.report, tick.state, tick.joints
        scalars = (
            *(state.time, report.law_gap, report.textbook_gap, report.unexplained_gap),
            *(report.curvature, report.damping, report.kkt_residual, tick.tick_us),
        )
        vectors = (
            *(scalars, state.q, state.v, command.tau, report.tau_qp, report.tau_hybrid),
            *(report.tau_textbook, self._at_joints(command.tau, joints)),
            *(state.wrench_meas, state.wrench, report.lam, report.signals),
        )
        self._rows.append(np.concatenate(vectors))
        eventful = report.saturated or report.damping > 0 or command.fallback
        words = (
            *(tick.directive.phase, report.mode, tick.directive.contact.name, report.status.name),
            ", ".join(limit.name for limit in report.active) if eventful else "",
            report.explain() if eventful else "",
        )
        self._words.append(words)
        marks = (command.fallback, state.touching, report.saturated)
        self._marks.append((*marks, joints.limited) if joints else marks)

    def _at_joints(self, tau: Vector, joints: JointReading | None) -> Vector:
        """Return torque delivered and measured (nv each), and the drives' current and voltage."""
        if (joints is not None) != self._driven:
            found, start = ("none", "one") if joints is None else ("one", "none")
            raise InputError(f"joint reading: got {found} in a tick, need {start} as at the start")
        if joints is None:
            ideal = self._B @ tau  # delivers and measures what is commanded
            return np.concatenate((ideal, ideal))
        torques = (self._B @ joints.tau_delivered, self._B @ joints.tau_meas)
        return np.concatenate((*torques, joints.current, joints.voltage))

    def table(self) -> pl.DataFrame:
        """Return one row a tick; vector columns are named ``quantity.component``."""
        self._finish_piece()
        return pl.concat(self._pieces, rechunk=False)

    def _start_piece(self) -> None:
        self._rows: list[Vector] = []
        self._words: list[tuple[str, ...]] = []
        self._marks: list[tuple[bool, ...]] = []

    def _finish_piece(self) -> None:
        """Unpack the rows; what a mode does not have is NaN in its ticks."""
        names = dict.fromkeys((*self._common, *(n for own in self._own.values() for n in own)))
        places = {name: i for i, name in enumerate(names)}
        values = np.full((len(names), len(self._rows)), np.nan)
        for mode, own in self._own.items():
            at = [i for i, words in enumerate(self._words) if words[1] == mode]
            if at:
                columns = [places[name] for name in (*self._common, *own)]
                values[np.ix_(columns, at)] = np.array([self._rows[i] for i in at]).T
        words = {name: [row[i] for row in self._words] for i, name in enumerate(WORDS)}
        marks = {name: [row[i] for row in self._marks] for i, name in enumerate(self._mark_names)}
        numbers = dict(zip(names, values, strict=True))
        kinds = dict.fromkeys(WORDS, pl.String) | dict.fromkeys(marks, pl.Boolean)
        table = pl.DataFrame({**words, **marks, **numbers}, schema_overrides=kinds)
        self._pieces.append(table.select("time", pl.exclude("time")))
        self._start_piece()


def _own_columns(tick: ControlTick) -> list[str]:
    """Return the columns that only this mode has: multipliers and signals."""
    multipliers = [f"lam.{row}" for row in tick.rows.constraint]
    return multipliers + [f"{name}.{j}" for name, n in tick.signals.items() for j in range(n)]


def fallback_count(table: pl.DataFrame) -> int:
    """Return how many ticks sent the fallback torque."""
    return int((table["status"] != Status.OK.name).sum())


def write_parquet(table: pl.DataFrame, path: Path) -> None:
    """Write the table; every byte but the timing columns repeats from run to run."""
    table.write_parquet(path, compression="zstd", statistics=False, row_group_size=2 * PIECE)
