"""Bode plots: measured points over the curve of a model."""

from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Complex

from qpctrl.arrays import Vector
from scenarios import report_style as style
from scenarios.report_style import Figure, trace

Response: TypeAlias = Complex[np.ndarray, " _"]
"""Complex gain at each frequency."""


def bode_figure(
    frequency: Vector,
    measured: Response,
    model_frequency: Vector,
    model: Response,
    y: str,
) -> Figure:
    """Return magnitude and phase over frequency, both axes of the magnitude logarithmic.

    Args:
        frequency: where it was measured [Hz].
        measured: what was measured there.
        model_frequency: where the model is drawn [Hz].
        model: the model there.
        y: name and unit of the magnitude.
    """
    dots: dict[str, Any] = {"mode": "markers", "marker": {"color": style.SERIES[1], "size": 9}}
    curve = {"line": {"color": style.SERIES[0], "width": 2}}
    figure = style.figure(
        [
            trace(model_frequency, np.abs(model), "model", hovertemplate="%{y:.4g}", **curve),
            trace(frequency, np.abs(measured), "measured", hovertemplate="%{y:.4g}", **dots),
        ],
        "frequency [Hz]",
        y,
        height=520,
    )
    below = [
        trace(model_frequency, _degrees(model), "phase of the model", **curve),
        trace(frequency, _degrees(measured), "measured phase", **dots),
    ]
    for drawn in below:
        shown = drawn | {"hovertemplate": "%{y:.2f}°", "showlegend": False}
        style.add_panel(figure, shown, "phase [deg]", None)
    for axis in ("xaxis", "yaxis"):
        figure["layout"][axis] |= {"type": "log"}
    figure["layout"]["hovermode"] = "x"
    return figure


def _degrees(response: Response) -> Vector:
    return np.degrees(np.unwrap(np.angle(response)))
