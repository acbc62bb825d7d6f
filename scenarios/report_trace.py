"""Figures that any scenario can use: a path in a plane, wrenches over time, named curves."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from qpctrl.arrays import Array, Vector
from scenarios import report_style as style
from scenarios.report_style import Figure, column, line, trace

AXES_OF_E = ("x", "y", "z")


class Curve(NamedTuple):
    """A quantity over time."""

    words: str
    y: Vector
    """Values (ticks)."""
    dashed: bool = False
    """Whether it is a reference, drawn dashed in black."""


def curve_figure(
    table: pl.DataFrame,
    y: str,
    unit: str,
    curves: Sequence[Curve],
    below: tuple[str, Sequence[Curve]] | None = None,
) -> Figure | None:
    """Return named curves over time, with the phases behind them.

    Args:
        table: the record, one row a tick.
        y: what the curves are; their unit follows in brackets.
        unit: unit of all curves.
        curves: what to draw.
        below: title and curves of a second panel below, with the same unit.
    """
    time = column(table, "time")
    figure = style.figure(_lines(time, curves, unit), "time [s]", f"{y} [{unit}]", height=440)
    if not figure["data"]:
        return None
    if below is not None:
        title, more = below
        values = np.concatenate([np.zeros(1), *(curve.y for curve in more)])
        for drawn in _lines(time, more, unit):
            style.add_panel(figure, drawn, f"{title} [{unit}]", style.symmetric(values))
    return style.shade(figure, style.spans(table))


def wrench_figure(table: pl.DataFrame, rows: slice, measured: str = "wrench_meas") -> Figure | None:
    """Return forces (``rows`` 0 to 3) or moments (3 to 6) against their set-points, and the error.

    Args:
        table: the record, one row a tick.
        rows: which three components of the wrench.
        measured: name of the wrench in the record.
    """
    names, unit = (("fx", "fy", "fz"), "N") if rows.start == 0 else (("mx", "my", "mz"), "Nm")
    found = [column(table, f"{measured}.{name}") for name in names]
    wanted = [column(table, f"force.F_des.{i}") for i in range(rows.start, rows.stop)]
    curves = [Curve(f"{n}, measured", y) for n, y in zip(names, found, strict=True)]
    curves += [Curve(f"{n}, set-point", y, dashed=True) for n, y in zip(names, wanted, strict=True)]
    errors = [
        Curve(f"{n}, error", y - y_des) for n, y, y_des in zip(names, found, wanted, strict=True)
    ]
    has = any(not np.isnan(curve.y).all() for curve in errors)
    what = "force" if rows.start == 0 else "moment"
    return curve_figure(table, what, unit, curves, ("error", errors) if has else None)


def plane_figure(table: pl.DataFrame, geometry: Mapping[str, Array]) -> Figure | None:
    """Return the path of the tool in a plane of the environment's frame E [mm].

    Args:
        table: the record, one row a tick.
        geometry: ``X_WE`` (4×4); ``plane`` (2), which axes of E to draw; ``reference``
            (samples×3) [m] in the world, and ``outline`` (samples×2) [m] in the plane, the
            environment itself; the last two may be missing.
    """
    if not {"X_WE", "plane"} <= set(geometry) or table.is_empty():
        return None
    X_WE, across, up = geometry["X_WE"], *(int(i) for i in geometry["plane"])

    def in_plane(p_W: Array) -> Array:
        return 1e3 * (p_W - X_WE[:3, 3]) @ X_WE[:3, [across, up]]

    p_W = np.stack([column(table, f"motion.X_WF.{i}") for i in (9, 10, 11)], axis=1)
    actual = in_plane(p_W)
    actual = actual[np.union1d(style.thin(actual[:, 0]), style.thin(actual[:, 1]))]
    hover = "%{x:.2f} mm, %{y:.2f} mm<extra>%{fullData.name}</extra>"
    outline = 1e3 * geometry.get("outline", np.zeros((0, 2)))
    reference = in_plane(geometry.get("reference", np.zeros((0, 3))))
    drawn: list[tuple[str, Array, dict[str, Any]]] = [
        ("environment", outline, {"color": "#b9c1ca", "width": 7}),
        ("actual path", actual, {"color": style.SERIES[0], "width": 3}),
        ("reference", reference, {"color": style.INK, "width": 1.4, "dash": "5px,4px"}),
    ]
    traces = [trace(p[:, 0], p[:, 1], n, line=look, hovertemplate=hover) for n, p, look in drawn]
    figure = style.figure([t for t in traces if len(t["x"])], "", "", height=500)
    if not figure["data"]:
        return None
    title = "{} in the frame of the environment [mm]"
    figure["layout"]["hovermode"] = "closest"
    figure["layout"]["xaxis"] = style.axis(title.format(AXES_OF_E[across]))
    figure["layout"]["yaxis"] = style.axis(title.format(AXES_OF_E[up]), scaleanchor="x")
    return figure


def _lines(time: Vector, curves: Sequence[Curve], unit: str) -> list[dict[str, Any]]:
    lines = []
    for i, curve in enumerate(curves):
        look: dict[str, Any] = {"width": 1.2, "dash": "5px,4px"} if curve.dashed else {}
        colour = style.INK if curve.dashed else style.SERIES[i % len(style.SERIES)]
        lines.append(line(time, curve.y, curve.words, colour, unit, **look))
    return lines
