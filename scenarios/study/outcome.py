"""What became of a rollout: one class, and the statistics of force that it hangs on."""

from collections.abc import Mapping
from enum import StrEnum

import numpy as np
import polars as pl

from qpctrl.arrays import Vector
from scenarios.metric import rms, tick_metrics
from scenarios.study.system import Measures

LONG_LOSS = 50.0  # ms out of contact; a controller takes the contact for lost by then
CHATTER = 3  # times that the contact opened
SATURATED_SHARE = 0.01  # of the ticks; fewer are passing, as at a start
DEGRADED_FORCE = 0.1  # RMSE over set-point


class OutcomeClass(StrEnum):
    """What became of a rollout; the first that applies, from the worst on."""

    DIVERGED = "diverged"
    """It left all bounds, or a number is not finite. The row has a reason and no measures."""
    LOST = "lost"
    """Out of contact for `LONG_LOSS` in one piece, or pulled where the environment cannot pull."""
    CHATTER = "chatter"
    """The contact opened `CHATTER` times or more, each time for less than that."""
    SATURATED = "saturated"
    """A limit was active in more than `SATURATED_SHARE` of the ticks."""
    DEGRADED = "degraded"
    """A fallback tick, or a force RMSE above `DEGRADED_FORCE` of the set-point."""
    OK = "ok"


FAILURES = (OutcomeClass.DIVERGED, OutcomeClass.LOST, OutcomeClass.CHATTER)
"""Outcomes of which a full trace of all ticks is kept."""

FORCE_MEASURES = {
    "force_mae_N": "mean absolute force error",
    "force_rmse_N": "root mean square force error",
    "force_p95_N": "95th percentile of the absolute force error",
    "force_peak_N": "largest force",
    "force_bias_N": "mean force error",
    "force_spread_N": "absolute mean + 3 standard deviations of the force error",
    "force_rmse_ratio": "RMS force error over the set-point",
}
"""Words of what `force_measures` returns."""

CONTACT_MEASURES = {
    "contact_lost_fraction": "share of the judged time out of contact",
    "longest_loss_ms": "longest time out of contact in one piece",
    "contact_breaks": "times that the contact opened",
}
"""Words of what `contact_measures` returns."""

TICK_MEASURES = {
    "saturated_fraction": "share of the ticks with a limit active",
    "fallback_ticks": "ticks that sent the fallback torque",
    "qp_law_gap_max": "QP against the hybrid law, worst unsaturated tick",
}
"""Words of what every rollout can say of its ticks."""


def force_measures(force: Vector, set_point: float) -> dict[str, float]:
    """Return the statistics of ``force`` (ticks) [N] around its ``set_point`` [N]."""
    error = force - set_point
    size = np.abs(error)
    rmse = rms(error)
    return {
        "force_mae_N": float(size.mean()),
        "force_rmse_N": rmse,
        "force_p95_N": float(np.quantile(size, 0.95)),
        "force_peak_N": float(force.max()),
        "force_bias_N": float(error.mean()),
        "force_spread_N": float(abs(error.mean()) + 3 * error.std()),
        "force_rmse_ratio": rmse / set_point,
    }


def contact_measures(touching: Vector, dt: float) -> dict[str, float]:
    """Return share, longest piece and number of times out of contact.

    Args:
        touching: whether there is contact, tick by tick.
        dt: period [s].
    """
    open_ = np.concatenate(([False], ~touching.astype(bool), [False]))
    edges = np.flatnonzero(np.diff(open_.astype(np.int8)))
    pieces = edges[1::2] - edges[::2]
    return {
        "contact_lost_fraction": float(np.mean(~touching.astype(bool))),
        "longest_loss_ms": 1e3 * dt * float(pieces.max(initial=0)),
        "contact_breaks": float(len(pieces)),
    }


def tick_measures(table: pl.DataFrame) -> Measures:
    """Return what the ticks of a ``table`` say; no gap where every tick is saturated."""
    found = tick_metrics(table)
    return {name: None if np.isnan(found[name]) else found[name] for name in TICK_MEASURES}


def counts_text(outcomes: Mapping[str, int]) -> str:
    """Return how many rollouts ended in which class, in words; classes without any are left out."""
    return ", ".join(f"{count} {kind}" for kind, count in outcomes.items() if count)


def classify(measures: Measures) -> OutcomeClass:
    """Return the class of a rollout in which nothing is wild; what it has no number of is 0."""
    if _of(measures, "longest_loss_ms") >= LONG_LOSS:
        return OutcomeClass.LOST
    if _of(measures, "contact_breaks") >= CHATTER:
        return OutcomeClass.CHATTER
    if _of(measures, "saturated_fraction") > SATURATED_SHARE:
        return OutcomeClass.SATURATED
    if _of(measures, "fallback_ticks") > 0 or _of(measures, "force_rmse_ratio") > DEGRADED_FORCE:
        return OutcomeClass.DEGRADED
    return OutcomeClass.OK


def _of(measures: Measures, name: str) -> float:
    return measures.get(name) or 0.0
