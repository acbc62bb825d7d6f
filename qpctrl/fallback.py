"""The one fallback: hold with damping and gravity compensation.

τ = B⁺ (g(q) − K_d v), within the torque limits and the torque rate. It is sent whenever a tick
has no solution of the demanded accuracy, and counted. A velocity that is not measured is taken
from the last two configurations; where nothing new is known there is no damping, for acting on
an old velocity would push.
"""

import casadi as ca
import numpy as np

from qpctrl.arrays import Vector
from qpctrl.dynamics import Dynamics
from qpctrl.robot import Robot

HOLD_DAMPING = 5.0
"""Damping of the fallback [1/s], times the diagonal of the mass matrix."""


class Fallback:
    """Torque to hold the arm at rest where it is."""

    def __init__(self, robot: Robot) -> None:
        dynamics = Dynamics(robot)
        gravity = ca.substitute(dynamics.h, dynamics.v, ca.SX.zeros(robot.nv))
        damping = HOLD_DAMPING * ca.diag(dynamics.M) * dynamics.v
        self._function = ca.Function(
            "fallback", [dynamics.q, dynamics.v], [ca.densify(gravity - damping)]
        )
        self._B_pinv = np.linalg.pinv(robot.B)

    def torque(self, q: Vector, v: Vector) -> Vector:
        """Return the holding torque (nu) [Nm], not yet limited."""
        return self._B_pinv @ np.asarray(self._function(q, v)).ravel()


def limited(tau: Vector, tau_last: Vector, tau_max: Vector, step: Vector) -> Vector:
    """Return ``tau`` (nu) within ``step`` [Nm] of ``tau_last`` and inside ±``tau_max``."""
    return np.clip(np.clip(tau, tau_last - step, tau_last + step), -tau_max, tau_max)
