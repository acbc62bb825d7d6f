"""The pictures of a mobile arm that wipes a long board."""

from typing import Any

import numpy as np
import polars as pl

from qpctrl.arrays import Array, Vector
from qpctrl.robot import Limits
from scenarios import report_style as style
from scenarios.panel import Panel, board_panels
from scenarios.report_style import Figure, column, trace
from scenarios.report_trace import Curve, curve_figure
from scenarios.scenario import Outcome
from scenarios.whole_body.mobile_metric import shares
from scenarios.whole_body.mobile_world import BASE

HALF_CARRIAGE = (0.30, 0.23)  # m, along x and y of the base
LINE = 0.05  # m, by which the line of the board goes on beyond the path


def mobile_panels(outcome: Outcome) -> tuple[Panel, ...]:
    """Return the path on the board, the base from above, errors, force, and limits in use."""
    table, geometry = outcome.table, outcome.experiment.geometry
    path, *rest = board_panels(outcome.summary, table, geometry)
    return (
        path._replace(half=False),
        Panel(
            "above",
            "Base and eraser from above",
            "The board is the green line; the carriage is drawn where it starts and where it ends.",
            above_figure(table, geometry["X_WE"]),
            True,
        ),
        *rest,
        Panel(
            "limits",
            "What is used of the limits",
            "The largest share of all joints. Of a position: way from the middle of its range, "
            "over half of that.",
            limits_figure(table, outcome.experiment.robot.limits),
        ),
    )


def above_figure(table: pl.DataFrame, X_WE: Array) -> Figure | None:
    """Return the ways of base and eraser [m], with y of the world to the left and x up."""
    x, y = (column(table, f"motion.X_WF.{i}") for i in (9, 10))
    if table.is_empty() or np.isnan(x).all():
        return None
    base = [column(table, f"q.{name}") for name in BASE]
    fixed = np.isnan(base[0]).all()
    p_x, p_y, yaw = (np.zeros(len(table)) if fixed else values for values in base)
    hover = "x %{y:.3f} m, y %{x:.3f} m<extra>%{fullData.name}</extra>"
    ends = np.array([np.nanmin(y) - LINE, np.nanmax(y) + LINE])
    tool = np.union1d(style.thin(x), style.thin(y))
    drawn: list[tuple[str, Vector, Vector, dict[str, Any]]] = [
        ("board", np.full(2, X_WE[0, 3]), ends, {"color": style.BOARD, "width": 7}),
        ("eraser", x[tool], y[tool], {"color": style.SERIES[0], "width": 2}),
        ("middle of the base", p_x, p_y, {"color": style.SERIES[1], "width": 4}),
        ("start", *_carriage(p_x[0], p_y[0], yaw[0]), {"color": style.MUTED, "width": 1.4}),
        ("end", *_carriage(p_x[-1], p_y[-1], yaw[-1]), {"color": style.INK, "width": 1.8}),
    ]
    traces = [trace(b, a, name, line=look, hovertemplate=hover) for name, a, b, look in drawn]
    figure = style.figure(traces, "", "", height=500)
    figure["layout"]["hovermode"] = "closest"
    figure["layout"]["xaxis"] = style.axis("y of the world [m]", autorange="reversed")
    figure["layout"]["yaxis"] = style.axis("x of the world [m]", scaleanchor="x")
    return figure


def limits_figure(table: pl.DataFrame, limits: Limits) -> Figure | None:
    """Return the largest shares of position, speed and torque limits over time."""
    curves = [Curve(words, share) for words, share in shares(table, limits).items()]
    limit = Curve("limit", np.ones(len(table)), dashed=True)
    return curve_figure(table, "share of the limit", "1", [*curves, limit])


def _carriage(x: float, y: float, yaw: float) -> tuple[Vector, Vector]:
    """Return x and y (5 each) [m] of the outline of the carriage."""
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]]) * HALF_CARRIAGE
    cos, sin = np.cos(yaw), np.sin(yaw)
    outline = corners @ np.array([[cos, sin], [-sin, cos]]) + [x, y]
    return outline[:, 0], outline[:, 1]
