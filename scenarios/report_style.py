"""How the report looks: colours, page style, and the parts that its figures are made of.

A figure is data for plotly.js, plain dictionaries, built in milliseconds. Long series are
thinned before they are drawn: the smallest and the largest value of each bucket stay, so a peak
of a single tick is still there.
"""

import math
from base64 import b64encode
from html import escape
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import polars as pl
from jaxtyping import Int

from qpctrl.arrays import Array, Matrix, Vector

Figure: TypeAlias = dict[str, Any]
"""``data`` and ``layout`` of plotly.js."""
Indices: TypeAlias = Int[np.ndarray, " _"]

BUCKETS = 1200  # of a line, two points each: more than a screen has columns
MAX_SHADES = 80  # stretches of phases that are drawn; the shortest go first
HALVES = ([0.47, 1.0], [0.0, 0.37])  # of a figure with two panels

INK, MUTED, GRID = "#1f2933", "#66727f", "#e3e7ec"
PASS, FAIL, LIMIT = "#17703d", "#b3261e", "#b3261e"
BOARD, SWEPT, CHALK, MARK = "#24463c", "#3d6155", "#f6f3e8", "#f4c542"
SERIES = ("#1f5fa8", "#d9730d", "#2b8a5b", "#b0307a", "#7a5bc0", "#8a6d1d", "#3596a6", "#5c6670")
"""Line colours, told apart by people with colour-blindness too; used in turn."""

PHASES = {
    "approach": "#eef2f8",
    "touch": "#fbe3b8",
    "press": "#fbdccb",
    "wipe": "#e3f2e6",
    "release": "#ecdcf2",
    "lift": "#eef2f8",
}
"""Background of each phase; a phase that is not listed takes the next of `OTHER_PHASES`."""
OTHER_PHASES = ("#e3f2e6", "#e6eefb", "#fbe3b8", "#ecdcf2", "#fbdccb")

FONT = (
    "system-ui, -apple-system, 'Segoe UI', 'Helvetica Neue', 'Liberation Sans', Arial, sans-serif"
)

CSS = f"""
:root {{ color-scheme: light; }}
* {{ box-sizing: border-box; }}
body {{ margin: 0; background: #f4f5f7; color: {INK}; font: 16px/1.5 {FONT}; }}
main {{ max-width: 1180px; margin: 0 auto; padding: 32px 24px 64px; }}
header {{ display: flex; gap: 24px; justify-content: space-between; align-items: center;
  flex-wrap: wrap; margin-bottom: 24px; }}
header > div:first-child {{ flex: 1 1 480px; }}
.kicker {{ color: {MUTED}; font-size: 14px; letter-spacing: .04em; }}
h1 {{ font-size: 38px; line-height: 1.15; margin: 2px 0 6px; overflow-wrap: anywhere; }}
h2 {{ font-size: 19px; margin: 0 0 4px; }}
h3 {{ font-size: 15px; margin: 20px 0 6px; }}
p {{ margin: 0 0 10px; max-width: 88ch; }}
.verdict {{ padding: 14px 26px; border-radius: 10px; color: white; text-align: center; }}
.verdict strong {{ display: block; font-size: 30px; line-height: 1.15; letter-spacing: .03em; }}
.verdict span {{ font-size: 14px; }}
.passed {{ background: {PASS}; }} .failed {{ background: {FAIL}; }}
.good {{ color: {PASS}; font-weight: 600; }} .bad {{ color: {FAIL}; font-weight: 600; }}
section, details {{ background: white; border: 1px solid {GRID}; border-radius: 10px;
  padding: 20px 22px; margin-bottom: 18px; overflow-x: auto; }}
section.notes {{ border-left: 6px solid {FAIL}; }}
section ul {{ margin: 6px 0 0; padding-left: 22px; }}
.pair {{ display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 18px; }}
.caption {{ color: {MUTED}; font-size: 14px; margin-bottom: 8px; }}
.tiles {{ display: grid; grid-template-columns: repeat(4, minmax(0, 1fr)); gap: 12px;
  margin-bottom: 18px; }}
.tile {{ background: white; border: 1px solid {GRID}; border-radius: 10px; padding: 12px 16px; }}
.tile b {{ display: block; font-size: 23px; line-height: 1.25; font-weight: 600; }}
.tile b small {{ font-size: 14px; font-weight: 400; color: {MUTED}; }}
.tile span {{ color: {MUTED}; font-size: 13px; }}
table {{ border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }}
th, td {{ text-align: left; padding: 7px 12px 7px 0; border-bottom: 1px solid {GRID};
  overflow-wrap: break-word; vertical-align: top; }}
th {{ color: {MUTED}; font-weight: 500; font-size: 13px; }}
tr:last-child td {{ border-bottom: 0; }}
.good, .bad {{ white-space: nowrap; }} details td:first-child {{ width: 36%; }}
td.n, th.n {{ text-align: right; padding-right: 20px; white-space: nowrap; }}
code {{ font-family: ui-monospace, 'DejaVu Sans Mono', monospace; font-size: 13px;
  color: {MUTED}; }}
summary {{ cursor: pointer; font-weight: 600; }}
footer {{ color: {MUTED}; font-size: 13px; }}
@media (max-width: 860px) {{ .pair {{ grid-template-columns: minmax(0, 1fr); }}
  .tiles {{ grid-template-columns: repeat(2, minmax(0, 1fr)); }} }}
@media print {{ body {{ background: white; }} section {{ break-inside: avoid; }} }}
"""


