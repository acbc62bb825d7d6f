"""Joint drives on the bench: what arrives at the joint, against closed forms and limits."""

import math
from dataclasses import replace

import numpy as np
import pytest

from scenarios.actuator.bench import Link, constant, linear_part, run_bench
from scenarios.actuator.catalogue import drive_names, load_drive
from scenarios.actuator.check import (
    electric_shares,
    no_load_gap,
    steady_gaps,
    steady_torque,
    stop_excess,
    torque_at_speed,
    torque_limit,
)
from scenarios.actuator.drive import DESIGNS, JointDrive
from scenarios.actuator.parts import Friction, Gear, Loops, Motor, Spring, StrainGauge
from scenarios.actuator.response import (
    frequency_response,
    settling_time,
    step_answer,
    sweep,
    torque_at_rest,
)
from scenarios.actuator.transfer import (
    bandwidth,
    crossing,
    peak,
    textbook_transfer,
    torque_transfer,
)

STEP = 1e-4
"""Of the inner loop [s]."""

AGREEMENT = 0.02
"""Of bandwidths, relative: of the sampling at 10 kHz the closed form has the first order."""

EVERY = pytest.mark.parametrize("name", drive_names())
TORQUE_LOOPS = [name for name in drive_names() if load_drive(name).has_torque_loop]
ELASTIC = [name for name in drive_names() if load_drive(name).spring]

# A drive of this file's own: what is tested does not change with the catalogue.
MOTOR = Motor(
    torque_constant=0.078,
    resistance=0.318,
    inductance=2e-4,
    voltage=48.0,
    peak_current=30.0,
    continuous_current=2.75,
    inertia=3.594e-5,
)
NOISY = replace(MOTOR, current_noise=0.02, current_resolution=0.015)
GEAR = Gear(ratio=100.0, inertia=1.12e-5)  # with the motor: 0.4714 kg m² and 7.8 Nm/A at the joint
FRICTION = Friction(coulomb=7.0, viscous=3.44)
NONE = Friction()
BRISTLES = Friction(coulomb=7.0, static=10.0, stribeck_speed=0.1, viscous=3.44)
MOST = 7.8 * 30.0  # Nm: of the motor, at the joint
LOOP = Loops(current_bandwidth=1000.0, K_p=5.0, K_i=100.0, damping_ratio=0.7, cutoff=1000.0)


def loop_by_loop(drive: JointDrive, frequency: np.ndarray, step: float = 0.0) -> np.ndarray:
    """Return τ/τ_cmd with a locked output: the block diagram, solved at each frequency [Hz]."""
    s = 2j * np.pi * frequency
    loops, b = drive.loops, drive.friction.viscous
    current = 1 / (1 + s / (2 * np.pi * loops.current_bandwidth))
    if drive.rigid:
        return current
    lead = 1 + s * step / 2  # of a filter that has the newest sample; the lag of a difference
    filtered = lead / (1 + s / (2 * np.pi * loops.cutoff)) if loops.cutoff else 1.0
    k, J = drive.stiffness, drive.inertia
    parts = [part for part in (drive.gear, drive.spring) if part]
    twist = sum(part.damping * (k / part.stiffness) ** 2 for part in parts)  # each its share
    admittance = 1 / (J * s**2 + (b + twist) * s + k)  # theta per motor torque
    measured = k + twist * s if drive.strain_gauge else k  # a spring's ends tell of its twist alone
    back = filtered * measured * (loops.K_p + loops.K_i / s + drive.K_d * s / lead)
    back = back - loops.friction_feedforward * b * s
    theta = admittance * current / (1 + admittance * current * back)
    return theta * (1 + loops.K_p + loops.K_i / s) * (k + twist * s)


