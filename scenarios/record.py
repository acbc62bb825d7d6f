"""The record of a run: one row a tick, written to Parquet in one piece."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix, Vector
from qpctrl.controller import Controller
from qpctrl.report import Command, TickReport
from qpctrl.status import Status
from qpctrl.tick import Tick as ControlTick
from scenarios.plant import PlantState
from scenarios.scenario import Directive

PIECE = 4096  # ticks in one piece of the table
SCALARS = (
    *("time", "law_gap", "textbook_gap", "unexplained_gap", "curvature"),
    *("damping", "kkt_residual", "tick_us"),
)
WORDS = ("phase", "mode", "status", "active", "explanation")
MARKS = ("fallback", "touching", "saturated")
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True, kw_only=True, eq=False)
class Tick:
    """Everything known at one tick."""

    directive: Directive
    state: PlantState
    command: Command
    report: TickReport
    tick_us: float
    """Time that the controller took [µs]."""


class Record:
    """Collects ticks in fixed arrays, flushed into table pieces whenever they are full."""

    def __init__(self, controller: Controller) -> None:
        robot = controller.robot
        joints = robot.joint_names
        self._vectors = {
            **dict.fromkeys(("q", "v"), joints),
            **dict.fromkeys(("tau", "tau_qp", "tau_hybrid", "tau_textbook"), robot.actuator_names),
            "tau_delivered": joints,
            "wrench_meas": WRENCH,
        }
        self._signals = {
            name: _signal_names(engine.tick) for name, engine in controller.engines.items()
        }
        self._multipliers = {
            name: engine.tick.rows.equality[: engine.tick.mode_rows]
            for name, engine in controller.engines.items()
        }
        self._B = robot.B
        widths = {name: len(parts) for name, parts in self._vectors.items()}
        widths |= dict.fromkeys(SCALARS, 1)
        for mode, names in self._signals.items():
            widths[f"signals {mode}"] = len(names)
            widths[f"lam {mode}"] = len(self._multipliers[mode])
        self._widths = widths
        self._arrays = self._fresh()
        self._words: dict[str, list[str]] = {name: [] for name in WORDS}
        self._marks: dict[str, list[bool]] = {name: [] for name in MARKS}
        self._count = 0
        self._pieces: list[pl.DataFrame] = []

    def add(self, tick: Tick) -> None:
        """Append one tick."""
        if self._count == PIECE:
            self._flush()
        i, arrays, report, state = self._count, self._arrays, tick.report, tick.state
        for name in ("law_gap", "textbook_gap", "unexplained_gap", "curvature", "damping"):
            arrays[name][i] = getattr(report, name)
        arrays["time"][i], arrays["tick_us"][i] = state.time, tick.tick_us
        arrays["kkt_residual"][i] = report.kkt_residual
        arrays["q"][i], arrays["v"][i] = state.q, state.v
        arrays["wrench_meas"][i] = state.wrench_meas
        arrays["tau"][i], arrays["tau_qp"][i] = tick.command.tau, report.tau_qp
        arrays["tau_hybrid"][i], arrays["tau_textbook"][i] = report.tau_hybrid, report.tau_textbook
        arrays["tau_delivered"][i] = self._B @ tick.command.tau
        arrays[f"signals {report.mode}"][i] = report.signals
        arrays[f"lam {report.mode}"][i] = report.lam
        eventful = report.saturated or report.damping > 0 or tick.command.fallback
        words = (
            *(tick.directive.phase, report.mode, report.status.name),
            ", ".join(limit.name for limit in report.active),
            report.explain() if eventful else "",
        )
        for name, word in zip(WORDS, words, strict=True):
            self._words[name].append(word)
        marks = (tick.command.fallback, state.touching, report.saturated)
        for name, mark in zip(MARKS, marks, strict=True):
            self._marks[name].append(mark)
        self._count += 1

    def table(self) -> pl.DataFrame:
        """Return one row a tick; vector columns are named ``quantity.component``."""
        self._flush()
        return pl.concat(self._pieces, rechunk=False)

    def _fresh(self) -> dict[str, Matrix]:
        return {name: np.full((PIECE, width), np.nan) for name, width in self._widths.items()}

    def _flush(self) -> None:
        n = self._count
        columns: dict[str, Vector | list[str] | list[bool]] = {
            "time": self._arrays["time"][:n, 0],
            **self._words,
            **self._marks,
        }
        for name, parts in self._vectors.items():
            for j, part in enumerate(parts):
                columns[f"{name}.{part}"] = self._arrays[name][:n, j]
        columns |= self._merged(
            "lam", {m: [f"lam.{r}" for r in v] for m, v in self._multipliers.items()}
        )
        columns |= self._merged("signals", self._signals)
        columns |= {name: self._arrays[name][:n, 0] for name in SCALARS if name != "time"}
        kinds = dict.fromkeys(WORDS, pl.String) | dict.fromkeys(MARKS, pl.Boolean)
        self._pieces.append(pl.DataFrame(columns, schema_overrides=kinds))
        self._words = {name: [] for name in WORDS}
        self._marks = {name: [] for name in MARKS}
        self._arrays = self._fresh()  # polars may have kept the old ones
        self._count = 0

    def _merged(self, kind: str, names: Mapping[str, Sequence[str]]) -> dict[str, Vector]:
        """Return the columns of all modes; what a mode does not have is NaN in its ticks."""
        columns: dict[str, Vector] = {}
        for mode, parts in names.items():
            values = self._arrays[f"{kind} {mode}"][: self._count]
            for j, part in enumerate(parts):
                known = columns.get(part)
                fresh = values[:, j]
                columns[part] = fresh if known is None else np.where(np.isnan(known), fresh, known)
        return columns


def _signal_names(tick: ControlTick) -> list[str]:
    return [f"{name}.{j}" for name, size in tick.signals.items() for j in range(size)]


def fallback_count(table: pl.DataFrame) -> int:
    """Return how many ticks sent the fallback torque."""
    return int((table["status"] != Status.OK.name).sum())


def write_parquet(table: pl.DataFrame, path: Path) -> None:
    """Write the table; every byte but the timing columns repeats from run to run."""
    table.write_parquet(path, compression="zstd", statistics=False, row_group_size=2 * PIECE)
