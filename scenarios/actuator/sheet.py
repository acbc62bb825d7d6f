"""The data sheet of a drive: its numbers, what it does on the bench, and whether that agrees."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from qpctrl.arrays import positive
from qpctrl.errors import InputError
from scenarios.actuator.check import (
    TorqueSpeed,
    electric_shares,
    no_load_gap,
    steady_gaps,
    stop_excess,
    torque_at_speed,
)
from scenarios.actuator.drive import JointDrive
from scenarios.actuator.inner import INNER_RATE, check_rate
from scenarios.actuator.response import Rest, StepAnswer, Sweep, step_answer, sweep, torque_at_rest
from scenarios.actuator.transfer import (
    TransferFunction,
    bandwidth,
    textbook_transfer,
    torque_transfer,
)
from scenarios.scenario import Criterion

FASTEST = 2e5
"""Highest rate of the inner loop [Hz]: time on the bench grows with it."""

SLOWEST = 2.0
"""Lowest bandwidth that is measured [Hz]: a slower drive takes minutes."""

AGREEMENT = 0.02
"""Of bandwidths, relative: the closed form has of the sampling what is of first order."""


class Fact(NamedTuple):
    """A line of the data sheet."""

    key: str
    words: str
    unit: str


FACTS: dict[str, tuple[Fact, ...]] = {
    "torque and speed": (
        Fact("continuous_torque_Nm", "Continuous torque", "Nm"),
        Fact("peak_torque_Nm", "Peak torque", "Nm"),
        Fact("torque_rate_Nm_s", "Torque rate that the loop follows", "Nm/s"),
        Fact("stall_torque_Nm", "Stall torque, by the voltage", "Nm"),
        Fact("droop_Nms_rad", "Torque lost to back-EMF and drag", "Nm s/rad"),
        Fact("no_load_speed_rad_s", "No-load speed", "rad/s"),
        Fact("torque_constant_Nm_A", "Torque per current", "Nm/A"),
    ),
    "response, output locked": (
        Fact("bandwidth_Hz", "Bandwidth (−3 dB), measured", "Hz"),
        Fact("bandwidth_model_Hz", "Bandwidth, transfer function", "Hz"),
        Fact("bandwidth_second_order_Hz", "Bandwidth, second order alone", "Hz"),
        Fact("phase_deg", "Phase at the bandwidth, measured", "deg"),
        Fact("natural_frequency_Hz", "Natural frequency √(k (1 + K_p) / J)", "Hz"),
        Fact("resonance_Hz", "Peak of the response, measured", "Hz"),
        Fact("resonance_height", "Its height over the static gain", ""),
        Fact("rise_time_ms", "Rise time, 10 to 90 %", "ms"),
        Fact("overshoot_percent", "Overshoot of a quarter of the peak", "%"),
    ),
    "mechanics, at the joint": (
        Fact("reflected_inertia_kgm2", "Reflected inertia J", "kg m²"),
        Fact("apparent_inertia_kgm2", "Apparent inertia J / (1 + K_p)", "kg m²"),
        Fact("stiffness_Nm_rad", "Stiffness, motor to joint", "Nm/rad"),
        Fact("hard_stop_rad", "Hard stop of the spring", "rad"),
        Fact("backlash_rad", "Backlash", "rad"),
        Fact("efficiency", "Efficiency", ""),
        Fact("coulomb_Nm", "Coulomb friction", "Nm"),
        Fact("static_Nm", "Break-away friction", "Nm"),
        Fact("viscous_Nms_rad", "Viscous friction", "Nm s/rad"),
    ),
    "torque at rest": (
        Fact("reading_step_Nm", "Step of the reading", "Nm"),
        Fact("rest_torque_Nm", "Commanded, in a step from 0", "Nm"),
        Fact("torque_error_Nm", "Commanded − delivered, then", "Nm"),
        Fact("torque_spread_Nm", "Standard deviation of delivered torque", "Nm"),
        Fact("reading_spread_Nm", "Standard deviation of the reading", "Nm"),
    ),
}
"""What the data sheet says, in its order; a number that does not exist is left out."""

CRITERIA = {
    "bandwidth_gap": "Bandwidth against the transfer function",
    "growth_rate": "Growth of the slowest transient",
    "steady_torque_gap": "Steady torque against the command, linear part",
    "deflection_gap": "Steady twist against τ / k, linear part",
    "no_load_gap": "No-load speed against U / k_t",
    "torque_at_speed_gap": "Torque while it turns, against its closed form",
    "current_share": "Largest current",
    "voltage_share": "Largest voltage",
    "stop_excess_rad": "Twist beyond the hard stop",
}
"""Words of each criterion."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DataSheet:
    """A drive, what was measured of it, and how that compares."""

    drive: JointDrive
    inner_rate: float
    """Of its loops [Hz]."""
    model: TransferFunction
    """Delivered over commanded torque in closed form."""
    second_order: TransferFunction
    """The same without current loop, filter and integral."""
    sweep: Sweep
    answer: StepAnswer
    rest: Rest
    at_speed: TorqueSpeed
    metrics: dict[str, float]
    """The facts by key; NaN or infinite where there is none."""
    criteria: tuple[Criterion, ...]

    @property
    def passed(self) -> bool:
        """Whether all criteria hold."""
        return all(criterion.passed for criterion in self.criteria)

    def facts(self) -> dict[str, list[tuple[Fact, float]]]:
        """Return the facts that exist, with their values, in groups by title."""
        return {
            title: [(f, self.metrics[f.key]) for f in group if math.isfinite(self.metrics[f.key])]
            for title, group in FACTS.items()
        }