def geared(friction: Friction = FRICTION, *, motor: Motor = MOTOR, **gear: float) -> JointDrive:
    """Return a geared drive of 16 000 Nm/rad."""
    return JointDrive(
        name="geared",
        source="",
        motor=motor,
        gear=replace(GEAR, **{"stiffness": 16000.0, "damping": 10.0, **gear}),
        friction=friction,
        loops=Loops(current_bandwidth=1000.0),
    )


def elastic(friction: Friction = FRICTION, *, motor: Motor = MOTOR, **loops: float) -> JointDrive:
    """Return a series elastic drive of 6000 Nm/rad whose encoders have no steps."""
    return JointDrive(
        name="elastic",
        source="",
        motor=motor,
        gear=GEAR,
        friction=friction,
        spring=Spring(stiffness=6000.0, hard_stop=0.07),
        loops=replace(LOOP, **loops),
    )


def strain(*, motor: Motor = MOTOR, **gauge: float) -> JointDrive:
    """Return a drive with a strain gauge, 4364 Nm/rad with the gear."""
    return JointDrive(
        name="strain",
        source="",
        motor=motor,
        gear=replace(GEAR, stiffness=16000.0, damping=10.0),
        friction=FRICTION,
        strain_gauge=StrainGauge(stiffness=6000.0, **gauge),
        loops=replace(LOOP, K_p=9.0, K_i=200.0, cutoff=1500.0),
    )


def direct(coulomb: float) -> JointDrive:
    """Return a direct drive with friction."""
    return JointDrive(
        name="direct",
        source="",
        motor=replace(MOTOR, torque_constant=1.0, inertia=5e-3),
        friction=Friction(coulomb=coulomb, static=coulomb),
        loops=Loops(current_bandwidth=500.0),
    )


# --- From commanded to delivered torque ---------------------------------------------------------


def test_the_catalogue_has_every_design() -> None:
    assert {load_drive(name).design for name in drive_names()} == set(DESIGNS)


@EVERY
@pytest.mark.parametrize("step", [0.0, STEP])
def test_the_transfer_function_is_the_block_diagram_solved(name: str, step: float) -> None:
    drive, f = load_drive(name), np.geomspace(0.1, 2000, 60)
    unfiltered = replace(drive, loops=replace(drive.loops, cutoff=0.0))
    for one in (drive, unfiltered):
        found = torque_transfer(one, step)(f)
        assert found == pytest.approx(loop_by_loop(one, f, step), rel=1e-9)


def test_friction_feedforward_is_in_the_transfer_function() -> None:
    plain = geared()
    drive = replace(plain, loops=replace(plain.loops, friction_feedforward=0.9))
    f = np.geomspace(0.1, 2000, 60)
    assert torque_transfer(drive)(f) == pytest.approx(loop_by_loop(drive, f), rel=1e-9)
    near = np.array([20.0, 29.0, 40.0])
    swept = frequency_response(drive, near, step=STEP)
    assert swept.response == pytest.approx(torque_transfer(drive)(swept.frequency), rel=0.02)
    without = torque_transfer(plain)(swept.frequency)
    assert np.abs(swept.response / without - 1).max() > 0.1


@EVERY
def test_the_measured_bandwidth_is_that_of_the_transfer_function(name: str) -> None:
    drive = load_drive(name)
    model = torque_transfer(drive, STEP)
    edge = bandwidth(model.grid(), model(model.grid()))
    assert abs(model(np.array([edge]))[0]) == pytest.approx(1 / math.sqrt(2), rel=1e-5)
    swept = frequency_response(drive, edge * np.linspace(0.94, 1.06, 9), step=STEP)
    assert swept.bandwidth == pytest.approx(edge, rel=AGREEMENT)
    exact = model(swept.frequency)
    assert swept.response == pytest.approx(exact, rel=2.5 * AGREEMENT)  # in phase too


