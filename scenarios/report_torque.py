"""The figure of the joint torques: what was commanded, what arrived, what was measured."""

from collections.abc import Mapping
from html import escape
from itertools import cycle
from typing import Any

import numpy as np
import polars as pl

from qpctrl.arrays import Vector
from scenarios import report_style as style
from scenarios.report_style import Figure, column, line, trace

MAX_MARKS = 400
SAME = 1e-9  # of the largest torque: curves that differ by less are drawn as one
IDEAL = {"delivered": ("tau_delivered", "4px,3px")}  # column and dash of a curve, by its words
DRIVEN = {**IDEAL, "measured": ("tau_meas", "1px,2px")}
LIMITED = "motor_limited"  # the column of records whose joints have drives


def torque_figure(table: pl.DataFrame) -> Figure | None:
    """Return the torque of each joint over time [Nm], with the ticks at which a limit binds.

    Delivered and, of joints with drives, measured torque are drawn where they are not what was
    commanded. Curves of one joint are switched on and off together.
    """
    sent = _commanded(table)
    if table.is_empty() or not sent:
        return None
    traces: list[dict[str, Any]] = []
    for (name, tau), colour in zip(sent.items(), cycle(style.SERIES), strict=False):
        traces += _curves(table, name, tau, colour)
    traces += [binding_marks(table, sent), _motor_marks(table)]
    height = 580 if LIMITED in table.columns else 440  # the legend of drives takes more lines
    figure = style.figure(traces, "time [s]", "torque [Nm]", height=height)
    return style.shade(figure, style.spans(table))


def torque_words(table: pl.DataFrame) -> str:
    """Return how often a limit binds and, of joints with drives, what becomes of a command."""
    bound = int((table["active"] != "").sum()) if "active" in table.columns else 0
    ticks, limits = style.number(len(table)), "No limit bound on any tick."
    if bound:
        limits = f"A limit bound on {bound} of {ticks} ticks (red marks; hover to see which)."
    if LIMITED not in table.columns:
        return f"Torque sent to each joint. {limits}"
    met, motors = int(table[LIMITED].sum()), "No motor met its limit of current or voltage."
    if met:
        motors = f"A motor met its limit of current or voltage on {met} of {ticks} ticks (crosses)."
    return (
        "Torque commanded to each joint and, where they differ from it, delivered by its drive on "
        f"average until the next tick, and measured then. {_largest_words(table)}{limits} {motors}"
    )


def binding_marks(table: pl.DataFrame, curves: Mapping[str, Vector]) -> dict[str, Any]:
    """Return marks where a limit binds, on the curve of the joint that the limit names."""
    if "active" not in table.columns:
        return trace(np.zeros(0), np.zeros(0), "limit binds")
    active = table["active"].fill_null("").to_numpy()
    binding = np.flatnonzero(active != "")
    binding = binding[:: max(1, -(-len(binding) // MAX_MARKS))]
    names = [str(active[i]) for i in binding]
    owners = [next((c for c in curves if name.endswith(c)), next(iter(curves))) for name in names]
    y = np.array([curves[c][i] for c, i in zip(owners, binding, strict=True)])
    mark = {"color": style.FAIL, "size": 9, "symbol": "triangle-down"}
    said = "%{text}<extra>limit binds</extra>"
    texts = [escape(name) for name in names]
    shown: dict[str, Any] = {"mode": "markers", "marker": mark, "text": texts}
    return trace(column(table, "time")[binding], y, "limit binds", hovertemplate=said, **shown)


def _commanded(table: pl.DataFrame) -> dict[str, Vector]:
    names = [name.removeprefix("tau.") for name in table.columns if name.startswith("tau.")]
    return {name: column(table, f"tau.{name}") for name in names}


def _curves(table: pl.DataFrame, name: str, tau: Vector, colour: str) -> list[dict[str, Any]]:
    """Return the curves of one joint: commanded, and what differs from it."""
    time, driven = column(table, "time"), LIMITED in table.columns
    group = {"legendgroup": escape(name)} if driven else {}
    curves = [line(time, tau, name, colour, "Nm", **group)]
    for what, (quantity, dash) in (DRIVEN if driven else IDEAL).items():
        value = column(table, f"{quantity}.{name}")
        if _differs(value, tau):
            words = f"{name}, {what}"
            curves.append(line(time, value, words, colour, "Nm", dash=dash, **group))
    return curves


def _motor_marks(table: pl.DataFrame) -> dict[str, Any]:
    """Return crosses at zero torque where a motor met its limit of current or voltage."""
    met = table[LIMITED].fill_null(False).to_numpy() if LIMITED in table.columns else np.zeros(0)
    at = np.flatnonzero(met)
    at = at[:: max(1, -(-len(at) // MAX_MARKS))]
    words = "motor at its limit"
    mark = {"color": style.INK, "size": 6, "symbol": "x-thin-open"}
    shown: dict[str, Any] = {"mode": "markers", "marker": mark, "hovertemplate": words}
    return trace(column(table, "time")[at], np.zeros(len(at)), words, **shown)


def _largest_words(table: pl.DataFrame) -> str:
    """Return by how much delivered and commanded torque differ, and where most."""
    sent = _commanded(table)
    gaps = {name: np.abs(column(table, f"tau_delivered.{name}") - sent[name]) for name in sent}
    largest = {name: float(np.nanmax(gap, initial=0.0)) for name, gap in gaps.items()}
    if not any(largest.values()):
        return ""
    name = max(largest, key=lambda joint: largest[joint])
    rms = float(np.sqrt(np.nanmean(gaps[name] ** 2)))
    return (
        f"What is delivered differs most at {name}: by up to "
        f"{style.number(largest[name])} Nm, RMS {style.number(rms)} Nm. "
    )


def _differs(value: Vector, sent: Vector) -> bool:
    largest = np.nanmax(np.abs(sent), initial=1.0)
    return bool(np.nanmax(np.abs(value - sent), initial=0.0) > SAME * largest)