@np.errstate(over="ignore", invalid="ignore")  # a motor too fast for the step runs away
def data_sheet(drive: JointDrive, *, inner_rate: float = INNER_RATE) -> DataSheet:
    """Return the data sheet of a drive, measured on the bench in about two seconds.

    Args:
        drive: which.
        inner_rate: of its loops [Hz].

    Raises:
        InputError: a rate that is no number, or too slow for the drive, or needlessly fast; a
            drive that is too slow or too fast to be measured.
    """
    positive(inner_rate, (), "inner_rate")
    if inner_rate > FASTEST:
        raise InputError(f"inner_rate: got {inner_rate:g} Hz, need at most {FASTEST:g} Hz")
    step = 1 / inner_rate
    check_rate([drive], step, [0.0])
    model = torque_transfer(drive, step)
    _check_bandwidth(drive, model, inner_rate)
    swept, answer = sweep(drive, step=step), step_answer(drive, step=step)
    rest, at_speed = torque_at_rest(drive, step=step), torque_at_speed(drive, step=step)
    return DataSheet(
        drive=drive,
        inner_rate=inner_rate,
        model=model,
        second_order=textbook_transfer(drive),
        sweep=swept,
        answer=answer,
        rest=rest,
        at_speed=at_speed,
        metrics={
            **_numbers(drive),
            **_mechanics(drive),
            **_response(drive, model, swept, answer),
            "reading_step_Nm": _reading_step(drive),
            "reading_spread_Nm": rest.reading_spread,
            "torque_spread_Nm": rest.spread,
            "torque_error_Nm": rest.error,
            "rest_torque_Nm": rest.tau_cmd,
        },
        criteria=_criteria(drive, model, swept, at_speed, step),
    )


def model_bandwidth(model: TransferFunction) -> float:
    """Return the bandwidth of a closed form [Hz]; NaN: none."""
    grid = model.grid()
    return bandwidth(grid, model(grid))


def _check_bandwidth(drive: JointDrive, model: TransferFunction, inner_rate: float) -> None:
    edge, most = model_bandwidth(model), inner_rate / 4
    if not SLOWEST <= edge <= most:
        raise InputError(
            f"drive {drive.name!r}: got a bandwidth of {edge:.3g} Hz, need {SLOWEST:g} Hz to a "
            f"quarter of the inner rate, {most:g} Hz"
        )


