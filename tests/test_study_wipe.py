"""The system `wipe`: what is wrong in the world shows in its measures as mechanics says."""

import concurrent.futures
import multiprocessing
from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from qpctrl.errors import InputError
from scenarios.study.study_file import find_study, read_study, study_of
from scenarios.study.systems.wipe.controller import KINDS
from scenarios.study.systems.wipe.guide import PRESS_TIME, SPEED_RAMP, Job, circles
from scenarios.study.systems.wipe.measure import normal_force, reimpact_peak, settling
from scenarios.study.systems.wipe.system import Wipe
from scenarios.study.systems.wipe.world import board_error, draw, scene
from scenarios.world import TOOL

SYSTEM = Wipe()
USUAL = {name: p.usual for name, p in SYSTEM.parameters.items()}
SHORT = {"duration": 0.6, "judged_from": 0.6, "force": 12.0}
ROUND = {"radius": 0.02, "speed": 0.2, "duration": 1.3, "judged_from": 0.65}  # a circle in 0.63 s
SLOW = {"radius": 0.02, "speed": 0.1, "duration": 1.9, "judged_from": 0.943}  # one circle, 1.26 s
STILL = {"speed": 1e-3, "radius": 0.02, "friction": 0.0, "duration": 0.5, "judged_from": 0.6}

WITH_FEEDBACK = 0.01  # of the set-point, which an integral reaches within a short run
OPEN_LOOP = 0.03  # the spring gives way by what the contact is pressed in, others wait for friction
READ_OFF = 0.02  # how far a soft contact is from a rigid one
TILT_SHARE = 0.1  # of the tilt error, which feedback of a moving force does not reach in full


@cache
def measures(controller="qp", seed=3, **changed):
    return SYSTEM.run({**USUAL, **changed}, controller, seed).measures


@pytest.mark.parametrize("controller", KINDS)
def test_each_controller_presses_on_a_known_board_with_its_set_point(controller):
    found = measures(controller, **SHORT)
    loose = controller in ("impedance", "admittance")
    assert abs(found["force_bias_N"]) < (OPEN_LOOP if loose else WITH_FEEDBACK) * SHORT["force"]
    assert found["force_mae_N"] > 0
    assert found["position_mae_mm"] < (3.0 if loose else 0.1)
    assert found["contact_lost_fraction"] == 0
    way = 0.2 * (0.6 - SPEED_RAMP / 2)
    assert found["energy_J"] == pytest.approx(0.3 * SHORT["force"] * way, rel=0.1)


def test_felt_presses_flat_on_a_known_board():
    found = measures("qp-cone", tip=1.0, **SHORT)
    assert abs(found["force_bias_N"]) < WITH_FEEDBACK * SHORT["force"]
    assert found["orientation_rmse_deg"] < 0.05


@pytest.mark.parametrize(("axis", "degrees"), [("tilt_x", 5.0), ("tilt_y", -4.0)])
def test_a_tilted_board_is_as_high_as_its_tilt_says(axis, degrees):
    found = measures(**ROUND, **{axis: degrees})
    wanted = 2 * 1e3 * ROUND["radius"] * np.tan(np.radians(abs(degrees)))
    assert found["height_range_mm"] == pytest.approx(wanted, rel=READ_OFF)


def test_friction_on_a_tilted_board_changes_the_normal_force_as_statics_says():
    tilt, mu, force = np.radians(6.0), 0.5, 20.0
    found = measures(
        **SLOW, tilt_x=6.0, friction=mu, force=force, k_fi=100.0, k_fp=0.7, damping=40.0
    )
    angle = np.linspace(0, 2 * np.pi, 1000)
    along = np.stack([-np.sin(angle), np.cos(angle), np.cos(angle) * np.tan(tilt)])
    sigma = along[2] / np.linalg.norm(along, axis=0)
    lam = force / (np.cos(tilt) + mu * sigma)
    assert found["force_mae_N"] == pytest.approx(np.abs(lam - force).mean(), rel=TILT_SHARE)
    assert found["force_mae_N"] > 0.5


def test_an_offset_board_changes_the_force_of_a_spring_by_its_stiffness():
    near = measures("impedance", **SHORT, offset=-2e-3, spring_normal=400.0)
    far = measures("impedance", **SHORT, offset=2e-3, spring_normal=400.0)
    change = near["force_bias_N"] - far["force_bias_N"]
    assert change == pytest.approx(400.0 * 4e-3, rel=0.03)
    blind = measures(**SHORT, offset=2e-3)
    assert abs(blind["force_bias_N"]) < WITH_FEEDBACK * SHORT["force"]


