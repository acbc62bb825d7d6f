"""The costs of a mode's tasks, as Hessians and gradients in a and λ."""

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca

from qpctrl.model import ModeModel, WrittenTask
from qpctrl.objective import ForceObjective, GraspObjective, MotionObjective, PostureObjective
from qpctrl.slack import with_slack
from qpctrl.space import SpaceTerms
from qpctrl.spatial import SX


class Costs(NamedTuple):
    """Costs ½ aᵀH_a a + g_aᵀa + ½ λᵀH_lam λ + g_lamᵀλ."""

    H_a: SX
    """(nv×nv)."""
    g_a: SX
    """(nv)."""
    H_lam: SX
    """(k×k)."""
    g_lam: SX
    """(k)."""


def costs_of(model: ModeModel, tasks: Sequence[WrittenTask]) -> Costs:
    """Return the costs of some tasks and, where there is any, of the slack."""
    H_a, g_a = _costs_in_a(model, tasks)
    H_lam, g_lam = _force_costs(model, tasks)
    H_grasp, g_grasp = _grasp_costs(model, tasks)
    return Costs(H_a, g_a, H_lam + H_grasp, g_lam + g_grasp)


def _costs_in_a(model: ModeModel, tasks: Sequence[WrittenTask]) -> tuple[SX, SX]:
    nv = model.robot.nv
    H_a, g_a = ca.SX(nv, nv), ca.SX(nv, 1)
    for item in tasks:
        objective, weight = item.written.objective, item.weight
        if isinstance(objective, PostureObjective):
            H_a += weight * model.M_N
            g_a -= weight * (model.M_N @ objective.a_post)
        elif isinstance(objective, MotionObjective) and item.task.space:
            terms = model.spaces[item.task.space]
            H_a += _inertia(terms, weight)
            g_a += weight * (terms.J.T @ (terms.Lambda @ (terms.J_dot_v - objective.a_cmd)))
    return (H_a, g_a) if model.mode.slack is None else with_slack(model, H_a, g_a)


def _force_costs(model: ModeModel, tasks: Sequence[WrittenTask]) -> tuple[SX, SX]:
    cost = {space: (ca.SX(0), ca.SX.zeros(space.n)) for space in model.spaces}
    for item in tasks:
        objective = item.written.objective
        if isinstance(objective, ForceObjective) and item.task.space:
            cost[item.task.space] = (item.weight, objective.F_cmd)
    H, g = [], [ca.SX(0, 1)]
    for space, split in model.splits.items():
        weight, F_cmd = cost[space]
        H.append(weight * split.S)
        g.append(-weight * (split.A @ model.spaces[space].Lambda_inv @ F_cmd))
    return ca.diagcat(*H), ca.vertcat(*g)


def _inertia(terms: SpaceTerms, weight: SX) -> SX:
    """Return w JᵀΛJ (nv×nv); from R, with the zeros of J, half of the products will do."""
    R = terms.root
    if R.is_empty():
        return weight * terms.task_inertia
    columns, heavy = ca.horzsplit(R), ca.horzsplit(weight * R)
    moved = [i for i, column in enumerate(columns) if column.nnz()]
    product = ca.SX(R.shape[1], R.shape[1])
    for a, i in enumerate(moved):
        for j in moved[: a + 1]:
            product[i, j] = product[j, i] = ca.dot(heavy[i], columns[j])
    return product


def _grasp_costs(model: ModeModel, tasks: Sequence[WrittenTask]) -> tuple[SX, SX]:
    k = sum(split.k for split in model.splits.values())
    H, g = ca.SX(k, k), ca.SX(k, 1)
    for item in tasks:
        objective = item.written.objective
        if isinstance(objective, GraspObjective):
            E = grasp_map(model, objective)
            W = _isotropic([model.spaces[space].Lambda_inv for space in objective.E])
            H += item.weight * (E.T @ W @ E)
            g -= item.weight * (E.T @ (W @ objective.F_cmd))
    return H, g


def grasp_map(model: ModeModel, grasp: GraspObjective) -> SX:
    """Return the map (6×k) from all multipliers to the commanded sum of wrenches."""
    none = ca.SX(6, 0)
    return ca.horzcat(
        none,
        *(
            grasp.E[space] @ split.A.T if space in grasp.E else ca.SX(6, split.k)
            for space, split in model.splits.items()
        ),
    )


def _isotropic(mobilities: list[SX]) -> SX:
    """Return a metric of wrenches (6×6) that is the same in all directions of one unit."""
    linear, angular = (
        sum((ca.trace(mobility[part, part]) for mobility in mobilities), ca.SX(0))
        / (3 * len(mobilities))
        for part in (slice(3), slice(3, 6))
    )
    return ca.diag(ca.vertcat(*[linear] * 3, *[angular] * 3))
