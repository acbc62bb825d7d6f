"""What must hold for a drive on the bench, whatever its numbers are.

Each check drives the inner tick itself, and compares it with what follows from the drive's parts
on paper.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from qpctrl.arrays import Vector
from scenarios.actuator.bench import Link, constant, linear_part, run_bench
from scenarios.actuator.drive import JointDrive
from scenarios.actuator.response import settling_time
from scenarios.actuator.transfer import torque_transfer

STILL = 1e-7
"""What is left of a transient when a steady state is judged."""

LONGEST = 10.0
"""Time that a steady state is waited for [s]."""

LONGEST_RUN = 1.0
"""Time that a motor is given to reach its limits [s]."""

LINKS = (math.inf, 1.0, 0.1, 0.01)
"""Inertia of the links behind a spring that is driven into its stop [kg m²]; inf: held."""

CRASH = 0.15
"""Time in which it is driven there [s]."""

SPEEDS = 8
"""At which torque is measured."""


class TorqueSpeed(NamedTuple):
    """Torque while the joint turns, commanded as high as a controller may."""

    v: Vector
    """Speed of the joint [rad/s]."""
    limit: Vector
    """Highest torque that may be commanded [Nm], which is commanded."""
    expected: Vector
    """What arrives of it at the joint, on paper [Nm]."""
    tau: Vector
    """What arrives [Nm]."""

    @property
    def gap(self) -> float:
        """Largest difference of the last two, over the highest torque."""
        return float(np.abs(self.tau - self.expected).max() / self.limit.max())


def torque_limit(drive: JointDrive, v: Vector) -> Vector:
    """Return the highest torque [Nm] that may be commanded at speeds ``v`` [rad/s] along it."""
    limits = [drive.limits(float(speed)) for speed in v]
    lines = [min(one.peak, one.stall - one.droop * w) for one, w in zip(limits, v, strict=True)]
    return np.array(lines)


def no_torque_speed(drive: JointDrive) -> float:
    """Return the speed at which nothing may be commanded any more [rad/s]."""
    limits = drive.limits()
    low, high = 0.0, limits.stall / limits.droop
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if torque_limit(drive, np.array([middle])) > 0 else (low, middle)
    return low


def steady_torque(drive: JointDrive, tau_cmd: Vector, v: Vector) -> Vector:
    """Return what arrives at the joint [Nm] when all is steady and the motor drives it.

    The motor gives (1 + K_p) τ_cmd − K_p (τ + bias) + f τ_f and needs τ/η + τ_f, with the friction
    τ_f = g(v) + b v; an integral removes what that leaves, but for the bias.

    Args:
        drive: which.
        tau_cmd: commanded torque, at least 0 [Nm].
        v: speeds along it, above 0 [rad/s].
    """
    loops, f, eta = drive.loops, drive.friction, drive.gear.efficiency
    bias = drive.strain_gauge.bias if drive.strain_gauge else 0.0
    if loops.K_i:
        return tau_cmd - bias
    rest = max(f.static - f.coulomb, 0.0) * np.exp(-((v / f.stribeck_speed) ** 2))
    friction = f.coulomb + rest + f.viscous * v
    slides = np.tanh(v / (3 * f.stribeck_speed))
    compensated = loops.friction_feedforward * (f.coulomb * slides + f.viscous * v)
    motor = (1 + loops.K_p) * tau_cmd - loops.K_p * bias + compensated - friction
    return motor / (loops.K_p + 1 / eta)


def torque_at_speed(drive: JointDrive, *, step: float) -> TorqueSpeed:
    """Return the torque at steady speeds up to where nothing may be commanded any more."""
    v = no_torque_speed(drive) * np.linspace(0.1, 0.95, SPEEDS)
    limit = torque_limit(drive, v)
    winding = drive.motor.inductance / drive.motor.resistance  # its pace where voltage is short
    wait = min(settling_time(drive) + 8 * winding, LONGEST)
    steps = round(wait / step) + 100
    record = run_bench([drive] * SPEEDS, constant(limit, steps, SPEEDS), step=step, link=Link(v=v))
    tau = np.asarray(record.tau[-100:].mean(axis=0))
    return TorqueSpeed(v, limit, steady_torque(drive, limit, v), tau)


def steady_gaps(drive: JointDrive, *, step: float) -> tuple[float, float]:
    """Return how far a linear drive holds beside a command, and its twist beside τ/k, relative.

    Half of the peak torque, output locked; the twist of a rigid drive is right by itself.
    """
    linear = linear_part(drive)
    rate = torque_transfer(linear).decay_rate
    wait = min(-math.log(STILL) / rate, LONGEST) if rate > 0 else LONGEST
    tau_cmd = 0.5 * linear.peak_torque
    record = run_bench([linear], constant(tau_cmd, round(wait / step) + 10), step=step)
    tau, twist = float(record.tau[-1, 0]), float((record.theta - record.q)[-1, 0])
    deflection = 0.0 if linear.rigid else abs(twist * linear.stiffness / tau - 1)
    return abs(tau / tau_cmd - 1), deflection


def no_load_gap(drive: JointDrive, *, step: float) -> float:
    """Return how far the speed at which full voltage gives no torque is from U/k_t, relative.

    By the current at speeds around it, without friction: it is linear in the speed there.
    """
    linear = linear_part(drive)
    free = replace(linear, friction=replace(linear.friction, viscous=0.0))
    motor = free.motor
    span = min(0.05, 0.5 * motor.peak_current * motor.resistance / motor.voltage)
    share = np.linspace(1 - span, 1 + span, 5)
    most = motor.peak_current * free.torque_constant
    steps = max(100, round(min(5 * motor.inductance / motor.resistance, LONGEST_RUN) / step))
    record = run_bench(
        [free] * len(share),
        constant(most, steps, len(share)),
        step=step,
        link=Link(v=share * free.no_load_speed),
    )
    slope, offset = np.polyfit(share, record.current[-1], 1)
    return float(abs(-offset / slope - 1))


def stop_excess(drive: JointDrive, *, step: float) -> float:
    """Return how far the spring goes beyond its stop [rad]; negative: it does not get there.

    At full current, from the no-load speed of the motor, the link at rest and held, or free; to
    both sides. What throws a link from outside may be faster than that.
    """
    if drive.spring is None or math.isinf(drive.spring.hard_stop):
        return -math.inf
    sign, inertia = np.repeat([1.0, -1.0], len(LINKS)), np.array(LINKS * 2)
    most = 2 * drive.motor.peak_current * drive.torque_constant
    record = run_bench(
        [drive] * len(inertia),
        constant(sign * most, round(CRASH / step), len(inertia)),
        step=step,
        link=Link(inertia=inertia),
        omega=sign * drive.no_load_speed,
    )
    twist = np.abs(record.theta - record.q) * drive.stiffness / drive.spring.stiffness
    return float(twist.max()) - drive.spring.hard_stop


def electric_shares(drive: JointDrive, *, step: float, seed: int = 0) -> tuple[float, float]:
    """Return largest current and voltage over their limits, commanded twice what they allow.

    Forwards and then backwards, with noise, the link held, and as heavy as the rotor and free.
    """
    most = drive.motor.peak_current * drive.torque_constant
    run_up = 2 * drive.inertia * drive.no_load_speed / most
    half = round(min(3 * run_up + 0.01, LONGEST_RUN) / step)
    tau_cmd = np.repeat(2 * most * np.array([1.0, -1.0]), half)[:, None] * np.ones(2)
    link = Link(inertia=np.array([math.inf, drive.inertia]))
    record = run_bench([drive] * 2, tau_cmd, step=step, link=link, seed=seed)
    motor = drive.motor
    return (
        float(np.abs(record.current).max()) / motor.peak_current,
        float(np.abs(record.voltage).max()) / motor.voltage,
    )