def test_the_board_is_shifted_along_its_own_normal():
    X = board_error({"tilt_x": 90.0, "tilt_y": 0.0, "offset": 0.1})
    np.testing.assert_allclose(X.translation, [0, -0.1, 0], atol=1e-12)


def test_torque_bias_shows_in_the_position_until_an_integral_removes_it():
    found = measures(**STILL, torque_bias=2.0)
    world = scene({**USUAL, **STILL, "torque_bias": 2.0}, STILL["radius"], 3)
    robot, q = world.level.robot, world.q_start
    model, data = robot.model, robot.model.createData()
    J = pin.computeFrameJacobian(model, data, q, robot.frame_id(TOOL), pin.LOCAL)
    M = np.triu(pin.crba(model, data, q))
    M = M + np.triu(M, 1).T
    Lambda_inv = J @ np.linalg.solve(M, J.T)
    pushed = J @ np.linalg.solve(M, 2.0 * draw(3, robot.nv).bias)  # of the free tool
    normal = Lambda_inv[:, 2]
    held = pushed - normal * pushed[2] / normal[2]  # with the normal force that holds it
    wanted = 1e3 * np.linalg.norm(held[:2]) / USUAL["k_p"]
    assert wanted > 0.5
    assert found["position_mae_mm"] == pytest.approx(wanted, rel=0.03)
    cured = measures(**{**STILL, "duration": 1.2, "judged_from": 1.2}, torque_bias=2.0, k_i=25e3)
    assert cured["position_mae_mm"] < 0.1 * wanted


@pytest.mark.parametrize(
    ("changed", "wanted"),
    [({"sensor_bias": 1.5}, 12.0 - 1.5), ({"sensor_gain": 1.2}, 12.0 / 1.2)],
)
def test_an_integral_presses_until_the_sensor_reads_the_set_point(changed, wanted):
    found = measures(**SHORT, **changed, k_fi=100.0)
    assert found["force_bias_N"] + SHORT["force"] == pytest.approx(wanted, abs=0.05)


def test_errors_of_size_zero_change_nothing():
    plain = measures(**SHORT)
    tiny = {"sensor_noise": 1e-300, "noise_q": 1e-300, "noise_v": 1e-300, "torque_bias": 1e-300}
    assert measures(**SHORT, **tiny) == plain
    assert measures(**SHORT, sensor_noise=0.5) != plain


NOISY = {**SHORT, "sensor_noise": 0.3, "noise_v": 1e-3, "torque_bias": 1.0, "torque_spread": 0.1}


def noisy_run(seed):
    return SYSTEM.run({**USUAL, **NOISY}, "qp", seed).measures


def test_the_same_seed_gives_the_same_row_in_any_order_and_process():
    first = noisy_run(7)
    other = noisy_run(8)
    assert noisy_run(7) == first
    assert other["position_mae_mm"] != first["position_mae_mm"]
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, mp_context=spawn) as pool:
        assert pool.submit(noisy_run, 7).result() == first


def test_a_full_record_gives_the_same_measures():
    full = SYSTEM.run({**USUAL, **SHORT}, "qp", 3, full=True)
    brief = SYSTEM.run({**USUAL, **SHORT}, "qp", 3)
    assert full.measures == brief.measures
    assert full.table.select(brief.table.columns).equals(brief.table)
    assert "tau_hybrid.joint1" in full.table.columns


def test_a_slower_controller_holds_its_torque():
    rollout = SYSTEM.run({**USUAL, **SHORT, "period": 4.0}, "qp", 3)
    np.testing.assert_allclose(np.diff(rollout.table["time"].to_numpy()), 4e-3, atol=1e-9)
    assert abs(rollout.measures["force_bias_N"]) < WITH_FEEDBACK * SHORT["force"]


def test_drives_move_the_joints():
    found = measures(**{**SHORT, "duration": 0.4}, actuator=1.0)
    assert abs(found["force_bias_N"]) < 0.05 * SHORT["force"]
    assert found["position_mae_mm"] != measures(**{**SHORT, "duration": 0.4})["position_mae_mm"]


