"""The figures of the report. Each is none where the record has nothing to show."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import polars as pl
from jaxtyping import Bool

from qpctrl.arrays import Array, Matrix
from qpctrl.status import Status
from scenarios import report_style as style
from scenarios.report_style import Figure, column, line, trace
from scenarios.report_torque import binding_marks

Flags: TypeAlias = Bool[np.ndarray, " _"]

PAD = (0.120, 0.050)  # m, the eraser along x and y of E
SWEEP_STEP = 0.002  # m, between two outlines of the eraser
FLOOR = 1e-18  # drawn instead of what is smaller, on a logarithmic axis
SLIGHT = 0.01  # N, below it a force is drawn as none
LAW_LIMIT, KKT_LIMIT = 1e-8, 1e-9


def path_figure(table: pl.DataFrame, geometry: Mapping[str, Array]) -> Figure | None:
    """Return the path on the board [mm], as someone sees it who faces the board.

    y of E points right and x of E up, since z of E points into the board.
    """
    if "X_WE" not in geometry or table.is_empty():
        return None
    p_E = 1e3 * _path_on_board(table, geometry["X_WE"])
    loops = 1e3 * geometry.get("loops", np.zeros((0, 2)))
    loops = loops[:: max(1, len(loops) // (2 * style.BUCKETS))]
    touched = p_E[~np.isnan(p_E[:, 0])]
    shown = loops if len(loops) else touched
    if not len(shown):
        return None
    actual = p_E[np.union1d(style.thin(p_E[:, 0]), style.thin(p_E[:, 1]))]
    chalk = {"color": style.CHALK, "width": 4}
    dashes = {"color": style.MARK, "width": 1.6, "dash": "6px,5px"}
    hover = "x %{y:.1f} mm, y %{x:.1f} mm<extra>%{fullData.name}</extra>"
    traces = [
        _swept(touched),
        trace(actual[:, 1], actual[:, 0], "actual path", line=chalk, hovertemplate=hover),
        trace(loops[:, 1], loops[:, 0], "reference", line=dashes, hovertemplate=hover),
    ]
    for name, at, symbol in (("first touch", touched[:1], "circle"), ("end", touched[-1:], "x")):
        look = {"color": style.MARK, "size": 11, "symbol": symbol}
        dot = trace(at[:, 1], at[:, 0], name, mode="markers", marker=look, hovertemplate=hover)
        traces.append(dot)
    margin = 500 * np.array(PAD) + 12
    low, high = shown.min(0) - margin, shown.max(0) + margin
    grid: dict[str, Any] = {"gridcolor": "#31554a", "zerolinecolor": "#31554a"}
    figure = style.figure(traces, "", "", height=500)
    figure["layout"] |= {"plot_bgcolor": style.BOARD, "hovermode": "closest"}
    x_axis = style.axis("y on the board [mm]", range=[low[1], high[1]], **grid)
    y_axis = style.axis("x on the board [mm]", range=[low[0], high[0]], scaleanchor="x", **grid)
    figure["layout"] |= {"xaxis": x_axis, "yaxis": y_axis}
    return figure


def force_figure(table: pl.DataFrame, limits: Mapping[str, float]) -> Figure | None:
    """Return the force on the board over time [N], and its error while wiping."""
    time, pressed = column(table, "time"), column(table, "wrench_meas.fz")
    wanted = column(table, "force.F_des.2")
    if np.isnan(pressed).all():
        return None
    along = [column(table, f"wrench_meas.{name}") for name in ("fx", "fy")]
    traces = [
        line(time, along[0], "tangential, x", style.SERIES[1], "N", width=0.8),
        line(time, along[1], "tangential, y", style.SERIES[2], "N", width=0.8),
        line(time, pressed, "normal, measured", style.SERIES[0], "N", width=1.8),
        line(time, wanted, "normal, set-point", style.INK, "N", width=1.4, dash="5px,4px"),
    ]
    figure = style.figure(traces, "time [s]", "force [N]", height=480)
    if np.nanmax(np.abs(np.stack([pressed, *along])), initial=0.0) < SLIGHT:
        figure["layout"]["yaxis"]["range"] = [-1.0, 1.0]
    error = np.where(_focus(table), pressed - wanted, np.nan)
    if not np.isnan(error).all():
        below = line(time, error, "error of the normal force", style.SERIES[3], "N", width=1.0)
        style.add_panel(figure, below, "error [N]", style.symmetric(error))
        if limit := limits.get("force_rmse_N"):
            style.add_limit(figure, limit, "± limit of its RMS", "y2")
            style.add_limit(figure, -limit, "", "y2")
    return style.shade(figure, style.spans(table))


def error_figure(table: pl.DataFrame, limits: Mapping[str, float]) -> Figure | None:
    """Return the position error in the plane of the board, and the tilt [deg], over time."""
    time = column(table, "time")
    e_x, e_y, tilt_x, tilt_y = (column(table, f"motion.X_e.{i}") for i in (0, 1, 3, 4))
    if np.isnan(e_x).all():
        return None
    focus = _focus(table)
    worst = np.nanmax(np.abs(np.r_[e_x[focus], e_y[focus]]), initial=0.0)
    scale, unit = (1e6, "µm") if worst < 1e-3 else (1e3, "mm")
    traces = [
        line(time, scale * e_x, "error along x", style.SERIES[0], unit),
        line(time, scale * e_y, "error along y", style.SERIES[1], unit),
    ]
    figure = style.figure(traces, "time [s]", f"position error [{unit}]", height=500)
    figure["layout"]["yaxis"]["range"] = style.symmetric(scale * np.r_[e_x[focus], e_y[focus]])
    tilt, limit = np.degrees(np.hypot(tilt_x, tilt_y)), limits.get("tilt_max_deg")
    top = max(1.3 * (limit or 0.0), 1.15 * np.nanmax(tilt[focus], initial=0.0))
    below = line(time, tilt, "tilt", style.SERIES[4], "deg")
    style.add_panel(figure, below, "tilt [deg]", [0.0, top] if top > 0 else None)
    if limit:
        style.add_limit(figure, limit, "limit", "y2")
    return style.shade(figure, style.spans(table), pixels=420)


def equality_figure(table: pl.DataFrame) -> Figure | None:
    """Return how the QP relates to both laws over time, relative, on a logarithmic axis."""
    look: dict[str, tuple[str, dict[str, Any]]] = {
        "textbook_gap": ("QP − textbook law", {"color": "#f2b27a", "width": 6}),
        "curvature": ("curvature term", {"color": style.INK, "width": 1.4, "dash": "5px,4px"}),
        "unexplained_gap": ("their difference", {"color": "#e7a9cc", "width": 5}),
        "law_gap": ("QP − hybrid law", {"color": style.SERIES[0], "width": 1.8}),
        "kkt_residual": ("KKT residual of the QP", {"color": style.SERIES[2], "width": 1.4}),
    }
    time, traces = column(table, "time"), []
    for name, (words, drawn) in look.items():
        t, peak = style.envelope(time, np.where(_solved(table), column(table, name), np.nan))
        low = np.nan if name == "curvature" else FLOOR
        peak = np.where(peak < FLOOR, low, peak)
        traces.append(trace(t, peak, words, line=drawn, hovertemplate="%{y:.1e}"))
    traces.append(binding_marks(table, {"": np.maximum(column(table, "law_gap"), FLOOR)}))
    figure = style.figure(traces, "time [s]", "relative to max |τ|", height=480)
    if not figure["data"]:
        return None
    figure["layout"]["yaxis"] |= {"type": "log", "exponentformat": "power", "dtick": 2}
    style.add_limit(figure, LAW_LIMIT, "limit of QP − hybrid law: 10⁻⁸")
    style.add_limit(figure, KKT_LIMIT, "limit of the KKT residual: 10⁻⁹", anchor="bottom")
    return style.shade(figure, style.spans(table))


def timing_figure(table: pl.DataFrame) -> Figure | None:
    """Return the histogram of the time that the controller takes for a tick [µs]."""
    taken = column(table, "tick_us")
    taken = taken[taken > 0]
    if not len(taken):
        return None
    edges = np.geomspace(0.98 * taken.min(), 1.02 * taken.max(), 71)
    counts = np.histogram(taken, edges)[0].astype(np.float64)
    bars = trace(np.sqrt(edges[1:] * edges[:-1]), counts, "ticks", type="bar", width=np.diff(edges))
    del bars["mode"]
    bars |= {"marker": {"color": style.SERIES[0]}, "hovertemplate": "%{x:.0f} µs: %{y} ticks"}
    figure = style.figure([bars], "time of one tick [µs]", "ticks", height=320)
    figure["layout"] |= {"bargap": 0, "showlegend": False, "hovermode": "closest"}
    figure["layout"]["margin"] |= {"b": 48, "t": 84}
    low, high = np.log10(edges[0]), np.log10(max(edges[-1], 1.1 * _period(table)))
    ticks = [m * 10**k for k in range(8) for m in (1, 2, 3, 5)]
    labels = {"tickvals": ticks, "ticktext": [f"{t}" for t in ticks]}
    figure["layout"]["xaxis"] |= {"type": "log", "range": [float(low), float(high)], **labels}
    marks = {"median": np.median(taken), "99th percentile": np.quantile(taken, 0.99)}
    for row, (words, x) in enumerate((marks | {"control period": _period(table)}).items()):
        span = {"type": "line", "x0": x, "x1": x, "yref": "paper", "y0": 0, "y1": 1}
        look = {"color": style.INK, "width": 1.2, "dash": "dash"}
        figure["layout"]["shapes"].append(span | {"line": look})
        side = "left" if np.log10(x) < 0.2 * low + 0.8 * high else "right"
        at = {"x": np.log10(x), "yref": "paper", "y": 1, "xanchor": side, "yanchor": "bottom"}
        note = {"text": f"{words} {x:.0f} µs", "showarrow": False, "yshift": 15 * row}
        figure["layout"]["annotations"].append(at | note)
    return figure


def equal_words(table: pl.DataFrame) -> str:
    """Return what the reader sees, in numbers of the ticks on which no limit binds."""
    gaps = ("law_gap", "textbook_gap", "unexplained_gap")
    wanted = ["status", *(n for n in (*gaps, "saturated", "damping") if n in table.columns)]
    free = table.select(wanted).filter(_solved(table))
    if "saturated" in table.columns:
        free = free.filter(~pl.col("saturated"))
    if "damping" in table.columns:
        free = free.filter(pl.col("damping") == 0)
    gap, textbook, rest = (float(np.nanmax(column(free, name), initial=0.0)) for name in gaps)
    if free.is_empty():
        return "A limit bound, or there was no solution, on every tick: nothing to compare."
    equal = "one law, to round-off" if gap <= LAW_LIMIT else "not one law to round-off (10⁻⁸)"
    ticks = f"{style.number(len(free))} of {style.number(len(table))} ticks"
    printed = (
        f"The law as the textbook prints it differs by up to {style.number(textbook)}; its "
        "curvature term Jᵀ Aᵀ S⁻¹ Ȧ V, a force error that the QP does not make, explains all of "
        f"it but {style.number(rest)}. "
    )
    if textbook <= LAW_LIMIT:
        printed = "So is the law as the textbook prints it: no constraint turns or moves here. "
    return (
        f"On the {ticks} on which no limit binds, the torque of the QP and that of the closed-form "
        f"hybrid law differ by at most {style.number(gap)} of max |τ|: they are {equal}. "
        f"{printed}(Each point is the largest of a few neighbouring ticks.)"
    )


def timing_words(table: pl.DataFrame) -> str:
    """Return how often the controller missed its period."""
    over = int((column(table, "tick_us") > _period(table)).sum())
    return (
        "Time that the controller takes for a tick, by the clock of the machine that ran it. "
        f"{over} of {style.number(len(table))} ticks took longer than the control period."
    )


def _period(table: pl.DataFrame) -> float:
    """Return the control period [µs]."""
    time = column(table, "time")
    return 1e6 * float(np.median(np.diff(time))) if len(time) > 1 else 1e3


def _path_on_board(table: pl.DataFrame, X_WE: Array) -> Matrix:
    """Return x and y in E [m] of each tick; NaN where the tool does not touch."""
    p_W = np.stack([column(table, f"motion.X_WF.{i}") for i in (9, 10, 11)], axis=1)
    p_E = (p_W - X_WE[:3, 3]) @ X_WE[:3, :2]
    if "touching" in table.columns:
        p_E[~table["touching"].fill_null(False).to_numpy()] = np.nan
    return p_E


def _swept(p_E: Matrix) -> dict[str, Any]:
    """Return the area [mm] that the eraser passed over, as one outline for each short step."""
    travelled = np.cumsum(np.r_[0.0, np.linalg.norm(np.diff(p_E, axis=0), axis=1)])
    _, at = np.unique((travelled // (1e3 * SWEEP_STEP)).astype(np.int64), return_index=True)
    steps = p_E[at] if len(p_E) else p_E
    half = 500 * np.array(PAD)
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [np.nan, np.nan]])
    outlines = (steps[:, None, :] + corners).reshape(-1, 2)
    filled = {"fill": "toself", "fillcolor": style.SWEPT, "line": {"width": 0}, "hoverinfo": "skip"}
    return trace(outlines[:, 1], outlines[:, 0], "wiped area", **filled)


def _solved(table: pl.DataFrame) -> Flags:
    """Return on which ticks the QP had a solution."""
    if "status" not in table.columns:
        return np.ones(len(table), dtype=np.bool_)
    return (table["status"] == Status.OK.name).to_numpy()


def _focus(table: pl.DataFrame) -> Flags:
    """Return which ticks to look at: wiping, else in contact, else all."""
    wiping = (table["phase"] == "wipe").to_numpy() if "phase" in table.columns else np.zeros(0)
    if wiping.any():
        return np.asarray(wiping, dtype=np.bool_)
    wanted = ~np.isnan(column(table, "force.F_des.2"))
    return wanted if wanted.any() else np.ones(len(table), dtype=np.bool_)
