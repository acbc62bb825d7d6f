"""The inner tick: current and torque loops of all joints, and the motors that they drive.

One CasADi function for n joints: from the commanded torque and the joints' motion to the torque on
the joints, in a step of 0.1 ms.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, Vector
from qpctrl.errors import InputError
from qpctrl.layout import Layout
from qpctrl.spatial import SX
from scenarios.actuator.drive import JointDrive
from scenarios.actuator.joint import Joint

INNER_RATE = 10000.0
"""Rate of the drives' loops [Hz] that is used where none is given."""

STATES = (
    *("current", "integral"),  # A and V: of the current loop
    *("theta", "omega"),  # rad, rad/s: motor, seen at the joint
    *("torque", "torque_integral"),  # Nm, Nm s: measured, and the error of it
    "bristle",  # rad: twist of the bristles
    *("rate", "carried"),  # rad/s, Nm: between motor and joint, one step ago
    *("delivered", "limited"),  # Nm and 1: summed over the steps of a period
)
NOISES = ("current", "torque")


class InnerTick(NamedTuple):
    """The function (x, tau_cmd, q, v, p, noise) → (x, tau, voltage), n joints in each vector."""

    function: ca.Function
    states: Layout
    numbers: Layout
    """Of the drives, p; they may change without building the function again."""


def build_inner_tick(
    drives: Sequence[JointDrive], step: float, mobility: Array | float = 0.0
) -> InnerTick:
    """Return the inner tick of these joints.

    Args:
        drives: one for each joint.
        step: of the inner loop [s].
        mobility: acceleration of each joint per torque (n) [1/(kg m²)]; 0: locked output.

    Raises:
        InputError: the step is too long for a winding, a spring or a loop; says which would do.
    """
    n = len(drives)
    free = np.broadcast_to(mobility, n).tolist()
    check_rate(drives, step, free)
    numbers = [parameters(drive, step, y) for drive, y in zip(drives, free, strict=True)]
    layout = Layout({name: np.array([one[name] for one in numbers]) for name in numbers[0]})
    states = Layout(dict.fromkeys(STATES, np.zeros(n)))
    noises = Layout(dict.fromkeys(NOISES, np.zeros(n)))
    x, x_of = states.symbols("x")
    p, p_of = layout.symbols("p")
    w, w_of = noises.symbols("noise")
    tau_cmd, q, v = (ca.SX.sym(name, n) for name in ("tau_cmd", "q", "v"))
    after: dict[str, list[SX]] = {name: [] for name in (*STATES, "tau", "voltage")}
    for j, drive in enumerate(drives):
        joint = Joint(drive, step, _at(p_of, j), _at(w_of, j))
        for name, value in joint.step(_at(x_of, j), tau_cmd[j], q[j], v[j]).items():
            after[name].append(value)
    stacked = {name: ca.vertcat(*values) for name, values in after.items()}
    function = ca.Function(
        "inner_tick",
        [x, tau_cmd, q, v, p, w],
        [states.pack(stacked), stacked["tau"], stacked["voltage"]],
        ["x", "tau_cmd", "q", "v", "p", "noise"],
        ["x_next", "tau", "voltage"],
        {"cse": True},
    )
    return InnerTick(function, states, layout)


class Need(NamedTuple):
    """What asks for short inner steps."""

    longest: float
    """Step that it still stands [s]."""
    drive: str
    words: str


def check_rate(drives: Sequence[JointDrive], step: float, mobility: Sequence[float]) -> None:
    """Refuse a step [s] that is too long for one of the drives, with the rate that would do.

    Raises:
        InputError: names what is too fast for it.
    """
    needs = [need for pair in zip(drives, mobility, strict=True) for need in _needs(*pair)]
    worst = min(needs)
    if step > worst.longest * (1 + 1e-9):
        rate = 1000 * np.ceil(1 / worst.longest / 1000)
        raise InputError(
            f"inner rate: got {1 / step:g} Hz, too slow for drive {worst.drive!r} with its "
            f"{worst.words}; {rate:g} Hz would do"
        )


