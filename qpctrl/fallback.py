"""The one fallback: hold with damping and gravity compensation.

τ = B⁺ (g(q) − K_d v), within the torque limits and the torque rate. It is sent whenever a tick
has no solution of the demanded accuracy, and counted.
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
        self._limits = robot.limits

    def torque(self, q: Vector, v: Vector) -> Vector:
        """Return the holding torque (nu) [Nm] within ±tau_max."""
        limit = self._limits.tau_max
        held = self._B_pinv @ np.asarray(self._function(q, v)).ravel()
        return np.clip(held, -limit, limit)

    def clip(self, tau: Vector, tau_last: Vector, dt: float) -> Vector:
        """Return ``tau`` (nu) moved inside the torque and torque-rate limits."""
        step = self._limits.tau_rate * dt
        near = np.clip(tau, tau_last - step, tau_last + step)
        return np.clip(near, -self._limits.tau_max, self._limits.tau_max)
