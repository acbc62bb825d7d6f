"""The one fallback: hold with damping and gravity compensation.

τ = B⁺ (g(q) − K_d v), within the same torque bounds as that of the QP. It is sent whenever a tick
has no solution of the demanded accuracy, and counted. A velocity that is not measured is taken
from the last two configurations; where nothing new is known there is no damping, for acting on
an old velocity would push.
"""

import casadi as ca
import numpy as np

from qpctrl import limit
from qpctrl.dynamics import Dynamics
from qpctrl.layout import Layout
from qpctrl.robot import Robot
from qpctrl.spatial import SX

HOLD_DAMPING = 5.0
"""Damping of the fallback [1/s], times the diagonal of the mass matrix."""


def build_fallback(robot: Robot, inputs: Layout) -> ca.Function:
    """Return (q, v, u) → (tau, held): the torque to hold the arm, with and without its limits.

    Args:
        robot: the robot as the controller believes it to be.
        inputs: layout of a mode's packed inputs ``u``; of these only limits and period matter.
    """
    dynamics = Dynamics(robot)
    u_vector, u = inputs.symbols("u")
    gravity = ca.substitute(dynamics.h, dynamics.v, ca.SX.zeros(robot.nv))
    damping = HOLD_DAMPING * ca.diag(dynamics.M) * dynamics.v
    held = ca.SX(np.linalg.pinv(robot.B)) @ (gravity - damping)
    return ca.Function(
        "fallback",
        [dynamics.q, dynamics.v, u_vector],
        [ca.densify(_within(robot, held, dynamics.v, u)), ca.densify(held)],
        ["q", "v", "u"],
        ["tau", "held"],
        {"cse": True},
    )


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
