"""Our joint drives against MuJoCo's dcmotor, where the two say the same; and where they do not.

Both let back-EMF act with the speed at the start of a step. MuJoCo's torque is then that of the
current at its end, a leapfrog whose speed is half a step ahead; ours is that of the current's mean,
exact at a given speed. Both are of first order in the step.
"""

from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
import pytest
from scipy.linalg import expm

from qpctrl.evaluator import Evaluator
from scenarios.actuator.catalogue import load_drive
from scenarios.actuator.drive import CURRENT_SHARE, VOLTAGE_SHARE, JointDrive
from scenarios.actuator.inner import build_inner_tick
from scenarios.actuator.parts import Friction, Loops, Motor

STEP = 1e-4  # s
FIRST_ORDER = (1.8, 2.2)
"""Ratio of two errors of first order, of a step and of half of it."""

ROUND_OFF = 1e-9  # relative

DIRECT = load_drive("ilm115-direct")
LINK = 2e-3  # kg m²: light, so that the motor comes near its no-load speed


class Trace(NamedTuple):
    """Of one joint at the end of each step (N)."""

    current: np.ndarray  # A
    speed: np.ndarray  # rad/s
    voltage: np.ndarray  # V
    torque: np.ndarray  # Nm


class Drive:
    """Our inner tick of one joint, with every noise at zero."""

    def __init__(self, drive: JointDrive, step: float = STEP, mobility: float = 0.0) -> None:
        tick = build_inner_tick([drive], step, mobility)
        self._evaluate = Evaluator(tick.function)
        self._evaluate.inputs["p"][:] = tick.numbers.vector()
        self.state = tick.states.views(self._evaluate.inputs["x"])

    def step(self, tau_cmd: float, q: float, v: float) -> tuple[float, float]:
        """Return torque on the joint [Nm] and voltage [V]."""
        inputs, out = self._evaluate.inputs, self._evaluate.outputs
        inputs["tau_cmd"][:], inputs["q"][:], inputs["v"][:] = tau_cmd, q, v
        self._evaluate()
        inputs["x"][:] = out["x_next"]
        return float(out["tau"][0]), float(out["voltage"][0])


def profile(times: np.ndarray) -> np.ndarray:
    """Return commanded torques [Nm] that take the motor to its voltage limit and back."""
    levels = np.array([8.0, -8.0, 12.0, -12.0, 3.0])
    return levels[np.minimum((times / 0.03).astype(int), len(levels) - 1)]


def simulate(drive: JointDrive, commands: np.ndarray, step: float, link: float) -> Trace:
    """Return what our drive does to a free link [kg m²] under commands (N) [Nm]."""
    joint = Drive(drive, step, 1 / link)
    carried = link + (drive.inertia if drive.rigid else 0.0)  # a rigid rotor is the plant's
    q = v = 0.0
    rows = []
    for command in commands:
        tau, voltage = joint.step(command, q, v)
        v += step * tau / carried
        q += step * v
        rows.append((joint.state["current"][0], v, voltage, tau))
    return Trace(*np.array(rows).T)


def mujoco_joint(
    attributes: str, *, step: float = STEP, link: float = 1.0
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a hinge with a link [kg m²], moved by a dcmotor of these attributes."""
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option timestep="{step}" gravity="0 0 0" integrator="Euler"/>
          <worldbody>
            <body>
              <joint name="joint" axis="0 0 1"/>
              <inertial pos="0 0 0" mass="1" diaginertia="{link} {link} {link}"/>
            </body>
          </worldbody>
          <actuator><dcmotor joint="joint" {attributes}/></actuator>
        </mujoco>""")
    return model, mujoco.MjData(model)


def winding(drive: JointDrive, inductance: bool = True) -> str:
    """Return the attributes of a drive's motor and gear."""
    motor = drive.motor
    text = (
        f'motorconst="{motor.torque_constant}" resistance="{motor.resistance}" '
        f'gear="{drive.gear.ratio}" armature="{motor.inertia + drive.gear.inertia}" '
    )
    return text + (f'inductance="{motor.inductance}"' if inductance else "")