def test_what_remains_of_the_bandwidth_gap_is_the_sampling_of_the_loops() -> None:
    drive, f = direct(0.0), 500.0 * np.linspace(0.94, 1.06, 9)
    gaps = [
        abs(frequency_response(drive, f, step=STEP / m).bandwidth / 500.0 - 1) for m in (1, 2, 4)
    ]
    assert gaps[0] > 0.01
    assert gaps[1] < 0.3 * gaps[0]  # of second order in the step
    assert gaps[2] < 0.3 * gaps[1]


@pytest.mark.parametrize("drive", [strain(), elastic()], ids=lambda d: d.name)
def test_a_torque_loop_comes_near_the_continuous_one_as_its_step_becomes_short(
    drive: JointDrive,
) -> None:
    model = torque_transfer(drive)
    edge = bandwidth(model.grid(), model(model.grid()))
    gaps, left = [], []
    for step in (STEP, STEP / 2):
        f = edge * np.linspace(0.96, 1.04, 7)
        found = frequency_response(drive, f, step=step).bandwidth
        sampled = torque_transfer(drive, step)
        gaps.append(found / edge - 1)
        left.append(found / bandwidth(sampled.grid(), sampled(sampled.grid())) - 1)
    assert abs(gaps[0]) > 0.004
    assert gaps[1] / gaps[0] == pytest.approx(0.5, abs=0.1)  # of first order in the step
    assert abs(left[0]) < 0.5 * abs(gaps[0])


@pytest.mark.parametrize("drive", [geared(), strain(), elastic()], ids=lambda d: d.name)
def test_the_sweep_finds_the_peak_of_the_transfer_function(drive: JointDrive) -> None:
    model, swept = torque_transfer(drive), sweep(drive, step=STEP)
    at, height = peak(model.grid(), model(model.grid()))
    assert height > 1.02
    assert swept.peak[1] == pytest.approx(height, rel=0.01)
    if height > 2:  # a flat top is anywhere
        assert swept.peak[0] == pytest.approx(at, rel=0.01)


@pytest.mark.parametrize(("K_p", "hertz"), [(0.0, 17.96), (5.0, 43.98)])
def test_a_series_elastic_joint_resonates_where_the_textbook_says(K_p: float, hertz: float) -> None:
    """At the resonance the torque lags by 90 degrees, whatever the damping.

    The loops lag too: that moves it by 0.03 % at K_p = 0, by 0.15 % at K_p = 5.
    """
    plain = {"K_i": 0.0, "cutoff": 0.0, "damping_ratio": 0.1}
    drive = elastic(NONE, K_p=K_p, **plain)
    swept = frequency_response(drive, hertz * np.linspace(0.9, 1.1, 9), step=STEP)
    assert crossing(swept.frequency, swept.response, -90.0) == pytest.approx(hertz, rel=0.01)
    second_order = textbook_transfer(drive)
    assert abs(second_order(np.array([hertz]))[0]) == pytest.approx(5.0, rel=1e-3)  # 1 / (2 ζ)
    stiffer = elastic(NONE, K_p=1.05 * K_p + 0.05, **plain)
    swept = frequency_response(stiffer, hertz * np.linspace(0.9, 1.1, 9), step=STEP)
    assert crossing(swept.frequency, swept.response, -90.0) != pytest.approx(hertz, rel=0.01)


@pytest.mark.parametrize("drive", [geared(), strain(), elastic()], ids=lambda d: d.name)
def test_a_step_of_the_transfer_function_is_the_step_of_the_linear_drive(drive: JointDrive) -> None:
    height = 0.02 * drive.peak_torque
    record = run_bench([linear_part(drive)], constant(height, 6000), step=STEP / 2)
    model = height * torque_transfer(drive).step(record.time)
    assert np.abs(record.tau[:, 0] - model).max() < 0.02 * height
    assert model.max() > 1.05 * height


