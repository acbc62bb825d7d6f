"""The smooth part of a control tick, as one CasADi function per mode.

(q, v, u, x) → QP data, both laws, next memory, and what a report wants to know. Built once,
before the loop starts.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from qpctrl import limit
from qpctrl.contact import WrenchRows
from qpctrl.contact_report import ContactPlace, contact_places
from qpctrl.costs import costs_of
from qpctrl.errors import InputError
from qpctrl.gives import Give, what_tasks_get
from qpctrl.law import LawTerms, LawTorque, closed_forms
from qpctrl.layout import Layout
from qpctrl.levels import level_outputs, levels_of
from qpctrl.mode import Mode
from qpctrl.model import ModeModel
from qpctrl.objective import (
    ForceObjective,
    GraspObjective,
    MotionObjective,
    PostureObjective,
)
from qpctrl.qp import FORMS, QpExpressions, QpTerms, RowNames
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from qpctrl.spatial import SX

SINGULAR_MOBILITY = 1e-4
"""Share of the mobility left along an axis below which Λ⁻¹ is damped."""

SINGULAR_DAMPING = 0.05
"""Damping μ at the singularity itself [1/kg, 1/(kg m²)]."""

PIVOT_RATIO = 1e-10
"""A row whose pivot falls below this share of its diagonal depends on the rows before it."""


MATRICES = ("H", "A", "C", "G")
"""Outputs of every tick that are matrices, also for a robot with a single joint."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tick:
    """The function of one mode, and the names of what goes in and comes out."""

    mode: Mode
    model: ModeModel
    """The expressions that the function is made from."""
    function: ca.Function
    inputs: Layout
    memory: Layout
    rows: RowNames
    signals: dict[str, int]
    """Recorded quantities ``task.signal`` and their sizes, in the order of output ``signals``."""
    gives: tuple[Give, ...]
    spaces: tuple[TaskSpace, ...]
    mode_rows: int
    """Number of constraint rows k, all constraints together."""
    patterns: dict[str, ca.Sparsity]
    """Which entries of H, A, C and G can differ from zero."""
    has_law: bool
    """Whether closed forms exist: one task space, one motion task, B = I."""
    contacts: tuple[ContactPlace, ...]
    """What a report says about contacts."""
    upper_levels: int
    """Number of priorities above the lowest, whose cost H and g are; those of level i are H_i, g_i,
    and G_i are the rows of what its tasks get."""
    searched: bool
    """Whether the minimiser without inequalities is found by whoever solves the QP; its outputs
    here, the torques of the laws among them, are zeros then."""

    @property
    def matrices(self) -> tuple[str, ...]:
        """Outputs that are matrices, also where they have a single column."""
        upper = range(self.upper_levels)
        return *MATRICES, *(f"{name}_{i}" for i in upper for name in ("H", "G"))


def build_tick(robot: Robot, mode: Mode, form: str = "reduced") -> Tick:
    """Return the tick of ``mode``.

    Args:
        robot: the robot as the controller believes it to be.
        mode: active constraints and tasks.
        form: ``reduced`` (a, λ) or ``full`` (a, τ, λ).

    Raises:
        InputError: the tasks leave motion undetermined, or a constraint has no force task.
    """
    model = ModeModel(robot, mode)
    _check_determined(model)
    terms = _qp_terms(model)
    qp, rows = FORMS[form](terms)
    law = _law(model)
    gives, G = what_tasks_get(model, form, terms)
    signals = {
        f"{item.task.name}.{key}": value
        for item in model.tasks
        for key, value in item.written.signals.items()
    }
    outputs = {
        **qp._asdict(),
        **_law_outputs(law, form, qp),
        "G": G,
        **level_outputs(model, form, G, gives),
        **_space_outputs(model),
        "memory": model.memory_after(),
        "signals": _stack(ca.vec(ca.densify(value)) for value in signals.values()),
    }
    function = ca.Function(
        "tick",
        [model.dynamics.q, model.dynamics.v, model.u_vector, model.x_vector],
        [ca.densify(expression) for expression in outputs.values()],
        ["q", "v", "u", "x"],
        list(outputs),
        {"cse": True},
    )
    return Tick(
        mode=mode,
        model=model,
        function=function,
        inputs=model.inputs,
        memory=model.memory,
        rows=rows,
        signals={key: int(value.numel()) for key, value in signals.items()},
        gives=gives,
        spaces=tuple(model.spaces),
        mode_rows=terms.k,
        patterns={"G": G.sparsity()}
        | {name: getattr(qp, name).sparsity() for name in ("H", "A", "C")},
        has_law=law is not None,
        contacts=contact_places(model),
        upper_levels=len(model.mode.priorities) - 1,
        searched=terms.searched,
    )