def replay(drive: JointDrive, voltages: np.ndarray, step: float, link: float) -> Trace:
    """Return what MuJoCo makes of the voltages (N) [V], each held for one step."""
    model, data = mujoco_joint(winding(drive), step=step, link=link)
    rows = []
    for voltage in voltages:
        data.ctrl[0] = voltage
        mujoco.mj_step(model, data)
        rows.append((data.act[0], data.qvel[0], voltage, data.qfrc_actuator[0]))
    return Trace(*np.array(rows).T)


def exact(drive: JointDrive, voltages: np.ndarray, step: float, link: float) -> np.ndarray:
    """Return current [A] and speed [rad/s] (N×2) of a rigid drive by the matrix exponential."""
    motor, k_t, J = drive.motor, drive.torque_constant, drive.inertia + link
    R, L = motor.resistance, motor.inductance
    change = expm(step * np.array([[-R / L, -k_t / L, 1 / L], [k_t / J, 0, 0], [0, 0, 0]]))
    x, rows = np.zeros(2), []
    for voltage in voltages:
        x = change[:2] @ np.array([*x, voltage])
        rows.append(x)
    return np.array(rows)


def largest(difference: np.ndarray) -> float:
    return float(np.abs(difference).max())


# The winding and a rotor --------------------------------------------------------------------


@pytest.fixture(scope="module")
def runs() -> dict[float, tuple[Trace, Trace, np.ndarray]]:
    """Our run, MuJoCo's replay of its voltages and the exact answer to them, by step [s]."""
    found = {}
    for step in (STEP, STEP / 2):
        commands = profile(np.arange(round(0.18 / step)) * step)
        ours = simulate(DIRECT, commands, step, LINK)
        found[step] = (
            ours,
            replay(DIRECT, ours.voltage, step, LINK),
            exact(DIRECT, ours.voltage, step, LINK),
        )
    return found


def test_the_replayed_voltages_are_worth_a_replay(runs):
    ours = runs[STEP][0]
    assert largest(ours.voltage) == DIRECT.motor.voltage  # at its limit
    assert largest(ours.speed) > 0.6 * DIRECT.no_load_speed
    assert ours.current.max() > 50  # A
    assert ours.current.min() < -50


def test_current_and_speed_are_those_of_mujoco_within_what_a_step_changes(runs):
    motor = DIRECT.motor
    for ours, mujocos, _ in runs.values():
        change = largest(np.diff(ours.speed))  # rad/s
        speed, current = (
            largest(ours.speed - mujocos.speed),
            largest(ours.current - mujocos.current),
        )
        assert 0 < speed < change
        assert 0 < current < motor.torque_constant * change / motor.resistance  # its back-EMF


@pytest.mark.parametrize("column", ["current", "speed"])
def test_half_the_step_halves_the_difference_from_mujoco_and_from_the_exact_answer(runs, column):
    errors = []
    for ours, mujocos, truth in (runs[STEP], runs[STEP / 2]):
        a, b = getattr(ours, column), getattr(mujocos, column)
        c = truth[:, ["current", "speed"].index(column)]
        errors.append([largest(a - b), largest(a - c), largest(b - c)])
    between, ours_off, mujocos_off = np.divide(*errors)
    assert FIRST_ORDER[0] < between < FIRST_ORDER[1]
    assert FIRST_ORDER[0] < ours_off < FIRST_ORDER[1]
    assert mujocos_off > FIRST_ORDER[0]  # of its current even second: a leapfrog


# The torque–speed line ----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ilm115-direct", "orange-geared"])
def test_the_torque_speed_line_of_a_drive_is_that_of_mujoco(name):
    drive = load_drive(name)
    limit = VOLTAGE_SHARE * drive.motor.voltage
    model, data = mujoco_joint(
        f'{winding(drive, inductance=False)} input="ff" controller="0 0 0 0 0 {limit}"'
    )
    limits = drive.limits()
    asked = 0.5 * limits.stall
    for speed in np.array([-0.2, 0.0, 0.3, 0.5, 0.8, 0.9, 1.1]) * drive.no_load_speed:
        data.qvel[0], data.ctrl[0] = speed, asked / drive.gear.ratio
        mujoco.mj_forward(model, data)
        line = limits.stall - limits.droop * speed
        assert data.qfrc_actuator[0] == pytest.approx(min(asked, line), rel=ROUND_OFF, abs=1e-9)


