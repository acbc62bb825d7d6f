"""Constraints with slack s = A V̇ + Ȧ V − v̇_c, which can give way when a limit binds.

    ‖V̇ − a_cmd‖²_Λ = ‖V̇ − a_cmd‖²_{PΛ} + ‖A (V̇ − a_cmd)‖²_{S⁻¹}

Where A's rows hold, the last term is constant. With slack, w_s ‖s‖²_{S⁻¹} takes its place: the
costs stay orthogonal, and without active limits s = 0 for every w_s (docs/formulation.md).
"""

import casadi as ca

from qpctrl.model import ModeModel
from qpctrl.objective import MotionObjective
from qpctrl.spatial import SX


def with_slack(model: ModeModel, H_a: SX, g_a: SX) -> tuple[SX, SX]:
    """Return the costs in a, H_a (nv×nv) and g_a (nv), with that of the slack among them."""
    w_s = model.u["slack.weight"]
    for space, split in model.splits.items():
        terms = model.spaces[space]
        motions = [
            (item.weight, item.written.objective.a_cmd)
            for item in model.tasks
            if isinstance(item.written.objective, MotionObjective) and item.task.space == space
        ]
        pull = w_s * (split.A @ terms.J_dot_v + split.A_dot_V - split.v_c_dot)
        for weight, a_cmd in motions:
            pull -= weight * (split.A @ (terms.J_dot_v - a_cmd))
        H_a += (w_s - sum(weight for weight, _ in motions)) * split.held_inertia(terms.J)
        g_a += terms.J.T @ split.held_wrench(pull)
    return H_a, g_a


def row_units(model: ModeModel) -> tuple[str, ...]:
    """Return the unit of A V̇ for each row: angular where no linear axis is in it."""
    units: list[str] = []
    for space, split in model.splits.items():
        linear = [i for i, axis in enumerate(space.axes) if axis.startswith("v")]
        rows = (ca.sparsify(split.A[i, linear]).nnz() for i in range(split.k))
        units += ("m/s²" if nnz else "rad/s²" for nnz in rows)
    return tuple(units)
