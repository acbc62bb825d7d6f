"""A joint drive: its parts, and what follows from them at the joint."""

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, final

from qpctrl.errors import InputError
from scenarios.actuator.parts import Friction, Gear, Loops, Motor, Spring, StrainGauge

Design = Literal["direct-drive", "geared", "strain-gauge", "series-elastic"]
DESIGNS: tuple[Design, ...] = ("direct-drive", "geared", "strain-gauge", "series-elastic")

NO_GEAR, NO_FRICTION = Gear(), Friction()

VOLTAGE_SHARE = 0.9
"""Share of the voltage that the torque–speed line may use; the loops need the rest."""

CURRENT_SHARE = 0.95
"""Share of the current that a commanded torque may use; the same."""

LOOP_SHARE = 0.15
"""Share of the current that is kept for the errors of a torque loop."""

STOP_SHARE = 0.98
"""Share of the way to a spring's hard stop that a commanded torque may use."""


class TorqueLimits(NamedTuple):
    """What a controller may ask of a drive."""

    peak: float
    """Highest torque [Nm], by current, gear and spring."""
    rate: float
    """Highest rate of torque [Nm/s] that the torque loop follows without meeting a limit."""
    step: float
    """Largest step of torque [Nm] for which the voltage suffices."""
    stall: float
    """Torque at rest that the voltage can drive [Nm]."""
    droop: float
    """Torque lost to back-EMF per speed of the joint [Nm s/rad]."""


