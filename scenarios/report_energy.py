"""The energy that a robot gave to its environment, as a picture."""

import polars as pl

from scenarios.panel import Panel
from scenarios.report_style import column
from scenarios.report_trace import Curve, curve_figure


def energy_panel(table: pl.DataFrame, task: str = "force") -> Panel:
    """Return the energy over time.

    Args:
        table: the record, one row a tick.
        task: name of the task that observes it.
    """
    given = Curve("given to the environment", column(table, f"{task}.energy.0"))
    return Panel(
        "energy",
        "Energy given to the environment",
        "The passivity observer: ∫ Fᵀ V dt, measured wrench on the environment times twist of the "
        "tool. It falls where the environment gives energy back.",
        curve_figure(table, "energy", "J", [given]),
    )
