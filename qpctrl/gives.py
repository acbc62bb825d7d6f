"""What each task gets from a solution of the QP, against which it can be said to give way."""

from typing import NamedTuple

import casadi as ca

from qpctrl.costs import grasp_map
from qpctrl.model import ModeModel
from qpctrl.objective import ForceObjective, GraspObjective
from qpctrl.qp import QpTerms
from qpctrl.slack import row_units
from qpctrl.space import CentroidalSpace, TaskSpace
from qpctrl.spatial import AXES, SX


class Give(NamedTuple):
    """Which rows of ``G x`` measure how far one task, or the slack, can give way."""

    task: str
    rows: slice
    axes: tuple[str, ...]
    units: tuple[str, ...]


def what_tasks_get(model: ModeModel, form: str, terms: QpTerms) -> tuple[tuple[Give, ...], SX]:
    """Return rows G with ``G x`` = what each task gets: J a, Aᵀ λ, or M_N a; A J a with slack."""
    nv = model.robot.nv
    nu = model.robot.nu if form == "full" else 0
    k_all = sum(split.k for split in model.splits.values())
    offset, column = {}, nv + nu
    for space, split in model.splits.items():
        offset[space], column = column, column + split.k
    gives, blocks, start = [], [ca.SX(0, nv + nu + k_all)], 0
    for item in model.tasks:
        objective, owner = item.written.objective, item.task.space
        axes = owner.axes if owner else model.robot.joint_names
        if isinstance(objective, GraspObjective):
            axes = AXES
        block = ca.SX(len(axes), nv + nu + k_all)
        if isinstance(objective, ForceObjective) and owner:
            split = model.splits[owner]
            block[:, offset[owner] : offset[owner] + split.k] = split.A.T
            units = tuple("N" if axis.startswith("v") else "Nm" for axis in axes)
        elif isinstance(objective, GraspObjective):
            block[:, nv + nu :] = grasp_map(model, objective)
            units = ("N",) * 3 + ("Nm",) * 3
        elif owner:
            block[:, :nv] = model.spaces[owner].J
            units = _rate_units(owner)
        else:
            block[:, :nv] = model.M_N
            units = ("Nm",) * len(axes)
        blocks.append(block)
        gives.append(Give(item.task.name, slice(start, start + len(axes)), axes, units))
        start += len(axes)
    if terms.slack:
        blocks.append(ca.horzcat(terms.AJ, ca.SX(k_all, nu + k_all)))
        rows = slice(start, start + k_all)
        gives.append(Give("slack", rows, terms.constraint_rows, row_units(model)))
    return tuple(gives), ca.vertcat(*blocks)


def _rate_units(space: TaskSpace) -> tuple[str, ...]:
    """Return the unit of J a for each axis of a space."""
    linear, angular = ("N", "Nm") if isinstance(space, CentroidalSpace) else ("m/s²", "rad/s²")
    return tuple(linear if axis.startswith("v") else angular for axis in space.axes)
