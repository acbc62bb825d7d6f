"""Haptic interface, pushed arms, stiff and virtual walls: criteria, and exact sampled models."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from runs import ran
from scipy.linalg import expm

from qpctrl import Controller, InputError, Measurement, Mode, Weighted
from scenarios.admittance import Admittance
from scenarios.encoder import EncodedPlant
from scenarios.environment import Grip, Hand, Springs
from scenarios.force_sensor import ForceSensor, SensedPlant
from scenarios.haptic import CUTOFF, DT, Haptic
from scenarios.impedance import Impedance
from scenarios.plant_compliant import CompliantPlant
from scenarios.push import Pushes, displacement, inertia_at_home, linear_answer, pushed
from scenarios.robot_file import load_robot
from scenarios.scenario import Options
from scenarios.simulation import simulate
from scenarios.slider import SPACE, slider
from scenarios.stiff_wall import StiffWall
from scenarios.virtual_wall import COUNTED_CYCLES, FREQUENCY, GRIP, VirtualWall
from tasks import ImpedanceReference, ImpedanceTask

SAMPLED = 2e-5
"""Relative: what the window of the sweep leaves of the start, e^-40, and Runge–Kutta's error."""

RUNS = {
    "haptic": ("haptic",),
    "haptic with a virtual mass": ("haptic", "--virtual-mass", "0.6"),
    "impedance": ("impedance",),
    "impedance with mass": (
        *("impedance", "--mass-term", "--coordinates", "minimal", "--robot", "ur5"),
    ),
    "admittance": ("admittance",),
    "spring with a bias": (
        *("admittance", "--simulated", "spring", "--bias", "2", "0", "-1", "0", "0.1", "0"),
    ),
    "damper": ("admittance", "--simulated", "damper"),
    "stiff wall": ("stiff_wall",),
    "soft wall": ("stiff_wall", "--times-limit", "0.7"),
    "virtual wall": ("virtual_wall",),
}


@pytest.mark.parametrize("name", list(RUNS))
def test_a_run_meets_its_own_criteria(name: str) -> None:
    assert not ran(*RUNS[name]).missed


def sampled_impedance(scenario: Haptic, frequency: np.ndarray) -> np.ndarray:
    """Return F/X of the device under a held torque, exactly: s₊ = Φ s + Γ τ + ∫ Φ b f dt."""
    m, M_v = scenario.mass, scenario.virtual_mass
    A, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([0.0, 1.0 / m])
    Phi = expm(A * DT)
    held = expm(DT * np.block([[A, b[:, None]], [np.zeros((1, 3))]]))[:2, 2]
    follow = 1 - np.exp(-2 * np.pi * CUTOFF * DT)
    found = []
    for f in frequency:
        s, z = 2j * np.pi * f, np.exp(2j * np.pi * f * DT)
        pushed = np.linalg.solve(s * np.eye(2) - A, (np.eye(2) * z - Phi) @ b)
        law = np.array([-scenario.stiffness, -scenario.damping], dtype=complex)
        if M_v is not None:  # V̇ = follow · (v − v/z)/T over (1 − (1 − follow)/z)
            law[1] += (m - M_v) * follow * (1 - 1 / z) / DT / (1 - (1 - follow) / z)
        x = np.linalg.solve(z * np.eye(2) - Phi - np.outer(held, law), pushed)[0]
        found.append(1 / x)
    return np.array(found)


@pytest.mark.parametrize("name", ["haptic", "haptic with a virtual mass"])
def test_the_hand_feels_the_sampled_impedance_exactly(name: str) -> None:
    scenario = Haptic(virtual_mass=0.6 if "mass" in name else None)
    frequency, Z = scenario.sweep(ran(*RUNS[name]).table)
    assert len(frequency) == 15
    assert np.abs(Z / sampled_impedance(scenario, frequency) - 1).max() < SAMPLED


def test_the_held_torque_takes_damping_away() -> None:
    """At resonance Z = j ω b_felt, and b_felt = b − k T / 2."""
    scenario = Haptic()
    f = np.array([np.sqrt(scenario.stiffness / scenario.mass) / (2 * np.pi)])
    felt = sampled_impedance(scenario, f)[0] / (2j * np.pi * f[0])
    loss = scenario.damping - scenario.stiffness * DT / 2
    assert felt.real == pytest.approx(loss, rel=0.01)


def test_an_arm_with_the_mass_term_moves_as_the_virtual_mass_not_as_its_own() -> None:
    scenario = Impedance(mass_term=True, mass=1.5, inertia=0.05)
    table = simulate(replace(scenario.prepare(Options()), horizon=0.2))
    K, B = (np.repeat(pair, 3) for pair in ([800.0, 30.0], [150.0, 5.0]))
    Lambda = inertia_at_home(load_robot("fr3"), "flange")
    time, f = table["time"].to_numpy(), pushed(table)
    virtual, own = (
        linear_answer(time, f, M, np.diag(B), np.diag(K)).x[-1, 0]
        for M in (np.diag([1.5] * 3 + [0.05] * 3), Lambda)
    )
    x = displacement(table, "impedance")[-1, 0]
    assert abs(own - virtual) > 0.2 * virtual
    assert abs(x - virtual) < 0.1 * abs(own - virtual)


