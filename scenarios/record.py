"""The record of a run: one row a tick, written to Parquet in one piece."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from qpctrl.arrays import Array, Vector
from qpctrl.controller import Controller
from qpctrl.report import Command, TickReport
from qpctrl.status import Status
from scenarios.plant import PlantState
from scenarios.scenario import Directive

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
    """Collects ticks and turns them into a table."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._rows: list[Tick] = []
        self._started = time.perf_counter()

    def add(self, tick: Tick) -> None:
        """Append one tick."""
        self._rows.append(tick)

    def table(self) -> pl.DataFrame:
        """Return one row a tick; vector columns are named ``quantity.component``."""
        rows, names = self._rows, self._controller.robot.joint_names
        reports = [row.report for row in rows]
        columns: dict[str, Array | list[str] | list[bool]] = {
            "time": np.array([row.state.time for row in rows]),
            "phase": [row.directive.phase for row in rows],
            "mode": [row.directive.mode for row in rows],
            "status": [report.status.name for report in reports],
            "fallback": [row.command.fallback for row in rows],
            "touching": [row.state.touching for row in rows],
            "saturated": [report.saturated for report in reports],
            "active": [", ".join(limit.name for limit in report.active) for report in reports],
        }
        for name, values in self._vectors().items():
            parts = WRENCH if name.startswith("wrench") else names
            columns |= {f"{name}.{part}": values[:, i] for i, part in enumerate(parts)}
        columns |= self._multipliers()
        columns |= self._signals()
        for name in ("law_gap", "textbook_gap", "unexplained_gap", "curvature", "damping"):
            columns[name] = np.array([getattr(report, name) for report in reports])
        columns["kkt_residual"] = np.array([report.kkt_residual for report in reports])
        columns["tick_us"] = np.array([row.tick_us for row in rows])
        return pl.DataFrame(columns)

    def _vectors(self) -> dict[str, Array]:
        rows = self._rows
        return {
            "q": np.array([row.state.q for row in rows]),
            "v": np.array([row.state.v for row in rows]),
            "tau": np.array([row.command.tau for row in rows]),
            "tau_qp": np.array([row.report.tau_qp for row in rows]),
            "tau_hybrid": np.array([row.report.tau_hybrid for row in rows]),
            "tau_textbook": np.array([row.report.tau_textbook for row in rows]),
            "tau_delivered": np.array([row.command.tau for row in rows]),
            "wrench_meas": np.array([row.state.wrench_meas for row in rows]),
        }

    def _multipliers(self) -> dict[str, Vector]:
        names = {
            mode: engine.tick.rows.equality[: engine.tick.mode_rows]
            for mode, engine in self._controller.engines.items()
        }
        columns = {f"lam.{n}": np.full(len(self._rows), np.nan) for m in names.values() for n in m}
        for i, row in enumerate(self._rows):
            for name, value in zip(names[row.report.mode], row.report.lam, strict=True):
                columns[f"lam.{name}"][i] = value
        return columns

    def _signals(self) -> dict[str, Vector]:
        columns: dict[str, Vector] = {}
        for mode, engine in self._controller.engines.items():
            at = [i for i, row in enumerate(self._rows) if row.report.mode == mode]
            if not at:
                continue
            values = np.array([self._rows[i].report.signals for i in at])
            start = 0
            for name, size in engine.tick.signals.items():
                for j in range(size):
                    column = columns.setdefault(f"{name}.{j}", np.full(len(self._rows), np.nan))
                    column[at] = values[:, start + j]
                start += size
        return columns


def fallback_count(table: pl.DataFrame) -> int:
    """Return how many ticks sent the fallback torque."""
    return int((table["status"] != Status.OK.name).sum())


def write_parquet(table: pl.DataFrame, path: Path) -> None:
    """Write the table; every byte but the timing columns repeats from run to run."""
    table.write_parquet(path, compression="zstd", statistics=False)