@EVERY
def test_a_step_with_all_imperfections_ends_within_the_friction_that_the_loop_leaves(
    name: str,
) -> None:
    drive = load_drive(name)
    answer = step_answer(drive, step=STEP)
    assert answer.height == pytest.approx(0.25 * drive.peak_torque)
    assert np.abs(answer.tau[answer.time < -STEP / 2]).max() < 0.01 * answer.height
    losses = (1 / drive.gear.efficiency - 1) * answer.tau.max()
    friction = max(drive.friction.coulomb, drive.friction.static) + losses
    left = 0.0 if drive.loops.K_i else friction / (1 + drive.loops.K_p)
    assert abs(answer.final_error) <= left + 0.01 * answer.height
    if left < 0.05 * answer.height:
        assert 0 < answer.rise_time < answer.time[-1]


# --- Steady states ------------------------------------------------------------------------------


@EVERY
def test_a_linear_drive_holds_the_command_and_twists_by_torque_over_stiffness(name: str) -> None:
    torque, deflection = steady_gaps(load_drive(name), step=STEP)
    assert torque < 1e-6
    assert deflection < 1e-6


def test_the_deflection_of_a_spring_is_torque_over_stiffness() -> None:
    drive = elastic(NONE)
    record = run_bench([drive] * 2, constant(np.array([120.0, -60.0]), 16_000, 2), step=STEP)
    assert record.theta[-1] == pytest.approx(np.array([0.02, -0.01]), rel=1e-6)  # 6000 Nm/rad
    assert record.tau[-1] == pytest.approx(np.array([120.0, -60.0]), rel=1e-6)


@EVERY
def test_torque_that_a_controller_may_ask_for_arrives_at_every_speed(name: str) -> None:
    drive = load_drive(name)
    found = torque_at_speed(drive, step=STEP)
    assert (found.limit > 0).all()
    assert found.gap < 0.01
    if drive.loops.K_i:
        assert found.tau == pytest.approx(found.limit, abs=0.01 * found.limit.max())


def test_torque_beyond_the_voltage_line_does_not_arrive() -> None:
    speed = np.array([5.5])
    assert torque_limit(strain(), speed)[0] < 0
    record = run_bench([strain()], constant(150.0, 6000), step=STEP, link=Link(v=speed))
    by_voltage = 7.8 * (48 - 7.8 * 5.5) / 0.318  # Nm: torque constant, 48 V, 0.318 Ω
    assert record.tau[-1, 0] == pytest.approx(by_voltage - 7.0 - 3.44 * 5.5, rel=1e-3)
    assert record.voltage[-1, 0] == 48.0


@EVERY
def test_the_no_load_speed_is_voltage_over_torque_constant(name: str) -> None:
    assert no_load_gap(load_drive(name), step=STEP) < 0.01


@pytest.mark.parametrize("drive", [direct(0.0), geared(NONE)], ids=lambda d: d.name)
def test_a_free_joint_runs_up_to_its_no_load_speed_and_no_further(drive: JointDrive) -> None:
    link = Link(inertia=drive.inertia)
    record = run_bench([drive], constant(5 * drive.peak_torque, 10_000), step=STEP, link=link)
    no_load = 48.0 / (drive.gear.ratio * drive.motor.torque_constant)
    assert record.v[-1000:, 0].mean() == pytest.approx(no_load, rel=0.01)
    assert record.v[20, 0] < 0.5 * no_load
    assert record.omega.max() < 1.1 * no_load


# --- Friction, losses and play ------------------------------------------------------------------


@pytest.mark.parametrize("static", [7.0, 9.0])
@pytest.mark.parametrize("inertia", [math.inf, 1.0])
def test_below_break_away_nothing_creeps(static: float, inertia: float) -> None:
    drive = geared(Friction(coulomb=7.0, static=static, viscous=3.44))
    asked = static * np.array([0.5, 0.99, -0.99, 1.01])
    link = Link(inertia=inertia)
    record = run_bench([drive] * 4, constant(asked, 100_000, 4), step=STEP, link=link)
    assert record.time[-1] == pytest.approx(10.0, abs=0.01)
    assert (record.theta[:, :3] == 0.0).all()
    assert (record.q[:, :3] == 0.0).all()
    assert abs(record.theta[-1, 3]) > 1e-6  # it breaks away where it should


