"""A mobile arm wipes a board beyond its reach: base and arm together, and what stops it."""

import functools
from dataclasses import replace

import mujoco
import numpy as np
import oracles
import pinocchio as pin
import polars as pl
import pytest

from qpctrl import InputError
from scenarios.metric import column
from scenarios.mobile_eraser import MobileEraser
from scenarios.path import advancing_loops
from scenarios.plant_mujoco import MujocoPlant
from scenarios.robot_file import MODELS
from scenarios.run import run_scenario
from scenarios.scenario import Options, Outcome
from scenarios.simulation import simulate
from scenarios.whole_body.mobile_guide import BasePlan, Lift
from scenarios.whole_body.mobile_metric import (
    acting_limits,
    joint_margins,
    limit_use,
    matrix,
    progress,
)
from scenarios.whole_body.mobile_world import BASE, BOARD_LEFT, CARRIAGE, mobile_world
from scenarios.wiping import WipingGuide
from scenarios.world import TOOL, Pad

DT = 1e-3
SHORT = 0.2  # m, one circle
REACH = 0.855  # m, of the arm, from the maker's data sheet
FEEDBACK = 2e-5  # m, by which the base may leave a path that its own task follows
LEANING = 0.02  # m, by which it may leave that which its posture follows


@functools.cache
def run(**parameters) -> Outcome:
    """Return a run, made once."""
    return run_scenario(MobileEraser(**parameters), Options(compiled="no"))


def missed(outcome: Outcome) -> dict[str, float]:
    """Return the criteria that do not hold, and their values."""
    return {c["name"]: c["value"] for c in outcome.summary["criteria"] if not c["passed"]}


def wiping(outcome: Outcome) -> pl.DataFrame:
    """Return the ticks spent wiping."""
    return outcome.table.filter(pl.col("phase") == "wipe")


def tool_places(outcome: Outcome) -> np.ndarray:
    """Return where the eraser is in the world (ticks×3) [m], by pinocchio, every 50th tick."""
    robot, table = outcome.experiment.robot, wiping(outcome)[::50]
    q, still = matrix(table, "q"), np.zeros(robot.nv)
    return np.array(
        [oracles.frame_terms(robot.model, row, still, TOOL).X_WF.translation for row in q]
    )


