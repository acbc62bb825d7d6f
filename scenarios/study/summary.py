"""What the rows of a study say together: outcomes, rates and means, controller by controller."""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix
from scenarios.run import plain
from scenarios.scenario import Criterion
from scenarios.study.importance import FAILED, importance
from scenarios.study.outcome import FAILURES, OutcomeClass
from scenarios.study.rate import (
    Groups,
    bootstrap_means,
    effective_size,
    percentile_interval,
    wilson,
)
from scenarios.study.study import Study
from scenarios.study.word import shown, unit_of, words_of

MEAN_SEED = 0  # of the bootstrap
CONFIDENCE = 0.95  # of all intervals
APART = 0.01
"""Share of a mean difference above which rollouts count as different; less may be round-off."""
FORCE_ERRORS = ("force_mae_N", "force_rmse_N", "force_p95_N", "force_rmse_ratio")
PATH_ERRORS = ("mae_mm", "rmse_mm", "p95_mm", "accuracy_mm")
"""Ends of the names that start with ``position`` or ``path``."""


class Conclusion(NamedTuple):
    """What is found in the rows of a study."""

    criteria: tuple[Criterion, ...]
    summary: dict[str, Any]
    """What summary.json holds."""


def conclude(
    study: Study,
    manifest: Mapping[str, Any],
    table: pl.DataFrame,
    timing: Mapping[str, Any] | None,
) -> Conclusion:
    """Return the verdict on the rows that are there, and all numbers of the report.

    Args:
        study: what was studied.
        manifest: what study.json holds.
        table: its rows; some may be missing, and then it has not passed.
        timing: how long they took, if it is known.
    """
    criteria = study.judge(table)
    complete = len(table) == manifest["rows"]
    said = [{**c._asdict(), "value": plain(c.value), "passed": c.passed} for c in criteria]
    summary = {
        **manifest,
        "passed": complete and all(c.passed for c in criteria),
        "criteria": said,
        **summarise(study, table),
        "timing": timing,
    }
    return Conclusion(criteria, summary)


def summarise(study: Study, table: pl.DataFrame) -> dict[str, Any]:
    """Return counts of outcomes, words of the measures, and what each controller achieved.

    Rates have Wilson intervals, means those of a bootstrap over the rollouts that have the
    measure; both of 95 %. It is draws that count, see `draws_of`, not rollouts. Where the
    rollouts are no sample, ``sampled`` is false and there are none of them. A rollout that
    diverged has no measures and is in no mean. Where the design is made for them,
    ``sensitivity`` holds the indices or effects of the factors.
    """
    names, draws = told(study), draws_of(study, table)
    controllers = {}
    for name in study.controllers:
        own = table["controller"] == name
        controllers[name] = _of_controller(study, names, table.filter(own), draws[own.to_numpy()])
    if is_sampled(study):
        for name, apart in differences(study, table, draws).items():
            controllers[name]["differences"] = apart
    found = {
        "rows_done": len(table),
        "outcomes": _counts(table),
        "measures": {n: {"words": words_of(study, n), "unit": unit_of(study, n)} for n in names},
        "sampled": is_sampled(study),
        "contact": study.search is None and "contact_lost_fraction" in study.measures,
        "controllers": controllers,
    }
    matters = importance(study, table)
    return {**found, "sensitivity": matters} if matters else found


def is_sampled(study: Study) -> bool:
    """Return whether the rollouts are a sample, so that means and rates have intervals.

    One rollout at each point of levels or of a map is none: its points are chosen.
    """
    return study.repeats > 1 or not study.columns or not _is_chosen(study)


def draws_of(study: Study, table: pl.DataFrame) -> Groups:
    """Return the draw of each row. Rows of one draw are alike, those of two are independent.

    Where points are chosen, what is drawn are the random numbers of a repeat, which all its points
    share. Where points are drawn as well, a draw is one of `Design.group`, with all its repeats:
    a point, a block or a trajectory.
    """
    if _is_chosen(study):
        return table["repeat"].to_numpy()
    count = len(study.columns)
    return np.array([study.design.group(row, count) for row in table["row"]], dtype=np.int64)


def _is_chosen(study: Study) -> bool:
    return study.design.kind in ("levels", "map") or not study.columns


def told(study: Study) -> tuple[str, ...]:
    """Return the measures whose means are told.

    Those that are shown, how far they are from their closed forms, those that others publish, and
    the two that are weighed against each other.
    """
    own = shown(study)
    gaps = [f"{name}_gap" for name in own]
    published = [name for one in study.published for name in one.measures]
    along = [one.measure for other in study.published for one in other.along]
    names = dict.fromkeys((*own, *gaps, *published, *along, *(trade_off(study) or ())))
    return tuple(name for name in names if name in study.measures)


def trade_off(study: Study) -> tuple[str, str] | None:
    """Return a force and a position error, those that are shown before others, if it has both."""
    names = dict.fromkeys((*study.show, *study.measures))
    force = [name for name in names if name in FORCE_ERRORS]
    path = [n for n in names if n.startswith(("position_", "path_")) and n.endswith(PATH_ERRORS)]
    return (force[0], path[0]) if force and path else None