def test_a_direct_drive_sticks_too_whatever_pulls_at_it() -> None:
    """It is held by bristles, which bend by microradians and then stay as they are."""
    drive, push = direct(2.0), np.array([1.8, -1.8, 0.0, 1.2, 1.0])
    asked = np.array([0.0, 0.0, -1.8, 0.6, 1.5])  # the last slides
    link = Link(inertia=0.01, tau_ext=push)
    record = run_bench([drive] * 5, constant(asked, 100_000, 5), step=STEP, link=link)
    assert np.abs(record.q[-1, :4]).max() < 1e-4
    assert record.q[-1, :4] == pytest.approx(record.q[10_000, :4], abs=1e-12)
    sliding = (2.5 - 2.0) / (0.01 + 5e-3)  # rad/s²
    assert record.v[1_000, 4] == pytest.approx(sliding * 0.1, rel=0.02)


def test_a_joint_that_is_pushed_from_outside_sticks_too() -> None:
    """The push rises for 1 s, then stays for 9 s: the gear twists, the motor does not turn."""
    drive = geared(Friction(coulomb=7.0))
    push = np.minimum(np.arange(100_000) / 10_000, 1.0)[:, None] * np.array([6.5, -6.5, 7.5])
    link = Link(inertia=1.0, tau_ext=push)
    record = run_bench([drive] * 3, constant(0.0, 100_000, 3), step=STEP, link=link)
    assert (record.theta[:, :2] == 0.0).all()
    assert record.q[-1, :2] == pytest.approx(np.array([1, -1]) * 6.5 / 16000, rel=1e-2)
    assert record.theta[-1, 2] > 0.1


def test_noise_does_not_unstick_the_motor() -> None:
    record = run_bench([geared(motor=NOISY)], constant(0.9 * 7.0, 20_000), step=STEP, seed=3)
    assert record.tau_meas.std() > 0.01
    assert (record.theta == 0.0).all()


def test_sliding_costs_coulomb_and_viscous_friction() -> None:
    v = np.array([0.1, 0.5, 2.0, -0.5])
    record = run_bench([geared()] * 4, constant(50.0, 9000, 4), step=STEP, link=Link(v=v))
    lost = 50.0 - record.tau[-100:].mean(axis=0)
    assert lost == pytest.approx(7.0 * np.sign(v) + 3.44 * v, rel=1e-3)


@pytest.mark.parametrize("tau_cmd", [50.0, -50.0])
def test_losses_of_the_gear_help_who_brakes_and_cost_who_drives(tau_cmd: float) -> None:
    """Driving, η of the motor's torque arrives; driven, it holds 1 / (2 − 1/η) of it."""
    drive, v = geared(NONE, efficiency=0.8, damping=60.0), np.array([1.0, -1.0])
    record = run_bench([drive] * 2, constant(tau_cmd, 9000, 2), step=STEP, link=Link(v=v))
    arrives, driving = record.tau[-100:].mean(axis=0) / tau_cmd, v * tau_cmd > 0
    assert arrives[driving] == pytest.approx(0.8, rel=1e-3)
    assert arrives[~driving] == pytest.approx(1 / (2 - 1 / 0.8), rel=1e-3)


def test_the_motor_crosses_the_backlash_where_torque_changes_sign() -> None:
    drive = geared(Friction(viscous=3.44), backlash=0.01)
    tau_cmd = constant(20.0, 40_000)
    tau_cmd[20_000:] = -20.0
    record = run_bench([drive], tau_cmd, step=STEP)
    assert record.tau[19_999, 0] == pytest.approx(20.0, rel=1e-6)
    assert record.tau[-1, 0] == pytest.approx(-20.0, rel=1e-6)
    crossed = record.theta[19_999, 0] - record.theta[-1, 0]
    assert crossed - 2 * 20.0 / 16000 == pytest.approx(0.01, rel=1e-6)
    inside = np.abs(record.theta[:, 0]) < 0.005
    assert inside.sum() > 10
    assert (record.tau[inside, 0] == 0.0).all()