def test_a_mass_term_is_unstable_beyond_its_bound() -> None:
    """The filtered difference of twists is stable iff α M_v < 2 m, α of the filter."""
    alpha, robot = 1 - np.exp(-2 * np.pi * 100.0 * DT), slider(1.0)
    for share, calm in ((0.95, True), (1.05, False)):
        task = ImpedanceTask(space=SPACE, K_v=0.0, B_v=1.0, M_v=share * 2 / alpha, cutoff=100.0)
        controller = Controller(robot, [Mode(name="feel", tasks=(Weighted(task),))])
        plant = CompliantPlant(robot, "tool", Hand(lambda t: np.eye(6)[0]))
        state, memory = plant.reset(np.zeros(1)), controller.start("feel", np.zeros(1))
        forces = []
        for _ in range(300):
            command, _, memory = controller.step(
                "feel",
                Measurement(state.time, state.q, state.v),
                {"impedance": ImpedanceReference(X_WD=pin.SE3.Identity())},
                memory,
            )
            state = plant.step(command.tau)
            forces.append(command.tau[0])
        jumps = np.abs(np.diff(forces))
        assert (jumps[-20:].max() < jumps[:20].max()) == calm


def test_the_wall_is_stiff_enough_to_fail_and_a_softer_one_is_not() -> None:
    stiff, soft = ran(*RUNS["stiff wall"]), ran(*RUNS["soft wall"])
    force = stiff.table["wrench.fx"].abs()
    assert force.max() > 20 * force[1]  # measured: it does run away
    assert stiff.metrics["growth_per_s"] > 1.0
    assert soft.metrics["growth_per_s"] < -1.0


def test_the_energy_of_a_run_does_not_mind_a_late_sensor() -> None:
    """A spring can give back no more than it holds at the start."""
    stored = 0.5 * 1.5 * ran(*RUNS["stiff wall"]).metrics["stiffness_limit_N_per_m"] * 1e-4**2
    assert ran(*RUNS["soft wall"]).metrics["energy_to_environment_J"] > -1.05 * stored


def test_friction_below_the_limit_lets_the_wall_give_energy() -> None:
    wall = VirtualWall()
    gained = {share: wall.energy_to_hand(share * wall.limit) for share in (0.8, 1.2)}
    assert gained[0.8] > 0 > gained[1.2]
    # ∮ x_k dx = −½ Σ Δx², so N cycles give (K T / 2 − b) · 2 (π f A)² N / f
    omega, friction = 2 * np.pi * FREQUENCY, 0.8 * wall.limit
    grip = GRIP[0] + 1j * omega * GRIP[1]
    device = wall.stiffness - wall.mass * omega**2 + 1j * omega * (friction - wall.limit)
    A = wall.amplitude * abs(grip / (grip + device))
    expected = (wall.limit - friction) * (omega * A) ** 2 / 2 * COUNTED_CYCLES / FREQUENCY
    assert gained[0.8] == pytest.approx(expected, rel=0.05)


def test_a_linear_answer_to_a_step_is_the_textbook_one() -> None:
    time = np.arange(2000) * 1e-3
    M, B, K = np.diag([2.0, 1.0]), np.diag([4.0, 12.0]), np.diag([50.0, 9.0])
    x = linear_answer(time, np.tile([5.0, 3.0], (2000, 1)), M, B, K).x
    decay, rate = 1.0, np.sqrt(24.0)
    swing = np.cos(rate * time) + decay / rate * np.sin(rate * time)
    assert x[:, 0] == pytest.approx(0.1 * (1 - np.exp(-decay * time) * swing), abs=1e-9)
    assert x[-1, 1] == pytest.approx(3.0 / 9.0, abs=0.1)


def test_pushes_follow_each_other_and_reach_their_height() -> None:
    plan = Pushes(force=7.0, moment=0.5, hold=1.0, rest=1.0)
    assert plan.duration == 12.0
    for i, (phase, height) in enumerate(zip(("push x", "twist z"), (7.0, 0.5), strict=True)):
        axis = 5 * i
        assert plan.phase(2.0 * axis + 0.5) == phase
        assert plan.wrench(2.0 * axis + 0.5)[axis] == pytest.approx(height)
        assert plan.phase(2.0 * axis + 1.5) == "rest"
        assert not plan.wrench(2.0 * axis + 1.5).any()


def still(environment, **options) -> CompliantPlant:
    """Return a slider of 2 kg in an environment."""
    return CompliantPlant(slider(2.0), "tool", environment, **options)


