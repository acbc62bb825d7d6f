"""A test bench for joint drives: their outputs are held, led or free, and everything is recorded.

The inner tick itself runs here, many drives side by side, without a robot or a controller.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from qpctrl.arrays import Array, Matrix, Vector
from qpctrl.evaluator import Evaluator
from scenarios.actuator.ablation import without
from scenarios.actuator.drive import JointDrive
from scenarios.actuator.inner import NOISES, build_inner_tick, initial_state


@dataclass(frozen=True, kw_only=True, eq=False)
class Link:
    """What the drives move."""

    inertia: Array | float = math.inf
    """Of a free link, without a rotor (n) [kg m²]; inf: its motion is given by ``v``."""
    v: Array | float = 0.0
    """Speed (steps×n or n) [rad/s]; of a free link only at the start."""
    tau_ext: Array | float = 0.0
    """Torque on a free link from outside (steps×n or n) [Nm]."""


LOCKED = Link()

OF_THE_MOTOR = ("current", "theta", "omega")
AT_START, AT_END = ("theta", "omega", "q", "v"), ("tau", "tau_meas", "current", "voltage")
"""When in a step each signal is recorded."""


class Record(NamedTuple):
    """What happened on the bench: a row for each step, a column for each drive (steps×n)."""

    time: Vector
    """Start of each step (steps) [s]."""
    tau: Matrix
    """Torque on the joint [Nm], its mean over the step."""
    tau_meas: Matrix
    """Torque that the drive reads [Nm]: by its sensor, else by its current."""
    current: Matrix
    """At the end of the step [A]."""
    voltage: Matrix
    """[V]."""
    theta: Matrix
    """Angle of the motor, seen at the joint, at the start of the step [rad]."""
    omega: Matrix
    """Its speed [rad/s]."""
    q: Matrix
    """Angle of the link, at the start of the step [rad]."""
    v: Matrix
    """Its speed [rad/s]."""


def linear_part(drive: JointDrive) -> JointDrive:
    """Return the drive without noise, steps of its readings, Coulomb friction, play and losses."""
    bare = without(without(drive, "noise"), "backlash")
    smooth = replace(
        drive.friction, coulomb=0.0, static=0.0, bristle_stiffness=0.0, bristle_damping=0.0
    )
    return replace(bare, gear=replace(bare.gear, efficiency=1.0), friction=smooth)


def constant(tau: Array | float, steps: int, n: int = 1) -> Matrix:
    """Return a command (steps×n) [Nm] that stays as it is."""
    return np.array(np.broadcast_to(tau, (steps, n)), dtype=np.float64)


def run_bench(
    drives: Sequence[JointDrive],
    tau_cmd: Matrix,
    *,
    step: float,
    link: Link = LOCKED,
    omega: Array | float | None = None,
    seed: int | None = None,
) -> Record:
    """Return what the drives do, from rest without torque.

    Args:
        drives: one for each column.
        tau_cmd: commanded torque (steps×n) [Nm].
        step: of the inner loop [s].
        link: what they move; a rigid drive's rotor moves with it.
        omega: speed of the motors at the start (n) [rad/s]; none: that of the link.
        seed: of the noise; none: there is no noise.

    Raises:
        InputError: the step is too long for a drive.
    """
    steps, n = tau_cmd.shape
    led, tau_ext = (np.broadcast_to(value, (steps, n)) for value in (link.v, link.tau_ext))
    inertia = np.broadcast_to(link.inertia, n) + [d.inertia if d.rigid else 0.0 for d in drives]
    free, mobility = np.isfinite(inertia), 1 / inertia
    tick = build_inner_tick(drives, step, mobility)
    evaluate = Evaluator(tick.function)
    given, result = evaluate.inputs, evaluate.outputs
    given["p"][:] = tick.numbers.vector()
    x, q, v = given["x"], given["q"], given["v"]
    state = tick.states.views(x)
    v[:] = led[0]
    start = initial_state(drives, q, np.zeros(n))
    start["omega"] = v + 0.0 if omega is None else np.broadcast_to(omega, n)
    for name, value in {**start, "rate": start["omega"] - v}.items():
        state[name][:] = value
    seen = {"tau": result["tau"], "voltage": result["voltage"], "q": q, "v": v}
    seen |= {"tau_meas": state["torque"], **{name: state[name] for name in OF_THE_MOTOR}}
    rows = {name: np.empty((steps, n)) for name in seen}
    at_start, at_end = ([(rows[k], seen[k]) for k in names] for names in (AT_START, AT_END))
    noise = None if seed is None else _noise(seed, steps, n)
    moving = bool(free.any() or led.any())
    for i in range(steps):
        given["tau_cmd"][:] = tau_cmd[i]
        if noise is not None:
            given["noise"][:] = noise[i]
        for row, value in at_start:
            row[i] = value
        evaluate()
        x[:] = result["x_next"]
        for row, value in at_end:
            row[i] = value
        if moving:
            v[:] = np.where(free, v + step * mobility * (result["tau"] + tau_ext[i]), led[i])
            q += step * v
    return Record(time=step * np.arange(steps), **rows)


def _noise(seed: int, steps: int, n: int) -> Matrix:
    return np.random.default_rng(seed).normal(size=(steps, len(NOISES) * n))
