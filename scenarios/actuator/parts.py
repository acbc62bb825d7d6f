"""What a joint drive is made of: motor, gear, friction, spring or torque sensor, and its loops.

All angles, speeds, torques, inertias and friction are those of the joint, unless they are said to
be of the motor's shaft, which turns ``ratio`` times as fast. A three-phase motor is described by
its power-invariant DC equivalent.
"""

import math
from dataclasses import dataclass, fields
from typing import Any, ClassVar, final

from qpctrl.errors import InputError

RANGE = (1e-12, 1e12)
"""Of every number that is neither 0 nor may be infinite."""


class Part:
    """Base of the parts: every number is checked by name when the part is made.

    It may be infinite only where that is what it is by default.
    """

    _positive: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            _check(field.name, value, field.name in self._positive, field.default == math.inf)


def _check(name: str, value: Any, positive: bool, may_be_infinite: bool) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
        raise InputError(f"{name}: got {value!r}, need a number")
    if value <= 0 if positive else value < 0:
        raise InputError(f"{name}: got {value}, need a number {'> 0' if positive else '>= 0'}")
    least, most = RANGE
    if value and not least <= value <= most and not (value == math.inf and may_be_infinite):
        raise InputError(f"{name}: got {value}, need a number from {least:g} to {most:g}")


def _at_most(name: str, value: float, most: float, what: str = "") -> None:
    if value > most:
        raise InputError(f"{name}: got {value}, need at most {most:g}{what and f', {what}'}")


@final
@dataclass(frozen=True, kw_only=True)
class Motor(Part):
    """Winding and rotor: L di/dt = u − R i − k_t ω, τ = k_t i, ω the speed of the shaft."""

    torque_constant: float
    """k_t [Nm/A], also the back-EMF constant [V s/rad]."""
    resistance: float
    """R of the winding [Ω]."""
    inductance: float
    """L of the winding [H]."""
    voltage: float
    """Highest voltage [V]."""
    peak_current: float
    """Highest current [A]."""
    continuous_current: float
    """Current that may flow forever [A]."""
    inertia: float
    """Of the rotor, at its shaft [kg m²]."""
    current_noise: float = 0.0
    """Standard deviation of a reading of the current [A]."""
    current_resolution: float = 0.0
    """Step of a reading of the current [A]; 0: none."""

    _positive = (
        *("torque_constant", "resistance", "inductance", "voltage"),
        *("peak_current", "continuous_current", "inertia"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_most("continuous_current", self.continuous_current, self.peak_current, "peak_current")


@final
@dataclass(frozen=True, kw_only=True)
class Gear(Part):
    """Gear between motor and joint; its defaults are those of no gear at all."""

    ratio: float = 1.0
    """Turns of the motor in a turn of the joint [1]."""
    inertia: float = 0.0
    """Of the gear, at the motor's shaft [kg m²]."""
    stiffness: float = math.inf
    """At the joint [Nm/rad]."""
    damping: float = 0.0
    """Of the same twist [Nm s/rad]."""
    backlash: float = 0.0
    """Play at the joint, from stop to stop [rad]."""
    efficiency: float = 1.0
    """Share of the motor's torque that arrives at the joint under load [1]."""
    peak_torque: float = math.inf
    """Highest torque that the gear stands [Nm]."""

    _positive = ("ratio", "stiffness", "efficiency", "peak_torque")

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_most("efficiency", self.efficiency, 1.0)


@final
@dataclass(frozen=True, kw_only=True)
class Friction(Part):
    """Friction of motor and gear: Coulomb, Stribeck and viscous, or LuGre where it has bristles.

    g(ω) = τ_c + (τ_b − τ_c) exp(−(ω/ω_s)²). Source: CanudasDeWit1995.
    """

    coulomb: float = 0.0
    """τ_c, while it slides [Nm]."""
    static: float = 0.0
    """τ_b, to break away [Nm]; below ``coulomb`` it counts as equal to that."""
    stribeck_speed: float = 0.01
    """ω_s [rad/s]."""
    viscous: float = 0.0
    """[Nm s/rad]."""
    bristle_stiffness: float = 0.0
    """σ_0 [Nm/rad]; 0: no bristles, it sticks rigidly."""
    bristle_damping: float = 0.0
    """σ_1 [Nm s/rad]."""

    _positive = ("stribeck_speed",)


@final
@dataclass(frozen=True, kw_only=True)
class Spring(Part):
    """Spring of a series elastic joint; its twist is read by two encoders."""

    stiffness: float
    """[Nm/rad]."""
    damping: float = 0.0
    """[Nm s/rad]."""
    hard_stop: float = math.inf
    """Twist at which it meets its stop, to either side [rad]."""
    counts: float = 0.0
    """Of each encoder, per turn; 0: no steps."""

    _positive = ("stiffness", "hard_stop")

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0 < self.counts < 1:
            raise InputError(f"counts: got {self.counts}, need 0 or at least 1")


@final
@dataclass(frozen=True, kw_only=True)
class StrainGauge(Part):
    """Torque sensor between gear and joint."""

    stiffness: float
    """[Nm/rad]."""
    noise: float = 0.0
    """Standard deviation of a reading [Nm]."""
    bias: float = 0.0
    """Constant error [Nm]."""
    resolution: float = 0.0
    """Step of a reading [Nm]; 0: none."""

    _positive = ("stiffness",)


@final
@dataclass(frozen=True, kw_only=True)
class Loops(Part):
    """The loops of a drive: current, and torque where that is measured.

    τ_motor = τ + K_p (τ − τ_meas) + K_i ∫ (τ − τ_meas) dt − K_d dτ_meas/dt + friction.
    """

    current_bandwidth: float
    """Of the current loop [Hz]; its gains follow by pole placement."""
    K_p: float = 0.0
    """Proportional gain of torque [1]."""
    K_i: float = 0.0
    """Integral gain of torque [1/s]."""
    damping_ratio: float = 0.0
    """Of the torque loop with locked output [1]; K_d follows."""
    cutoff: float = 0.0
    """Low-pass filter of the measured torque [Hz]; 0: none."""
    friction_feedforward: float = 0.0
    """Share of the modelled friction that is added to the command [1]."""

    _positive = ("current_bandwidth",)

    def __post_init__(self) -> None:
        super().__post_init__()
        _at_most("friction_feedforward", self.friction_feedforward, 1.0)