def _needs(drive: JointDrive, mobility: float) -> tuple[Need, ...]:
    motor, bandwidth = drive.motor, drive.loops.current_bandwidth
    winding, J = motor.inductance / motor.resistance, drive.inertia
    swing = float(np.sqrt(J * motor.inductance)) / drive.torque_constant
    found = {
        f"winding, whose time constant is {1e3 * winding:.3g} ms": 0.5 * winding,
        f"current bandwidth of {bandwidth:g} Hz": 0.15 / bandwidth,
        f"swing of {J:.3g} kg m² on its back-EMF": swing,
    }
    if not drive.rigid:
        k = drive.stiffness
        words = f"stiffness of {k:.3g} Nm/rad between motor and joint"
        found[words] = 1.0 / float(np.sqrt(k * (1 / J + mobility)))
    return tuple(Need(longest, drive.name, words) for words, longest in found.items())


def parameters(drive: JointDrive, step: float, mobility: float) -> dict[str, float]:
    """Return the numbers of one drive that its inner tick needs, by name."""
    motor, gear, friction, loops = drive.motor, drive.gear, drive.friction, drive.loops
    spring, gauge = drive.spring, drive.strain_gauge
    k = 0.0 if drive.rigid else drive.stiffness
    decay = float(np.exp(-motor.resistance * step / motor.inductance))
    pole = float(np.exp(-2 * np.pi * loops.current_bandwidth * step))
    K_u = (1 - pole) * motor.resistance / (1 - decay)  # V/A, puts the pole of the loop there
    return {
        "k_t": drive.torque_constant,
        "R": motor.resistance,
        "decay": decay,  # of the current in a step without voltage
        "share": (1 - decay) * motor.inductance / (motor.resistance * step),  # of it in the mean
        "voltage": motor.voltage,
        "peak_current": motor.peak_current,
        "K_u": K_u,
        "K_u_i": K_u * (1 - decay),  # V/A for each step
        "current_noise": motor.current_noise,
        "current_resolution": motor.current_resolution,
        "J": drive.inertia,
        "k": k,
        "d": drive.twist_damping,
        "half_play": gear.backlash / 2,
        "load_friction": 1 / gear.efficiency - 1,
        "hard_stop": min(spring.hard_stop * spring.stiffness / k, 1e9) if spring else 1e9,
        "mobility": mobility,
        "coulomb": friction.coulomb,
        "static": max(friction.static, friction.coulomb),
        "stribeck_speed": friction.stribeck_speed,
        "viscous": friction.viscous,
        "sigma_0": friction.bristle_stiffness,
        "sigma_1": friction.bristle_damping,
        "K_p": loops.K_p,
        "K_i": loops.K_i,
        "K_d": drive.K_d,
        "alpha": 1 - float(np.exp(-2 * np.pi * loops.cutoff * step)) if loops.cutoff else 1.0,
        "feedforward": loops.friction_feedforward,
        "count": 2 * np.pi / spring.counts if spring and spring.counts else 0.0,
        "spring": spring.stiffness if spring else 1.0,
        "bias": gauge.bias if gauge else 0.0,
        "torque_noise": gauge.noise if gauge else 0.0,
        "torque_resolution": gauge.resolution if gauge else 0.0,
    }


def initial_state(drives: Sequence[JointDrive], q: Vector, tau: Vector) -> dict[str, Array]:
    """Return the state of drives that hold still at ``q`` (n) with ``tau`` (n) [Nm], by name."""
    k = np.array([drive.stiffness for drive in drives])
    k_t = np.array([drive.torque_constant for drive in drives])
    play = np.array([drive.gear.backlash for drive in drives]) / 2
    current = tau / k_t
    return {
        "current": current,
        "integral": np.array([drive.motor.resistance for drive in drives]) * current,
        "theta": q + tau / k + play * np.sign(tau),
        "carried": tau,
        "torque": tau,
    }


def _at(values: Mapping[str, SX], j: int) -> dict[str, SX]:
    return {name: vector[j] for name, vector in values.items()}
