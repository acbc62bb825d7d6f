"""A mass on a wall: what theory says of its rest, its sliding, and the stability of its loop.

x is the believed normal, y the believed tangent. The true wall is turned by α: its normal is
n = (cos α, −sin α), its tangent t = (sin α, cos α). The mass m presses with F_cmd along x and
slides with σ v along y, so that v_x = σ v tan α. Where nothing changes any more

    F_x = G F_cmd + w,  F_cmd = f_d + K_fp (f_d − s F_x − b) + K_fi ∫… − d m σ v tan α

with torque gain G, what the model leaves out w, sensor gain s and bias b. An integral makes
s F_x + b = f_d. The wall carries F_x = λ (cos α + σ μ sin α), and along y, at rest, the motion
task holds −λ sin α with the spring G m K_p.

The loop of the force is linear without tilt, as long as the mass touches: sampled with its delay,
it is stable iff the eigenvalues of its matrix are within the unit circle. On a rigid wall with an
ideal sensor that is |K_fp| < 1 and 0 < κ < 2 (1 − K_fp), κ = K_fi T, for one tick of delay, and
κ < 2 sin(π / (2 (2d − 1))) for an integral alone at d ticks.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from qpctrl.arrays import Matrix, Vector
from scenarios.plant_rigid import SLIP_SPEED
from scenarios.study.system import Setting

MASS = 2.0  # kg, as believed
K_P, K_D = 400.0, 40.0  # 1/s², 1/s, of the motion along the wall
GRAVITY = 9.81  # m/s², along x, as believed: the wall is a table
RIGID, COMPLIANT = 0.0, 1.0  # values of the parameter ``wall``
JAMMED = 1e-6  # share of the normal force that is left to carry the push
SCANNED = 400
"""Values of a parameter, a constant ratio apart, at which a loop is tried."""


def true_axes(setting: Setting) -> tuple[Vector, Vector]:
    """Return normal n and tangent t (2 each) of the true wall."""
    alpha = np.radians(setting["tilt"])
    c, s = float(np.cos(alpha)), float(np.sin(alpha))
    return np.array([c, -s]), np.array([s, c])


def slip_speed(setting: Setting) -> float:
    """Return the speed [m/s] below which the friction of the wall is not all there."""
    return max(SLIP_SPEED, setting["friction"] * setting["force"] / setting["rate"] / MASS)


def steady_force(setting: Setting) -> float | None:
    """Return λ [N] of a mass that rests, or slides at a constant speed.

    None where it jams, or where it rubs but is too slow for Coulomb's law.

    Args:
        setting: value of every parameter of the system.
    """
    alpha, sigma = np.radians(setting["tilt"]), np.sign(setting["speed"])
    creeps = 0 < abs(setting["speed"]) < np.cos(alpha) * slip_speed(setting)
    if creeps and setting["friction"] > 0:
        return None
    carried = np.cos(alpha) + sigma * setting["friction"] * np.sin(alpha)
    F_x = _steady_push(setting, setting["speed"] * np.tan(alpha))
    return float(F_x / carried) if carried > JAMMED and F_x > 0 else None


def steady_offset(setting: Setting, lam: float) -> float:
    """Return how far a mass at rest is off [m] along the true wall, pushed with ``lam`` [N]."""
    alpha, G = np.radians(setting["tilt"]), setting["torque_gain"]
    compensated = G * setting["sensor_gain"] if setting["cutoff"] > 0 else 0.0
    y = (1 - compensated) * lam * np.sin(alpha) / (G * MASS * K_P)
    depth = 0.0
    if setting["wall"] == COMPLIANT:
        depth = setting["offset"] + lam / setting["stiffness"]
    return float((y + depth * np.sin(alpha)) / np.cos(alpha))


def unmodelled_force(setting: Setting) -> float:
    """Return w [N], the force along x that neither set-point nor wall accounts for."""
    weight = MASS * GRAVITY
    true = (1 + setting["mass_error"]) * (1 + setting["gravity_error"]) * weight
    return true - setting["torque_gain"] * weight + setting["torque_bias"]


def lost_tilt(setting: Setting) -> float | None:
    """Return the tilt [deg] at which an accelerated mass leaves the wall: tan α = f_d / (m a).

    It is pressed without feedback, on a rigid wall, by a controller that errs in nothing else.
    """
    exact = {"mass_error": 0.0, "gravity_error": 0.0, "torque_gain": 1.0, "torque_bias": 0.0}
    closed = any(setting[gain] > 0 for gain in ("k_fp", "k_fi", "damping", "cutoff"))
    late = setting["speed"] < setting["acceleration"] * setting["duration"]
    if closed or late or setting["wall"] != RIGID or any(setting[n] != x for n, x in exact.items()):
        return None
    return float(np.degrees(np.arctan2(setting["force"], MASS * setting["acceleration"])))


def stability_limit(setting: Setting, parameter: str, low: float, high: float) -> float | None:
    """Return the smallest value of ``parameter`` at which the sampled loop stops being stable.

    Args:
        setting: value of every other parameter.
        parameter: what is raised.
        low: where the search starts.
        high: where it ends.

    Returns:
        The value; none with a tilt, where the loop is not this one, if it is unstable from the
        start, or if it is stable up to the end.
    """

    def margin(exponent: float) -> float:
        return float(np.log(spectral_radius({**setting, parameter: np.exp(exponent)})))

    if setting["tilt"] != 0:
        return None
    at = np.linspace(np.log(low), np.log(high), SCANNED)
    unstable = next((i for i, exponent in enumerate(at) if margin(exponent) >= 0), 0)
    if unstable == 0:
        return None
    return float(np.exp(brentq(margin, at[unstable - 1], at[unstable], xtol=1e-12)))


def spectral_radius(setting: Setting) -> float:
    """Return the largest magnitude of the eigenvalues of the sampled force loop [1]."""
    return float(np.abs(np.linalg.eigvals(loop_matrix(setting))).max())


class _Response(NamedTuple):
    """What the mass and the wall make of a force that is held over a period."""

    order: int
    """States of it: position and velocity, or none."""
    after: Callable[[Matrix, Matrix], Matrix]
    """(state, force) → state one period later; rows of the loop's state."""
    push: Callable[[Matrix, Matrix], Matrix]
    """(state, force) → force on the wall, now."""


