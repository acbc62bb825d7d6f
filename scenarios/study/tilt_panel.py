"""The pictures of the study ``tilt``: what is measured against signed tilt, over closed forms."""

from typing import Any, NamedTuple

import numpy as np
import polars as pl

from qpctrl.arrays import Vector
from scenarios import report_style as style
from scenarios.panel import Panel
from scenarios.report_style import Figure, column, trace

SYMBOLS = ("circle-open", "x-thin-open", "square-open", "diamond-open")
SIZES = (12, 9, 17, 15)


class Curves(NamedTuple):
    """Closed forms over the range of tilts."""

    tilt: Vector
    """[deg]."""
    force: Vector
    """λ / f_d − 1 [%]."""
    offset: Vector
    """Tangential offset [mm]."""
    speed: Vector
    """True over believed speed − 1 [%]."""


def tilt_panels(table: pl.DataFrame, curves: Curves, speed: float) -> tuple[Panel, ...]:
    """Return force error, offset and speed error of every controller.

    Args:
        table: the rollouts.
        curves: the closed forms.
        speed: reference along the believed plane [m/s].
    """
    table = table.with_columns(
        force_error=100 * (pl.col("force_ratio") - 1),
        speed_error=100 * (pl.col("speed_m_s") / speed - 1),
    )
    measured = "Points: measured, one mark a controller. Line: closed form"
    return (
        Panel(
            "force",
            "Force error while holding still",
            f"λ / f_d − 1: too much force, whatever the sign of the tilt. {measured}.",
            _figure(table, "force_error", curves.tilt, curves.force, "force error [%]"),
        ),
        Panel(
            "offset",
            "Tangential offset while holding still",
            f"Desired − actual, along y of the believed plane. {measured}, in the posture of the "
            "start.",
            _figure(table, "offset_mm", curves.tilt, curves.offset, "offset [mm]"),
        ),
        Panel(
            "speed",
            "Speed error while sliding",
            f"True speed over the believed one − 1. {measured}, 1 / cos α − 1.",
            _figure(table, "speed_error", curves.tilt, curves.speed, "speed error [%]"),
        ),
    )


def _figure(table: pl.DataFrame, name: str, tilt: Vector, curve: Vector, title: str) -> Figure:
    analytic = trace(
        tilt, curve, "closed form", line={"color": style.INK, "width": 1.4}, hoverinfo="skip"
    )
    traces = [analytic]
    for i, (controller, rows) in enumerate(_by_controller(table)):
        look: dict[str, Any] = {
            "color": style.SERIES[i % len(style.SERIES)],
            "size": SIZES[i % len(SIZES)],
            "symbol": SYMBOLS[i % len(SYMBOLS)],
            "line": {"width": 2},
        }
        x, y = column(rows, "tilt_deg"), column(rows, name)
        hover = "%{y:.5g}"
        traces.append(trace(x, y, controller, mode="markers", marker=look, hovertemplate=hover))
    figure = style.figure(traces, "signed tilt of the plane [deg]", title)
    figure["layout"]["xaxis"]["range"] = _padded(tilt)
    return figure


def _by_controller(table: pl.DataFrame) -> list[tuple[str, pl.DataFrame]]:
    names = table["controller"].unique(maintain_order=True).to_list()
    return [(name, table.filter(pl.col("controller") == name)) for name in names]


def _padded(x: Vector) -> list[float]:
    margin = 0.03 * float(np.ptp(x))
    return [float(x.min()) - margin, float(x.max()) + margin]
