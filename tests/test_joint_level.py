"""Drives under a controller: what it believes, what it may ask, and what arrives."""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import polars as pl
import pytest
from polars.testing import assert_frame_equal
from runs import ran

from qpctrl import FaceOnPlane, InputError, Robot, TaskSpace
from qpctrl.compiler import COMPILERS
from qpctrl.robot import from_pinocchio
from scenarios.actuator.catalogue import load_drive
from scenarios.joint_level import CAPSTAN, JointLevel, with_armature
from scenarios.plant import Plant
from scenarios.plant_actuated import Mobility
from scenarios.plant_rigid import RigidPlant
from scenarios.robot_file import load_robot
from scenarios.scenario import Options
from scenarios.slider import slider

DT = 1e-3
DRIVEN = ("direct-drive", "geared", "strain-gauge", "series-elastic")
JOINTS = [f"joint{i}" for i in range(1, 8)]


def level(robot: Robot, actuator: str, **options: object) -> JointLevel:
    """Return the joint level of a robot, interpreted: tests need no compiler."""
    return Options(actuator=actuator, compiled="no", **options).joints(robot, DT)  # type: ignore[arg-type]


def inertia(robot: Robot) -> np.ndarray:
    """Return M (nv×nv) at home."""
    M = pin.crba(robot.model, robot.model.createData(), robot.home)
    return np.triu(M) + np.triu(M, 1).T


def held_plant(joints: JointLevel) -> Plant:
    """Return the arm with its flange free to slide on a plane, moved by its drives."""
    robot, space = joints.robot, TaskSpace("flange")
    board = FaceOnPlane(space=space, R_WE=robot.pose(robot.home, "flange").rotation)
    return joints.drive(RigidPlant(robot, board, dt=joints.dt, armature=joints.armature))


def test_ideal_joints_change_nothing() -> None:
    robot = load_robot("fr3")
    ideal = level(robot, "ideal")
    assert ideal.robot is robot
    assert (ideal.dt, ideal.steps, ideal.armature) == (DT, 1, None)


@pytest.mark.parametrize("actuator", DRIVEN)
def test_the_controller_knows_the_inertia_that_its_torque_meets(actuator: str) -> None:
    """Torque feedback divides the rotor's inertia by 1 + K_p; the plant has the rotor itself."""
    bare = inertia(with_armature(load_robot("fr3"), np.zeros(7)))
    joints = level(load_robot("fr3"), actuator)
    seen = np.diag(inertia(joints.robot) - bare)
    loops = [drive.loops.K_p for drive in joints.drives]
    rotor = [
        drive.gear.ratio**2 * (drive.motor.inertia + drive.gear.inertia) for drive in joints.drives
    ]
    assert seen == pytest.approx(np.array(rotor) / (1 + np.array(loops)), rel=1e-9)
    own = rotor if actuator == "direct-drive" else np.zeros(7)
    assert joints.armature == pytest.approx(own, abs=1e-12)


def test_each_joint_gets_the_first_drive_that_is_strong_enough() -> None:
    names = [drive.name for drive in level(load_robot("fr3"), "geared").drives]
    assert names == ["orange-geared"] * 4 + ["lime-geared"] * 3
    assert 20 * 0.041 * 100 < 87 < 30 * 0.078 * 100  # Nm, of Avocado and Orange


def test_a_torque_may_be_asked_for_that_file_and_motor_can_give() -> None:
    own, joints = load_robot("fr3").limits, level(load_robot("fr3"), "strain-gauge")
    limits = joints.robot.limits
    assert limits.tau_max[:4] == pytest.approx(own.tau_max[:4])
    lime = load_drive("lime-strain")
    # the peak by hand: 80 % of the current's torque, less friction at the joint's highest speed
    by_hand = 0.8 * 15 * 0.0236 * 50 - 3.45 - 0.86 * np.array([5.26, 4.18, 5.26])
    assert limits.tau_max[4:] == pytest.approx(by_hand, rel=1e-6)
    assert (limits.tau_rate < own.tau_rate).all()
    assert limits.tau_droop[6] == pytest.approx((50 * 0.0236) ** 2 / 0.698 + 0.86)
    assert limits.tau_stall[6] < 0.9 * 48 * 50 * 0.0236 / 0.698
    assert lime.peak_torque > limits.tau_max[6]


def test_a_drive_moves_a_slide_by_a_capstan() -> None:
    (drive,) = level(slider(0.5), "direct-drive", drives=("ilm115-direct",)).drives
    at_shaft, r = load_drive("ilm115-direct"), CAPSTAN
    assert drive.peak_torque == pytest.approx(at_shaft.peak_torque / r)
    assert drive.inertia == pytest.approx(at_shaft.inertia / r**2)
    assert drive.no_load_speed == pytest.approx(at_shaft.no_load_speed * r)
    (spring,) = level(slider(0.5), "series-elastic", drives=("orange-elastic",)).drives
    assert spring.spring is not None
    assert spring.stiffness * spring.spring.hard_stop == pytest.approx(0.07 * 6000 / r)


