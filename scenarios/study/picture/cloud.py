"""Measures at random points: each rollout against each factor, and the mean along it."""

from typing import Any

import numpy as np
import polars as pl
from jaxtyping import Int

from qpctrl.arrays import Vector
from scenarios.panel import Panel
from scenarios.report_style import trace
from scenarios.study.picture.grid import Cell, columns_for, grid, look, values_axis
from scenarios.study.picture.level import factor_axis
from scenarios.study.study import Study
from scenarios.study.word import heading, short_title, shown

MOST_POINTS = 300
"""Points of one controller in one plot."""
MOST_MEASURES = 3
"""Measures that are drawn, the most telling ones."""
BINS = 12
"""Stretches of a factor, with as many rollouts each, whose means make the curve."""


def cloud_panels(study: Study, table: pl.DataFrame) -> list[Panel]:
    """Return one figure for each measure that is shown, with a plot for each factor."""
    panels = []
    for name in shown(study)[:MOST_MEASURES]:
        known = table.filter(pl.col(name).is_not_null())
        if len(known):
            words = f"{heading(study, name)}, rollout by rollout"
            said, figure = _caption(study, table, name), _figure(study, known, name)
            panels.append(Panel(f"cloud-{name}", words, said, figure))
    return panels


def thinned(y: Vector, most: int) -> Int[np.ndarray, " _"]:
    """Return indices, rising, of ``most`` values at the most, the same every time.

    They are drawn evenly at random, since rows of a design repeat a pattern; the smallest and
    the largest value are among them.
    """
    if len(y) <= most:
        return np.arange(len(y))
    some = np.random.default_rng(0).choice(len(y), most - 2, replace=False)
    return np.unique(np.concatenate([some, [y.argmin(), y.argmax()]]))


def thinned_words(drawn: int, of: int) -> str:
    """Return how many of the rollouts are drawn; nothing where all are."""
    return f"{drawn} of {of} rollouts are drawn, the extremes among them." if drawn < of else ""


def _figure(study: Study, known: pl.DataFrame, name: str) -> dict[str, Any]:
    axis = values_axis(short_title(study, name, 34), known[name].to_numpy())
    cells, columns = [], columns_for(len(study.columns))
    for i, factor in enumerate(study.columns):
        traces: list[dict[str, Any]] = []
        curves: list[dict[str, Any]] = []
        for j, controller in enumerate(study.controllers):
            rows = known.filter(pl.col("controller") == controller)
            x, y = rows[factor.column].to_numpy(), rows[name].to_numpy()
            if not len(y):
                continue
            at, colour = thinned(y, MOST_POINTS), look(j).colour
            dots = {"color": colour, "size": 4, "opacity": 0.35}
            traces.append(
                trace(x[at], y[at], "", mode="markers", marker=dots)
                | {"hovertemplate": "%{x:.4g}, %{y:.4g}<extra></extra>"}
            )
            middle, mean = _along(x, y)
            line = {"color": colour, "width": 2.6}
            curves.append(trace(middle, mean, controller, line=line, hoverinfo="skip"))
        up = axis if i % columns == 0 else axis | {"title": {"text": ""}}
        cells.append(Cell(traces=traces + curves, x=factor_axis(study, factor), y=up))
    figure = grid(cells, columns, share="y", height=240)
    figure["layout"]["hovermode"] = "closest"
    return figure


def _along(x: Vector, y: Vector) -> tuple[Vector, Vector]:
    """Return the means of stretches of ``x`` with as many values each, or of its few values."""
    levels = np.unique(x)
    if len(levels) <= BINS:
        return levels, np.array([y[x == level].mean() for level in levels])
    parts = np.array_split(np.argsort(x, kind="stable"), min(BINS, len(x)))
    return np.array([x[p].mean() for p in parts]), np.array([y[p].mean() for p in parts])


def _caption(study: Study, table: pl.DataFrame, name: str) -> str:
    said = ["Curve: mean along the factor."]
    known = table.filter(pl.col(name).is_not_null())
    counts = known["controller"].value_counts()["count"].to_list()
    words = thinned_words(sum(min(n, MOST_POINTS) for n in counts), len(known))
    if gone := len(table) - len(known):
        said.append(f"{gone} of {len(table)} rollouts have no number and are not drawn.")
    return " ".join([*said, words]).strip()
