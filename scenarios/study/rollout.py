"""One rollout of a study: its row in the table, whatever happens on the way."""

import io
import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from qpctrl.errors import InputError, QpctrlError
from scenarios.study.outcome import FAILURES, OutcomeClass, classify
from scenarios.study.plan import Task, loaded_code
from scenarios.study.search import Boundary, Place, Trial, Worst
from scenarios.study.study import Study
from scenarios.study.system import DivergedError, Measures, Setting

TIMING = ("elapsed_s",)
"""Columns that differ from run to run."""


NUMERIC = (ArithmeticError, ValueError, np.linalg.LinAlgError)
"""What numbers that have left all bounds raise on their way."""


class RolloutError(QpctrlError):
    """A fault of the program in a rollout; it ends the study, whose finished chunks stay."""


class Tracing(NamedTuple):
    """Of which rollouts every tick is kept."""

    rows: int = 0
    """So many rows of the design, evenly spread; the first repeat of each, all controllers."""
    of: int = 1
    """Rows that the design has."""
    failures: bool = False
    """All that diverged, lost contact or chattered."""

    def wants(self, task: Task, outcome: OutcomeClass) -> bool:
        """Return whether the ticks of a rollout with this outcome are kept."""
        before, after = (row * self.rows // self.of for row in (task.row, task.row + 1))
        sampled = task.repeat == 0 and after > before
        return sampled or (self.failures and outcome in FAILURES)


class Made(NamedTuple):
    """A rollout that has been made."""

    row: dict[str, Any]
    trace: bytes | None
    """Its ticks as a Parquet file, if they are kept."""


def roll_out(study: Study, task: Task, tracing: Tracing = Tracing()) -> Made:  # noqa: B008
    """Return the row of a rollout, or of a search.

    A plant or a computation that leaves all bounds is an outcome, ``diverged`` with a reason,
    whose measures are null.

    Raises:
        InputError: a setting that the system cannot run.
        RolloutError: a fault of the program, which is no outcome.
    """
    started = time.perf_counter()
    point = dict(zip((f.name for f in study.columns), task.point, strict=True))
    setting = study.setting(point)
    if study.search is None:
        trial = _attempt(study, setting, task)
    else:
        trial = _find(study, study.search, setting, task)
    elapsed = time.perf_counter() - started
    trace = None
    if study.search is None and tracing.wants(task, trial.outcome):
        trace = _trace(study, setting, task)
    row = {
        "identity": task.identity,
        **{"row": task.row, "repeat": task.repeat},
        **{f.column: x for f, x in zip(study.columns, task.point, strict=True)},
        **{"controller": task.controller, "seed": task.seed},
        **{"outcome": str(trial.outcome), "reason": trial.reason},
        **{name: _plain(trial.measures.get(name)) for name in study.measures},
        "elapsed_s": elapsed,
    }
    return Made(row, trace)


def roll_out_all(study: Study, tracing: Tracing, source: str, chunk: Sequence[Task]) -> list[Made]:
    """Return the rollouts of a chunk.

    Args:
        study: the study.
        tracing: of which rollouts every tick is kept.
        source: version of this code's own files that the rows shall be of.
        chunk: what to roll out.

    Raises:
        InputError: this process has another version of the code, or a setting cannot be run.
        RolloutError: a fault of the program.
    """
    if (own := loaded_code()["source"]) != source:
        raise InputError(
            f"the code changed since the study began: it is {own} here and was {source}; start "
            "again with another --out"
        )
    return [roll_out(study, task, tracing) for task in chunk]


def row_schema(study: Study) -> dict[str, type[pl.DataType]]:
    """Return the columns of a table of rollouts."""
    return {
        "identity": pl.String,
        **{"row": pl.Int64, "repeat": pl.Int64},
        **{factor.column: pl.Float64 for factor in study.columns},
        **{"controller": pl.String, "seed": pl.Int64, "outcome": pl.String, "reason": pl.String},
        **dict.fromkeys((*study.measures, *TIMING), pl.Float64),
    }


def _plain(value: float | None) -> float | None:
    return None if value is None else float(value)


def _attempt(study: Study, setting: Setting, task: Task) -> Trial:
    """Return what becomes of one rollout."""
    wanted = study.system.measures
    measures: Measures = {}
    try:
        with np.errstate(all="ignore"):
            measures = study.system.run(setting, task.controller, task.seed).measures
        reason = _what_is_wrong(wanted, measures)
    except DivergedError as error:
        reason = str(error)
    except InputError as error:
        raise InputError(f"{_where(task)}: {error}") from error
    except NUMERIC as error:
        reason = _said(error)
    except Exception as error:
        raise RolloutError(f"{_where(task)}: {_said(error)}") from error
    if reason:
        return Trial(OutcomeClass.DIVERGED, reason, dict.fromkeys(wanted))
    return Trial(classify(measures), "", {name: measures[name] for name in wanted})


def _find(study: Study, search: Boundary | Worst, setting: Setting, task: Task) -> Trial:
    """Return what a search at one point finds."""
    place = Place(study.system, study.factors, setting, task.controller, task.seed)
    try:
        return search.find(place, lambda at: _attempt(study, at, task))
    except InputError:
        raise
    except NUMERIC as error:
        return Trial(OutcomeClass.DIVERGED, _said(error), dict.fromkeys(study.measures))


def _where(task: Task) -> str:
    return f"rollout of row {task.row} with {task.controller!r}"


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _trace(study: Study, setting: Setting, task: Task) -> bytes:
    """Return every tick of a rollout that is made once more, as a Parquet file.

    A rollout that ends with an error, and so without a record, leaves a table without rows.
    """
    try:
        with np.errstate(all="ignore"):
            table = study.system.run(setting, task.controller, task.seed, full=True).table
    except DivergedError as error:
        table = error.table
    except Exception:
        table = pl.DataFrame()
    file = io.BytesIO()
    table.write_parquet(file, compression="zstd", statistics=False)
    return file.getvalue()


def _what_is_wrong(wanted: Any, measures: Measures) -> str:
    missing = [name for name in wanted if name not in measures]
    if missing:
        return f"no {', '.join(missing)}"
    known = {name: value for name, value in measures.items() if value is not None}
    wild = [name for name, value in known.items() if not math.isfinite(value)]
    return f"not finite: {', '.join(wild)}" if wild else ""
