"""The figures of the report, as data for plotly.js: plain dictionaries, built in milliseconds.

Long series are thinned before they are drawn: the smallest and the largest value of each
bucket stay, so a peak of a single tick is still there.
"""

from base64 import b64encode
from collections.abc import Iterator, Mapping
from html import escape
from itertools import cycle
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import polars as pl
from jaxtyping import Bool, Int

from qpctrl.arrays import Array, Matrix, Vector
from scenarios import report_style as style

Figure: TypeAlias = dict[str, Any]
"""``data`` and ``layout`` of plotly.js."""
Indices: TypeAlias = Int[np.ndarray, " _"]
Flags: TypeAlias = Bool[np.ndarray, " _"]

BUCKETS = 1200  # of a line, two points each: more than a screen has columns
CONTACT = ("press", "wipe", "release")
PAD = (0.120, 0.050)  # m, the eraser along x and y of E
HALVES = ([0.47, 1.0], [0.0, 0.37])  # of a figure with two panels
FLOOR = 1e-18  # drawn instead of an exact zero on a logarithmic axis
MAX_MARKS = 400
MAX_SHADES = 80


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


def path_figure(table: pl.DataFrame, geometry: Mapping[str, Array]) -> Figure | None:
    """Return the path on the board [mm], as someone sees it who faces the board.

    y of E points right and x of E up, since z of E points into the board.
    """
    if "X_WE" not in geometry:
        return None
    p_E = _path_on_board(table, geometry["X_WE"])
    loops = geometry.get("loops", np.zeros((0, 2)))
    touched = p_E[~np.isnan(p_E[:, 0])]
    shown = loops if len(loops) else touched
    if not len(shown):
        return None
    at = np.union1d(thin(p_E[:, 0]), thin(p_E[:, 1]))
    loop_at = np.arange(0, len(loops), max(1, len(loops) // (2 * BUCKETS)))
    chalk: dict[str, Any] = {"color": style.CHALK, "width": 4}
    dashes: dict[str, Any] = {"color": style.MARK, "width": 1.6, "dash": "6px,5px"}
    ends = touched[[0, -1]] if len(touched) else touched
    traces = [
        _swept(touched),
        _trace(p_E[at, 1] * 1e3, p_E[at, 0] * 1e3, "actual path", line=chalk),
        _trace(loops[loop_at, 1] * 1e3, loops[loop_at, 0] * 1e3, "reference", line=dashes),
        _trace(ends[:1, 1] * 1e3, ends[:1, 0] * 1e3, "first touch", mode="markers")
        | {"marker": {"color": style.MARK, "size": 11, "symbol": "circle"}},
        _trace(ends[1:, 1] * 1e3, ends[1:, 0] * 1e3, "last contact", mode="markers")
        | {"marker": {"color": style.MARK, "size": 11, "symbol": "square"}},
    ]
    for trace in traces[1:]:
        trace["hovertemplate"] = "x %{y:.1f} mm, y %{x:.1f} mm<extra>%{fullData.name}</extra>"
    low, high = shown.min(0), shown.max(0)
    margin = np.array(PAD) / 2 + 0.012
    figure = _figure([t for t in traces if t["x"]], "y of the board [mm]", height=500)
    x_range, y_range = zip(1e3 * (low - margin), 1e3 * (high + margin), strict=True)
    on_board = {"gridcolor": "#35584c", "zeroline": False}
    figure["layout"] |= {
        "plot_bgcolor": style.BOARD,
        "xaxis": _axis("y of the board [mm]", range=list(y_range), **on_board),
        "yaxis": _axis("x of the board [mm]", range=list(x_range), scaleanchor="x", **on_board),
    }
    return figure


def force_figure(table: pl.DataFrame, limits: Mapping[str, float]) -> Figure | None:
    """Return the force on the board over time [N], and its error while wiping."""
    time, pressed = column(table, "time"), column(table, "wrench_meas.fz")
    wanted = column(table, "force.F_des.2")
    if np.isnan(pressed).all():
        return None
    mark = {"color": style.INK, "width": 1.6, "dash": "5px,4px"}
    traces = [
        _line(time, pressed, "normal force, measured", style.SERIES[0], width=1.8),
        _line(time, wanted, "set-point", style.INK) | {"line": mark},
        _line(time, column(table, "wrench_meas.fx"), "tangential, x", style.SERIES[1], width=0.8),
        _line(time, column(table, "wrench_meas.fy"), "tangential, y", style.SERIES[2], width=0.8),
    ]
    error = np.where(_focus(table), pressed - wanted, np.nan)
    figure = _figure(traces, "time [s]", "force [N]")
    if not np.isnan(error).all():
        below = _line(time, error, "error of the normal force", style.SERIES[3], yaxis="y2")
        _add_panel(figure, [below], "error [N]", _symmetric(error))
        _limit_lines(figure, limits.get("force_rmse_N"), "± limit of RMS", "y2", both=True)
    return _shaded(_with_hover(figure, "N"), spans(table))


def error_figure(table: pl.DataFrame, limits: Mapping[str, float]) -> Figure | None:
    """Return the position error in the plane of the board, and the tilt [deg], over time."""
    time = column(table, "time")
    e = np.stack([column(table, f"motion.X_e.{i}") for i in (0, 1, 3, 4)])
    if np.isnan(e).all():
        return None
    focus = _focus(table)
    small = not (np.abs(e[:2, focus]) > 1e-3).any()
    scale, unit = (1e6, "µm") if small else (1e3, "mm")
    traces = [
        _line(time, scale * e[0], "along x", style.SERIES[0]),
        _line(time, scale * e[1], "along y", style.SERIES[1]),
    ]
    figure = _figure(traces, "time [s]", f"position error [{unit}]", height=500)
    figure["layout"]["yaxis"]["range"] = _symmetric(scale * e[:2, focus])
    tilt = np.degrees(np.hypot(e[2], e[3]))
    _with_hover(figure, unit)
    _add_panel(figure, [_line(time, tilt, "tilt [deg]", style.SERIES[4], yaxis="y2")], "tilt [deg]")
    figure["data"][-1]["hovertemplate"] = "%{y:.4g} deg"
    limit = limits.get("tilt_max_deg")
    top = max([1.3 * x for x in (limit, np.nanmax(tilt[focus], initial=0)) if x], default=None)
    if top is not None:
        figure["layout"]["yaxis2"]["range"] = [0, top]
    _limit_lines(figure, limit, "limit", "y2")
    return _shaded(figure, spans(table), width=440)


def torque_figure(table: pl.DataFrame) -> Figure | None:
    """Return the torque of each joint over time [Nm], with the ticks at which a limit binds."""
    time, traces = column(table, "time"), []
    names = [name.removeprefix("tau.") for name in table.columns if name.startswith("tau.")]
    for name, colour in zip(names, cycle(style.SERIES)):  # noqa: B905 - the colours are endless
        sent, got = column(table, f"tau.{name}"), column(table, f"tau_delivered.{name}")
        traces.append(_line(time, sent, name, colour))
        if np.nanmax(np.abs(got - sent), initial=0.0) > 1e-9 * np.nanmax(np.abs(sent), initial=1.0):
            delivered = _line(time, got, f"{name}, delivered", colour)
            delivered["line"]["dash"] = "4px,3px"
            traces.append(delivered)
    if not traces:
        return None
    _with_hover({"data": traces}, "Nm")
    torques = {name: column(table, f"tau.{name}") for name in names}
    traces += list(_binding_marks(table, torques))
    return _shaded(_figure(traces, "time [s]", "torque [Nm]", height=440), spans(table))


def equality_figure(table: pl.DataFrame) -> Figure | None:
    """Return how the QP relates to both laws over time, relative, on a logarithmic axis."""
    shown = {
        "textbook_gap": ("QP − textbook law", style.SERIES[1], "solid", 4.5),
        "curvature": ("curvature term", style.INK, "5px,4px", 1.4),
        "unexplained_gap": ("QP − textbook law, less curvature", style.SERIES[3], "solid", 1.4),
        "law_gap": ("QP − hybrid law", style.SERIES[0], "solid", 1.4),
        "kkt_residual": ("KKT residual", style.SERIES[2], "solid", 1.4),
    }
    time, traces = column(table, "time"), []
    for name, (words, colour, dash, width) in shown.items():
        values = column(table, name)
        if np.isnan(values).all():
            continue
        t, peak = _envelope(time, values)
        peak = np.where(peak <= 0, np.nan if name == "curvature" else FLOOR, peak)
        line = {"color": colour, "width": width, "dash": dash}
        traces.append(_trace(t, peak, words, line=line) | {"hovertemplate": "%{y:.1e}"})
    if not traces:
        return None
    gap = np.maximum(column(table, "law_gap"), FLOOR)
    traces += list(_binding_marks(table, {"": gap}))
    figure = _figure(traces, "time [s]", "relative to max |τ|", height=460)
    figure["layout"]["yaxis"] |= {"type": "log", "exponentformat": "power", "dtick": 3}
    _limit_lines(figure, 1e-8, "10⁻⁸ limit of QP − hybrid law", "y")
    _limit_lines(figure, 1e-9, "10⁻⁹ limit of the KKT residual", "y", below=True)
    return _shaded(figure, spans(table))


def timing_figure(table: pl.DataFrame) -> Figure | None:
    """Return the histogram of the time that the controller takes for a tick [µs]."""
    taken = column(table, "tick_us")
    taken = taken[taken > 0]
    if not len(taken):
        return None
    edges = np.geomspace(0.98 * taken.min(), 1.02 * taken.max(), 71)
    counts, _ = np.histogram(taken, edges)
    bars = {
        "type": "bar",
        "x": _numbers(np.sqrt(edges[1:] * edges[:-1])),
        "y": _numbers(counts),
        "width": _numbers(np.diff(edges)),
        "marker": {"color": style.SERIES[0], "line": {"width": 0}},
        "hovertemplate": "%{x:.0f} µs: %{y} ticks<extra></extra>",
    }
    figure = _figure([bars], "time of one tick [µs]", "ticks", height=340)
    figure["layout"] |= {"bargap": 0, "showlegend": False, "hovermode": "closest"}
    figure["layout"]["xaxis"] |= {"type": "log", "dtick": "D2", "hoverformat": ".0f"}
    marks = {"median": np.median(taken), "p99": np.quantile(taken, 0.99)}
    for words, value in marks.items():
        _vertical(figure, float(value), f"{words} {style.number(float(value))} µs")
    return figure
