"""What a drive answers on the bench: to sines, to a step, and while it holds still.

The sines go through the linear part of the drive, to be compared with its closed form; all else
is measured with friction, play, noise and the steps of its readings.
"""

import math
from typing import NamedTuple

import numpy as np

from qpctrl.arrays import Vector
from scenarios.actuator.bench import constant, linear_part, run_bench
from scenarios.actuator.drive import JointDrive
from scenarios.actuator.transfer import TransferFunction, bandwidth, peak, torque_transfer
from scenarios.report_bode import Response

CLEAN_DECAY = 9.0
"""Time constants of the slowest transient after which it is called over: e⁻⁹ = 1e-4."""

LONGEST_SETTLING = 3.0
"""Time that a transient is given to fade [s]; what takes longer is not waited for."""

SMALL = 0.01
"""Amplitude of the sines, as a share of the peak torque: no limit is met."""

WINDOW = 0.1
"""Shortest time over which sine and answer are correlated [s]."""

ROOM = 2_000_000
"""Steps of all drives side by side that are kept in memory: 130 MB."""

WIDEST = 50.0
"""Bandwidth over the lowest frequency of a sweep, at most."""

STEP_SHARE = 0.25
"""Height of the step, as a share of the peak torque."""


class Sweep(NamedTuple):
    """A frequency response as measured."""

    frequency: Vector
    """Rising [Hz]."""
    response: Response
    """Delivered over commanded torque there."""

    @property
    def bandwidth(self) -> float:
        """Where the magnitude falls to 1/√2 [Hz]; NaN: nowhere."""
        return bandwidth(self.frequency, self.response)

    @property
    def peak(self) -> tuple[float, float]:
        """Frequency [Hz] and height [1] of the largest magnitude."""
        return peak(self.frequency, self.response)

    def phase(self, frequency: float) -> float:
        """Return the phase [deg] at a frequency [Hz] in between."""
        degrees = np.degrees(np.unwrap(np.angle(self.response)))
        return float(np.interp(math.log(frequency), np.log(self.frequency), degrees))


class StepAnswer(NamedTuple):
    """The answer to a step of the commanded torque."""

    time: Vector
    """Since the step [s]."""
    tau_cmd: Vector
    """[Nm]."""
    tau: Vector
    """Delivered torque [Nm]."""
    tau_meas: Vector
    """Torque as the drive reads it [Nm]."""

    @property
    def height(self) -> float:
        """Of the step [Nm]."""
        return float(self.tau_cmd[-1])

    @property
    def rise_time(self) -> float:
        """From a tenth to nine tenths of the step [s]; NaN: it does not get there."""
        reached = [np.flatnonzero(self.tau >= share * self.height) for share in (0.1, 0.9)]
        if not all(len(found) for found in reached):
            return math.nan
        return float(self.time[reached[1][0]] - self.time[reached[0][0]])

    @property
    def overshoot(self) -> float:
        """How far delivered torque rises above the step, as a share of it [1]."""
        return max(0.0, float(self.tau.max()) / self.height - 1)

    @property
    def final_error(self) -> float:
        """Commanded − delivered torque, mean of the last tenth [Nm]."""
        tail = len(self.time) // 10
        return float((self.tau_cmd - self.tau)[-tail:].mean())


class Rest(NamedTuple):
    """Torque while a constant one is commanded and nothing moves."""

    tau_cmd: float
    """[Nm]."""
    error: float
    """Commanded − delivered, mean [Nm]."""
    spread: float
    """Standard deviation of delivered torque [Nm]."""
    reading_spread: float
    """Standard deviation of the drive's own reading [Nm]."""


def settling_time(drive: JointDrive) -> float:
    """Return how long to wait for transients to fade [s]."""
    rate = torque_transfer(drive).decay_rate
    return min(CLEAN_DECAY / rate, LONGEST_SETTLING) if rate > 0 else LONGEST_SETTLING


