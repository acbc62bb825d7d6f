"""Drives with one of their imperfections taken away, to see what it costs."""

import math
from dataclasses import replace
from typing import Literal, get_args

from qpctrl.errors import unknown_name
from scenarios.actuator.drive import JointDrive
from scenarios.actuator.parts import Friction, Spring, StrainGauge

Ablation = Literal["friction", "backlash", "compliance", "noise", "torque-loop", "limits"]
"""What can be taken away from a drive; each is described by a function of this module."""

ABLATIONS: tuple[Ablation, ...] = get_args(Ablation)

STIFFER = 10.0
"""Times the stiffness of a drive from which compliance is taken away."""

BEYOND = 10.0
"""Times voltage and current of a motor from which limits are taken away."""


def without(drive: JointDrive, name: Ablation) -> JointDrive:
    """Return the drive without one thing; the same drive where it does not have it.

    Raises:
        InputError: nothing of that name can be taken away.
    """
    if name not in _CHANGES:
        raise unknown_name("value of --without", name, ABLATIONS)
    return _CHANGES[name](drive)


def _without_friction(drive: JointDrive) -> JointDrive:
    """Return the drive without friction of motor and gear, and without losses under load."""
    return replace(drive, friction=Friction(), gear=replace(drive.gear, efficiency=1.0))


def _without_backlash(drive: JointDrive) -> JointDrive:
    return replace(drive, gear=replace(drive.gear, backlash=0.0))


def _without_compliance(drive: JointDrive) -> JointDrive:
    """Return the drive with gear, sensor and spring `STIFFER` times as stiff.

    Everything is √`STIFFER` times as fast then, its loops included, with the damping ratios as
    they were. The spring meets its stop, and turns a count, at the same torque as before.
    """
    if drive.rigid:
        return drive
    k, faster = STIFFER, math.sqrt(STIFFER)
    gear, loops = drive.gear, drive.loops
    gear = replace(gear, stiffness=k * gear.stiffness, damping=faster * gear.damping)
    loops = replace(
        loops,
        current_bandwidth=faster * loops.current_bandwidth,
        cutoff=faster * loops.cutoff,
        K_i=faster * loops.K_i,
    )
    return replace(
        drive,
        gear=gear,
        loops=loops,
        spring=drive.spring and _stiffer_spring(drive.spring),
        strain_gauge=drive.strain_gauge and _stiffer_gauge(drive.strain_gauge),
    )


def _stiffer_spring(spring: Spring) -> Spring:
    return replace(
        spring,
        stiffness=STIFFER * spring.stiffness,
        damping=math.sqrt(STIFFER) * spring.damping,
        hard_stop=spring.hard_stop / STIFFER,
        counts=STIFFER * spring.counts,
    )


def _stiffer_gauge(gauge: StrainGauge) -> StrainGauge:
    return replace(gauge, stiffness=STIFFER * gauge.stiffness)


def _without_noise(drive: JointDrive) -> JointDrive:
    """Return the drive without noise, bias and steps of its readings of current and torque."""
    spring, gauge = drive.spring, drive.strain_gauge
    return replace(
        drive,
        motor=replace(drive.motor, current_noise=0.0, current_resolution=0.0),
        spring=spring and replace(spring, counts=0.0),
        strain_gauge=gauge and replace(gauge, noise=0.0, bias=0.0, resolution=0.0),
    )


def _without_torque_loop(drive: JointDrive) -> JointDrive:
    """Return the drive with K_p = K_i = 0; measured torque still damps the motor."""
    return replace(drive, loops=replace(drive.loops, K_p=0.0, K_i=0.0))


def _without_limits(drive: JointDrive) -> JointDrive:
    """Return the drive with `BEYOND` times voltage and current, and no limit of gear and spring."""
    motor, spring = drive.motor, drive.spring
    return replace(
        drive,
        motor=replace(
            motor, voltage=BEYOND * motor.voltage, peak_current=BEYOND * motor.peak_current
        ),
        gear=replace(drive.gear, peak_torque=math.inf),
        spring=spring and replace(spring, hard_stop=math.inf),
    )


_CHANGES = {
    "friction": _without_friction,
    "backlash": _without_backlash,
    "compliance": _without_compliance,
    "noise": _without_noise,
    "torque-loop": _without_torque_loop,
    "limits": _without_limits,
}
