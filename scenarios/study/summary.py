"""What the rows of a study say together: outcomes, rates and means, controller by controller."""

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import polars as pl

from scenarios.run import plain
from scenarios.scenario import Criterion
from scenarios.study.importance import importance
from scenarios.study.outcome import FAILURES, OutcomeClass
from scenarios.study.rate import bootstrap_means, percentile_interval, wilson
from scenarios.study.search import Worst
from scenarios.study.study import Study
from scenarios.study.word import shown, unit_of, words_of

MEAN_SEED = 0  # of the bootstrap
CONFIDENCE = 0.95  # of all intervals
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
    measure; both of 95 %. Where the rollouts are no sample, ``sampled`` is false and there are
    none of them. A rollout that diverged has no measures and is in no mean. Where the
    design is made for them, ``sensitivity`` holds the indices or effects of the factors.
    """
    names = told(study)
    found = {
        "rows_done": len(table),
        "outcomes": _counts(table),
        "measures": {n: {"words": words_of(study, n), "unit": unit_of(study, n)} for n in names},
        "sampled": is_sampled(study),
        "contact": study.search is None and "contact_lost_fraction" in study.measures,
        "controllers": {
            name: _of_controller(study, names, table.filter(pl.col("controller") == name))
            for name in study.controllers
        },
    }
    matters = importance(study, table)
    return {**found, "sensitivity": matters} if matters else found


def is_sampled(study: Study) -> bool:
    """Return whether the rollouts are a sample, so that means and rates have intervals.

    One rollout at each point of levels or of a map is none: its points are chosen.
    """
    chosen = study.design.kind in ("levels", "map") and study.repeats == 1
    return isinstance(study.search, Worst) or not chosen or not study.columns


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
    rows: pl.DataFrame, names: tuple[str, ...], *, sampled: bool = True
) -> dict[str, dict[str, float]]:
    """Return the mean of each measure with its interval, over the rollouts that have it.

    Args:
        rows: rollouts.
        names: measures; one that no rollout has is left out.
        sampled: whether the rollouts are a sample.

    Returns:
        ``value, low, high, deviation, min, max, rollouts``; ``low`` and ``high`` are left out
        where they are no sample, and of one rollout alone they are itself.
    """
    groups: dict[bytes, list[str]] = {}  # the same rollouts are drawn for all that have them
    known = {name: rows[name].is_not_null().to_numpy() for name in names}
    for name in names:
        if known[name].any():
            groups.setdefault(known[name].tobytes(), []).append(name)
    found: dict[str, dict[str, float]] = {}
    for group in groups.values():
        values = rows.filter(pl.Series(known[group[0]])).select(group).to_numpy()
        columns = {"value": values.mean(axis=0)}
        if sampled:
            drawn = bootstrap_means(values, MEAN_SEED) if len(values) > 1 else values
            columns["low"], columns["high"] = percentile_interval(drawn, CONFIDENCE)
        columns |= {"min": values.min(axis=0), "max": values.max(axis=0)}
        columns["deviation"] = values.std(axis=0, ddof=min(len(values) - 1, 1))
        for i, name in enumerate(group):
            found[name] = {key: float(column[i]) for key, column in columns.items()}
            found[name]["rollouts"] = len(values)
    return {name: found[name] for name in names if name in found}


def _counts(rows: pl.DataFrame) -> dict[str, int]:
    counts = dict(rows["outcome"].value_counts().iter_rows())
    return {str(kind): int(counts.get(str(kind), 0)) for kind in OutcomeClass}


def _of_controller(study: Study, names: tuple[str, ...], rows: pl.DataFrame) -> dict[str, Any]:
    counts = _counts(rows)
    found: dict[str, Any] = {
        "rows": len(rows),
        "outcomes": counts,
        "rates": {k: _rate(study, n, len(rows)) for k, n in counts.items() if len(rows)},
        "measures": means(rows, names, sampled=is_sampled(study)),
    }
    if len(rows):
        found["failed"] = _rate(study, sum(counts[kind] for kind in FAILURES), len(rows))
    if study.search is not None:
        found["reasons"] = dict(sorted(Counter(rows["reason"].to_list()).items()))
    return found


def _rate(study: Study, count: int, of: int) -> dict[str, float]:
    return wilson(count, of)._asdict() if is_sampled(study) else {"value": count / of}