def test_a_pushed_mass_accelerates_and_its_friction_holds_it_back() -> None:
    push = np.array([3.0, 0, 0, 0, 0, 0])
    free, held = still(Hand(lambda t: push)), still(Hand(lambda t: push), joint_damping=4.0)
    for plant in (free, held):
        plant.reset(np.zeros(1))
    for _ in range(500):
        fast, slow = free.step(np.zeros(1)), held.step(np.zeros(1))
    assert fast.q[0] == pytest.approx(3.0 / 2.0 * 0.5**2 / 2, rel=1e-12)
    assert slow.v[0] == pytest.approx(3.0 / 4.0 * (1 - np.exp(-2.0 * 0.5)), rel=1e-9)
    assert fast.wrench[0] == -3.0  # robot on hand
    assert free.energy == pytest.approx(-3.0 * fast.q[0], rel=1e-9)


def test_a_grip_pulls_towards_the_hand() -> None:
    plant = still(Grip(lambda t: (0.01, 0.0), stiffness=200.0, damping=30.0))
    plant.reset(np.array([0.3]))  # positions are measured from there
    for _ in range(3000):
        state = plant.step(np.zeros(1))
    assert state.q[0] == pytest.approx(0.31, abs=1e-6)


def test_a_sensor_adds_bias_noise_and_delay_and_keeps_the_truth() -> None:
    bias = np.array([1.0, -2.0, 0.5, 0.1, 0.0, -0.1])
    force = lambda t: np.array([1000.0 * t, 0, 0, 0, 0, 0])  # noqa: E731
    plant = SensedPlant(still(Hand(force)), ForceSensor(bias=bias, delay=3))
    plant.reset(np.zeros(1))
    states = [plant.step(np.zeros(1)) for _ in range(10)]
    assert states[-1].wrench[0] == pytest.approx(-9.0)
    assert states[-1].wrench_meas == pytest.approx(np.r_[-6.0, 0, 0, 0, 0, 0] + bias)
    noisy = SensedPlant(still(Hand(force)), ForceSensor(noise=0.5), seed=4)
    readings = []
    for _ in range(2):  # a reset starts the same noise again
        noisy.reset(np.zeros(1))
        found = [noisy.step(np.zeros(1)) for _ in range(2000)]
        readings.append(np.array([s.wrench_meas - s.wrench for s in found]))
    assert np.array_equal(*readings)
    assert readings[0].std(axis=0) == pytest.approx([0.5] * 3 + [0.05] * 3, rel=0.1)


def test_an_encoder_counts_and_its_velocity_is_a_difference() -> None:
    plant = EncodedPlant(still(Hand(lambda t: np.eye(6)[0])), 1e-4, 1e-3)
    plant.reset(np.zeros(1))
    states = [plant.step(np.zeros(1)) for _ in range(200)]
    counts = np.array([state.q[0] for state in states]) / 1e-4
    assert counts == pytest.approx(np.round(counts), abs=1e-9)
    assert abs(states[-1].q[0] - plant.truth.q[0]) <= 0.5e-4
    assert states[-1].v[0] == pytest.approx((states[-1].q[0] - states[-2].q[0]) / 1e-3)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: Haptic(virtual_mass=2.5), "virtual_mass: got 2.5, need less than 2.3"),
        (lambda: Haptic(virtual_mass=-1.0), "virtual_mass"),
        (lambda: Haptic(low=5.0, high=2.0), "low < high"),
        (lambda: Haptic(high=300.0), "high"),
        (lambda: Impedance(stiffness=-1.0), "stiffness"),
        (lambda: Impedance(mass_term=True, mass=100.0).prepare(Options()), "one tick"),
        (lambda: VirtualWall(duration=0.001), "duration: got 0.001"),
        (lambda: Impedance(mass=0.0), "mass: .*> 0"),
        (lambda: Admittance(inertia=-1.0), "inertia"),
        (lambda: Admittance(bias=(1.0, 2.0)), "bias"),
        (lambda: Admittance(noise=-1.0), "force noise"),
        (lambda: Admittance(delay=-1), "force delay: got -1"),
        (lambda: StiffWall(times_limit=0.0), "times_limit"),
        (lambda: StiffWall(virtual_mass=3.0).computed_limit(), "no limit between"),
        (lambda: VirtualWall(resolution=0.0), "resolution"),
        (lambda: VirtualWall(amplitude=1e-4), "50 encoder counts"),
        (lambda: Springs(np.zeros(6), np.zeros(6)), "stiffness"),
        (lambda: Grip(lambda t: (0.0, 0.0), stiffness=0.0, damping=1.0), "grip stiffness"),
        (lambda: still(Hand(lambda t: np.zeros(6)), joint_damping=-1.0), "joint_damping"),
        (lambda: ForceSensor(bias=float("nan")), "force bias"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(build, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        build()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "panels"),
    [
        ("haptic", "Z Y push place"),
        ("impedance", "shift turn force moment"),
        ("admittance", "shift turn force moment"),
        ("stiff wall", "force"),
        ("virtual wall", "force place"),
    ],
)
def test_a_report_has_its_pictures(name: str, panels: str) -> None:
    for panel in (*panels.split(), "torque", "equality", "timing"):
        assert f'id="{panel}"' in ran(*RUNS[name]).page