def _numbers(drive: JointDrive) -> dict[str, float]:
    limits = drive.limits()
    return {
        "continuous_torque_Nm": drive.continuous_torque,
        "peak_torque_Nm": limits.peak,
        "torque_rate_Nm_s": limits.rate,
        "stall_torque_Nm": limits.stall,
        "droop_Nms_rad": limits.droop,
        "no_load_speed_rad_s": drive.no_load_speed,
        "torque_constant_Nm_A": drive.torque_constant,
    }


def _mechanics(drive: JointDrive) -> dict[str, float]:
    friction, spring = drive.friction, drive.spring
    return {
        "reflected_inertia_kgm2": drive.inertia,
        "apparent_inertia_kgm2": drive.apparent_inertia,
        "stiffness_Nm_rad": drive.stiffness,
        "hard_stop_rad": spring.hard_stop if spring else math.inf,
        "backlash_rad": drive.gear.backlash,
        "efficiency": drive.gear.efficiency,
        "coulomb_Nm": friction.coulomb,
        "static_Nm": max(friction.static, friction.coulomb),
        "viscous_Nms_rad": friction.viscous,
    }


def _response(
    drive: JointDrive, model: TransferFunction, swept: Sweep, answer: StepAnswer
) -> dict[str, float]:
    at, height = swept.peak
    rings = height > 1.01 and not drive.rigid
    edge = swept.bandwidth
    return {
        "bandwidth_Hz": edge,
        "bandwidth_model_Hz": model_bandwidth(model),
        "bandwidth_second_order_Hz": model_bandwidth(textbook_transfer(drive)),
        "phase_deg": swept.phase(edge) if math.isfinite(edge) else math.nan,
        "natural_frequency_Hz": drive.natural_frequency / (2 * math.pi),
        "resonance_Hz": at if rings else math.nan,
        "resonance_height": height if rings else math.nan,
        "rise_time_ms": 1e3 * answer.rise_time,
        "overshoot_percent": 100 * answer.overshoot,
    }


def _reading_step(drive: JointDrive) -> float:
    """Return the smallest change of torque that the drive can read [Nm]; 0: any."""
    if drive.spring:
        counts, k = drive.spring.counts, drive.spring.stiffness
        return 2 * math.pi * k / counts if counts else 0.0
    if drive.strain_gauge:
        return drive.strain_gauge.resolution
    return drive.torque_constant * drive.motor.current_resolution


def _criteria(
    drive: JointDrive, model: TransferFunction, swept: Sweep, at_speed: TorqueSpeed, step: float
) -> tuple[Criterion, ...]:
    torque_gap, twist_gap = steady_gaps(drive, step=step)
    current, voltage = electric_shares(drive, step=step)
    found = [
        Criterion(
            "bandwidth_gap",
            abs(swept.bandwidth / model_bandwidth(model) - 1),
            AGREEMENT,
            "× closed form",
        ),
        Criterion("growth_rate", -model.decay_rate, 0.0, "1/s"),
        Criterion("steady_torque_gap", torque_gap, 1e-6, "× command"),
        Criterion("deflection_gap", twist_gap, 1e-6, "× τ / k"),
        Criterion("no_load_gap", no_load_gap(drive, step=step), 0.01, "× closed form"),
        Criterion("torque_at_speed_gap", at_speed.gap, 0.01, "× peak torque"),
        Criterion("current_share", current, 1.01, "× limit"),
        Criterion("voltage_share", voltage, 1.0, "× limit"),
    ]
    if drive.rigid:
        found = [one for one in found if one.name != "deflection_gap"]
    if drive.spring and math.isfinite(drive.spring.hard_stop):
        found.append(Criterion("stop_excess_rad", stop_excess(drive, step=step), 1e-3, "rad"))
    return tuple(found)