def test_a_drive_at_full_voltage_settles_on_the_torque_of_mujoco():
    drive = replace(load_drive("orange-geared"), friction=Friction())
    model, data = mujoco_joint(
        f'{winding(drive, inductance=False)} input="ff" '
        f'controller="0 0 0 0 0 {drive.motor.voltage}"'
    )
    for speed in np.array([0.85, 0.95, 1.05]) * drive.no_load_speed:
        joint = Drive(drive)
        joint.state["theta"][:], joint.state["omega"][:] = 0.0, speed
        tau = 0.0
        for i in range(5000):  # a link that turns at this speed whatever the torque
            tau, voltage = joint.step(drive.peak_torque, speed * STEP * i, speed)
        data.qvel[0], data.ctrl[0] = speed, drive.peak_torque / drive.gear.ratio
        mujoco.mj_forward(model, data)
        assert voltage == drive.motor.voltage
        assert tau == pytest.approx(data.qfrc_actuator[0], rel=1e-6)  # what has not yet settled


# LuGre friction -----------------------------------------------------------------------------

LUGRE = load_drive("lbr-strain").friction


def our_friction(speeds: np.ndarray, step: float) -> np.ndarray:
    """Return friction (N) [Nm] of our rotor, whose speed (N) [rad/s] is given."""
    drive = replace(
        load_drive("lbr-strain"),
        friction=replace(LUGRE, viscous=0.0),
        loops=Loops(current_bandwidth=79.6),
    )
    joint = Drive(drive, step)
    found = []
    for speed in speeds:  # joint and rotor turn together and no current flows: friction alone
        joint.state["theta"][:], joint.state["omega"][:] = 0.0, speed
        joint.step(0.0, 0.0, speed)
        found.append(drive.inertia * (speed - joint.state["omega"][0]) / step)
    return np.array(found)


def mujoco_friction(speeds: np.ndarray, step: float, ratio: float = 160.0) -> np.ndarray:
    """Return the same of MuJoCo's motor: there friction is at the motor's shaft."""
    f, G = LUGRE, ratio
    model, data = mujoco_joint(
        f'motorconst="0" resistance="1" input="none" gear="{G}" lugre="'
        f"{f.bristle_stiffness / G**2} {f.bristle_damping / G**2} "
        f'{f.coulomb / G} {f.static / G} {f.stribeck_speed * G}"',
        step=step,
    )
    found = []
    for speed in speeds:
        data.qvel[0] = speed
        mujoco.mj_step(model, data)
        found.append(-data.qfrc_actuator[0])
    return np.array(found)


@pytest.mark.parametrize("speed", [0.1, -0.1, 0.25, 1.0])
def test_steady_lugre_friction_is_that_of_mujoco_and_of_the_stribeck_curve(speed):
    time = 20 * LUGRE.static / (LUGRE.bristle_stiffness * abs(speed))  # s: 20 time constants
    speeds = np.full(round(time / STEP), speed)
    g = LUGRE.coulomb + (LUGRE.static - LUGRE.coulomb) * np.exp(
        -((speed / LUGRE.stribeck_speed) ** 2)
    )
    ours, mujocos = our_friction(speeds, STEP)[-1], mujoco_friction(speeds, STEP)[-1]
    assert ours == pytest.approx(np.sign(speed) * g, rel=1e-6)  # e⁻²⁰, and round-off of ω / step
    assert ours == pytest.approx(mujocos, rel=1e-6)


