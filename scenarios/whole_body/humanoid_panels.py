"""The pictures of the humanoid at the wall."""

from collections.abc import Mapping

import polars as pl

from qpctrl.arrays import Array
from scenarios.panel import Panel, step_panel
from scenarios.report_style import column
from scenarios.report_trace import Curve, curve_figure, plane_figure
from scenarios.scenario import Outcome
from scenarios.whole_body.contact_panels import contact_panels, in_words
from scenarios.whole_body.humanoid_metric import body_motion
from scenarios.whole_body.humanoid_world import SOLES, HumanoidWorld

AXES = ("forward", "left", "up")


def humanoid_panels(outcome: Outcome, world: HumanoidWorld) -> tuple[Panel, ...]:
    """Return path and force of the hand, what the soles carry, and how the body moved."""
    table = outcome.table
    return (
        *_hand_panels(table, outcome.experiment.geometry),
        *contact_panels(table, world.soles, in_words(outcome.summary["events"])),
        *_body_panels(table, world),
    )


def _hand_panels(table: pl.DataFrame, geometry: Mapping[str, Array]) -> tuple[Panel, ...]:
    force = [column(table, f"wrench_meas.{name}") for name in ("fz", "fx", "fy")]
    wanted = column(table, "force.F_des.2")
    curves = [
        Curve("normal, measured", force[0]),
        Curve("tangential, up", force[1]),
        Curve("tangential, sideways", force[2]),
        Curve("normal, set-point", wanted, dashed=True),
    ]
    errors = [Curve(f"error {axis}", 1e3 * column(table, f"motion.X_e.{i}")) for i, axis in _PLANE]
    below = [Curve("error of the normal force", force[0] - wanted)]
    return (
        Panel(
            "path",
            "Path on the wall",
            "As you see it when you face the wall.",
            plane_figure(table, geometry),
            True,
        ),
        Panel(
            "error",
            "Position error of the hand",
            "Desired − actual, along the axes of the hand in the plane of the wall.",
            curve_figure(table, "error", "mm", errors),
            True,
        ),
        Panel(
            "force",
            "Force on the wall",
            "Hand on wall. Below: measured − set-point, the push included.",
            curve_figure(table, "force", "N", curves, ("error", below)),
        ),
    )


def _body_panels(table: pl.DataFrame, world: HumanoidWorld) -> tuple[Panel, ...]:
    com = [
        Curve(axis, 1e3 * column(table, f"centre of mass.c_e.{i}")) for i, axis in enumerate(AXES)
    ]
    slip = body_motion(table, world.robot).slip
    ways = [Curve(name.replace("_", " "), slip[:, i]) for i, name in enumerate(SOLES)]
    return (
        Panel(
            "com",
            "Centre of mass",
            "Desired − actual, in the axes of the world. It leans forward while the hand presses.",
            curve_figure(table, "error", "mm", com),
            True,
        ),
        Panel(
            "slip",
            "Way of the soles on the ground",
            "From where they stood at the start, by the true state.",
            curve_figure(table, "way", "mm", ways),
            True,
        ),
        step_panel(table, world.robot),
    )


_PLANE = ((0, "x"), (1, "y"))