class Span(NamedTuple):
    """A stretch of time spent in one phase."""

    phase: str
    start: float
    """Start [s]."""
    end: float
    """End [s]."""


def column(table: pl.DataFrame, name: str) -> Vector:
    """Return a column as numbers; NaN where there is none or it is not finite."""
    if name not in table.columns:
        return np.full(len(table), np.nan)
    values = table[name].cast(pl.Float64).fill_null(np.nan).to_numpy()
    return np.where(np.isfinite(values), values, np.nan)


def thin(y: Vector, buckets: int = BUCKETS) -> Indices:
    """Return indices, rising, that keep the extremes of each bucket of ``y`` and both ends."""
    n = len(y)
    if n <= 2 * buckets:
        return np.arange(n)
    width = -(-n // buckets)
    padded = np.full(width * -(-n // width), np.nan)
    padded[:n] = y
    blocks = padded.reshape(-1, width)
    lowest = np.where(np.isnan(blocks), np.inf, blocks).argmin(1)
    highest = np.where(np.isnan(blocks), -np.inf, blocks).argmax(1)
    first = np.arange(len(blocks)) * width
    return np.unique(np.r_[0, first + lowest, first + highest, n - 1])


def spans(table: pl.DataFrame) -> list[Span]:
    """Return the stretches of each phase, in the order of time."""
    if table.is_empty() or "phase" not in table.columns:
        return []
    time, phase = column(table, "time"), table["phase"].to_numpy()
    starts = np.r_[0, np.flatnonzero(phase[1:] != phase[:-1]) + 1]
    ends = np.r_[starts[1:], len(phase) - 1]
    return [
        Span(str(phase[i]), float(time[i]), float(time[j]))
        for i, j in zip(starts, ends, strict=True)
    ]


@np.errstate(over="ignore")  # a run that diverged may leave single precision
def packed(values: Array) -> dict[str, str]:
    """Return numbers as plotly.js reads them fastest, in single precision, for JSON."""
    return {"dtype": "f4", "bdata": b64encode(values.astype("<f4").tobytes()).decode()}


def trace(x: Vector, y: Vector, name: str, **more: Any) -> dict[str, Any]:
    """Return a curve with all its points; the name is escaped."""
    plain = {"type": "scatter", "mode": "lines", "name": escape(name)}
    return plain | {"x": x, "y": y} | more


def line(time: Vector, y: Vector, name: str, colour: str, unit: str, **more: Any) -> dict[str, Any]:
    """Return a thinned curve over time [s]; ``width`` and ``dash`` are those of the line."""
    at = thin(y)
    look = {"color": colour, "width": more.pop("width", 1.4), "dash": more.pop("dash", "solid")}
    hover = f"%{{y:.4g}} {unit}"
    return trace(time[at], y[at], name, line=look, hovertemplate=hover, **more)


def envelope(time: Vector, y: Vector, buckets: int = 500) -> tuple[Vector, Vector]:
    """Return the largest value of each bucket, and when it occurred [s]."""
    width = max(1, -(-len(y) // buckets))
    padded = np.full(width * -(-len(y) // width), np.nan)
    padded[: len(y)] = y
    blocks = padded.reshape(-1, width)
    at = np.where(np.isnan(blocks), -np.inf, blocks).argmax(1) + np.arange(len(blocks)) * width
    return time[at], y[at]


def axis(title: str, **more: Any) -> dict[str, Any]:
    """Return an axis with its title."""
    plain = {
        "title": {"text": title, "standoff": 8},
        "gridcolor": GRID,
        "zerolinecolor": "#b9c1ca",
        "ticks": "outside",
        "tickcolor": GRID,
        "automargin": True,
        "exponentformat": "power",
    }
    return plain | more


def figure(traces: list[dict[str, Any]], x: str, y: str, height: int = 420) -> Figure:
    """Return a figure with titled axes; traces without a single number are left out."""
    layout = {
        "height": height,
        "margin": {"l": 64, "r": 16, "t": 64, "b": 92},
        "font": {"family": FONT, "size": 13, "color": INK},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "hovermode": "x unified",
        "hoverlabel": {"font": {"size": 12}},
        "legend": {"orientation": "h", "x": 0, "y": 0, "yref": "container", "yanchor": "bottom"},
        "modebar": {"remove": ["select2d", "lasso2d", "autoScale2d"], "color": "#9aa5b1"},
        "xaxis": axis(x),
        "yaxis": axis(y),
        "shapes": [],
        "annotations": [],
    }
    return {"data": [t for t in traces if _has_numbers(t)], "layout": layout}


def add_panel(figure: Figure, trace: dict[str, Any], title: str, reach: list[float] | None) -> None:
    """Add a second panel below, with the same time axis and the range ``reach``."""
    layout = figure["layout"]
    figure["data"].append(trace | {"yaxis": "y2"})
    layout["yaxis"]["domain"], below = HALVES
    layout["yaxis2"] = axis(title, domain=below, anchor="x", range=reach)
    layout["xaxis"]["anchor"] = "y2"


def add_limit(figure: Figure, y: float, words: str, yaxis: str = "y", anchor: str = "top") -> None:
    """Add a dashed horizontal line with words at its right end."""
    log = figure["layout"]["yaxis"].get("type") == "log" and yaxis == "y"
    span = {"xref": "paper", "x0": 0, "x1": 1, "yref": yaxis, "y0": y, "y1": y}
    dashed = {"color": LIMIT, "width": 1.2, "dash": "dash"}
    figure["layout"]["shapes"].append({"type": "line", **span, "line": dashed})
    if words:
        note = {"text": words, "showarrow": False, "font": {"size": 11, "color": LIMIT}}
        at = {"xref": "paper", "x": 0.62, "xanchor": "center", "yref": yaxis}
        height = float(np.log10(y)) if log else y
        bottom_of_text = "bottom" if anchor == "top" else "top"
        figure["layout"]["annotations"].append(
            note | at | {"y": height, "yanchor": bottom_of_text, "bgcolor": "rgba(255,255,255,.7)"}
        )


def shade(figure: Figure, stretches: list[Span], pixels: int = 1020) -> Figure:
    """Shade the phases and name them above the plot of about that width, where there is room.

    A stretch too narrow for its name is named only if it is the first of its phase.
    """
    if not stretches:
        return figure
    begin, end = stretches[0].start, max(stretches[-1].end, stretches[0].start + 1e-9)
    free_from = [-30.0, -30.0]  # pixel up to which each of two lines of labels is taken
    named: set[str] = set()
    others = iter(OTHER_PHASES * (1 + len(stretches)))
    colours = dict(PHASES)
    shown = sorted(sorted(stretches, key=lambda s: s.start - s.end)[:MAX_SHADES], key=_start)
    for phase, start, stop in shown:
        colour = colours.setdefault(phase, next(others) if phase not in colours else "")
        box = {"xref": "x", "x0": start, "x1": stop, "yref": "paper", "y0": 0, "y1": 1}
        fill = {"fillcolor": colour, "line": {"width": 0}, "layer": "below"}
        figure["layout"]["shapes"].append({"type": "rect", **box, **fill})
        half, scale = 3.6 * len(phase) + 3, pixels / (end - begin)
        centre = scale * ((start + stop) / 2 - begin)
        if phase in named and scale * (stop - start) < 2 * half:
            continue
        named.add(phase)
        for row, taken in enumerate(free_from):
            if centre - half >= taken - 3:
                figure["layout"]["annotations"].append(_phase_label(phase, start, stop, row))
                free_from[row] = centre + half
                break
    figure["layout"]["xaxis"]["range"] = [begin, end]
    return figure


def symmetric(values: Vector | Matrix) -> list[float] | None:
    """Return a range around zero that holds all values; none if there are none."""
    finite = np.abs(values[np.isfinite(values)])
    largest = float(finite.max()) if finite.size else 0.0
    return [-1.15 * largest, 1.15 * largest] if largest > 0 else None


def number(value: object, digits: int = 3) -> str:
    """Return a number with ``digits`` significant ones: 0.0307, 12 300, 4.21·10⁻¹³, n/a."""
    if value is None or isinstance(value, bool) or not isinstance(value, int | float):
        return "n/a" if value is None else str(value)
    if not math.isfinite(value):
        return "n/a" if math.isnan(value) else ("∞" if value > 0 else "−∞")
    if value == 0:
        return "0"
    if not 1e-3 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        text = f"10{power}" if mantissa == "1" else f"{mantissa}·10{power}"
    elif abs(value) >= 10 ** (digits - 1):
        text = f"{value:,.0f}".replace(",", "\u202f")
    else:
        text = f"{value:.{digits}g}"
    return text.replace("-", "−")


def _phase_label(phase: str, start: float, stop: float, row: int) -> dict[str, Any]:
    where = {"xref": "x", "x": (start + stop) / 2, "yref": "paper", "y": 1, "yanchor": "bottom"}
    look = {"showarrow": False, "yshift": 14 * row, "font": {"size": 11, "color": MUTED}}
    return {"text": escape(phase), **where, **look}


def _start(span: Span) -> float:
    return span.start


def _has_numbers(trace: dict[str, Any]) -> bool:
    return not np.isnan(np.asarray(trace["y"], dtype=np.float64)).all()