def _qp_terms(model: ModeModel) -> QpTerms:
    u = model.u
    *_, lowest = levels_of(model)
    contact = [model.contact_rows(space) for space in model.spaces]
    b_c = [
        split.v_c_dot - split.A_dot_V - split.A @ model.spaces[space].J_dot_v
        for space, split in model.splits.items()
    ]
    constraints = [
        constraint
        for space in model.spaces
        for constraint in model.mode.constraints
        if constraint.space == space
    ]
    limits = limit.named(u)
    return QpTerms(
        **costs_of(model, lowest)._asdict(),
        M=model.dynamics.M,
        h=model.h,
        AJ=model.AJ,
        b_c=_stack(b_c),
        slack=model.mode.slack is not None,
        searched=model.mode.metric == "home"
        or len(model.mode.priorities) > 1
        or bool(model.of(GraspObjective)),  # whose Hessian in λ has not full rank
        B=model.robot.B,
        torque=limit.torque_bounds(
            limits, u["dt"], limit.actuator_speed(model.robot, model.dynamics.v)
        ),
        acceleration=limit.acceleration_bounds(
            limits, model.dynamics.coordinates, model.dynamics.v
        ),
        contact=WrenchRows(
            ca.diagcat(*(part.W for part in contact)), _stack(part.ub for part in contact)
        ),
        unilateral=tuple(side for constraint in constraints for side in constraint.unilateral),
        joint_names=model.robot.joint_names,
        actuator_names=model.robot.actuator_names,
        constraint_rows=tuple(f"{c.name}.{row}" for c in constraints for row in c.row_names),
        contact_rows=tuple(
            f"{part.name}.{row}"
            for space in model.spaces
            for part in model.mode.contact_limits
            if part.space == space
            for row in part.row_names
        ),
    )


def _law(model: ModeModel) -> LawTorque | None:
    motions, forces = model.of(MotionObjective), model.of(ForceObjective)
    postures = model.of(PostureObjective)
    levels = len(model.mode.priorities)
    square = np.array_equal(model.robot.B, np.eye(model.robot.nv))
    if (
        model.mode.metric != "inertia"
        or levels > 1
        or not square
        or len(model.spaces) != 1
        or len(motions) != 1
        or len(postures) > 1
    ):
        return None
    space, terms = next(iter(model.spaces.items()))
    return closed_forms(
        LawTerms(
            terms=terms,
            split=model.splits[space],
            M_factor=model.M_factor,
            h=model.h,
            M_N=model.M_N,
            a_cmd=motions[0][0].a_cmd,
            F_cmd=forces[0][0].F_cmd if forces else ca.SX.zeros(space.n),
            a_post=postures[0][0].a_post if postures else ca.SX.zeros(model.robot.nv),
        )
    )


def _space_outputs(model: ModeModel) -> dict[str, SX]:
    """Return what is known of the task spaces: rows, inertia, how far from singular they are."""
    splits = [split for split in model.splits.values() if split.k]
    mobility = _stack(terms.mobility_left for terms in model.spaces.values())
    pivots = _stack(split.pivot_ratios for split in splits)
    outputs = {
        "mobility_left": mobility,
        "damping": _damping(mobility),
        "row_pivots": pivots,
        "dependent": _count_below(pivots, PIVOT_RATIO),
    }
    for i, (space, split) in enumerate(model.splits.items()):
        outputs[f"A{i}"] = split.A
        if model.mode.metric == "inertia":
            outputs |= {f"Lambda{i}": model.spaces[space].Lambda, f"P{i}": split.P}
    return outputs


def _law_outputs(law: LawTorque | None, form: str, qp: QpExpressions) -> dict[str, SX]:
    if law is None:  # the equality-constrained QP takes the place of the closed form
        nu = qp.t.shape[0]
        tau = qp.C[:nu, :] @ qp.x_eq + qp.t
        none = ca.SX.zeros(nu)
        return {"tau_textbook": tau, "tau_hybrid": tau, "curvature": none, "x_law": qp.x_eq}
    middle = law.hybrid if form == "full" else ca.SX(0, 1)
    return {
        "tau_textbook": law.textbook,
        "tau_hybrid": law.hybrid,
        "curvature": law.curvature,
        "x_law": ca.vertcat(law.a, middle, law.lam),
    }


def _check_determined(model: ModeModel) -> None:
    moved = sum(space.n for _, space in model.of(MotionObjective) if space)
    if moved < model.robot.nv and not model.of(PostureObjective):
        raise InputError(
            f"mode {model.mode.name!r}: motion tasks fix {moved} of {model.robot.nv} freedoms; "
            "add a posture task for the rest"
        )


def _damping(mobility_left: SX) -> SX:
    """Return the damping μ of Λ⁻¹ that the smallest mobility asks for; 0 where none is."""
    if mobility_left.numel() == 0:
        return ca.SX(0)
    smallest = ca.mmin(ca.if_else(mobility_left > 0, mobility_left, 0))  # 0 where Λ is NaN
    damping = SINGULAR_DAMPING * ca.fmax((1 - smallest / SINGULAR_MOBILITY) ** 2, 1e-6)
    return ca.if_else(smallest > SINGULAR_MOBILITY, 0, damping)


def _count_below(values: SX, threshold: float) -> SX:
    """Return how many values are not above the threshold; a NaN is not."""
    return values.numel() - ca.sum1(ca.if_else(values > threshold, 1, 0)) + ca.SX(0)


def _stack(parts: object) -> SX:
    return ca.vertcat(ca.SX(0, 1), *parts)  # type: ignore[misc]
