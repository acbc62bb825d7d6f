"""Every drive of the catalogue: where its numbers come from, what they are, that its loops hold."""

import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from qpctrl import InputError
from qpctrl.evaluator import Evaluator
from scenarios.actuator.catalogue import (
    default_drives,
    drive_names,
    drive_text,
    load_drive,
    read_drive,
)
from scenarios.actuator.drive import DESIGNS, JointDrive
from scenarios.actuator.inner import NOISES, build_inner_tick, check_rate, initial_state

DRIVES = tuple(load_drive(name) for name in drive_names())
REFERENCES = Path(__file__).parents[1] / "docs" / "references.md"

STEP = 1e-4  # s
TIME = 0.6  # s
TORQUE = 10.0  # Nm: of the step
LINK = 0.1  # kg m²: free
LATE = slice(-2000, None)  # steps: what counts as settled
NOISE = 4.0
"""Standard deviations that a reading may be off; 1 in 16 000 is more, and the seed is fixed."""

RPM = 2 * np.pi / 60  # rad/s


class Bench:
    """Drives side by side, each on a joint of its own, with all their noise."""

    def __init__(self, drives: list[JointDrive], mobility: float) -> None:
        tick = build_inner_tick(drives, STEP, mobility)
        n = len(drives)
        self._evaluate = Evaluator(tick.function)
        self._evaluate.inputs["p"][:] = tick.numbers.vector()
        self._rng = np.random.default_rng(1)
        self._noises = n * len(NOISES)
        self.state = tick.states.views(self._evaluate.inputs["x"])
        for name, value in initial_state(drives, np.zeros(n), np.zeros(n)).items():
            self.state[name][:] = value

    def step(self, tau_cmd: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the torques on the joints (n) [Nm]."""
        inputs, out = self._evaluate.inputs, self._evaluate.outputs
        inputs["tau_cmd"][:], inputs["q"][:], inputs["v"][:] = tau_cmd, q, v
        inputs["noise"][:] = self._rng.normal(size=self._noises)
        self.state["delivered"][:] = 0.0
        self._evaluate()
        inputs["x"][:] = out["x_next"]
        return out["tau"].copy()


# Sources ------------------------------------------------------------------------------------


def keys() -> set[str]:
    return set(re.findall(r"^\| (\w+) \|", REFERENCES.read_text(encoding="utf-8"), re.MULTILINE))


@pytest.mark.parametrize("drive", DRIVES, ids=drive_names())
def test_a_source_starts_with_a_key_of_the_references(drive):
    key, rest = drive.source.split(":", 1)
    assert key in keys()
    assert len(rest) > 10
    assert set(re.findall(r"\((\w+)\)", rest)) <= keys()


# Numbers ------------------------------------------------------------------------------------

AS_PUBLISHED: dict[str, tuple[float | None, float]] = {
    # peak torque of the motor's shaft [Nm], where it is given; no-load speed of that shaft [rad/s]
    "ilm115-direct": (12.7, 1400 * RPM),
    "tmb0210-direct": (127.5, 983 * RPM),
    "harmonic-geared": (4.0, 2100 * RPM),
    "planetary-geared": (4.0, 2100 * RPM),
    "lbr-strain": (9.4, 1560 * RPM),
    "r2-elastic": (4.0, 2100 * RPM * 0.147 / 0.159),
    "avocado-geared": (None, 100 * 11.7169),
    "orange-geared": (None, 100 * 6.1827),
}
CONVENTION = 0.06
"""Data sheets round; a wrong convention of three phases is off by √2, √3 or 2."""


@pytest.mark.parametrize("name", AS_PUBLISHED)
def test_torque_and_speed_of_a_motor_are_those_of_its_data_sheet(name):
    motor, (torque, speed) = load_drive(name).motor, AS_PUBLISHED[name]
    if torque is not None:
        assert motor.torque_constant * motor.peak_current == pytest.approx(torque, rel=CONVENTION)
    assert motor.voltage / motor.torque_constant == pytest.approx(speed, rel=CONVENTION)
    assert motor.continuous_current < motor.peak_current


PUBLISHED = {  # reflected inertia [kg m²], stiffness from motor to joint [Nm/rad]
    "avocado-strain": (0.0941 + 0.0540, 1 / (1 / 8400 + 1 / 21000)),
    "orange-strain": (0.3594 + 0.1120, 1 / (1 / 16000 + 1 / 6000)),
    "orange-elastic": (0.3594 + 0.1120, 6000),
    "ce-big-strain": (100**2 * (3.04e-5 + 1.33 * 6.6944e-5), 31000 / 2),
    "walkman-elastic": (100**2 * (5.48e-5 + 2.63e-5), 1 / (1 / 31000 + 1 / 2300)),
    "lbr-strain": (4.155, 6900),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_inertia_and_stiffness_at_the_joint_are_as_published(name):
    drive, (inertia, stiffness) = load_drive(name), PUBLISHED[name]
    assert drive.inertia == pytest.approx(inertia, rel=1e-3)
    assert drive.stiffness == pytest.approx(stiffness, rel=1e-3)


def test_the_highest_torque_of_robonaut_meets_the_stop_of_its_spring():
    drive = load_drive("r2-elastic")
    assert drive.spring is not None
    assert drive.gear.peak_torque == 100.0
    assert drive.spring.stiffness * drive.spring.hard_stop == pytest.approx(100.0, rel=2e-3)


@pytest.mark.parametrize(("rpm", "efficiency"), [(500, 0.78), (1000, 0.73), (2000, 0.67)])
def test_the_harmonic_drive_loses_at_rated_torque_what_its_catalogue_says(rpm, efficiency):
    drive, rated = load_drive("harmonic-geared"), 87.0
    speed = rpm * RPM / drive.gear.ratio
    joint = Bench([drive], 0.0)
    joint.state["theta"][:], joint.state["omega"][:] = rated / drive.stiffness, speed
    asked = rated / drive.gear.efficiency + drive.friction.coulomb + drive.friction.viscous * speed
    tau, motor = [], []
    for i in range(6000):
        tau.append(joint.step(asked, np.array([speed * STEP * i]), np.array([speed]))[0])
        motor.append(drive.torque_constant * joint.state["current"][0])
    assert np.mean(tau[LATE]) == pytest.approx(rated, rel=0.01)  # what the friction's model says
    assert np.mean(tau[LATE]) / np.mean(motor[LATE]) == pytest.approx(efficiency, abs=0.025)


# Loops --------------------------------------------------------------------------------------


class Response(NamedTuple):
    """After a step of torque, of every drive (N×n)."""

    tau: np.ndarray  # Nm: on the joint
    delivered: np.ndarray  # Nm: as for who takes the apparent inertia for the joint's
    speed: np.ndarray  # rad/s: of the link


@pytest.fixture(scope="module", params=["locked", "free"])
def response(request) -> Response:
    """Return what a step of torque does to a locked output, or to a link that bears as much."""
    mobility = 0.0 if request.param == "locked" else 1 / LINK
    bench = Bench(list(DRIVES), mobility)
    rotor = np.array([drive.inertia if drive.rigid else 0.0 for drive in DRIVES])
    q = v = np.zeros(len(DRIVES))
    rows = []
    for _ in range(round(TIME / STEP)):
        tau = bench.step(TORQUE, q, v)
        v = v + STEP * (tau - TORQUE) * mobility / (1 + rotor * mobility)
        q = q + STEP * v
        rows.append((tau, bench.state["delivered"].copy(), v))
    return Response(*np.array(rows).transpose(1, 0, 2))


def friction_left(drive: JointDrive) -> float:
    """Return how much torque [Nm] friction and the teeth's losses may withhold or add at rest."""
    losses = (1 / drive.gear.efficiency - 1) * TORQUE
    friction = max(drive.friction.coulomb, drive.friction.static) + losses
    return friction / (1 + drive.loops.K_p)


def reading_error(drive: JointDrive) -> float:
    """Return how far [Nm] the readings that the loops follow may be off."""
    motor, gauge, spring = drive.motor, drive.strain_gauge, drive.spring
    if gauge:
        return gauge.resolution / 2 + NOISE * gauge.noise
    if spring and spring.counts:
        return 2 * np.pi / spring.counts * spring.stiffness  # half a count of each encoder
    return drive.torque_constant * (motor.current_resolution / 2 + NOISE * motor.current_noise)


@pytest.mark.parametrize("drive", DRIVES, ids=drive_names())
def test_a_drive_can_run_at_10_khz_with_locked_and_with_free_output(drive):
    check_rate([drive], STEP, [0.0])
    check_rate([drive], STEP, [1 / LINK])


@pytest.mark.parametrize("j", range(len(DRIVES)), ids=drive_names())
def test_torque_settles_within_the_friction_that_the_design_leaves(response, j):
    allowed = friction_left(DRIVES[j]) + reading_error(DRIVES[j])
    late = response.tau[LATE, j]
    assert abs(late.mean() - TORQUE) < allowed
    assert np.abs(late - TORQUE).max() < allowed
    assert abs(response.delivered[LATE, j].mean() - TORQUE) < allowed


@pytest.mark.parametrize("j", range(len(DRIVES)), ids=drive_names())
def test_nothing_grows_after_the_step(response, j):
    quarters = np.ptp(response.tau[:, j].reshape(4, -1), axis=1)
    assert quarters[0] > 1.0  # Nm: the step itself
    assert quarters[3] < max(0.8 * quarters[1], 2 * reading_error(DRIVES[j]))
    left = friction_left(DRIVES[j]) + reading_error(DRIVES[j])  # Nm, may push the link all along
    assert abs(response.speed[-1, j]) < left * TIME / LINK


def test_each_design_has_drives_in_the_order_of_their_size():
    for design in DESIGNS:
        small, large = default_drives(design, np.array([1.0, 1e6]))
        assert small.design == large.design == design
        assert small.peak_torque < large.peak_torque
    assert {drive.design for drive in DRIVES} == set(DESIGNS)


@pytest.mark.parametrize("drive", DRIVES, ids=drive_names())
def test_a_drive_survives_its_own_file(drive, tmp_path):
    path = tmp_path / f"{drive.name}.toml"
    path.write_text(drive_text(drive), encoding="utf-8")
    assert read_drive(path) == drive


@pytest.mark.parametrize("name", ["K_p", "K_i", "damping_ratio", "cutoff"])
@pytest.mark.parametrize("drive", ["orange-geared", "ilm115-direct"])
def test_a_torque_loop_needs_something_to_measure_by(drive, name):
    given = load_drive(drive)
    with pytest.raises(InputError, match=f"loops: {name} needs a strain gauge or a spring"):
        replace(given, loops=replace(given.loops, **{name: 0.5}))


def test_the_rate_that_would_do_would_do_for_all_drives_and_needs():
    drives = [load_drive("orange-geared"), load_drive("lime-geared")]
    with pytest.raises(InputError, match="too slow") as refused:
        check_rate(drives, 1 / 2000, [2.0, 100.0])
    rate = float(re.search(r"; (\d+) Hz would do", str(refused.value))[1])
    check_rate(drives, 1 / rate, [2.0, 100.0])
    with pytest.raises(InputError):
        check_rate(drives, 1 / (rate - 1000), [2.0, 100.0])