def test_lugre_friction_before_it_slides_is_that_of_mujoco_to_first_order():
    """The way is a sine of 5 mrad: from the bristles' spring to sliding and back."""
    differences = []
    for step in (STEP, STEP / 2):
        times = np.arange(round(1.0 / step)) * step
        speeds = 0.05 * np.cos(10 * times)
        ours, mujocos = our_friction(speeds, step), mujoco_friction(speeds, step)
        differences.append(largest(ours - mujocos))
        assert largest(ours) > 10.0
    assert differences[0] < 2 * LUGRE.bristle_stiffness * 0.05 * STEP  # Nm: of two steps' way
    assert FIRST_ORDER[0] < differences[0] / differences[1] < FIRST_ORDER[1]


def test_bristles_are_a_spring_of_stiffness_sigma_0_for_small_ways():
    speed, f = 1e-3, LUGRE  # rad/s, for 10 ms
    slope = f.bristle_stiffness * (1 - f.bristle_damping * speed / f.static)  # at the start
    for friction in (our_friction, mujoco_friction):
        found = friction(np.full(100, speed), STEP)
        assert (found[-1] - found[49]) / (50 * STEP * speed) == pytest.approx(slope, rel=1e-3)
        # at the end it has fallen by σ_0 z / g, 0.05 %


# Armature -----------------------------------------------------------------------------------


def stiff(stiffness: float) -> JointDrive:
    """Return a geared drive without friction whose gear has this stiffness [Nm/rad]."""
    drive = load_drive("orange-geared")
    gear = replace(drive.gear, stiffness=stiffness, damping=0.0)
    return replace(drive, friction=Friction(), gear=gear)


def test_reflected_inertia_is_the_armature_of_mujoco():
    drive, link = load_drive("orange-geared"), 0.2
    model, data = mujoco_joint(winding(drive), link=link)
    M = np.zeros((1, 1))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    assert M[0, 0] == pytest.approx(link + drive.inertia, rel=ROUND_OFF)
    assert drive.inertia == pytest.approx(100**2 * (3.594e-5 + 1.120e-5), rel=ROUND_OFF)


def test_a_stiff_gear_accelerates_the_link_as_an_armature_does():
    """But for the swing of rotor against link: torque steps in all over (J + m) ω_n."""
    link, errors = 0.2, []
    for stiffness in (2.5e5, 1e6):
        drive = stiff(stiffness)
        commands = np.repeat([20.0, -20.0, 10.0], 300)
        ours = simulate(drive, commands, STEP, link)
        mujocos = replay(drive, ours.voltage, STEP, link)
        swing = np.sqrt(stiffness * (1 / drive.inertia + 1 / link))  # rad/s
        carried = drive.inertia + link
        bound = 90.0 / (carried * swing) + 20.0 / carried * STEP  # rad/s; and one step
        errors.append(largest(ours.speed - mujocos.speed))
        assert largest(mujocos.speed) > 0.5
        assert errors[-1] < bound
    assert errors[1] < 0.6 * errors[0]  # four times as stiff, half the swing


# Where they differ --------------------------------------------------------------------------


def test_mujoco_limits_torque_where_our_drive_limits_current():
    """Whoever takes MuJoCo's current for the winding's overrates its heat a hundredfold."""
    motor = Motor(
        torque_constant=0.1,
        resistance=0.5,
        inductance=5e-4,
        voltage=24.0,
        peak_current=5.0,
        continuous_current=5.0,
        inertia=1e-4,
    )
    drive = JointDrive(name="small", source="", motor=motor, loops=Loops(current_bandwidth=500.0))
    model, data = mujoco_joint(f'{winding(drive)} saturation="0 5 0"', link=1e6)
    joint, peak = Drive(drive), 0.0
    data.ctrl[0] = motor.voltage
    for _ in range(200):
        mujoco.mj_step(model, data)
        joint.step(motor.torque_constant * motor.voltage / motor.resistance, 0.0, 0.0)
        peak = max(peak, joint.state["current"][0])
    assert data.actuator_force[0] == pytest.approx(0.1 * 5.0)
    assert data.act[0] == pytest.approx(48.0, rel=1e-6)  # the current of a stalled motor
    assert CURRENT_SHARE * 5.0 < peak < 5.0 * (1 + ROUND_OFF)