@pytest.mark.parametrize("actuator", DRIVEN)
def test_drives_that_are_asked_to_hold_an_arm_hold_it(actuator: str) -> None:
    joints = level(load_robot("fr3"), actuator)
    plant, robot = held_plant(joints), joints.robot
    hold = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.home)
    assert np.abs(hold).max() > 5
    state = plant.reset(robot.home)
    delivered = []
    for _ in range(300):
        state = plant.step(hold)
        assert state.joints is not None
        delivered.append(state.joints.tau_delivered)
    assert state.time == pytest.approx(0.3)
    assert np.mean(delivered, axis=0) == pytest.approx(hold, abs=0.02)
    assert state.joints.tau_meas == pytest.approx(hold, abs=0.15)
    k_t = np.array([drive.torque_constant for drive in joints.drives])
    stuck = max(drive.friction.coulomb for drive in joints.drives)  # what a rotor may hold itself
    assert k_t * state.joints.current == pytest.approx(hold, abs=stuck + 0.2)
    assert not state.joints.limited


@pytest.mark.parametrize("actuator", ["geared", "strain-gauge"])
def test_what_friction_takes_does_not_arrive_unless_torque_is_fed_back(actuator: str) -> None:
    """A slow ramp from rest: below break-away an open-loop drive delivers nothing of it."""
    joints = level(load_robot("fr3"), actuator)
    plant, robot = held_plant(joints), joints.robot
    hold = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.home)
    state = plant.reset(robot.home)
    for i in range(300):
        state = plant.step(hold + np.array([0.0, 0, 0, 2.0, 0, 0, 0]) * min(i / 100, 1.0))
    assert state.joints is not None
    more = (state.joints.tau_delivered - hold)[3]
    assert more == pytest.approx(0.0 if actuator == "geared" else 2.0, abs=0.15)


def test_two_runs_are_the_same_and_noise_has_a_seed() -> None:
    first, again = (ran("eraser", "--duration", "0.2", *NOISY) for _ in range(2))
    other = ran("eraser", "--duration", "0.2", "--seed", "1", *NOISY)
    timeless = pl.exclude("tick_us")
    assert_frame_equal(first.table.select(timeless), again.table.select(timeless))
    assert not first.table["current.joint1"].equals(other.table["current.joint1"])


@pytest.mark.skipif(not any(map(shutil.which, COMPILERS)), reason="needs a C compiler on PATH")
def test_a_compiled_run_has_the_same_ticks_bit_for_bit_with_one_solver() -> None:
    flags = ("eraser", "--duration", "0.2", "--actuator", "strain-gauge", "--solver", "proxsuite")
    tables = [
        ran(*flags, "--compiled", given).table.select(pl.exclude("tick_us"))
        for given in ("no", "yes")
    ]
    assert_frame_equal(*tables, check_exact=True)


@pytest.mark.skipif(not any(map(shutil.which, COMPILERS)), reason="needs a C compiler on PATH")
def test_a_compiled_run_has_the_same_ticks_to_round_off_with_its_own_solver() -> None:
    flags = ("eraser", "--duration", "0.2", "--compiled")
    one, two = (ran(*flags, given).table for given in ("no", "yes"))
    assert one["saturated"].any()
    assert one["status"].equals(two["status"])
    for name in ("tau.joint2", "tau.joint4", "q.joint4", "wrench.fz"):
        apart = (one[name] - two[name]).abs().max()
        assert apart <= SAME_RUN * one[name].abs().max(), name


SAME_RUN = 1e-9
"""A closed loop with contact amplifies round-off of its ticks; measured 3e-12 of the maximum."""

NOISY = ("--actuator", "strain-gauge", "--compiled", "no")


@pytest.mark.parametrize("actuator", DRIVEN)
def test_commanded_delivered_and_measured_torque_are_three(actuator: str) -> None:
    run = ran("eraser", "--actuator", actuator, "--duration", "0.5", "--compiled", "no")
    table = run.table.filter(pl.col("phase") == "wipe")
    for name in ("tau", "tau_delivered", "tau_meas"):
        assert {f"{name}.{joint}" for joint in JOINTS} <= set(table.columns)
    error = (table["tau_delivered.joint4"] - table["tau.joint4"]).abs().mean()
    reading = (table["tau_meas.joint4"] - table["tau_delivered.joint4"]).abs().mean()
    assert error is not None
    assert reading is not None
    assert 1e-6 < error < (8.0 if actuator == "geared" else 0.3)  # 7 Nm of friction
    assert reading > 1e-6
    assert not run.table["motor_limited"].any()
    assert run.summary["config"]["actuator"] == actuator


def test_torque_feedback_cuts_the_force_error_of_a_geared_arm() -> None:
    error = {
        actuator: ran("eraser", "--actuator", actuator, "--duration", "2").metrics["force_rmse_N"]
        for actuator in ("geared", "strain-gauge")
    }
    assert error["geared"] > 5 * error["strain-gauge"]


