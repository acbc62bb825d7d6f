"""From commanded to delivered torque in closed form: the linear part of a drive, output locked.

With the motor's twist θ, its current loop C(s) and the filter F(s) of the measured torque,

    J s² θ = C τ_w − (b + d) s θ − k θ,    τ = (k + d s) θ,
    τ_w = τ_cmd + (K_p + K_i / s) (τ_cmd − τ_meas) − K_d s τ_meas + f b s θ,

with τ_meas = F τ of a strain gauge, F k θ of a spring's two ends, K_p = K_i = K_d = 0 where none
is measured, and τ = C τ_cmd for a direct drive. Coulomb friction, play, losses and noise are left
out. Of the sampling in steps of h what is of first order stays: the filter, which has the newest
sample at once, leads by h/2, and the difference of two samples lags by as much.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex

from qpctrl.arrays import Vector
from scenarios.actuator.drive import JointDrive
from scenarios.report_bode import Response

HALF_POWER = 1 / math.sqrt(2)
PER_DECADE = 1500
"""Points at which a closed form is searched: they leave 1e-6 of a frequency between them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TransferFunction:
    """A ratio of two polynomials in s [1/s], highest power first."""

    numerator: Vector
    denominator: Vector

    def __call__(self, frequency: Vector) -> Response:
        """Return the complex gain at each frequency [Hz]."""
        s = 2j * np.pi * frequency
        return np.asarray(np.polyval(self.numerator, s) / np.polyval(self.denominator, s))

    @property
    def poles(self) -> Complex[np.ndarray, " _"]:
        """Roots of the denominator [1/s]."""
        return np.roots(self.denominator).astype(np.complex128)

    @property
    def decay_rate(self) -> float:
        """Rate at which the slowest transient fades [1/s]; negative: it grows."""
        return float(-self.poles.real.max())

    def grid(self) -> Vector:
        """Return frequencies [Hz], close together, far below the slowest to far above all poles."""
        size = np.abs(self.poles) / (2 * np.pi)
        low, high = 1e-3 * max(size.min(), 1e-3), 30 * size.max()
        return np.geomspace(low, high, round(PER_DECADE * math.log10(high / low)))

    def step(self, time: Vector) -> Vector:
        """Return the answer to a step of 1 at time 0 [s]: its partial fractions, summed."""
        p, numerator = self.poles, self.numerator
        residues = np.polyval(numerator, p) / (p * np.polyval(np.polyder(self.denominator), p))
        late = np.maximum(time, 0.0)[:, None]
        answer = (residues * np.exp(p * late)).sum(axis=1).real
        return np.where(time >= 0, answer + numerator[-1] / self.denominator[-1], 0.0)


def torque_transfer(drive: JointDrive, step: float = 0.0) -> TransferFunction:
    """Return τ/τ_cmd with a locked output, current loop, filter and integral included.

    Args:
        drive: whose.
        step: of its loops [s]; 0: continuous.
    """
    loops, J, k, b = drive.loops, drive.inertia, drive.stiffness, drive.friction.viscous
    lag = np.array([1 / (2 * np.pi * loops.current_bandwidth), 1.0])  # 1 / C
    if drive.rigid:
        return TransferFunction(numerator=np.array([1.0]), denominator=lag)
    s, half = np.array([1.0, 0.0]), np.array([step / 2, 1.0])
    whole = s if loops.K_i else np.array([1.0])  # all is multiplied by s where there is K_i / s
    gains = np.array([loops.K_p, loops.K_i])[: len(whole)]
    filtering = np.array([1 / (2 * np.pi * loops.cutoff), 1.0]) if loops.cutoff else half  # 1 / F
    feedback = np.polyadd(_product(gains, half), drive.K_d * _product(s, whole))
    carried = np.array([drive.damping - b, k])
    measured = carried if drive.strain_gauge else np.array([k])
    mechanics = _product(np.array([J, drive.damping, k]), lag, filtering, whole)
    compensation = loops.friction_feedforward * b * _product(s, filtering, whole)
    return TransferFunction(
        numerator=_product(carried, np.polyadd(gains, whole), filtering),
        denominator=np.polyadd(mechanics, np.polysub(_product(measured, feedback), compensation)),
    )


def textbook_transfer(drive: JointDrive) -> TransferFunction:
    """Return (1 + K_p) k / (J s² + (b + K_d k) s + k (1 + K_p)): all but the second order left out.

    For a direct drive, which has no second order, the current loop.
    """
    if drive.rigid:
        return torque_transfer(drive)
    stiff = drive.stiffness * (1 + drive.loops.K_p)
    damping = drive.damping + drive.K_d * drive.stiffness
    return TransferFunction(
        numerator=np.array([stiff]), denominator=np.array([drive.inertia, damping, stiff])
    )


def bandwidth(frequency: Vector, response: Response) -> float:
    """Return where the magnitude, 1 at first, falls to 1/√2 for the first time [Hz]; NaN: never.

    Args:
        frequency: rising [Hz].
        response: complex gain there.
    """
    return _falls(frequency, np.log(np.maximum(np.abs(response), 1e-300) / HALF_POWER))


def crossing(frequency: Vector, response: Response, phase: float) -> float:
    """Return where the phase falls to ``phase`` [deg] for the first time [Hz]; NaN: never.

    Args:
        frequency: rising, close enough together to unwrap the phase [Hz].
        response: complex gain there.
        phase: negative [deg].
    """
    return _falls(frequency, np.degrees(np.unwrap(np.angle(response))) - phase)


def peak(frequency: Vector, response: Response) -> tuple[float, float]:
    """Return frequency [Hz] and height [1] of the largest magnitude: a parabola through three."""
    size = np.abs(response)
    i = int(size.argmax())
    if not 0 < i < len(size) - 1:
        return float(frequency[i]), float(size[i])
    x, y = np.log(frequency[i - 1 : i + 2]), np.log(size[i - 1 : i + 2])
    a, b, c = np.polyfit(x - x[1], y, 2)
    return float(frequency[i] * np.exp(-b / (2 * a))), float(np.exp(c - b**2 / (4 * a)))


def _falls(frequency: Vector, excess: Vector) -> float:
    """Return where ``excess``, positive at first, becomes negative [Hz]; NaN: nowhere."""
    below = np.flatnonzero(excess < 0)
    if not len(below) or below[0] == 0:
        return math.nan
    i = below[0]
    share = excess[i - 1] / (excess[i - 1] - excess[i])
    return float(frequency[i - 1] * (frequency[i] / frequency[i - 1]) ** share)


def _product(*factors: Vector) -> Vector:
    found = np.ones(1)
    for factor in factors:
        found = np.polymul(found, factor)
    return found