def test_before_it_slides_a_bristle_is_a_spring_of_its_own() -> None:
    """On the way to g(0) the motor turns by (g / σ_0) log(1 / (1 − F / g)), if it is slow."""
    drive = geared(replace(BRISTLES, bristle_stiffness=1e5, bristle_damping=300.0))
    asked = np.array([0.1, 3.0, -6.0])
    tau_cmd = np.minimum(np.arange(12_000) / 10_000, 1.0)[:, None] * asked
    record = run_bench([drive] * 3, tau_cmd, step=STEP)
    theta, friction = record.theta[-1], asked - record.tau[-1]
    assert friction[0] / theta[0] == pytest.approx(1e5, rel=0.01)
    turned = np.sign(asked) * 10.0 / 1e5 * np.log(1 / (1 - np.abs(friction) / 10.0))
    assert theta == pytest.approx(turned, rel=0.01)
    assert friction[2] / theta[2] < 0.8e5


@pytest.mark.parametrize("stiffness", [0.0, 1e5])
def test_friction_while_sliding_is_g_of_the_speed(stiffness: float) -> None:
    """With a damper on the gear that is stronger than the fall of g: no stick-slip."""
    friction = replace(BRISTLES, bristle_stiffness=stiffness, bristle_damping=3e-3 * stiffness)
    v = np.array([0.02, 0.05, 0.1, 0.5, -0.1])
    drive, link = geared(friction, damping=200.0), Link(v=v)
    record = run_bench([drive] * 5, constant(50.0, 20_000, 5), step=STEP, link=link)
    lost = 50.0 - record.tau[-1000:].mean(axis=0)
    g = 7.0 + 3.0 * np.exp(-((v / 0.1) ** 2))
    assert lost == pytest.approx(g * np.sign(v) + 3.44 * v, rel=2e-3)
    assert record.tau[-1000:].std(axis=0).max() < 1e-3


# --- Torque loops -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TORQUE_LOOPS)
def test_torque_feedback_divides_the_inertia_that_is_felt_from_outside(name: str) -> None:
    """The link is moved to and fro slowly; torque against acceleration is J / (1 + K_p)."""
    drive = linear_part(load_drive(name))
    drive = replace(
        drive,
        friction=replace(drive.friction, viscous=0.0),
        loops=replace(drive.loops, K_i=0.0),
    )
    J = drive.gear.ratio**2 * (drive.motor.inertia + drive.gear.inertia)
    natural = math.sqrt(drive.stiffness * (1 + drive.loops.K_p) / J) / (2 * math.pi)
    period = round(30 / natural / STEP)  # steps
    phase = 2 * np.pi * np.arange(3 * period) / period
    v = 0.1 * np.cos(phase)[:, None]
    record = run_bench([drive], constant(0.0, len(phase)), step=STEP, link=Link(v=v))
    last = slice(2 * period, None)
    turn = np.exp(-1j * phase[last])
    acceleration = 2j * np.pi / (period * STEP) * (record.v[last, 0] @ turn)
    felt = -(record.tau[last, 0] @ turn) / acceleration
    assert felt.real == pytest.approx(J / (1 + drive.loops.K_p), rel=0.01)


def test_a_joint_pushed_from_outside_answers_with_link_and_apparent_inertia() -> None:
    drive, period = elastic(NONE, K_i=0.0), 10_000
    push = 10.0 * np.sin(2 * np.pi * np.arange(3 * period) / period)[:, None]
    link = Link(inertia=0.5, tau_ext=push)
    record = run_bench([drive], constant(0.0, len(push)), step=STEP, link=link)
    swing = np.ptp(record.v[period:, 0]) / 2 * 2 * np.pi / (period * STEP)
    assert 10.0 / swing - 0.5 == pytest.approx(0.4714 / 6, rel=0.02)