def means(
    rows: pl.DataFrame,
    names: tuple[str, ...],
    *,
    draws: Groups | None = None,
    sampled: bool = True,
) -> dict[str, dict[str, float]]:
    """Return the mean of each measure with its interval, over the rollouts that have it.

    Args:
        rows: rollouts.
        names: measures; one that no rollout has is left out.
        draws: the draw of each row, see `draws_of`; not given: each is one of its own.
        sampled: whether the rollouts are a sample.

    Returns:
        ``value, low, high, deviation, min, max, rollouts``; ``low`` and ``high`` are left out
        where they are no sample, or all of one draw, and of one rollout alone they are itself.
    """
    own = np.arange(len(rows)) if draws is None else draws
    groups: dict[bytes, list[str]] = {}  # the same draws are resampled for all that have them
    known = {name: rows[name].is_not_null().to_numpy() for name in names}
    for name in names:
        if known[name].any():
            groups.setdefault(known[name].tobytes(), []).append(name)
    found: dict[str, dict[str, float]] = {}
    for group in groups.values():
        has = known[group[0]]
        values = rows.filter(pl.Series(has)).select(group).to_numpy()
        columns = {"value": values.mean(axis=0)}
        if sampled and len(values) == 1:
            columns |= {"low": values[0], "high": values[0]}
        elif sampled and (count := len(np.unique(own[has]))) > 1:
            resampled = bootstrap_means(values, MEAN_SEED, groups=own[has])
            columns["low"], columns["high"] = percentile_interval(resampled, CONFIDENCE, count)
        columns |= {"min": values.min(axis=0), "max": values.max(axis=0)}
        columns["deviation"] = values.std(axis=0, ddof=min(len(values) - 1, 1))
        for i, name in enumerate(group):
            found[name] = {key: float(column[i]) for key, column in columns.items()}
            found[name]["rollouts"] = len(values)
    return {name: found[name] for name in names if name in found}


def differences(
    study: Study, table: pl.DataFrame, draws: Groups
) -> dict[str, dict[str, dict[str, dict[str, float]]]]:
    """Return how far controllers are from each other, rollout by rollout of the same draws.

    What a draw does to both of them is in neither's favour, and so not in the interval.

    Returns:
        By controller, measure of `shown` or ``failed``, and other controller: ``value``, its mean
        less that of the other one, with ``low, high``; and in how many ``draws`` they differ
        by more than `APART` of it. Only of controllers that have the measure in all their
        rollouts, and of two draws or more.
    """
    failed = table["outcome"].is_in(list(FAILURES)).cast(pl.Float64)
    measures = {**{name: table[name] for name in shown(study)}, FAILED: failed}
    found: dict[str, Any] = {name: {} for name in study.controllers}
    for measure, values in measures.items():
        names, side, own = _side_by_side(study.controllers, table, values, draws)
        pairs = list(itertools.permutations(range(len(names)), 2))
        if not pairs or (count := len(np.unique(own))) < 2:
            continue
        first, second = np.transpose(pairs)
        apart = side[:, first] - side[:, second]
        resampled = bootstrap_means(side, MEAN_SEED, groups=own)
        resampled = resampled[:, first] - resampled[:, second]
        low, high = percentile_interval(resampled, CONFIDENCE, count)
        for k, (i, j) in enumerate(pairs):
            value = float(apart[:, k].mean())
            differ = np.abs(apart[:, k]) > APART * abs(value)
            found[names[i]].setdefault(measure, {})[names[j]] = {
                **{"value": value, "low": float(low[k]), "high": float(high[k])},
                "draws": len(np.unique(own[differ])),
            }
    return found


def _side_by_side(
    controllers: Sequence[str], table: pl.DataFrame, values: pl.Series, draws: Groups
) -> tuple[list[str], Matrix, Groups]:
    """Return controllers that have all their values, these (rows × controllers), and the draws."""
    rows = table.select("row", "repeat", "controller", draw=pl.Series(draws), value=values)
    gaps = dict(rows.group_by("controller").agg(pl.col("value").null_count()).iter_rows())
    names = [name for name in controllers if gaps.get(name) == 0]
    wide = rows.filter(pl.col("controller").is_in(names)).pivot(
        on="controller", index=["row", "repeat", "draw"], values="value", maintain_order=True
    )
    common = wide.drop_nulls().sort("row", "repeat")
    return names, common.select(names).to_numpy(), common["draw"].to_numpy()


def _counts(rows: pl.DataFrame) -> dict[str, int]:
    counts = dict(rows["outcome"].value_counts().iter_rows())
    return {str(kind): int(counts.get(str(kind), 0)) for kind in OutcomeClass}


def _of_controller(
    study: Study, names: tuple[str, ...], rows: pl.DataFrame, draws: Groups
) -> dict[str, Any]:
    counts, outcome = _counts(rows), rows["outcome"]
    kinds = counts if len(rows) else ()
    found: dict[str, Any] = {
        "rows": len(rows),
        "draws": len(np.unique(draws)),
        "outcomes": counts,
        "rates": {kind: _rate(study, outcome == kind, draws) for kind in kinds},
        "measures": means(rows, names, draws=draws, sampled=is_sampled(study)),
    }
    if len(rows):
        found["failed"] = _rate(study, outcome.is_in(list(FAILURES)), draws)
    if study.search is not None:
        found["reasons"] = dict(sorted(Counter(rows["reason"].to_list()).items()))
    return found


def _rate(study: Study, happened: pl.Series, draws: Groups) -> dict[str, float]:
    count, of = int(happened.sum()), len(happened)
    if not is_sampled(study):
        return {"value": count / of}
    worth = effective_size(happened.cast(pl.Float64).to_numpy(), draws)
    return wilson(count, of, CONFIDENCE, worth=worth)._asdict()
