"""Measures against each factor while the others rest: marks over the closed form."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from qpctrl.arrays import Vector
from scenarios import report_style as style
from scenarios.panel import Panel
from scenarios.report_style import trace
from scenarios.study.factor import Factor
from scenarios.study.picture.grid import (
    Cell,
    Look,
    bars,
    columns_for,
    grid,
    look,
    values_axis,
)
from scenarios.study.search import Boundary
from scenarios.study.study import Study
from scenarios.study.summary import means
from scenarios.study.word import factor_title, heading, level_text, short_title, shown, unit_of

SAME_FORM = 1e-3
"""Largest difference, over the range, of closed forms that are drawn as one."""


class Points(NamedTuple):
    """A measure at the levels of a factor, in rising order of these."""

    x: Vector
    """Levels at which there is a number [unit of the factor]."""
    mean: Vector
    """Mean over the repeats [unit of the measure]."""
    low: Vector
    high: Vector
    """Its interval, of 95 %; the mean itself where there is one rollout."""


def level_panels(study: Study, table: pl.DataFrame) -> list[Panel]:
    """Return one figure for each measure that is shown, with a plot for each factor."""
    return [panel for name in shown(study) if (panel := _panel(study, table, name)).figure]


def points(rows: pl.DataFrame, column: str, measure: str) -> Points:
    """Return a measure at each value of ``column``; rows without it are left out."""
    found = []
    known = rows.filter(pl.col(measure).is_not_null()).sort(column)
    for (x,), level in known.group_by(column, maintain_order=True):
        one = means(level, (measure,))[measure]
        found.append((x, one["value"], one["low"], one["high"]))
    return Points(*np.array(found, dtype=np.float64).reshape(-1, 4).T)


def closed_points(rows: pl.DataFrame, column: str, measure: str) -> Points:
    """Return the closed form of a measure at each value of ``column`` at which it is known."""
    closed = f"{measure}_closed"
    if closed not in rows.columns:
        return Points(*np.zeros((4, 0)))
    known = rows.drop_nulls(closed).group_by(column).agg(pl.col(closed).mean()).sort(column)
    x, y = known[column].to_numpy(), known[closed].to_numpy()
    return Points(x, y, y, y)


def blocks(study: Study, table: pl.DataFrame) -> list[tuple[Factor, pl.DataFrame]]:
    """Return each factor with the rows in which it alone varies."""
    if len(study.columns) == 1:
        return [(study.columns[0], table)]
    found, start = [], 0
    for factor in study.columns:
        end = start + len(factor.levels(study.design.size))
        found.append((factor, table.filter(pl.col("row").is_between(start, end - 1))))
        start = end
    return found


def factor_axis(study: Study, factor: Factor) -> dict[str, Any]:
    """Return the axis of a factor."""
    if study.system.parameters[factor.name].choices:
        levels = [float(x) for x in factor.levels(study.design.size)]
        names = [level_text(study, factor, x) for x in levels]
        return style.axis(factor_title(factor), tickvals=levels, ticktext=names)
    values = np.array([factor.low, factor.high])
    log = factor.distribution == "log-uniform"
    return values_axis(factor_title(factor), values, log=log)


def marks(at: Points, name: str, seen: Look, unit: str, *, lines: bool) -> dict[str, Any]:
    """Return a measure at its levels, with intervals where there are any."""
    mode = "lines+markers" if lines else "markers"
    line = {"color": seen.colour, "width": 1.2, "dash": "dot"}
    hover = f"%{{y:.5g}} {unit}"
    drawn = trace(at.x, at.mean, name, mode=mode, marker=seen.marker(), line=line)
    if (at.high > at.low).any():
        drawn["error_y"] = bars(at.mean, at.low, at.high, color=seen.colour)
    return drawn | {"hovertemplate": hover}


def _panel(study: Study, table: pl.DataFrame, name: str) -> Panel:
    parts = blocks(study, table)
    drawn = [(factor, _traces(study, factor, rows, name)) for factor, rows in parts]
    everything = [t["y"] for _, traces in drawn for t in traces]
    figure = None
    if everything:
        columns = columns_for(len(parts))
        log = isinstance(study.search, Boundary) and study.search.scale == "log"
        axis = values_axis(short_title(study, name), np.concatenate(everything), log=log)
        cells = [
            Cell(
                traces=traces,
                x=factor_axis(study, factor),
                y=axis if i % columns == 0 else axis | {"title": {"text": ""}},
                shapes=_failures(study, factor, rows, name),
            )
            for i, ((factor, traces), (_, rows)) in enumerate(zip(drawn, parts, strict=True))
        ]
        figure = grid(cells, columns, share="y")
    return Panel(f"level-{name}", heading(study, name), _caption(study, table, name), figure)


def _traces(study: Study, factor: Factor, rows: pl.DataFrame, name: str) -> list[dict[str, Any]]:
    by = [rows.filter(pl.col("controller") == c) for c in study.controllers]
    forms = _forms(study, by, factor, name)
    traces = []
    for i, (controller, own) in enumerate(zip(study.controllers, by, strict=True)):
        at = points(own, factor.column, name)
        whole = len(at.x) == own[factor.column].n_unique()  # else a line would hide the hole
        if len(at.x):
            lines = whole and not forms
            traces.append(marks(at, controller, look(i), unit_of(study, name), lines=lines))
    return [*forms, *traces, *_published(study, factor, name)]


def _published(study: Study, factor: Factor, name: str) -> list[dict[str, Any]]:
    """Return what others report along the factor, as stars."""
    found = []
    for other in study.published:
        for one in other.along:
            if (one.factor, one.measure) == (factor.name, name):
                mark = {"symbol": "star", "size": 11, "color": style.INK}
                x, y = np.array(one.at), np.array(one.values)
                drawn = trace(x, y, f"{other.name}, published", mode="markers", marker=mark)
                found.append(drawn | {"hovertemplate": f"%{{y:.5g}} {unit_of(study, name)}"})
    return found


def _forms(
    study: Study, by: Sequence[pl.DataFrame], factor: Factor, name: str
) -> list[dict[str, Any]]:
    """Return the closed forms as curves, one for all controllers that share it."""
    found = [closed_points(rows, factor.column, name) for rows in by]
    if _alike(found):
        shared = closed_points(pl.concat(by), factor.column, name)
        return [form(shared, "closed form", style.INK)] if len(shared.x) else []
    known = zip(study.controllers, found, strict=True)
    return [
        form(at, f"closed form, {controller}", look(i).colour)
        for i, (controller, at) in enumerate(known)
        if len(at.x)
    ]


def form(at: Points, name: str, colour: str, dash: str = "solid") -> dict[str, Any]:
    """Return a closed form as a curve."""
    return trace(
        at.x,
        at.mean,
        name,
        line={"color": colour, "width": 1.6, "dash": dash},
        hovertemplate="%{y:.5g}",
    )


def _alike(forms: Sequence[Points]) -> bool:
    """Return whether the forms agree wherever two of them are known."""
    x, y = (np.concatenate([at[i] for at in forms]) for i in (0, 1))
    if not len(y):
        return True
    reach = max(float(np.ptp(y)), 1e-6 * float(np.abs(y).max()))
    return all(float(np.ptp(y[x == level])) <= SAME_FORM * reach for level in np.unique(x))


def _failures(study: Study, factor: Factor, rows: pl.DataFrame, name: str) -> list[dict[str, Any]]:
    """Return a tick at the upper edge for each setting at which a rollout has no number."""
    ticks = []
    for i, controller in enumerate(study.controllers):
        gone = rows.filter((pl.col("controller") == controller) & pl.col(name).is_null())
        high = 1 - 0.05 * i
        for x in gone[factor.column].unique().sort().to_list():
            line = {"color": look(i).colour, "width": 4}
            place = {
                "xref": "x",
                "x0": x,
                "x1": x,
                "yref": "y domain",
                "y0": high - 0.04,
                "y1": high,
            }
            ticks.append({"type": "line", **place, "line": line})
    return ticks


def _caption(study: Study, table: pl.DataFrame, name: str) -> str:
    said = []
    if len(study.columns) > 1:
        said.append("One factor varies, the others rest.")
    if f"{name}_closed" in study.measures and table[f"{name}_closed"].is_not_null().any():
        said.append("Marks: measured. Line: closed form.")
    if study.repeats > 1:
        said.append(f"Mean of {study.repeats} rollouts with its 95 % interval.")
    if any(one.measure == name for other in study.published for one in other.along):
        said.append("Stars: published.")
    if gone := table[name].null_count():
        why = missing_words(study, table, name)
        said.append(f"{gone} of {len(table)} have no number ({why}): ticks at the upper edge.")
    return " ".join(said)


def missing_words(study: Study, table: pl.DataFrame, name: str) -> str:
    """Return why rows have no number, with how many of them."""
    gone = table.filter(pl.col(name).is_null())
    kind = pl.col("reason") if study.search is not None else pl.col("outcome")
    counts = gone.group_by(kind.alias("why"), maintain_order=True).len()
    return ", ".join(f"{count} {why or 'no reason given'}" for why, count in counts.iter_rows())