@pytest.mark.parametrize("tip", [0.0, 1.0])
def test_the_tool_just_touches_a_tilted_board_at_the_start(tip):
    setting = {**USUAL, "tip": tip, "tilt_x": 4.0, "tilt_y": -3.0, "offset": 2e-3}
    world = scene(setting, 0.03, 0)
    world.plant.reset(world.q_start)
    model, data = world.plant._model, world.plant._data
    ends = data.geom("eraser/pad").xpos - world.X_WE_true.translation
    height = world.X_WE_true.rotation[:, 2] @ ends  # of the middle of ball or pad, before the board
    size, R = model.geom("eraser/pad").size, data.geom("eraser/pad").xmat.reshape(3, 3)
    reach = np.abs(R.T @ world.X_WE_true.rotation[:, 2]) @ size if tip else size[0]
    assert height == pytest.approx(-reach, abs=1e-9)


def test_circles_are_the_integral_of_their_velocity():
    path = circles(0.05, 0.2, 3.0, 1e-3)
    rest = round(PRESS_TIME / 1e-3)
    assert (path.v[:rest] == 0).all()
    np.testing.assert_allclose(np.gradient(path.p, 1e-3, axis=0)[1:-1], path.v[1:-1], atol=2e-5)
    np.testing.assert_allclose(np.gradient(path.v, 1e-3, axis=0)[1:-1], path.a[1:-1], atol=2e-3)
    steady = rest + round(SPEED_RAMP / 1e-3)
    np.testing.assert_allclose(path.p[steady + path.cycle], path.p[steady], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(path.v[steady:], axis=1), 0.2, rtol=1e-3)


def test_forces_and_times_are_read_off_as_defined():
    import polars as pl

    table = pl.DataFrame({f"wrench.f{axis}": [x] for axis, x in zip("xyz", [1, 2, 3], strict=True)})
    X_WE = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.zeros(3))  # its z is −y of the world
    force = normal_force(table, np.eye(3)[None], X_WE)
    np.testing.assert_allclose(force, [-2.0])
    job = Job(pin.SE3.Identity(), circles(0.03, 0.2, 0.1, 1e-3), 10.0)
    rising = np.array([0.0, 5.0, 12.0, 9.5, 10.0])
    assert settling(rising, job) == pytest.approx(3.0)
    assert settling(rising[:3], job) is None
    touching = np.array([True, False, True, True])
    assert reimpact_peak(np.array([50.0, 0.0, 30.0, 10.0]), touching) == 30.0
    assert reimpact_peak(np.ones(4), np.ones(4, dtype=bool)) is None


@pytest.mark.parametrize("judged_from", [0.0, 0.9])
def test_a_loss_of_contact_counts_whenever_it_is_while_the_board_is_wiped(judged_from):
    """5 N turn a mass of 6.2 kg along the board up to 0.4 m/s: tan α = f r / (m v²)."""
    fast = {"force": 5.0, "radius": 0.05, "speed": 0.5, "tilt_x": 15.0, "duration": 0.7}
    rollout = SYSTEM.run({**USUAL, **fast, "judged_from": judged_from}, "qp", 0)
    found, time = rollout.measures, rollout.table["time"].to_numpy()
    wiping = ~rollout.table["touching"].to_numpy()[time >= PRESS_TIME - 1e-9]
    assert 0.05 < wiping.mean() < 0.95
    assert found["contact_lost_fraction"] == wiping.mean()
    assert found["contact_breaks"] == np.sum(np.diff(wiping.astype(int)) == 1)


def test_nothing_left_to_judge_is_refused():
    with pytest.raises(InputError, match="judged_from: got 5 s"):
        SYSTEM.run({**USUAL, "judged_from": 5.0}, "qp", 0)


@pytest.mark.parametrize("name", ["polishing-tilt", "controllers", "screening", "loss-map"])
def test_ready_studies_describe_this_system(name):
    study = study_of(read_study(find_study(name)))
    assert isinstance(study.system, Wipe)
    point = dict(zip((f.name for f in study.columns), study.points(0)[0], strict=True))
    setting = study.setting(point)
    assert PRESS_TIME + setting["duration"] > setting["judged_from"]
    assert set(study.show) <= set(SYSTEM.measures)


def test_polishing_is_better_than_the_best_published_controller_on_the_steepest_board():
    study = study_of(read_study(find_study("polishing-tilt")))
    setting = {**study.setting({"tilt_x": 6.0}), "duration": 5.0}
    found = SYSTEM.run(setting, "qp", 0).measures
    best = study.published[-1].measures
    assert 0 < found["force_mae_N"] < best["force_mae_N"]
    assert 0 < found["position_mae_mm"] < best["position_mae_mm"]
    assert found["contact_lost_fraction"] == 0
