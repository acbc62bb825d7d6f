"""The one fallback: hold with damping and gravity compensation.

τ = B⁺ (g(q) − K_d v), within the same torque bounds as that of the QP. It is sent whenever a tick
has no solution of the demanded accuracy, and counted. A velocity that is not measured is taken
from the last two configurations; where nothing new is known there is no damping, for acting on
an old velocity would push.
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np

from qpctrl import limit
from qpctrl.arrays import Array, Vector
from qpctrl.dynamics import Dynamics
from qpctrl.evaluator import Evaluator
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
        self._limit = Evaluator(limit.limited_torque(robot))
        self._own_limits = limit.inputs(robot)

    def torque(self, q: Vector, v: Vector) -> Vector:
        """Return the holding torque (nu) [Nm], not yet limited."""
        return self._B_pinv @ np.asarray(self._function(q, v)).ravel()

    def limited(
        self, tau: Vector, tau_last: Vector, v: Vector, inputs: Mapping[str, Array]
    ) -> Vector:
        """Return ``tau`` (nu) [Nm] moved inside the bounds that the QP sets to the torque.

        Args:
            tau: torque of the fallback or of a law (nu) [Nm].
            tau_last: torque sent last (nu) [Nm].
            v: velocity (nv) [rad/s] at which the torque is sent.
            inputs: those of the mode; a limit among them that is NaN is the robot's own.
        """
        given = self._limit.inputs
        for name in limit.TORQUE_INPUTS:
            value = inputs[f"limits.{name}"]
            given[name][:] = np.where(np.isnan(value), self._own_limits[name], value)
        given["tau"][:], given["v"][:], given["tau_last"][:] = tau, v, tau_last
        given["dt"][:] = inputs["dt"]
        self._limit()
        return self._limit.outputs["limited"].copy()
