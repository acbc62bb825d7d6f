"""Heat maps over two factors: how often rollouts fail, and means of measures."""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import polars as pl

from scenarios import report_style as style
from scenarios.panel import Panel
from scenarios.report_style import number
from scenarios.study.outcome import FAILURES
from scenarios.study.picture.grid import Cell, grid
from scenarios.study.picture.limit import MOST_CELLS, Facet, facets
from scenarios.study.rate import wilson
from scenarios.study.study import Study
from scenarios.study.summary import is_sampled
from scenarios.study.word import (
    entry,
    factor_title,
    heading,
    level_text,
    shown,
    title,
    unit_of,
)

MOST_TEXTS = 200
"""Cells of a map up to which their numbers are written in them."""

RISING = [[0.0, "#f4f6f9"], [0.35, "#9dc0e3"], [0.7, "#3f7fbf"], [1.0, "#123f73"]]
FAILING = [[0.0, "#eef5f0"], [0.25, "#f3d9a4"], [0.6, "#de7f4b"], [1.0, "#8f1c14"]]
BOTH_WAYS = [[0.0, "#8a3b0b"], [0.25, "#e3a56c"], [0.5, "#f4f4f2"], [0.75, "#83b0d8"]]
BOTH_WAYS.append([1.0, "#123f73"])


class Tile(NamedTuple):
    """One cell of a map."""

    x: str
    y: str
    """Levels of the two factors in words."""
    z: float | None
    """None where there is no number."""
    hover: str


def heat_panels(study: Study, table: pl.DataFrame) -> list[Panel]:
    """Return a map of failures, if there are any, and one of each measure that is shown."""
    parts = facets(study, table, study.columns[2:])[:MOST_CELLS]
    panels = []
    kinds = [kind for kind in FAILURES if (table["outcome"] == kind).any()]
    if kinds:
        tiles = [_rates(study, facet.rows, kinds) for facet in parts]
        words = f"Share of rollouts {' or '.join(kinds)}"
        scale = {"colorscale": FAILING, "cmin": 0, "cmax": 100}
        figure = _figure(study, parts, tiles, "%", scale)
        panels.append(Panel("map-failed", words, _caption(study), figure))
    for name in shown(study):
        tiles = [_means(study, facet.rows, name) for facet in parts]
        values = [tile.z for some in tiles for tile in some if tile.z is not None]
        if values:
            figure = _figure(study, parts, tiles, unit_of(study, name), _scale(values))
            words = heading(study, name)
            panels.append(Panel(f"map-{name}", words, _caption(study, table, name), figure))
    return panels


def _rates(study: Study, rows: pl.DataFrame, kinds: Sequence[str]) -> list[Tile]:
    tiles = []
    for x, y, own in _places(study, rows):
        if own.is_empty():
            tiles.append(Tile(x, y, None, "no rollouts yet"))
            continue
        count = int(own["outcome"].is_in(list(kinds)).sum())
        rate, hover = wilson(count, len(own)), f"{count} of {len(own)}"
        if is_sampled(study):
            hover += f", 95 %: {number(100 * rate.low)} … {number(100 * rate.high)} %"
        tiles.append(Tile(x, y, 100 * rate.value, hover))
    return tiles


def _means(study: Study, rows: pl.DataFrame, name: str) -> list[Tile]:
    tiles = []
    for x, y, own in _places(study, rows):
        values = own[name].drop_nulls().to_numpy()
        if not len(values):
            tiles.append(Tile(x, y, None, "no number" if len(own) else "no rollouts yet"))
            continue
        mean = float(values.mean())
        said = f"{entry(name, mean, 4)} {unit_of(study, name)}".strip()
        said += f", mean of {len(values)}" if len(values) > 1 else ""
        tiles.append(Tile(x, y, mean, said))
    return tiles


def _places(study: Study, rows: pl.DataFrame) -> list[tuple[str, str, pl.DataFrame]]:
    """Return each pair of levels of the two factors in words, with its rows, which may be none."""
    first, second = study.columns[:2]
    pairs = itertools.product(
        *([float(x) for x in f.levels(study.design.size)] for f in (first, second))
    )
    parts = rows.partition_by(first.column, second.column, as_dict=True)
    return [
        (level_text(study, first, x), level_text(study, second, y), parts.get((x, y), rows.clear()))
        for x, y in pairs
    ]


def _figure(
    study: Study,
    parts: Sequence[Facet],
    tiles: Sequence[Sequence[Tile]],
    unit: str,
    scale: dict[str, Any],
) -> dict[str, Any]:
    first, second = study.columns[:2]
    hover = f"{first.name} %{{x}}, {second.name} %{{y}}<br>%{{text}}<extra></extra>"
    written = all(len(some) <= MOST_TEXTS for some in tiles)
    cells: list[Cell] = []
    for facet, some in zip(parts, tiles, strict=True):
        drawn: dict[str, Any] = {
            "type": "heatmap",
            **{"x": [t.x for t in some], "y": [t.y for t in some]},
            **{
                "z": [t.z if t.z is None else float(f"{t.z:.5g}") for t in some],
                "text": [t.hover for t in some],
            },
            **{"coloraxis": "coloraxis", "xgap": 1, "ygap": 1},
            "hovertemplate": hover,
        }
        if written:
            drawn |= {"texttemplate": "%{z:.3~g}", "textfont": {"size": 10}}
        axes = [_levels_axis(study, factor) for factor in (first, second)]
        if len(cells) % 2:
            axes[1]["title"] = {"text": ""}
        cells.append(Cell(traces=[drawn], x=axes[0], y=axes[1], title=facet.title))
    figure = grid(cells, 2, height=360)
    bar = {"title": {"text": unit, "side": "right"}, "thickness": 14, "len": 1, "x": 1.01}
    figure["layout"]["coloraxis"] = {**scale, "colorbar": bar}
    figure["layout"]["hovermode"] = "closest"
    figure["layout"]["margin"] |= {"r": 84, "b": 64}
    return figure


def _levels_axis(study: Study, factor: Any) -> dict[str, Any]:
    levels = [level_text(study, factor, float(x)) for x in factor.levels(study.design.size)]
    places = {"type": "category", "categoryorder": "array", "categoryarray": levels}
    return style.axis(factor_title(factor), **places, showgrid=False)


def _scale(values: Sequence[float]) -> dict[str, Any]:
    low, high = min(values), max(values)
    if low < 0 < high:
        reach = max(-low, high)
        return {"colorscale": BOTH_WAYS, "cmin": -reach, "cmax": reach}
    return {"colorscale": RISING, "cmin": low, "cmax": high if high > low else low + 1}


def _caption(study: Study, table: pl.DataFrame | None = None, name: str = "") -> str:
    said = []
    if study.repeats > 1:
        said.append(f"{study.repeats} rollouts at each point.")
    if table is not None:
        of = "Mean of " if study.repeats > 1 else ""
        words = f"{of}{title(study, name)}."
        said.insert(0, words[:1].upper() + words[1:])
        if gone := table[name].null_count():
            said.append(f"{gone} of {len(table)} rollouts have no number and are in no mean.")
    whole = len(study.controllers)
    for factor in study.columns[2:]:
        whole *= len(factor.levels(study.design.size))
    if whole > MOST_CELLS:
        said.append(f"{whole - MOST_CELLS} more maps are left out.")
    return " ".join(said)
