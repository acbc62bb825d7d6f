"""Force error against path error: what one costs in the other."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import polars as pl

from qpctrl.arrays import Vector
from scenarios import report_style as style
from scenarios.panel import Panel
from scenarios.report_style import trace
from scenarios.study.pareto import pareto_front
from scenarios.study.picture.cloud import thinned, thinned_words
from scenarios.study.picture.grid import Cell, Look, bars, grid, look, values_axis
from scenarios.study.study import Study
from scenarios.study.summary import trade_off
from scenarios.study.word import title

MOST_POINTS = 400
"""Points of one controller."""
WIDE = 30.0
"""Largest over smallest mean from which on an axis is logarithmic."""


def front_panel(study: Study, table: pl.DataFrame, summary: Mapping[str, Any]) -> Panel | None:
    """Return rollouts, means and their Pareto front; none without both errors, or for one alone.

    Args:
        study: what was studied.
        table: its rows.
        summary: what summary.json holds.
    """
    pair = trade_off(study)
    if pair is None or len(study.controllers) < 2:
        return None
    found = {n: one["measures"] for n, one in summary["controllers"].items()}
    known = {n: one for n, one in found.items() if set(pair) <= one.keys()}
    if not known:
        return None
    clouds, drawn, of = [], 0, 0
    for i, name in enumerate(study.controllers):
        rows = table.filter(pl.col("controller") == name).drop_nulls(list(pair))
        if len(rows):
            clouds.append(_cloud(rows, pair, look(i)))
            drawn, of = drawn + len(clouds[-1]["x"]), of + len(rows)
    means = np.array([[one[m]["value"] for m in pair] for one in known.values()])
    places = [study.controllers.index(name) for name in known]
    marks = [
        _mean(n, one, pair, look(i)) for i, (n, one) in zip(places, known.items(), strict=True)
    ]
    others = _published(study, pair)
    traces = [*clouds, *_front(means), *marks, *others]
    axes = [
        _axis(study, m, np.array([*means[:, k], *_numbers(study, pair, k)]))
        for k, m in enumerate(pair)
    ]
    figure = grid([Cell(traces=traces, x=axes[1], y=axes[0])], 1, height=440)
    figure["layout"]["hovermode"] = "closest"
    intervals = " with 95 % intervals" if summary["sampled"] else ""
    caption = (
        f"Large marks: mean of a controller{intervals}. Line: the front, on which no "
        "other controller is better in both means. Dots: rollouts."
        f"{' Stars: published.' if others else ''} {thinned_words(drawn, of)}"
    )
    return Panel("front", "Force against path", caption.strip(), figure)


def _cloud(rows: pl.DataFrame, pair: tuple[str, str], seen: Look) -> dict[str, Any]:
    y, x = (rows[name].to_numpy() for name in pair)
    at = thinned(y, MOST_POINTS)
    dots = {"color": seen.colour, "size": 4, "opacity": 0.3}
    drawn = trace(x[at], y[at], "", mode="markers", marker=dots)
    return drawn | {"hovertemplate": "%{x:.4g}, %{y:.4g}<extra></extra>"}


def _mean(
    name: str, one: Mapping[str, Mapping[str, float]], pair: tuple[str, str], seen: Look
) -> dict[str, Any]:
    ends = [
        np.array([[one[m].get(k, one[m]["value"])] for k in ("value", "low", "high")]) for m in pair
    ]
    (y, y_low, y_high), (x, x_low, x_high) = ends
    mark = {"color": seen.colour, "size": 13, "symbol": seen.symbol.removesuffix("-open")}
    mark |= {"line": {"color": "white", "width": 1}}
    if "thin" in seen.symbol:
        mark |= {"line": {"color": seen.colour, "width": 3}}
    whiskers = {
        "error_x": bars(x, x_low, x_high, color=seen.colour),
        "error_y": bars(y, y_low, y_high, color=seen.colour),
    }
    drawn = trace(x, y, name, mode="markers", marker=mark)
    return drawn | whiskers | {"hovertemplate": "%{x:.4g}, %{y:.4g}"}


def _front(means: np.ndarray) -> list[dict[str, Any]]:
    """Return the front of the means as a line, if there is more than one of them."""
    best = means[pareto_front(means)]
    if len(best) < 2:
        return []
    best = best[np.argsort(best[:, 1])]
    line = {"color": style.MUTED, "width": 1.4, "dash": "5px,4px"}
    return [trace(best[:, 1], best[:, 0], "front", line=line, hoverinfo="skip")]


def _published(study: Study, pair: tuple[str, str]) -> list[dict[str, Any]]:
    known = [one for one in study.published if set(pair) <= one.measures.keys()]
    if not known:
        return []
    y, x = (np.array([float(one.measures[m]) for one in known]) for m in pair)
    mark = {"symbol": "star", "size": 12, "color": style.INK}
    drawn = trace(x, y, "published", mode="markers+text", marker=mark)
    names = {"text": [one.name for one in known], "textposition": "top center"}
    return [drawn | names | {"hovertemplate": "%{text}: %{x:.4g}, %{y:.4g}<extra></extra>"}]


def _numbers(study: Study, pair: tuple[str, str], place: int) -> list[float]:
    return [
        float(one.measures[pair[place]])
        for one in study.published
        if set(pair) <= one.measures.keys()
    ]


def _axis(study: Study, name: str, means: Vector) -> dict[str, Any]:
    wide = bool(means.min() > 0 and means.max() > WIDE * means.min())
    more = {} if wide else {"rangemode": "tozero"}
    return values_axis(title(study, name), means, log=wide, **more)
