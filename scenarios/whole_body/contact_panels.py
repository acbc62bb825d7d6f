"""Pictures that whole-body scenarios share: what each contact carries and how much it has left."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl

from qpctrl.arrays import Vector
from scenarios import report_style as style
from scenarios.panel import Panel
from scenarios.report_style import Figure, column, line, trace
from scenarios.whole_body.contact import (
    CarryingContact,
    centre_of_pressure,
    friction_margin,
    pressure_margin,
    true_wrench,
)

HALF_WIDTH = 420  # pixels of a plot that stands beside another
ABOVE = 0.25  # of the face drawn around it


def in_words(events: Sequence[str]) -> str:
    """Return what gave way in a sentence."""
    return f"In the order of time: {'; '.join(events)}." if events else "Nothing gave way."


def contact_panels(
    table: pl.DataFrame, contacts: Sequence[CarryingContact], words: str = ""
) -> tuple[Panel, ...]:
    """Return wrenches, margins and centres of pressure of contacts, from the true wrenches.

    Args:
        table: the record, one row a tick, with ``contact.NAME.fx`` and so on of each contact.
        contacts: which ones, as the plant has them.
        words: what to say of the margins besides.
    """
    faces = [contact for contact in contacts if contact.half is not None]
    caption = (
        "From the true wrenches. Above: what friction has left, μ f_z − ‖f_t‖. Below: how far the "
        f"centre of pressure is from the nearest edge. At 0 a contact slips or tips. {words}"
    )
    return (
        *(_wrench_panel(table, contact) for contact in contacts),
        Panel("margins", "Margins of the contacts", caption, margin_figure(table, contacts)),
        *(_pressure_panel(table, contact) for contact in faces),
    )


def margin_figure(table: pl.DataFrame, contacts: Sequence[CarryingContact]) -> Figure | None:
    """Return what friction [N] and centre of pressure [mm] have left over time, with their 0."""
    time, traces, below = column(table, "time"), [], []
    for i, contact in enumerate(contacts):
        wrench, colour = true_wrench(table, contact), style.SERIES[i % len(style.SERIES)]
        traces.append(line(time, friction_margin(wrench, contact), _words(contact), colour, "N"))
        left = 1e3 * pressure_margin(wrench, contact)
        if not np.isnan(left).all():
            below.append(
                line(time, left, f"{_words(contact)}, to its edge", colour, "mm", width=1.0)
            )
    figure = style.figure(traces, "time [s]", "friction left [N]", height=480)
    if not figure["data"]:
        return None
    style.add_limit(figure, 0.0, "slips")
    for drawn in below:
        style.add_panel(figure, drawn, "to the edge [mm]", None)
    if below:
        style.add_limit(figure, 0.0, "tips", "y2")
    return style.shade(figure, style.spans(table))


def force_figure(table: pl.DataFrame, contact: CarryingContact) -> Figure | None:
    """Return the true force of a contact over time [N], and what the QP wants along z."""
    time, wrench = column(table, "time"), true_wrench(table, contact)
    traces = [
        line(time, wrench[:, i], name, style.SERIES[i], "N")
        for i, name in enumerate(("fx", "fy", "fz"))
    ]
    wanted = column(table, f"qp.{contact.name}.fz")
    traces.append(line(time, wanted, "fz of the QP", style.INK, "N", width=1.2, dash="5px,4px"))
    figure = style.figure(traces, "time [s]", "force [N]", height=440)
    return style.shade(figure, style.spans(table), HALF_WIDTH) if figure["data"] else None


def pressure_figure(table: pl.DataFrame, contact: CarryingContact) -> Figure | None:
    """Return the path of the centre of pressure in its face [mm], x of the frame up.

    Seen from inside the robot: y of a frame whose z points down points right then.
    """
    if contact.half is None:
        return None
    centre = 1e3 * centre_of_pressure(true_wrench(table, contact))
    centre = centre[~np.isnan(centre[:, 0])]
    if not len(centre):
        return None
    kept = centre[np.union1d(style.thin(centre[:, 0]), style.thin(centre[:, 1]))]
    a, b = (1e3 * half for half in contact.half)
    hover = "x %{y:.1f} mm, y %{x:.1f} mm<extra>%{fullData.name}</extra>"
    across, along = np.array([-b, b, b, -b, -b]), np.array([-a, -a, a, a, -a])
    edge = {"color": style.LIMIT, "width": 1.6, "dash": "dash"}
    path, dot = {"color": style.SERIES[0], "width": 1.6}, {"color": style.INK, "size": 9}
    traces = [
        trace(across, along, "edge of the face", line=edge, hovertemplate=hover),
        trace(kept[:, 1], kept[:, 0], "centre of pressure", line=path, hovertemplate=hover),
        trace(*_end(kept), "end", mode="markers", marker=dot, hovertemplate=hover),
    ]
    figure = style.figure(traces, "", "", height=420)
    reach: dict[str, Any] = {"range": [-(1 + ABOVE) * b, (1 + ABOVE) * b]}
    figure["layout"]["hovermode"] = "closest"
    figure["layout"]["xaxis"] = style.axis("y [mm]", **reach)
    up = [-(1 + ABOVE) * a, (1 + ABOVE) * a]
    figure["layout"]["yaxis"] = style.axis("x [mm]", range=up, scaleanchor="x")
    return figure


def _end(points: Any) -> tuple[Vector, Vector]:
    return points[-1:, 1], points[-1:, 0]


def _wrench_panel(table: pl.DataFrame, contact: CarryingContact) -> Panel:
    return Panel(
        f"contact-{contact.name}",
        f"Contact {_words(contact)}",
        "True force of the robot on what it touches, in the axes of the contact; z points into it.",
        force_figure(table, contact),
        True,
    )


def _pressure_panel(table: pl.DataFrame, contact: CarryingContact) -> Panel:
    return Panel(
        f"pressure-{contact.name}",
        f"Centre of pressure, {_words(contact)}",
        "Seen from the robot, x of the contact's frame up. Dashed: the edge, where it would tip.",
        pressure_figure(table, contact),
        True,
    )


def _words(contact: CarryingContact) -> str:
    return contact.name.replace("_", " ")