def weak(folder: Path, name: str, voltage: float) -> str:
    """Return the file of a catalogue drive with another supply voltage."""
    drive = load_drive(name)
    tables = {"motor": drive.motor, "gear": drive.gear, "friction": drive.friction}
    lines = [
        'source = "a test"',
        f"loops = {{ current_bandwidth = {drive.loops.current_bandwidth} }}",
    ]
    for key, part in tables.items():
        given = {field: getattr(part, field) for field in part.__dataclass_fields__}
        if key == "motor":
            given["voltage"] = voltage
        inside = ", ".join(f"{k} = {v}" for k, v in given.items())
        lines.append(f"{key} = {{ {inside} }}")
    path = folder / f"weak-{name}.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return str(path)


def test_the_torque_speed_line_binds_the_controller_before_the_motor(tmp_path: Path) -> None:
    """With a 25th of the voltage: the QP saturates, the motors do not."""
    drives = [weak(tmp_path, "tmb0210-direct", 17.0)] * 4
    drives += [weak(tmp_path, "ilm115-direct", 1.36)] * 3
    flags = ("eraser", "--actuator", "direct-drive", "--speed", "0.5", "--duration", "1")
    run = ran(*flags, "--drives", *drives)
    bound = run.table["active"].str.contains("torque-speed")
    assert bound.sum() > 100
    assert run.table.filter(bound)["saturated"].all()
    assert not run.table["motor_limited"].any()
    for joint, k, R, U in (("joint4", 4.07, 2.18, 17.0), ("joint5", 0.2294, 0.07, 1.36)):
        tau, v = (run.table[f"{name}.{joint}"] for name in ("tau", "v"))
        needed = (R / k * tau + k * v).abs()  # V
        assert needed.max() < 0.9 * U + 1e-9  # type: ignore[operator]
        on_line = run.table["active"].str.contains(f"torque-speed {joint}")
        assert needed.filter(on_line).to_numpy() == pytest.approx(0.9 * U)
    assert run.table["active"].str.contains("torque-speed joint[45]").any()


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        ("--actuator gered", "did you mean 'geared'"),
        ("--drives orange-geared", "with actuator 'ideal', need none"),
        ("--actuator geared --drives orange-gered", "did you mean 'orange-geared'"),
        ("--actuator geared --drives orange-strain", "'orange-strain' is a strain-gauge drive"),
        ("--actuator geared --drives lime-geared lime-geared", "got 2, need 1 or 7"),
        ("--actuator geared --drives no.toml", "drive file 'no.toml': No such file"),
        ("--actuator geared --inner-rate 10500", "need a multiple of the controller's 1000 Hz"),
        ("--actuator geared --inner-rate nan", "nearest 10000 Hz"),
        ("--actuator geared --inner-rate 500", "nearest 1000 Hz"),
        ("--actuator geared --inner-rate 3000", "too slow for drive"),
        ("--actuator strain-gauge --inner-rate 2000", "Hz would do"),
        ("--compiled maybe", "auto"),
        ("--inner-rate 20000", "ideal joints have no loops"),
    ],
)
def test_bad_flags_are_refused_in_one_line(flags: str, says: str) -> None:
    run = subprocess.run(
        [Path(sys.executable).parent / "qpctrl", "run", "eraser", *flags.split()],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 2
    assert len(run.stderr.strip().splitlines()) == 1
    assert says in run.stderr


def test_an_actuator_that_moves_two_joints_has_no_drive() -> None:
    model = load_robot("planar_2r").model
    robot = from_pinocchio(model, B=np.array([[1.0], [1.0]]), tau_rate=1e3)
    with pytest.raises(InputError, match="each actuator must move one joint"):
        level(robot, "geared", drives=("lime-geared",))


def test_a_folded_arm_meets_its_hard_stops_without_chatter() -> None:
    """Where joint 3 is ten times as mobile as at home, a stop must not throw it."""
    joints = level(load_robot("fr3"), "series-elastic")
    free = Mobility(with_armature(joints.robot, joints.armature))
    rng, limits = np.random.default_rng(3), joints.robot.limits
    poses = [rng.uniform(limits.q_min, limits.q_max) for _ in range(300)]
    q = max(poses, key=lambda pose: float(free.at(pose)[2]))
    assert free.at(q)[2] > 5 * free.at(joints.robot.home)[2]
    M_inv = np.linalg.inv(inertia(replace(with_armature(joints.robot, joints.armature), home=q)))
    assert free.at(q) == pytest.approx(np.diag(M_inv))
    plant, robot = held_plant(joints), joints.robot
    state = plant.reset(q)
    hold = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), q)
    speeds = []
    for i in range(200):  # far beyond what the springs carry
        push = np.zeros(7)
        push[2] = 600.0 if i < 100 else 0.0
        state = plant.step(hold + push)
        speeds.append(np.abs(state.v).max())
    assert np.isfinite(speeds).all()
    assert max(speeds) < 60
