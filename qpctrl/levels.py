"""Tasks sorted by priority, and what a tick says of the levels above the lowest."""

from collections.abc import Sequence
from itertools import groupby

import casadi as ca

from qpctrl.costs import costs_of
from qpctrl.gives import Give
from qpctrl.model import ModeModel, WrittenTask
from qpctrl.spatial import SX


def levels_of(model: ModeModel) -> list[list[WrittenTask]]:
    """Return the tasks of each priority, the highest first."""
    ranked = sorted(model.tasks, key=lambda item: item.priority)
    return [list(level) for _, level in groupby(ranked, key=lambda item: item.priority)]


def level_outputs(model: ModeModel, form: str, G: SX, gives: Sequence[Give]) -> dict[str, SX]:
    """Return cost and rows of every level but the lowest: H_i (n×n), g_i (n), G_i (p×n).

    Args:
        model: of the mode.
        form: of the QP, whose variables these are in.
        G: rows of what all tasks get.
        gives: which of them are whose.
    """
    rows = {give.task: list(range(give.rows.start, give.rows.stop)) for give in gives}
    outputs: dict[str, SX] = {}
    for i, level in enumerate(levels_of(model)[:-1]):
        costs = costs_of(model, level)
        nu = model.robot.nu if form == "full" else 0
        own = [row for item in level for row in rows[item.task.name]]
        outputs[f"H_{i}"] = ca.diagcat(costs.H_a, ca.SX(nu, nu), costs.H_lam)
        outputs[f"g_{i}"] = ca.vertcat(costs.g_a, ca.SX(nu, 1), costs.g_lam)
        outputs[f"G_{i}"] = G[own, :]
    return outputs
