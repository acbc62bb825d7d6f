"""What matters in a study: indices or effects of its factors, from its rows.

Rows are brought into the order of the design. What is missing there – a rollout that diverged,
one that is not made yet – is no number, and its block or trajectory is left out whole.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl
from scipy.special import ndtr

from qpctrl.arrays import Matrix, Vector
from qpctrl.errors import InputError
from scenarios.study.factor import SIGMAS, Factor
from scenarios.study.outcome import FAILURES
from scenarios.study.rate import Rate
from scenarios.study.sensitivity import morris_effects, sobol_indices
from scenarios.study.study import Study
from scenarios.study.word import shown

SEED = 0  # of the bootstrap
FAILED = "failed"
"""Name of the indicator: 1 where a rollout diverged, lost contact or chattered, else 0."""


def importance(study: Study, table: pl.DataFrame) -> dict[str, Any]:
    """Return indices or effects of each measure of `shown`, by controller; nothing without them.

    Args:
        study: whose design says which of the two, ``indices`` or ``morris``; what is explained is
            the mean of its repeats.
        table: its rows, of which some may be missing.

    Returns:
        By controller and measure: ``first`` and ``total``, or ``mu_star`` (with intervals), ``mu``
        and ``sigma``, one for each factor, and how many blocks or trajectories were used; a
        ``note`` where they cannot be had.
    """
    if study.design.kind not in ("indices", "morris"):
        return {}
    found: dict[str, Any] = {}
    for controller in study.controllers:
        rows = table.filter(pl.col("controller") == controller)
        values = {name: _in_order(study, rows, rows[name]).mean(1) for name in shown(study)}
        failed = rows["outcome"].is_in(list(FAILURES)).cast(pl.Float64)
        if 0 < failed.sum() < len(failed):
            values[FAILED] = _in_order(study, rows, failed).mean(1)
        found[controller] = {name: _of(study, rows, y) for name, y in values.items()}
    return {"factors": [factor.name for factor in study.columns], "controllers": found}


def ranking(one: Mapping[str, Any], factors: Sequence[str]) -> list[tuple[str, dict[str, float]]]:
    """Return factors with their total index, or with μ*, the most telling first.

    Args:
        one: what `importance` found for a controller and measure; with a ``note`` there is none.
        factors: their names, in the order of the design.
    """
    rates = one.get("total") or one.get("mu_star") or []
    known = [pair for pair in zip(factors, rates, strict=False) if pair[1]["value"] is not None]
    return sorted(known, key=lambda pair: pair[1]["value"], reverse=True)


def share(factor: Factor, values: Vector) -> Vector:
    """Return where ``values`` of a factor lie in its range, 0 to 1, in its distribution.

    Whole numbers and given values are equally spaced.
    """
    if factor.values:
        place = {value: i for i, value in enumerate(factor.values)}
        at = np.array([place.get(value, math.nan) for value in values.tolist()])
        return at / max(len(place) - 1, 1)
    if factor.distribution == "log-uniform" and not factor.whole:
        return np.log(values / factor.low) / math.log(factor.high / factor.low)
    centred = (values - factor.low) / (factor.high - factor.low)
    if factor.distribution == "normal" and not factor.whole:
        tail = float(ndtr(-SIGMAS))
        return (ndtr(SIGMAS * (2 * centred - 1)) - tail) / (1 - 2 * tail)
    return centred


def _of(study: Study, rows: pl.DataFrame, y: Vector) -> dict[str, Any]:
    try:
        return _morris(study, rows, y) if study.design.kind == "morris" else _sobol(study, y)
    except InputError as error:
        return {"note": str(error)}


def _sobol(study: Study, y: Vector) -> dict[str, Any]:
    found = sobol_indices(y, len(study.columns), SEED)
    used = {"blocks": found.blocks, "blocks_used": found.blocks_used}
    if np.isnan(found.first).all():
        return {"note": "the same in all rollouts", **used}
    first = zip(found.first, found.first_low, found.first_high, strict=True)
    total = zip(found.total, found.total_low, found.total_high, strict=True)
    return {
        "first": [_rate(*one) for one in first],
        "total": [_rate(*one) for one in total],
        **used,
    }


def _morris(study: Study, rows: pl.DataFrame, y: Vector) -> dict[str, Any]:
    columns = [_in_order(study, rows, rows[f.column]).max(1) for f in study.columns]
    points = np.column_stack([share(f, x) for f, x in zip(study.columns, columns, strict=True)])
    whole, values = _whole_trajectories(points, y)
    found = morris_effects(whole, values, SEED)
    stars = zip(found.mu_star, found.mu_star_low, found.mu_star_high, strict=True)
    return {
        "mu_star": [_rate(*one) for one in stars],
        "mu": found.mu.tolist(),
        "sigma": found.sigma.tolist(),
        "trajectories": len(points) // (len(study.columns) + 1),
        "trajectories_used": found.trajectories_used,
    }


def _whole_trajectories(points: Matrix, y: Vector) -> tuple[Matrix, Vector]:
    """Return the trajectories all of whose points are known."""
    count = points.shape[1]
    known = ~np.isnan(points).any(axis=1).reshape(-1, count + 1).any(axis=1)
    return points[np.repeat(known, count + 1)], y[np.repeat(known, count + 1)]


def _in_order(study: Study, rows: pl.DataFrame, values: pl.Series) -> Matrix:
    """Return values in the order of the design (rows × repeats); NaN where there is none."""
    each = len(study.columns) + (2 if study.design.kind == "indices" else 1)
    grid = np.full((study.design.size * each, study.repeats), np.nan)
    numbers = values.cast(pl.Float64).fill_null(np.nan).to_numpy()
    grid[rows["row"].to_numpy(), rows["repeat"].to_numpy()] = numbers
    return grid


def _rate(value: float, low: float, high: float) -> dict[str, float | None]:
    known = Rate(*(float(x) for x in (value, low, high)))
    return {key: x if math.isfinite(x) else None for key, x in known._asdict().items()}