@pytest.mark.parametrize("metric", ["inertia", "home"])
def test_base_and_arm_wipe_together_and_meet_the_criteria(metric: str) -> None:
    outcome = run(metric=metric, length=SHORT)
    assert not missed(outcome)
    table, metrics = outcome.table, outcome.summary["metrics"]
    phases = table["phase"].unique(maintain_order=True).to_list()
    assert phases == ["approach", "touch", "press", "wipe", "release", "lift"]
    wipe = wiping(outcome)
    true_force = column(wipe, "wrench.fz")
    assert true_force == pytest.approx(np.full(len(wipe), 10.0), abs=0.5)
    assert metrics["force_rmse_share"] == pytest.approx(
        np.sqrt(np.mean((true_force / 10 - 1) ** 2))
    )
    wiped = tool_places(outcome)
    assert np.ptp(wiped[:, 2]) == pytest.approx(0.16, abs=1e-3)  # two radii, up and down
    assert wiped[-1] - wiped[0] == pytest.approx([0.0, SHORT, 0.0], abs=2e-3)
    base, share = column(wipe, "q.base_y"), np.linspace(0, 1, len(wipe))
    assert base[-1] - base[0] == pytest.approx(SHORT, abs=LEANING)
    strayed = column(wipe, "q.base_x"), column(wipe, "q.base_yaw")
    assert np.abs(strayed).max() < (FEEDBACK if metric == "home" else LEANING)
    arm = np.ptp(matrix(wipe, "q")[:, 3:], axis=0)
    assert arm.max() > 0.3  # rad: the arm draws the circle
    assert base[len(base) // 2] == pytest.approx(SHORT * share[len(base) // 2], abs=LEANING)
    assert not table["touching"][-1]


def test_the_default_path_is_beyond_the_reach_of_the_arm_and_on_the_board() -> None:
    scenario = MobileEraser()
    assert scenario.length >= 2.0 > 2 * REACH
    p = advancing_loops(scenario.speed, scenario.length, DT, radius=scenario.radius).p
    model = mujoco.MjModel.from_xml_path(str(MODELS / "mobile_arm.xml"))
    board = model.body("board").pos[1] + model.geom("board").size[1] * np.array([-1.0, 1.0])
    assert board[1] == pytest.approx(BOARD_LEFT)
    y_W = -p[:, 1] + np.array([[-0.025], [0.025]])  # both long edges of the pad
    assert board[0] < y_W.min() < y_W.max() < board[1]


def test_the_qp_is_the_hybrid_law_although_the_robot_is_redundant() -> None:
    outcome = run(metric="inertia", length=SHORT)
    wipe = wiping(outcome)
    tau, law = matrix(wipe, "tau_qp"), matrix(wipe, "tau_hybrid")
    assert outcome.experiment.robot.nv == 10
    assert np.abs(tau).max() > 10.0
    assert np.abs(tau - law).max() < 1e-8 * np.abs(tau).max()
    metrics = outcome.summary["metrics"]
    assert metrics["qp_law_gap_max"] < 1e-8
    assert 0 < metrics["kkt_residual_max"] == column(outcome.table, "kkt_residual").max() < 1e-8
    other = run(metric="home", length=SHORT)  # has no closed form, and does not claim one
    assert "qp_law_gap_max" not in {c["name"] for c in other.summary["criteria"]}
    assert "base.X_e.1" in other.table.columns


def test_the_torque_is_smooth_where_the_contact_changes() -> None:
    outcome = run(metric="inertia", length=SHORT)
    limits, table = outcome.experiment.robot.limits, outcome.table
    steps = np.abs(np.diff(matrix(table, "tau"), axis=0)) / (limits.tau_rate * DT)
    mode, metrics = table["mode"].to_numpy(), outcome.summary["metrics"]
    switches = np.flatnonzero(mode[1:] != mode[:-1])
    assert [mode[0], *mode[switches + 1]] == ["free", "contact", "free"]
    assert metrics["torque_step_max_share"] == pytest.approx(steps.max())
    assert metrics["torque_step_switch_max"] == pytest.approx(steps[switches].max())
    assert 0 < steps[switches].max() < 0.5
    assert column(table, "wrench.fz")[switches[1]] < 0.1  # N, let go with almost nothing on it


def test_a_fixed_base_reaches_a_part_says_what_stops_it_and_stops_in_order() -> None:
    outcome = run(fixed_base=True, length=1.0)
    metrics, table = outcome.summary["metrics"], outcome.table
    failures = missed(outcome)
    assert not outcome.passed
    assert 0.4 < metrics["wiped_length_m"] < REACH
    wiped = tool_places(outcome)[:, 1]
    assert metrics["wiped_length_m"] == pytest.approx(np.ptp(wiped), abs=0.03)
    assert failures["wiped_length_missing_m"] == pytest.approx(1.0 - metrics["wiped_length_m"])
    stopped_by = [name for name in failures if name.startswith("acts ")]
    assert stopped_by[0] == "acts velocity joint4"  # the elbow, which stretches
    acting = wiping(outcome).filter(pl.col("active").str.contains("velocity joint4"))
    assert metrics["acts velocity joint4"] == pytest.approx(DT * len(acting))
    assert "velocity joint4 at its upper limit" in acting["explanation"][0]
    assert table["phase"][-1] == "stop"
    assert table["time"][-1] < outcome.experiment.horizon - 1.0
    speed = matrix(table, "v")
    assert np.abs(speed[-1]).max() < 0.3 * np.abs(speed).max()
    within_limits(outcome)


def within_limits(outcome: Outcome) -> None:
    """Check that every torque is a number within its limits, and no position beyond its."""
    limits, tau = outcome.experiment.robot.limits, matrix(outcome.table, "tau")
    q = matrix(outcome.table, "q")
    assert np.isfinite(tau).all()
    assert (np.abs(tau) <= limits.tau_max * (1 + 1e-9)).all()
    assert (limits.q_min <= q).all()
    assert (q <= limits.q_max).all()
    assert all(value is not None for value in outcome.summary["metrics"].values())


def test_a_fixed_base_wipes_what_it_reaches() -> None:
    outcome = run(fixed_base=True, length=SHORT, radius=0.05)
    assert not missed(outcome)
    assert outcome.experiment.robot.nv == 7
    assert np.ptp(tool_places(outcome)[:, 1]) > SHORT


def test_too_fast_for_the_base_it_is_the_base_that_is_named() -> None:
    outcome = run(speed=1.3, radius=0.001)
    metrics, failures = outcome.summary["metrics"], missed(outcome)
    assert [name for name in failures if name.startswith("acts ")] == ["acts velocity base_y"]
    fast = np.abs(column(outcome.table, "v.base_y"))
    assert fast.max() == pytest.approx(1.0, abs=1e-3)  # m/s, its limit
    assert metrics["acts velocity base_y"] == pytest.approx(DT * (fast > 0.9).sum(), abs=0.1)
    assert metrics["fallback_ticks"] == 0
    assert failures["force_rmse_share"] > 0.03
    within_limits(outcome)


def test_two_runs_are_the_same_but_for_timing() -> None:
    scenario = MobileEraser(length=0.1, force_noise=0.02)
    tables = [
        simulate(replace(scenario.prepare(Options(compiled="no")), horizon=2.8)).drop("tick_us")
        for _ in range(2)
    ]
    assert "wipe" in tables[0]["phase"]
    assert tables[0].equals(tables[1], null_equal=True)


def test_a_run_that_ends_before_it_wipes_fails_without_a_crash() -> None:
    scenario = MobileEraser()
    experiment = replace(scenario.prepare(Options(compiled="no")), horizon=0.1)
    metrics = scenario.metrics(simulate(experiment))
    failed = {c.name for c in scenario.judge(metrics) if not c.passed}
    assert {"force_rmse_share", "wiped_length_missing_m"} <= failed
    assert metrics["wiped_length_missing_m"] == scenario.length


def test_the_circles_advance_at_their_speed_and_end_where_they_shall() -> None:
    path = advancing_loops(0.25, 0.6, DT, radius=0.08, pitch=0.2)
    assert path.p[0] == pytest.approx([0.08, 0.0])
    assert path.p[-1] == pytest.approx([0.08, -0.6], abs=1e-4)
    assert np.diff(path.p, axis=0) / DT == pytest.approx((path.v[1:] + path.v[:-1]) / 2, abs=5e-5)
    assert np.diff(path.v, axis=0) / DT == pytest.approx((path.a[1:] + path.a[:-1]) / 2, abs=5e-3)
    speed = np.linalg.norm(path.v, axis=1)
    assert speed[0] == speed[-1] == 0.0
    assert speed[600:-600] == pytest.approx(0.25)
    short = advancing_loops(0.25, 0.05, DT, radius=0.01, pitch=0.05)
    assert short.p[-1] == pytest.approx([0.01, -0.05], abs=1e-4)


def test_the_base_goes_at_the_mean_speed_and_its_posture_leads_by_what_damping_takes() -> None:
    robot = mobile_world(pad=Pad(), fixed_base=False, dt=DT).robot
    plan = BasePlan(
        pose=lambda q: robot.pose(q, CARRIAGE),
        q_home=robot.home,
        length=1.5,
        duration=8.0,
        dt=DT,
        along=1,
        lead=0.45,
    )
    way = [plan.track.at(float(t)).X_WD.translation for t in (0.0, 4.0, 8.0, 9.0)]
    wanted = np.outer([0.0, 0.75, 1.5, 1.5], [0.0, 1.0, 0.0])
    assert np.array(way) == pytest.approx(wanted, abs=1e-6)
    speed = plan.track.at(4.0).V_des[1]
    assert speed == pytest.approx(1.5 / 7.5)
    assert plan.postures[4000] - robot.home == pytest.approx(
        [0, 0.75 + 0.45 * speed, *np.zeros(8)], abs=1e-6
    )


def test_lifting_begins_as_the_tool_moves_and_forgets_it() -> None:
    lift, h = Lift(since=2.0, depth=4e-4, speed=-3e-3), 1e-5
    assert lift.at(2.0) == pytest.approx((4e-4, -3e-3, 0.0))
    assert lift.at(2.5) == pytest.approx((0.0, 0.0, 0.0))
    for t in (2.05, 2.2, 2.35):
        before, now, after = (lift.at(t + k * h) for k in (-1, 0, 1))
        assert (after[0] - before[0]) / (2 * h) == pytest.approx(now[1], rel=1e-6)
        assert (after[1] - before[1]) / (2 * h) == pytest.approx(now[2], rel=1e-6)


def test_metrics_of_a_record_whose_numbers_are_known() -> None:
    robot = mobile_world(pad=Pad(), fixed_base=False, dt=DT).robot
    limits = robot.limits
    q, v, tau = np.tile(robot.home, (4, 1)), np.zeros((4, 10)), np.zeros((4, 10))
    q[1, 0], q[2, 3], v[1, 1], tau[3, 9] = 0.75, 2.0, -0.4, 6.0
    parts = (("q", q), ("v", v), ("tau", tau))
    columns = {
        f"{name}.{joint}": array[:, i]
        for name, array in parts
        for i, joint in enumerate(robot.joint_names)
    }
    columns |= {f"motion.X_WF.{i}": np.zeros(4) for i in (9, 11)}
    columns |= {"motion.X_WF.10": np.array([0.0, 0.3, 0.6, 1.0])}
    columns |= {"motion.X_e.0": np.array([0.0, 3e-3, 0.0, 0.0])}
    columns |= {"motion.X_e.1": np.array([0.0, 0.0, 0.0, 6e-3])}
    words = {"active": ["", "velocity base_y", "velocity base_y, torque joint7", ""]}
    table = pl.DataFrame({**columns, **words, "touching": [True] * 4})
    assert progress(table, 5e-3) == pytest.approx({"wiped_length_m": 0.6, "path_length_m": 0.6})
    assert limit_use(table, limits) == pytest.approx(
        {"position_use_max_share": 0.75, "speed_use_max_share": 0.4, "torque_use_max_share": 0.5}
    )
    margins = joint_margins(table, limits)
    assert margins["base_margin_min_mm"] == pytest.approx(250.0)
    joint1 = np.degrees(limits.q_max[3] - 2.0)
    assert margins["joint_margin_min_deg"] == pytest.approx(min(joint1, 41.254), abs=1e-2)
    assert acting_limits(table, DT) == {"acts velocity base_y": 2e-3, "acts torque joint7": 1e-3}


def test_the_pictures_show_the_path_the_base_and_the_limits() -> None:
    outcome = run(metric="inertia", length=SHORT)
    panels = {panel.key: panel for panel in MobileEraser(length=SHORT).panels(outcome)}
    assert list(panels) == ["path", "above", "error", "force", "limits"]
    drawn = {trace["name"]: trace for trace in panels["above"].figure["data"]}
    assert list(drawn) == ["board", "eraser", "middle of the base", "start", "end"]
    base = drawn["middle of the base"]
    assert np.ptp(base["x"]) == pytest.approx(SHORT, abs=LEANING)
    assert np.mean(drawn["end"]["x"][:4]) == pytest.approx(base["x"][-1])
    assert np.ptp(drawn["end"]["y"]) == pytest.approx(0.6, abs=0.01)
    used = {trace["name"]: np.nanmax(trace["y"]) for trace in panels["limits"].figure["data"]}
    metrics = outcome.summary["metrics"]
    assert used["position"] == pytest.approx(metrics["position_use_max_share"], abs=1e-3)
    assert used["speed"] == pytest.approx(metrics["speed_use_max_share"], abs=1e-3)


def test_the_scene_is_that_of_an_arm_with_a_board() -> None:
    world = mobile_world(pad=Pad(friction=0.5), fixed_base=False, dt=DT)
    assert world.robot.joint_names[:3] == BASE
    plant = MujocoPlant(world)
    state = plant.reset(world.robot.home)
    assert state.wrench == pytest.approx(np.zeros(6), abs=1e-9)  # the eraser's weight is taken off
    gap = world.robot.pose(world.robot.home, TOOL).actInv(world.X_WE)
    assert gap.translation == pytest.approx([0.0, 0.0, 0.02], abs=1e-6)
    bolted = mobile_world(pad=Pad(), fixed_base=True, dt=DT).robot
    assert bolted.home == pytest.approx(world.robot.home[3:])
    assert bolted.limits.v_max == pytest.approx(world.robot.limits.v_max[3:])
    poses = bolted.pose(bolted.home, TOOL), world.robot.pose(world.robot.home, TOOL)
    assert pin.log6(poses[0].actInv(poses[1])).vector == pytest.approx(np.zeros(6), abs=1e-12)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"metric": "euclid"}, "metric 'euclid'; .*inertia"),
        ({"base_weight": 0.0}, "base_weight: .*> 0"),
        ({"force": 0.0}, "force: .*> 0"),
        ({"speed": float("nan")}, "speed: .*finite"),
        ({"speed": 9.0}, "speed: got 9.0, need at most 5 m/s"),
        ({"length": 3.0}, "length: got 3.0, need at most 2.19 m: the board ends"),
        ({"length": 2.15, "radius": 0.15}, "length: got 2.15, need at most 2.12 m"),
        ({"radius": 0.5}, "radius: got 0.5, need at most 0.2 m"),
        ({"k_p": -1.0}, "k_p: .*>= 0"),
        ({"friction": float("inf")}, "friction: .*finite"),
    ],
    ids=str,
)
def test_numbers_that_make_no_sense_are_refused_in_one_line(wrong, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        MobileEraser(**wrong)
    assert "\n" not in str(refused.value)


def test_the_guide_of_wiping_takes_any_path() -> None:
    experiment = MobileEraser(length=SHORT).prepare(Options(compiled="no"))
    loops = experiment.geometry["loops"]
    assert loops[-1] == pytest.approx([0.08, -SHORT], abs=1e-4)
    assert WipingGuide.phases[3] == "wipe"
