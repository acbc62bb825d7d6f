"""The pictures of a report: a figure with its words, and the sets that scenarios share."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from qpctrl.arrays import Array
from qpctrl.robot import Robot
from scenarios import report_figure as draw
from scenarios.report_style import Figure, column
from scenarios.report_torque import torque_figure, torque_words
from scenarios.report_trace import Curve, curve_figure, plane_figure, wrench_figure
from scenarios.torque_step import torque_steps


class Panel(NamedTuple):
    """A figure with its words."""

    key: str
    """Name of the panel in the page, unique there."""
    title: str
    caption: str
    figure: Figure | None
    """None where the record has nothing to show; the panel is left out then."""
    half: bool = False
    """Whether it takes half of the width, beside another such panel."""


def board_panels(
    summary: Mapping[str, Any], table: pl.DataFrame, geometry: Mapping[str, Array]
) -> tuple[Panel, ...]:
    """Return path, position error and force of a tool on a flat board.

    Args:
        summary: what summary.json holds.
        table: the record, one row a tick; a column may be missing.
        geometry: ``X_WE``, pose (4×4) of the board, and ``loops`` (samples×2) [m], the path on it.
    """
    limits = {c["name"]: c["limit"] for c in summary["criteria"] if c["limit"] is not None}
    return (
        Panel(
            "path",
            "Path on the board",
            "As you see it when you face the board. Lighter: where the 120 × 50 mm pad passed.",
            draw.path_figure(table, geometry),
            half=True,
        ),
        Panel(
            "error",
            "Position error and tilt",
            "Desired − actual, in the plane of the board. The range is that of wiping.",
            draw.error_figure(table, limits),
            half=True,
        ),
        Panel(
            "force",
            "Force on the board",
            "Measured by the sensor in the wrist, robot on board. Below: measured − set-point.",
            draw.force_figure(table, limits),
        ),
    )


def environment_panels(
    table: pl.DataFrame, geometry: Mapping[str, Array], where: str
) -> tuple[Panel, ...]:
    """Return path, forces, moments and pose error of a tool led by its environment.

    Args:
        table: the record, one row a tick.
        geometry: what `plane_figure` draws.
        where: the environment in words.
    """
    pose = [column(table, f"motion.X_e.{i}") for i in range(6)]
    shift = [Curve(axis, 1e3 * y) for axis, y in zip("xyz", pose[:3], strict=True)]
    turn = [Curve(f"about {axis}", np.degrees(y)) for axis, y in zip("xyz", pose[3:], strict=True)]
    force, moment = wrench_figure(table, slice(0, 3)), wrench_figure(table, slice(3, 6))
    seen = "Robot on environment, in the axes of the tool. Below: measured − set-point."
    return (
        Panel("path", "Path", f"The tool's point, {where}.", plane_figure(table, geometry), True),
        Panel(
            "shift",
            "Position error",
            "Desired − actual, in the axes of the tool.",
            curve_figure(table, "position error", "mm", shift),
            True,
        ),
        Panel("force", "Force on the environment", seen, force),
        Panel("moment", "Moment on the environment", seen, moment),
        Panel(
            "turn",
            "Orientation error",
            "Desired − actual, as a rotation vector in the axes of the tool.",
            curve_figure(table, "orientation error", "deg", turn),
        ),
    )


def step_panel(table: pl.DataFrame, robot: Robot) -> Panel:
    """Return the picture of how far torques step from tick to tick."""
    steps = np.concatenate([np.zeros(1), torque_steps(table, robot)])
    return Panel(
        "step",
        "Step of torque from tick to tick",
        "The largest of all joints, over what the torque-rate limit allows in one tick.",
        curve_figure(table, "torque step", "× limit", [Curve("largest step", steps)]),
    )


def common_panels(table: pl.DataFrame) -> tuple[Panel, ...]:
    """Return what every report ends with: torque, equality of QP and law, timing."""
    return (
        Panel("torque", "Joint torque", torque_words(table), torque_figure(table)),
        Panel(
            "equality", "QP and closed form", draw.equal_words(table), draw.equality_figure(table)
        ),
        Panel("timing", "Tick time", draw.timing_words(table), draw.timing_figure(table)),
    )
