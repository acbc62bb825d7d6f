"""The one fallback: hold with damping and gravity compensation.

τ = B⁺ (g(q) − K_d v), within the same torque bounds as that of the QP. A robot with a floating
body is held up by its contacts: τ = B⁺ (g(q) + Jᵀ Aᵀ λ − K_d v) with the least multipliers that
carry the weight of what no torque drives. The fallback is sent whenever a tick
has no solution of the demanded accuracy, and counted. A velocity that is not measured is taken
from the last two configurations, but for a robot that floats; where nothing new is known there is
no damping, for acting on an old velocity would push.
"""

import casadi as ca
import numpy as np

from qpctrl import limit
from qpctrl.factor import Factor
from qpctrl.layout import Layout
from qpctrl.model import ModeModel
from qpctrl.qp import complement
from qpctrl.robot import Robot
from qpctrl.spatial import SX

WEAK_SUPPORT = 1e-9
"""Share of what contacts can carry below which a direction counts as carried by none."""

HOLD_DAMPING = 5.0
"""Damping of the fallback [1/s], times the diagonal of the mass matrix."""


def build_fallback(model: ModeModel) -> ca.Function:
    """Return (q, v, u) → (tau, held): the torque to hold still, with and without its limits.

    Args:
        model: of a mode; its constraints hold up what floats, and of its inputs ``u`` only limits,
            period and what constraints read matter.
    """
    robot, dynamics, u_vector, u = model.robot, model.dynamics, model.u_vector, model.u
    gravity = ca.substitute(dynamics.h, dynamics.v, ca.SX.zeros(robot.nv))
    damping = HOLD_DAMPING * ca.diag(dynamics.M) * dynamics.v
    carried = model.AJ.T @ _least_multipliers(robot, gravity, model.AJ)
    held = ca.SX(np.linalg.pinv(robot.B)) @ (gravity + carried - damping)
    last = limit.named(u)["tau_last"]  # a quaternion of zeros is finite, but no orientation
    held = ca.if_else(ca.fabs(held) <= limit.UNBOUNDED, held, last)
    return ca.Function(
        "fallback",
        [dynamics.q, dynamics.v, u_vector],
        [ca.densify(_within(robot, held, dynamics.v, u)), ca.densify(held)],
        ["q", "v", "u"],
        ["tau", "held"],
        {"cse": True},
    )


def _least_multipliers(robot: Robot, gravity: SX, AJ: SX) -> SX:
    """Return the least λ (k) with U (g + Jᵀ Aᵀ λ) = 0, U the rows that B leaves undriven."""
    if not robot.floats:
        return ca.SX(AJ.shape[0], 1)
    U = ca.SX(complement(robot.B))
    carry = U @ AJ.T
    square = carry @ carry.T
    weak = WEAK_SUPPORT * ca.trace(square) * ca.SX.eye(square.shape[0])
    return -(carry.T @ Factor(square + weak).solve(U @ gravity))


def build_limited(robot: Robot, inputs: Layout) -> ca.Function:
    """Return (tau, v, u) → limited: ``tau`` (nu) [Nm] moved inside the bounds that the QP sets."""
    tau, v = ca.SX.sym("tau", robot.nu), ca.SX.sym("v", robot.nv)
    u_vector, u = inputs.symbols("u")
    limited = ca.densify(_within(robot, tau, v, u))
    return ca.Function("limited", [tau, v, u_vector], [limited], ["tau", "v", "u"], ["limited"])


def _within(robot: Robot, tau: SX, v: SX, u: dict[str, SX]) -> SX:
    """Return ``tau`` within limits; where an input is no number the robot's own takes its place."""
    given, own = limit.named(u), limit.inputs(robot)
    usable = {
        name: ca.if_else(ca.fabs(given[name]) <= limit.UNBOUNDED, given[name], ca.SX(own[name]))
        for name in limit.TORQUE_INPUTS
    }
    lb, ub = limit.torque_bounds(usable, u["dt"], limit.actuator_speed(robot, v))
    return ca.fmin(ca.fmax(tau, lb), ub)