@final
@dataclass(frozen=True, kw_only=True)
class JointDrive:
    """One joint from commanded to delivered torque.

    Parts decide the design: with a spring it is series elastic, with a strain gauge it has torque
    feedback, with an elastic gear alone it is geared, and with none of them it is a direct drive.
    """

    name: str
    source: str
    """Where its numbers come from."""
    motor: Motor
    loops: Loops
    gear: Gear = NO_GEAR
    friction: Friction = NO_FRICTION
    spring: Spring | None = None
    strain_gauge: StrainGauge | None = None

    def __post_init__(self) -> None:
        if self.spring and self.strain_gauge:
            raise InputError(f"drive {self.name!r}: has a spring and a strain gauge, need one")
        if not self.has_torque_loop:
            for name in ("K_p", "K_i", "damping_ratio", "cutoff"):
                if getattr(self.loops, name):
                    raise InputError(
                        f"drive {self.name!r}: loops: {name} needs a strain gauge or a spring to "
                        "measure torque by"
                    )
        if self.rigid:
            for part, field, none in (
                ("gear", "backlash", 0.0),
                ("gear", "efficiency", 1.0),
                ("friction", "bristle_stiffness", 0.0),
            ):
                value = getattr(getattr(self, part), field)
                if value != none:
                    raise InputError(
                        f"drive {self.name!r}: {part}: {field}: got {value}, need {none:g} in a "
                        "drive without a gear"
                    )

    @property
    def design(self) -> Design:
        """Which of the four designs of the field it is."""
        if self.spring:
            return "series-elastic"
        if self.strain_gauge:
            return "strain-gauge"
        return "direct-drive" if self.rigid else "geared"

    @property
    def has_torque_loop(self) -> bool:
        """Whether torque is measured and fed back."""
        return self.spring is not None or self.strain_gauge is not None

    @property
    def stiffness(self) -> float:
        """From motor to joint [Nm/rad]: gear, sensor and spring in series; inf: rigid."""
        parts = (self.gear, self.spring, self.strain_gauge)
        compliance = sum(1 / part.stiffness for part in parts if part)
        return 1 / compliance if compliance else math.inf

    @property
    def rigid(self) -> bool:
        """Whether rotor and joint move as one."""
        return math.isinf(self.stiffness)

    @property
    def torque_constant(self) -> float:
        """Torque at the joint per current [Nm/A]; also voltage per speed of the joint."""
        return self.gear.ratio * self.motor.torque_constant

    @property
    def inertia(self) -> float:
        """Of rotor and gear, at the joint [kg m²]."""
        return self.gear.ratio**2 * (self.motor.inertia + self.gear.inertia)

    @property
    def apparent_inertia(self) -> float:
        """What is left of it for who commands the torque [kg m²]: torque feedback divides it.

        Source: AlbuSchaeffer2007.
        """
        return self.inertia / (1 + self.loops.K_p)

    @property
    def K_d(self) -> float:
        """Gain of the derivative of the measured torque [s], from the damping ratio.

        With a locked output J s² + (b + K_d k) s + k (1 + K_p); b is what friction and damping do.
        A strain gauge reads the damping of the twist too, which its loop thus amplifies.
        """
        if not self.has_torque_loop:
            return 0.0
        k, J, K_p = self.stiffness, self.inertia, self.loops.K_p
        wanted = 2 * self.loops.damping_ratio * math.sqrt(k * (1 + K_p) * J)
        read = self.twist_damping * K_p if self.strain_gauge else 0.0
        return max(0.0, wanted - self.damping - read) / k

    @property
    def damping(self) -> float:
        """Of the motor against a locked output [Nm s/rad]."""
        return self.friction.viscous + self.twist_damping

    @property
    def twist_damping(self) -> float:
        """Of the twist between motor and joint [Nm s/rad]: each part damps its share of it."""
        parts = [part for part in (self.gear, self.spring) if part and part.stiffness < math.inf]
        return sum(part.damping * (self.stiffness / part.stiffness) ** 2 for part in parts)

    @property
    def motor_torque(self) -> float:
        """Torque at the joint by the motor's peak current alone [Nm]."""
        return self.motor.peak_current * self.torque_constant

    @property
    def peak_torque(self) -> float:
        """Highest torque that may be commanded of a slow joint [Nm]."""
        return self.limits().peak

    @property
    def continuous_torque(self) -> float:
        """Torque that the winding stands forever [Nm], at least 0."""
        electric = self.motor.continuous_current * self.torque_constant - self._friction(0.0)
        return min(max(0.0, self.gear.efficiency * electric), self.peak_torque)

    def limits(self, speed: float = 0.0) -> TorqueLimits:
        """Return what may be commanded of a joint that turns at ``speed`` [rad/s] at most.

        Less than the motor gives: friction that is compensated takes its share, and so does a
        torque loop, which asks for (1 + K_p) times its error; that is 2 ζ / ω_n times the rate of
        the command. A step of current takes 2π f_c L times as much voltage.
        """
        motor, efficiency = self.motor, self.gear.efficiency
        stop = rate = math.inf
        amperes, volts = CURRENT_SHARE * motor.peak_current, VOLTAGE_SHARE * motor.voltage
        if self.has_torque_loop:
            kept = LOOP_SHARE * motor.peak_current
            amperes -= kept
            volts -= kept * (motor.resistance + motor.inductance * self.natural_frequency)
        if self.loops.damping_ratio > 0:
            lag = 2 * self.loops.damping_ratio / self.natural_frequency
            rate = LOOP_SHARE * self.motor_torque / ((1 + self.loops.K_p) * lag)
        if self.spring:
            stop = STOP_SHARE * self.spring.stiffness * self.spring.hard_stop
        jump = (1 - VOLTAGE_SHARE) * motor.voltage / motor.inductance / (1 + self.loops.K_p)
        by_current = self.torque_constant * amperes - self._friction(speed)
        by_voltage = self.torque_constant * volts / motor.resistance - self._friction(0.0)
        return TorqueLimits(
            peak=min(efficiency * by_current, self.gear.peak_torque, stop),
            rate=rate,
            step=self.torque_constant * jump / (2 * math.pi * self.loops.current_bandwidth),
            stall=efficiency * by_voltage,
            droop=efficiency * (self.torque_constant**2 / motor.resistance + self._drag),
        )

    @property
    def no_load_speed(self) -> float:
        """Speed of the joint at full voltage without load or friction [rad/s]."""
        return self.motor.voltage / self.torque_constant

    @property
    def natural_frequency(self) -> float:
        """Of the torque loop with locked output, ω_n = √(k (1 + K_p) / J) [rad/s]."""
        return math.sqrt(self.stiffness * (1 + self.loops.K_p) / self.inertia)

    @property
    def _drag(self) -> float:
        """Viscous friction that the loops compensate [Nm s/rad]."""
        feedforward = self.loops.friction_feedforward * self.friction.viscous
        return self.friction.viscous if self.has_torque_loop else feedforward

    def _friction(self, speed: float) -> float:
        """Return the friction [Nm] at ``speed`` [rad/s] that the loops compensate."""
        if self.has_torque_loop:
            return max(self.friction.coulomb, self.friction.static) + self._drag * speed
        return self.loops.friction_feedforward * self.friction.coulomb + self._drag * speed

    def check(self) -> "JointDrive":
        """Return the drive itself.

        Raises:
            InputError: it cannot give any torque, or its gear lacks a stiffness.
        """
        if self.rigid and self.gear.ratio != 1.0:
            raise InputError(f"drive {self.name!r}: gear: stiffness is missing")
        limits = self.limits()
        for name in ("peak", "stall"):
            if not getattr(limits, name) > 0:
                raise InputError(
                    f"drive {self.name!r}: {name} torque is {getattr(limits, name):.3g} Nm: "
                    "friction and the drive's own loops take all that the motor can give"
                )
        return self

    def on_capstan(self, radius: float) -> "JointDrive":
        """Return the drive of a sliding joint that this one moves by a capstan.

        Torques become forces [N], angles ways [m].

        Args:
            radius: of the capstan [m].
        """
        r = radius
        gear, f = self.gear, self.friction
        spring = self.spring and replace(
            self.spring,
            stiffness=self.spring.stiffness / r**2,
            damping=self.spring.damping / r**2,
            hard_stop=self.spring.hard_stop * r,
            counts=self.spring.counts / r,
        )
        gauge = self.strain_gauge and replace(
            self.strain_gauge,
            stiffness=self.strain_gauge.stiffness / r**2,
            noise=self.strain_gauge.noise / r,
            bias=self.strain_gauge.bias / r,
            resolution=self.strain_gauge.resolution / r,
        )
        return replace(
            self,
            gear=replace(
                gear,
                ratio=gear.ratio / r,
                stiffness=gear.stiffness / r**2,
                damping=gear.damping / r**2,
                backlash=gear.backlash * r,
                peak_torque=gear.peak_torque / r,
            ),
            friction=replace(
                f,
                coulomb=f.coulomb / r,
                static=f.static / r,
                stribeck_speed=f.stribeck_speed * r,
                viscous=f.viscous / r**2,
                bristle_stiffness=f.bristle_stiffness / r**2,
                bristle_damping=f.bristle_damping / r**2,
            ),
            spring=spring,
            strain_gauge=gauge,
        )
