"""Limits that a boundary search found: against the first factor, a curve for each of the second."""

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from scenarios.panel import Panel
from scenarios.study.factor import Factor
from scenarios.study.picture.grid import Cell, grid, look, values_axis
from scenarios.study.picture.level import (
    closed_points,
    factor_axis,
    form,
    marks,
    missing_words,
    points,
)
from scenarios.study.search import Boundary
from scenarios.study.study import Study
from scenarios.study.word import heading, level_text, level_title, short_title, unit_of

MOST_CELLS = 12
"""Plots side by side; more of them are left out, and that is said."""


class Facet(NamedTuple):
    """The rows of one plot."""

    title: str
    rows: pl.DataFrame


def limit_panels(study: Study, table: pl.DataFrame, search: Boundary) -> list[Panel]:
    """Return the limits over a map of two factors or more."""
    name = f"{search.parameter}_limit"
    parts = facets(study, table, study.columns[2:])
    cells = [_cell(study, facet, name, log=search.scale == "log") for facet in parts[:MOST_CELLS]]
    if not any(cell.traces for cell in cells):
        return [Panel(f"limit-{name}", heading(study, name), _caption(study, table, search), None)]
    figure = grid(cells, 1 if len(cells) == 1 else 2, share="xy", height=400)
    figure["layout"]["hovermode"] = "closest"
    left_out = len(parts) - len(cells)
    more = f" {left_out} more plots are left out." if left_out else ""
    caption = _caption(study, table, search) + more
    return [Panel(f"limit-{name}", heading(study, name), caption, figure)]


def facets(study: Study, table: pl.DataFrame, factors: tuple[Factor, ...]) -> list[Facet]:
    """Return the rows of each controller at each value of ``factors``."""
    values = [[float(x) for x in f.levels(study.design.size)] for f in factors]
    found = []
    for controller, at in itertools.product(study.controllers, itertools.product(*values)):
        rows = table.filter(pl.col("controller") == controller)
        said = [controller] if len(study.controllers) > 1 else []
        for factor, value in zip(factors, at, strict=True):
            rows = rows.filter(pl.col(factor.column) == value)
            said.append(level_title(study, factor, value))
        found.append(Facet(", ".join(said), rows))
    return found


def _cell(study: Study, facet: Facet, name: str, *, log: bool) -> Cell:
    first = study.columns[0]
    traces = list(_curves(study, facet.rows, name))
    values = np.concatenate([t["y"] for t in traces]) if traces else np.zeros(0)
    axis = values_axis(short_title(study, name, 54), values, log=log)
    return Cell(traces=traces, x=factor_axis(study, first), y=axis, title=facet.title)


def _curves(study: Study, rows: pl.DataFrame, name: str) -> Iterator[dict[str, Any]]:
    """Yield marks and, where it is known, the closed form, for each value of the second factor."""
    first, second = study.columns[:2]
    unit = unit_of(study, name)
    for i, value in enumerate(second.levels(study.design.size)):
        own, words = rows.filter(pl.col(second.column) == value), level_text(study, second, value)
        seen, found = look(i), points(own, first.column, name)
        series = level_title(study, second, float(value))
        known = closed_points(own, first.column, name)
        if len(known.x):
            curve = form(known, f"{series}, closed form", seen.colour, "dash")
            yield curve | {"hovertemplate": f"{words}: %{{x:.4g}}, %{{y:.4g}}<extra></extra>"}
        if len(found.x):
            drawn = marks(found, series, seen, unit, lines=not len(known.x))
            hover = f"{second.name} {words}: %{{x:.4g}}, %{{y:.4g}} {unit}<extra></extra>"
            yield drawn | {"hovertemplate": hover}


def _caption(study: Study, table: pl.DataFrame, search: Boundary) -> str:
    name = f"{search.parameter}_limit"
    said = []
    closed = f"{name}_closed"
    if closed in study.measures and table[closed].is_not_null().any():
        said.append("Marks: found by bisection. Dashed: closed form.")
    if gone := table[name].null_count():
        why = missing_words(study, table, name)
        where = f"{search.low:g} to {search.high:g}"
        said.append(f"No mark at {gone} of {len(table)} points, searched from {where}: {why}.")
    return " ".join(said)
