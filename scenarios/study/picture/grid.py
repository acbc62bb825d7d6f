"""Small plots side by side, each with axes of its own, and marks that tell controllers apart."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any, NamedTuple

import numpy as np

from qpctrl.arrays import Vector
from scenarios import report_style as style
from scenarios.report_style import Figure

CELL_HEIGHT = 330  # px
TOP, BOTTOM = 56, 96  # px, of the figure; the legend is at the bottom
GAPS = 0.075, 110.0  # of the width, and in px, between plots: room for the titles of axes

SYMBOLS = (
    *("circle-open", "x-thin-open", "square-open", "diamond-open"),
    *("triangle-up-open", "cross-thin-open", "triangle-down-open", "star-open"),
)
SIZES = (10, 9, 14, 13, 11, 13, 11, 13)
"""Of the symbols [px]; marks at the same place stay visible."""


class Look(NamedTuple):
    """How the marks of one series look."""

    colour: str
    symbol: str
    size: int

    def marker(self, **more: Any) -> dict[str, Any]:
        """Return the marker of a trace."""
        plain = {"color": self.colour, "symbol": self.symbol, "size": self.size}
        return plain | {"line": {"width": 2, "color": self.colour}} | more


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One plot of a grid."""

    traces: list[dict[str, Any]]
    x: Mapping[str, Any]
    """Axis across."""
    y: Mapping[str, Any]
    """Axis up."""
    title: str = ""
    shapes: list[dict[str, Any]] = field(default_factory=list)
    """Of which those with ``xref`` ``x`` and ``yref`` ``y`` or ``y domain`` are moved along."""


def columns_for(count: int) -> int:
    """Return how many of so many cells stand side by side."""
    return 2 if count in (2, 4) else 3


def look(place: int) -> Look:
    """Return the look of the series at a place of its list."""
    return Look(
        style.SERIES[place % len(style.SERIES)],
        SYMBOLS[place % len(SYMBOLS)],
        SIZES[place % len(SIZES)],
    )


def grid(
    cells: Sequence[Cell], columns: int, *, share: str = "", height: int = CELL_HEIGHT
) -> Figure:
    """Return a figure with the cells, row by row.

    Args:
        cells: what to draw; at least one.
        columns: cells side by side, at most.
        share: axes that all cells have in common: ``x``, ``y``, ``xy`` or none.
        height: of a cell [px].
    """
    columns = min(columns, len(cells))
    rows = -(-len(cells) // columns)
    inside = height * rows + GAPS[1] * (rows - 1)
    figure = style.figure([], "", "", height=round(inside + TOP + BOTTOM))
    layout, named = figure["layout"], set[str]()
    layout["margin"] |= {"t": TOP, "b": BOTTOM}
    wide = (1 - GAPS[0] * (columns - 1)) / columns
    for i, cell in enumerate(cells):
        row, column = divmod(i, columns)
        key = "" if i == 0 else str(i + 1)
        left, top = column * (wide + GAPS[0]), 1 - row * (height + GAPS[1]) / inside
        across, up = [left, min(left + wide, 1.0)], [max(top - height / inside, 0.0), top]
        layout[f"xaxis{key}"] = _shared(cell.x, "x", key, share) | {"domain": across}
        layout[f"yaxis{key}"] = _shared(cell.y, "y", key, share) | {"domain": up}
        layout[f"xaxis{key}"]["anchor"], layout[f"yaxis{key}"]["anchor"] = f"y{key}", f"x{key}"
        figure["data"] += [_placed(trace, key, named) for trace in cell.traces]
        layout["shapes"] += [_moved(shape, key) for shape in cell.shapes]
        if cell.title:
            layout["annotations"].append(_title(cell.title, left + wide / 2, top))
    return figure


def values_axis(title: str, values: Vector, *, log: bool = False, **more: Any) -> dict[str, Any]:
    """Return an axis for ``values``, which does not blow up what is but round-off.

    Args:
        title: of the axis.
        values: all that is drawn along it.
        log: whether it is logarithmic, where the values allow it.
        more: keys of the axis.
    """
    if log and values.size and values.min() > 0:
        few = values.max() < 300 * values.min()
        return style.axis(title, type="log", dtick="D2" if few else 1, **more)
    if values.size and np.ptp(values) <= 1e-6 * np.abs(values).max():
        middle, size = float(values.mean()), float(np.abs(values).max())
        more["range"] = [middle - 0.1 * (size or 1), middle + 0.1 * (size or 1)]
    return style.axis(title, **more)


def bars(value: Vector, low: Vector, high: Vector, **more: Any) -> dict[str, Any]:
    """Return error bars from ``low`` to ``high``, for ``error_x`` or ``error_y``; NaN: none."""
    up, down = np.nan_to_num(high - value), np.nan_to_num(value - low)
    plain = {"type": "data", "symmetric": False, "array": up, "arrayminus": down}
    return plain | {"thickness": 1.3, "width": 3} | more


def _shared(axis: Mapping[str, Any], letter: str, key: str, share: str) -> dict[str, Any]:
    return {**axis, **({"matches": letter} if key and letter in share else {})}


def _placed(trace: dict[str, Any], key: str, named: set[str]) -> dict[str, Any]:
    """Return a trace on the axes of its cell; a name stands in the legend once."""
    name = trace.get("name", "")
    shows = bool(name) and name not in named
    if shows:
        named.add(name)
    group = {"legendgroup": name} if name else {}
    return trace | {"xaxis": f"x{key}", "yaxis": f"y{key}", "showlegend": shows} | group


def _moved(shape: dict[str, Any], key: str) -> dict[str, Any]:
    places = {ref: shape[ref] for ref in ("xref", "yref")}
    return shape | {ref: f"{at[0]}{key}{at[1:]}" for ref, at in places.items()}


def _title(words: str, x: float, y: float) -> dict[str, Any]:
    at = {"xref": "paper", "x": x, "yref": "paper", "y": y, "xanchor": "center"}
    look = {"showarrow": False, "yanchor": "bottom", "yshift": 6, "font": {"size": 13}}
    return {"text": f"<b>{escape(words)}</b>", **at, **look}