def swept_frequencies(model: TransferFunction, step: float) -> Vector:
    """Return frequencies [Hz] for a sweep: even on a logarithmic axis, closer where it falls off.

    Args:
        model: what is expected.
        step: of the inner loop [s]; a period has at least four of them.
    """
    grid = model.grid()
    response = model(grid)
    edge = bandwidth(grid, response)
    middle = edge if math.isfinite(edge) else float(np.median(grid))
    wide = np.geomspace(middle / 12, 6 * middle, 18)
    near = middle * np.linspace(0.96, 1.04, 5)
    found = np.r_[wide, near, _around_peak(grid, response)]
    return np.unique(found[(found > middle / WIDEST) & (found < 0.25 / step)])


def frequency_response(drive: JointDrive, frequency: Vector, *, step: float) -> Sweep:
    """Return delivered over commanded torque of the linear part, output locked.

    A sine for each frequency, in drives side by side; correlated over whole periods
    of the time grid after the transients, so that frequencies move to the nearest that fit.

    Args:
        drive: what is measured.
        frequency: wanted [Hz].
        step: of the inner loop [s].

    Raises:
        InputError: the step is too long for the drive.
    """
    linear = linear_part(drive)
    cycles = np.ceil(np.maximum(1.0, WINDOW * frequency))
    window = np.round(cycles / (frequency * step)).astype(np.int64)
    fitting, kept = np.unique(cycles / (window * step), return_index=True)
    window = window[kept]
    steps = round(settling_time(drive) / step) + int(window.max())
    time = step * np.arange(steps)
    tau_cmd = SMALL * linear.peak_torque * np.sin(2 * np.pi * np.outer(time, fitting))
    at_once = max(1, ROOM // steps)
    tau = np.concatenate(
        [
            run_bench([linear] * sent.shape[1], sent, step=step).tau
            for sent in np.split(tau_cmd, range(at_once, len(fitting), at_once), axis=1)
        ],
        axis=1,
    )
    answers = [
        _component(tau[-m:, j], time[-m:], f) / _component(tau_cmd[-m:, j], time[-m:], f)
        for j, (f, m) in enumerate(zip(fitting, window, strict=True))
    ]
    return Sweep(fitting, np.array(answers))


def sweep(drive: JointDrive, *, step: float) -> Sweep:
    """Return the measured response from far below to well above the bandwidth.

    Raises:
        InputError: the step is too long for the drive.
    """
    return frequency_response(drive, swept_frequencies(torque_transfer(drive), step), step=step)


def step_answer(drive: JointDrive, *, step: float, seed: int = 0) -> StepAnswer:
    """Return the answer to a step of a quarter of the peak torque, with all imperfections."""
    duration = max(0.75 * settling_time(drive), 100 * step)
    before, after = round(0.1 * duration / step), round(duration / step)
    height = STEP_SHARE * drive.peak_torque
    tau_cmd = constant(height, before + after)
    tau_cmd[:before] = 0.0
    record = run_bench([drive], tau_cmd, step=step, seed=seed)
    time = record.time - step * before
    return StepAnswer(time, tau_cmd[:, 0], record.tau[:, 0], record.tau_meas[:, 0])


def torque_at_rest(drive: JointDrive, *, step: float, seed: int = 0) -> Rest:
    """Return how still and how true torque is at rest, at half of the continuous one."""
    settling = settling_time(drive)
    tau_cmd = 0.5 * (drive.continuous_torque or drive.peak_torque)
    steps, tail = round((settling + 0.5) / step), round(0.5 / step)
    record = run_bench([drive], constant(tau_cmd, steps), step=step, seed=seed)
    tau, reading = record.tau[-tail:, 0], record.tau_meas[-tail:, 0]
    return Rest(tau_cmd, float((tau_cmd - tau).mean()), _spread(tau), _spread(reading))


def _around_peak(frequency: Vector, response: Response) -> Vector:
    """Return a few frequencies [Hz] around a resonance, if there is one."""
    at, height = peak(frequency, response)
    half_width = 0.4 / height  # relative; that of half power is about 0.5 / height
    return at * np.linspace(1 - half_width, 1 + half_width, 5) if height > 1.01 else np.zeros(0)


def _spread(signal: Vector) -> float:
    """Return the standard deviation; 0 where only round-off is left of it."""
    spread = float(signal.std())
    return spread if spread > 1e-12 * float(np.abs(signal).max()) else 0.0


def _component(signal: Vector, time: Vector, frequency: float) -> complex:
    return complex(signal @ np.exp(-2j * np.pi * frequency * time))