@pytest.mark.parametrize("K_i", [0.0, 100.0])
def test_what_the_torque_loop_leaves_of_friction_is_divided_by_one_plus_k_p(K_i: float) -> None:
    link = Link(v=np.array([2.0]))
    record = run_bench([elastic(K_i=K_i)], constant(50.0, 9_000), step=STEP, link=link)
    lost = 50.0 - record.tau[-500:, 0].mean()
    friction = 7.0 + 3.44 * 2.0
    assert lost == pytest.approx(friction / 6 if K_i == 0 else 0.0, abs=0.02)


@pytest.mark.parametrize("drive", [strain(), elastic()], ids=lambda d: d.name)
def test_a_long_saturation_leaves_no_integral_behind(drive: JointDrive) -> None:
    """Twice the motor's torque for 1 s, then half of the peak.

    The integral of that second, were it not frozen, would hold the motor at its limit for
    seconds. What swings below the new command is the spring: braking meets the limit too.
    """
    tau_cmd = constant(2 * MOST, 14_000)
    tau_cmd[10_000:] = 0.5 * drive.peak_torque
    tau = run_bench([drive], tau_cmd, step=STEP).tau[:, 0]
    assert tau[9_000:10_000] == pytest.approx(MOST, abs=8.0)  # it stands, held by friction
    fall = tau[9_999] - tau_cmd[-1, 0]
    released = (tau[10_000:] - tau_cmd[-1, 0]) / fall
    assert -0.4 < released.min() < -0.05
    assert np.abs(released[500:]).max() < 0.06  # after 50 ms
    assert np.abs(released[3_000:]).max() < 0.01


@pytest.mark.parametrize("drive", [strain(), elastic()], ids=lambda d: d.name)
def test_the_answer_to_a_long_saturation_is_that_to_a_short_one(drive: JointDrive) -> None:
    after = []
    for saturated in (3_000, 30_000):
        tau_cmd = constant(2 * MOST, saturated + 3_000)
        tau_cmd[saturated:] = 0.5 * drive.peak_torque
        after.append(run_bench([drive], tau_cmd, step=STEP).tau[saturated:, 0])
    assert after[0] == pytest.approx(after[1], abs=1e-3 * MOST)
    assert np.ptp(after[0]) > 0.3 * MOST


# --- Limits -------------------------------------------------------------------------------------


@EVERY
def test_current_and_voltage_stay_within_their_limits(name: str) -> None:
    """Noise of the reading and its steps let the true current pass by less than 1 %."""
    drive = load_drive(name)
    current, voltage = electric_shares(drive, step=STEP)
    assert 0.85 < current < 1.01
    assert 0.3 < voltage <= 1.0
    clean, _ = electric_shares(linear_part(drive), step=STEP)
    assert clean < 1.005  # while back-EMF rises


@pytest.mark.parametrize("name", ELASTIC)
@pytest.mark.parametrize("step", [STEP, STEP / 2])
def test_the_spring_never_passes_its_stop(name: str, step: float) -> None:
    assert 0.0 < stop_excess(load_drive(name), step=step) < 1e-3


@pytest.mark.parametrize("inertia", [0.01, 0.1, 1.0])
def test_a_link_thrown_against_the_stop_passes_it_by_less_than_it_moves_in_a_step(
    inertia: float,
) -> None:
    """From outside, by the torque of the spring at its stop, against the motor at full torque."""
    drive = elastic(motor=NOISY)
    link = Link(inertia=inertia, tau_ext=-6000 * 0.07)
    speed = drive.no_load_speed
    record = run_bench([drive], constant(2 * MOST, 2_000), step=STEP, link=link, omega=speed)
    twist = (record.theta - record.q)[:, 0]
    arrives = int(np.argmax(twist > 0.069))
    fastest = np.abs(record.omega - record.v)[: arrives + 5, 0].max()
    assert twist.max() > 0.07
    assert twist.max() - 0.07 < 0.8 * STEP * fastest
    assert twist[-200:].max() < 0.0705