def loop_matrix(setting: Setting) -> Matrix:
    """Return the matrix of the sampled force loop, one tick to the next.

    Its state: position and velocity of the mass on a compliant wall, the filtered reading, the
    integral of the error if it is fed back, and the forces back to the oldest that is needed.
    """
    response, T, delay = _response(setting), 1 / setting["rate"], round(setting["delay"])
    cutoff, integrates = setting["sensor_cutoff"], setting["k_fi"] > 0
    follow = 1 - np.exp(-2 * np.pi * cutoff * T) if cutoff > 0 else 1.0
    now = np.eye(response.order + 2 + delay)
    motion, (read, integral), past = np.split(now, [response.order, response.order + 2])
    reading = (1 - follow) * read + follow * setting["sensor_gain"] * past[-1]
    total = integral - T * reading
    force = -setting["k_fp"] * reading + setting["k_fi"] * total
    if response.order:
        force = force - setting["damping"] * MASS * motion[1]
    force = setting["torque_gain"] * force
    F = response.push(motion, force)
    after = np.vstack([response.after(motion, force), reading, total, F, past[:-1]])
    kept = np.arange(len(now)) if integrates else np.delete(np.arange(len(now)), len(motion) + 1)
    return after[np.ix_(kept, kept)]


def _steady_push(setting: Setting, v_x: float) -> float:
    """Return F_x [N] at the constant velocity ``v_x`` [m/s] along the believed normal."""
    f_d, K, G = setting["force"], setting["k_fp"], setting["torque_gain"]
    s, b = setting["sensor_gain"], setting["sensor_bias"]
    if setting["k_fi"] > 0:
        return (f_d - b) / s
    F_cmd = (1 + K) * f_d - K * b - setting["damping"] * MASS * v_x
    return (G * F_cmd + unmodelled_force(setting)) / (1 + G * K * s)


def _response(setting: Setting) -> _Response:
    if setting["wall"] == RIGID:
        return _Response(0, lambda x, u: x, lambda x, u: u)
    k, d = setting["stiffness"], setting["wall_damping"]
    m = (1 + setting["mass_error"]) * MASS
    rates = np.array([[0, 1, 0], [-k / m, -d / m, 1 / m], [0, 0, 0]])
    held = expm(rates / setting["rate"])
    return _Response(
        2,
        lambda x, u: held[:2, :2] @ x + np.outer(held[:2, 2], u),
        lambda x, u: k * x[0] + d * x[1],
    )
