"""One rollout of a study: its row in the table, whatever happens on the way."""

import math
import time
from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import numpy as np
import polars as pl

from qpctrl.arrays import Vector
from scenarios.metric import rms
from scenarios.study.study import Measures, Study, Task

SATURATED_SHARE = 0.01  # of the ticks; fewer are passing, as at a start
DEGRADED_FORCE = 0.1  # RMSE over set-point


class OutcomeClass(StrEnum):
    """What became of a rollout; the first that applies, from the worst on."""

    DIVERGED = "diverged"
    """It ended early, or a number is not finite. The row has a reason and no measures."""
    LOST = "lost"
    """The contact was lost: an environment that cannot pull would have let go."""
    SATURATED = "saturated"
    """A limit was active in more than `SATURATED_SHARE` of the ticks."""
    DEGRADED = "degraded"
    """A fallback tick, or a force RMSE above `DEGRADED_FORCE` of the set-point."""
    OK = "ok"


FORCE_MEASURES = (
    *("force_mae_N", "force_rmse_N", "force_p95_N", "force_peak_N", "force_bias_N"),
    "force_rmse_ratio",
)
CLASS_MEASURES = ("contact_lost_fraction", "saturated_fraction", "fallback_ticks")
"""What the class of outcome hangs on, with ``force_rmse_ratio``."""

TIMING = ("elapsed_s",)
"""Columns that differ from run to run."""


def force_measures(force: Vector, set_point: float) -> dict[str, float]:
    """Return the statistics of ``force`` (ticks) [N] around its ``set_point`` [N].

    ``force_p95_N`` is the 95th percentile of the absolute error, ``force_peak_N`` the largest
    force itself, ``force_rmse_ratio`` the RMSE over the set-point.
    """
    error = force - set_point
    size = np.abs(error)
    rmse = rms(error)
    return {
        "force_mae_N": float(size.mean()),
        "force_rmse_N": rmse,
        "force_p95_N": float(np.quantile(size, 0.95)),
        "force_peak_N": float(force.max()),
        "force_bias_N": float(error.mean()),
        "force_rmse_ratio": rmse / set_point,
    }


def classify(measures: Measures) -> OutcomeClass:
    """Return the class of a rollout in which nothing is wild; what it has no number of is 0."""
    names = (*CLASS_MEASURES, "force_rmse_ratio")
    lost, saturated, fallback, rmse = (measures.get(name) or 0.0 for name in names)
    if lost > 0:
        return OutcomeClass.LOST
    if saturated > SATURATED_SHARE:
        return OutcomeClass.SATURATED
    if fallback > 0 or rmse > DEGRADED_FORCE:
        return OutcomeClass.DEGRADED
    return OutcomeClass.OK


def roll_out(study: Study, task: Task) -> dict[str, Any]:
    """Return the row of a rollout; it never raises.

    What goes wrong is an outcome, ``diverged`` with a reason, whose measures are null.
    """
    started = time.perf_counter()
    point = dict(zip((f.name for f in study.factors), task.point, strict=True))
    measures: Measures = {}
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            measures = study.run(point, task.controller, task.seed)
        reason = _what_is_wrong(study, measures)
    except Exception as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    outcome = OutcomeClass.DIVERGED if reason else classify(measures)
    kept = dict.fromkeys(study.measures) if reason else {n: measures[n] for n in study.measures}
    return {
        "identity": task.identity,
        "row": task.row,
        **{f.column: x for f, x in zip(study.factors, task.point, strict=True)},
        "controller": task.controller,
        "seed": task.seed,
        "outcome": str(outcome),
        "reason": reason,
        **kept,
        "elapsed_s": time.perf_counter() - started,
    }


def row_schema(study: Study) -> dict[str, type[pl.DataType]]:
    """Return the columns of a table of rollouts."""
    return {
        "identity": pl.String,
        "row": pl.Int64,
        **{factor.column: pl.Float64 for factor in study.factors},
        **{"controller": pl.String, "seed": pl.Int64, "outcome": pl.String, "reason": pl.String},
        **dict.fromkeys((*study.measures, *TIMING), pl.Float64),
    }


def roll_out_all(study: Study, chunk: Sequence[Task]) -> list[dict[str, Any]]:
    """Return the rows of a chunk of rollouts."""
    return [roll_out(study, task) for task in chunk]


def _what_is_wrong(study: Study, measures: Measures) -> str:
    missing = [name for name in study.measures if name not in measures]
    if missing:
        return f"no {', '.join(missing)}"
    known = {name: value for name, value in measures.items() if value is not None}
    wild = [name for name, value in known.items() if not math.isfinite(value)]
    return f"not finite: {', '.join(wild)}" if wild else ""
