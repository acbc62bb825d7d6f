"""Torque, torque-speed, torque-rate, joint position and velocity limits as bounds of the QP."""

from collections.abc import Mapping
from typing import NamedTuple, TypeVar

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


TORQUE_INPUTS = ("tau_max", "tau_stall", "tau_droop", "tau_rate", "tau_last")
"""Names of the inputs that bound the torque, each of shape (nu)."""

Quantity = TypeVar("Quantity", SX, Array)
"""Expressions or numbers."""


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
        "tau_stall": np.clip(limits.tau_stall, None, UNBOUNDED),
        "tau_droop": limits.tau_droop,
        "tau_rate": np.clip(limits.tau_rate, None, UNBOUNDED),
        "tau_last": np.zeros(robot.nu),
        "rates": np.array([POSITION_RATE, VELOCITY_RATE]),
    }


def named(u: Mapping[str, SX]) -> dict[str, SX]:
    """Return the limits among the inputs of a mode, by their names here."""
    return {key[7:]: value for key, value in u.items() if key.startswith("limits.")}


def torque_speed(side: float, stall: Quantity, droop: Quantity, v_a: Quantity) -> Quantity:
    """Return the line ±τ_stall − k_ω v_a (nu) [Nm] that the supply voltage sets to the torque.

    Args:
        side: 1 for the upper line, −1 for the lower one.
        stall: τ_stall (nu) [Nm].
        droop: k_ω (nu) [Nm s/rad].
        v_a: speed of the actuators, Bᵀ v (nu) [rad/s].
    """
    return side * stall - droop * v_a


def torque_bounds(u: Mapping[str, SX], dt: SX, v_a: SX) -> Bounds:
    """Return bounds on τ (nu) [Nm]: current, back-EMF, and tau_rate · dt around the last torque.

    −τ_stall − k_ω v_a ≤ τ ≤ τ_stall − k_ω v_a inside ±tau_max. Where a joint is driven so fast that
    the line leaves ±tau_max, the end of ±tau_max that is nearest to it is what remains.

    Args:
        u: the inputs named in `TORQUE_INPUTS`.
        dt: period of the loop [s].
        v_a: speed of the actuators, Bᵀ v (nu) [rad/s].
    """
    line = [torque_speed(side, u["tau_stall"], u["tau_droop"], v_a) for side in (-1.0, 1.0)]
    lo, hi = (ca.fmax(-u["tau_max"], ca.fmin(tau, u["tau_max"])) for tau in line)
    step = u["tau_rate"] * dt
    lb = ca.fmax(lo, ca.fmin(u["tau_last"], hi) - step)
    ub = ca.fmin(hi, ca.fmax(u["tau_last"], lo) + step)
    return _finite(Bounds(lb, ub))


def actuator_speed(robot: Robot, v: SX) -> SX:
    """Return v_a = Bᵀ v (nu) [rad/s]: what each torque is multiplied with to give power."""
    return ca.SX(robot.B.T) @ v


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