def test_a_spring_within_its_stops_knows_nothing_of_them() -> None:
    drive = elastic(NONE)
    assert drive.spring is not None
    endless = replace(drive, spring=replace(drive.spring, hard_stop=math.inf))
    runs = [run_bench([one], constant(150.0, 3_000), step=STEP).tau for one in (drive, endless)]
    assert runs[0] == pytest.approx(runs[1], rel=1e-12)
    assert runs[0].max() > 150.0


# --- Torque at rest -----------------------------------------------------------------------------


def test_the_reading_of_a_spring_has_the_steps_of_its_encoders() -> None:
    drive = elastic(cutoff=0.0)
    assert drive.spring is not None
    drive = replace(drive, spring=replace(drive.spring, counts=524288))
    tau_cmd = np.linspace(0, 40, 20_000)[:, None]
    reading = run_bench([drive], tau_cmd, step=STEP).tau_meas[:, 0]
    steps = np.diff(np.unique(np.round(reading, 9)))
    assert steps.min() == pytest.approx(6000 * 2 * np.pi / 524288, rel=1e-6)


def test_torque_at_rest_is_read_with_the_noise_that_the_filter_leaves() -> None:
    """A first-order filter with the share α of each new sample leaves √(α / (2 − α)) of it."""
    rest = torque_at_rest(strain(noise=0.01), step=STEP)
    share = 1 - math.exp(-2 * math.pi * 1500 * STEP)
    assert rest.reading_spread == pytest.approx(0.01 * math.sqrt(share / (2 - share)), rel=0.1)
    assert rest.tau_cmd == pytest.approx(0.5 * (7.8 * 2.75 - 7.0))
    assert abs(rest.error) < 0.1
    assert torque_at_rest(strain(), step=STEP).reading_spread < 0.2 * rest.reading_spread


def test_a_bias_of_the_gauge_is_a_bias_of_the_torque() -> None:
    drive = strain(bias=0.5)
    assert torque_at_rest(drive, step=STEP).error == pytest.approx(0.5, abs=0.05)
    record = run_bench([drive], constant(20.0, 9_000), step=STEP, link=Link(v=np.array([1.0])))
    assert record.tau[-1, 0] == pytest.approx(19.5, abs=0.01)
    assert steady_torque(drive, np.array([20.0]), np.array([1.0]))[0] == pytest.approx(19.5)


# --- The bench itself ---------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_noise_and_another_one_does_not() -> None:
    tau_cmd = constant(20.0, 500)
    first, again, other = (
        run_bench([strain(noise=0.01)], tau_cmd, step=STEP, seed=seed).tau_meas
        for seed in (1, 1, 2)
    )
    assert (first == again).all()
    assert (first != other).any()


def test_drives_side_by_side_do_not_know_of_each_other() -> None:
    drives = [direct(1.0), strain(), elastic()]
    together = run_bench(drives, constant(5.0, 800, 3), step=STEP).tau
    for j, drive in enumerate(drives):
        alone = run_bench([drive], constant(5.0, 800), step=STEP).tau
        assert together[:, j] == pytest.approx(alone[:, 0], rel=1e-12, abs=1e-12)


def test_settling_is_waited_for_as_long_as_the_slowest_pole_asks() -> None:
    slowest = torque_transfer(elastic(K_p=20.0)).decay_rate
    assert slowest == pytest.approx(100 / 21, rel=0.1)  # K_i / (1 + K_p)
    assert settling_time(elastic(K_p=20.0)) == pytest.approx(9.0 / slowest)
