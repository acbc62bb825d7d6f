"""Pictures of two arms that carry a box: its path, the forces, the contacts, steps of torque."""

from typing import Any

import numpy as np
import polars as pl

from scenarios import report_style as style
from scenarios.panel import Panel, step_panel
from scenarios.report_style import Figure, column, trace
from scenarios.report_trace import Curve, curve_figure
from scenarios.scenario import Outcome
from scenarios.whole_body.bimanual_metric import internal_force
from scenarios.whole_body.bimanual_world import BoxWorld
from scenarios.whole_body.contact_panels import contact_panels, in_words


def box_panels(outcome: Outcome, world: BoxWorld) -> tuple[Panel, ...]:
    """Return path and forces of the box, and what its contacts carry and have left."""
    table, words = outcome.table, in_words(outcome.summary["events"])
    error = [
        Curve(f"along {axis}", 1e3 * column(table, f"motion.X_e.{i}"))
        for i, axis in enumerate("xyz")
    ]
    return (
        Panel(
            "path",
            "Path of the box",
            "The middle of its lowest face, seen from the front: an eight in the air that rises, "
            "a ring on the table.",
            path_figure(table, world),
            True,
        ),
        Panel(
            "error",
            "Error of the path",
            "Desired − actual, in the axes of the lowest face. On the table z is not controlled.",
            curve_figure(table, "position error", "mm", error),
            True,
        ),
        Panel(
            "forces",
            "Internal force and force on the table",
            f"True forces and their set-points. {words}",
            force_figure(table),
        ),
        *contact_panels(table, world.contacts, words),
        step_panel(table, world.robot),
    )


def force_figure(table: pl.DataFrame) -> Figure | None:
    """Return internal force and force on the table over time, with their set-points."""
    curves = [
        Curve("internal force", internal_force(table)),
        Curve("internal force, set-point", column(table, "grasp.f_des.0"), dashed=True),
        Curve("force on the table", column(table, "contact.table.fz")),
        Curve("force on the table, set-point", column(table, "press.F_des.2"), dashed=True),
    ]
    return curve_figure(table, "force", "N", curves)


def path_figure(table: pl.DataFrame, world: BoxWorld) -> Figure | None:
    """Return the path of the middle of the lowest face, x to the right, height up [mm]."""
    p = np.stack([column(table, f"motion.X_WF.{i}") for i in (9, 10, 11)], axis=1)
    p = 1e3 * (p - world.X_WT.translation)
    p = p[np.isfinite(p).all(axis=1)]
    if not len(p):
        return None
    kept = np.arange(0, len(p), max(1, len(p) // 2000))
    hover = "%{x:.1f} mm, %{y:.1f} mm<extra>%{fullData.name}</extra>"
    looks: list[tuple[str, int, dict[str, Any]]] = [
        ("from the front: x and height", 2, {"color": style.SERIES[0], "width": 2}),
        ("from above: x and y", 1, {"color": style.SERIES[1], "width": 2}),
    ]
    traces = [
        trace(p[kept, 0], p[kept, i], name, line=look, hovertemplate=hover)
        for name, i, look in looks
    ]
    figure = style.figure(traces, "", "", height=420)
    figure["layout"]["hovermode"] = "closest"
    figure["layout"]["xaxis"] = style.axis("x [mm]")
    figure["layout"]["yaxis"] = style.axis("height, or y [mm]", scaleanchor="x")
    return figure
