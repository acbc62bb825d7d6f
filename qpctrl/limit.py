"""Torque, torque-rate, joint position and velocity limits as bounds of the QP."""

from collections.abc import Mapping
from typing import NamedTuple

import casadi as ca
import numpy as np

from qpctrl.arrays import Array
from qpctrl.robot import Robot
from qpctrl.spatial import SX

UNBOUNDED = 1e20
"""Stands for infinity in the data of the QP."""

POSITION_RATE = 50.0
"""Rate [1/s] at which a joint may close the distance to its position limit."""

VELOCITY_RATE = 200.0
"""Rate [1/s] at which a joint may close the distance to its velocity limit."""


class Bounds(NamedTuple):
    """Lower and upper bounds of one group of rows."""

    lb: SX
    ub: SX


def inputs(robot: Robot) -> dict[str, Array]:
    """Return the limits that may change every tick, with the robot's own as defaults."""
    limits = robot.limits
    return {
        "q_min": np.clip(limits.q_min, -UNBOUNDED, None),
        "q_max": np.clip(limits.q_max, None, UNBOUNDED),
        "v_max": np.clip(limits.v_max, None, UNBOUNDED),
        "tau_max": np.clip(limits.tau_max, None, UNBOUNDED),
        "tau_rate": np.clip(limits.tau_rate, None, UNBOUNDED),
        "tau_last": np.zeros(robot.nu),
        "rates": np.array([POSITION_RATE, VELOCITY_RATE]),
    }


def torque_bounds(u: Mapping[str, SX], dt: SX) -> Bounds:
    """Return bounds on τ (nu) [Nm]: ±tau_max, and within tau_rate · dt of the last torque."""
    step = u["tau_rate"] * dt
    lb = ca.fmax(-u["tau_max"], ca.fmin(u["tau_last"], u["tau_max"]) - step)
    ub = ca.fmin(u["tau_max"], ca.fmax(u["tau_last"], -u["tau_max"]) + step)
    return _finite(Bounds(lb, ub))


def acceleration_bounds(u: Mapping[str, SX], q: SX, v: SX) -> Bounds:
    """Return bounds on a (nv) [rad/s²] that keep position and velocity inside their limits.

    Control barriers: the distance to the velocity limit shrinks at most at rate r_v,
    the distance to the position limit as a critically damped decay of rate r_p:
    a ≤ min(r_v (v_max − v), r_p² (q_max − q) − 2 r_p v), and likewise below. A joint far
    outside its position limits comes back as fast as its velocity limits let it.
    Source: Nguyen2016.
    """
    r_p, r_v = u["rates"][0], u["rates"][1]
    lb_v, ub_v = r_v * (-u["v_max"] - v), r_v * (u["v_max"] - v)
    lb_q = r_p**2 * (u["q_min"] - q) - 2 * r_p * v
    ub_q = r_p**2 * (u["q_max"] - q) - 2 * r_p * v
    lb = ca.fmax(lb_v, ca.fmin(lb_q, ub_v))
    ub = ca.fmin(ub_v, ca.fmax(ub_q, lb_v))
    return _finite(Bounds(lb, ub))


def _finite(bounds: Bounds) -> Bounds:
    return Bounds(ca.fmax(bounds.lb, -UNBOUNDED), ca.fmin(bounds.ub, UNBOUNDED))
