"""The benchmark: figures of known samples, arms in series, all lines there; no time is judged."""

import itertools
import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from oracles import frame_terms

from qpctrl import Controller, InputError, Measurement, Status
from qpctrl.evaluator import Evaluator
from scenarios.bench.course import DT, contact_mode, course
from scenarios.bench.goal import goals
from scenarios.bench.growth import fitted_power, growth, in_the_way, power
from scenarios.bench.humanoid import HUMANOID, ROWS, SOLES, humanoid, standing_course
from scenarios.bench.page import render_page
from scenarios.bench.part_trial import PartTrial, calls_of, dynamics_function
from scenarios.bench.plan import Plan
from scenarios.bench.qp_trial import InnerQpTrial
from scenarios.bench.result import Result, measure, usable_folder, write_result
from scenarios.bench.row import Row
from scenarios.bench.serial import TOOL, serial_arm
from scenarios.bench.sheet import sheets
from scenarios.bench.suite import Suite, add_case
from scenarios.bench.timing import Rounds, one_core, ratio, take_turns, timing, turns
from scenarios.cli_bench import bench_command
from scenarios.robot_file import load_robot
from scenarios.whole_body.humanoid_world import HAND

ROUND_OFF = 1e-12
"""Two double-precision evaluations of M and h, over their largest entry."""
DEFAULT_KKT = 1e-9
"""Promised of every tick of the default solver."""
DIFFERENCES = 1e-4
"""Velocity by central differences over 2 ms, over its largest entry: h² q⃛ / 6."""

SETTLED = 30
"""Ticks in which a torque of 10 N on the tool is reached, at the robot's torque rate."""

TINY = Plan(
    ticks=6,
    rounds=2,
    codes=(False,),
    solvers=("daqp",),
    joints=(9,),
    humanoid=True,
    paced=4,
    runs=1,
    rollouts=1,
    wiping=0.1,
    rollout=0.1,
    longest=5.0,
)


@pytest.fixture(scope="module")
def result() -> Result:
    return measure(TINY)


# Figures -----------------------------------------------------------------------------------


def test_figures_are_numpys_and_percentiles_are_samples() -> None:
    samples = np.random.default_rng(0).permutation(np.arange(1.0, 2001.0)) * 1e3
    found = timing(samples)
    ranked = [np.quantile(samples, p, method="inverted_cdf") / 1e3 for p in (0.99, 0.999)]
    assert found[:2] == (2000, np.median(samples) / 1e3)
    assert [found.p99_us, found.p999_us] == ranked == [1980.0, 1998.0]
    assert found.max_us == 2000.0
    assert found.preempted is None


@pytest.mark.parametrize(("count", "p99", "p999"), [(1, None, None), (99, None, None)])
def test_percentiles_that_samples_cannot_tell_are_left_out(
    count: int, p99: float | None, p999: float | None
) -> None:
    assert timing(np.arange(1.0, count + 1))[2:4] == (p99, p999)


def test_a_percentile_needs_one_sample_above_it() -> None:
    assert timing(np.arange(1, 101) * 1e3).p99_us == 99.0
    assert timing(np.arange(1, 1000) * 1e3).p999_us is None
    assert timing(np.arange(1, 1001) * 1e3).p999_us == 999.0


def test_preempted_samples_are_counted_and_left_out_of_the_undisturbed_tail() -> None:
    samples = np.arange(1, 2001) * 1e3
    lost = samples > 1900e3
    found = timing(samples, lost.tolist())
    assert (found.preempted, found.max_us, found.max_kept_us) == (100, 2000.0, 1900.0)
    kept = np.percentile(samples[~lost], 99.9, method="inverted_cdf") / 1e3
    assert (found.p999_us, found.p999_kept_us) == (1998.0, kept)
    assert timing(samples, [True] * 2000).max_kept_us is None


def test_powers_are_those_of_polyfit() -> None:
    n, t = [7, 14, 28, 38], [3.0, 9.0, 41.0, 88.0]
    assert power((7, 14), (3.0, 24.0)) == pytest.approx(3.0, rel=1e-14)
    assert fitted_power(n, t) == pytest.approx(np.polyfit(np.log(n), np.log(t), 1)[0], rel=1e-14)


def part(name: str, n: int, median_us: float) -> Row:
    return Row(section="part", name=name, joints=n, compiled=True, timing=timing([median_us * 1e3]))


def test_growth_names_the_part_that_takes_most_and_those_that_grow_too_fast() -> None:
    rows = [part(name, n, t) for name, n, t in WHOLE_AND_PARTS]
    found = growth(rows)
    assert [(one.part, one.joints) for one in found] == [
        ("whole tick", (7, 38)),
        ("graph", (7, 38)),
        ("QP", (7, 38)),
    ]
    said = in_the_way(found, compiled=True)
    assert "38 joints: 100.0 µs a tick, above 60 µs" in said
    assert "most of it, 70.0 µs (70 %), is graph" in said
    assert "faster than n³: QP" in said
    assert in_the_way(found, compiled=False) == ""


WHOLE_AND_PARTS = [
    *(("whole tick", 7, 5.0), ("whole tick", 38, 100.0), ("graph", 7, 3.0), ("graph", 38, 70.0)),
    *(("QP", 7, 0.1), ("QP", 38, 20.0), ("certificate", 7, 1.0)),
]


# Turns -------------------------------------------------------------------------------------


class Counted:
    """A trial that notes its blocks."""

    def __init__(self, name: str, ticks: int, log: list[tuple[str, int]]) -> None:
        self.name, self.ticks, self._log = name, ticks, log

    def run(self, count: int) -> None:
        """Note it."""
        self._log.append((self.name, count))


def test_trials_take_turns_and_get_what_they_want() -> None:
    log: list[tuple[str, int]] = []
    trials = [Counted("a", 10, log), Counted("b", 1, log)]
    take_turns(trials, Rounds(rounds=4, longest=1.0, usual=10))
    assert log == [("a", 2), ("a", 3), ("a", 2), ("a", 3), ("b", 1)]


def test_a_ratio_is_that_of_neighbouring_turns() -> None:
    slow_for_a_while = np.array([1.0, 1.0, 9.0, 1.0, 7.0])
    assert ratio([2.0, 2.2, 18.0, 2.0, 13.0], slow_for_a_while.tolist()) == 2.0
    assert ratio([2.0, 4.0], [1.0, 1.0, 5.0]) == 3.0


def test_a_trial_with_many_samples_has_turns_all_over_a_round() -> None:
    order = turns([10, 100, 10, 0], block=10)
    assert [sum(count for i, count in order if i == which) for which in range(4)] == [
        10,
        100,
        10,
        0,
    ]
    assert max(count for _, count in order) == 10
    assert [i for i, _ in order] == [1, 0, *[1] * 5, 2, *[1] * 4]


def test_a_slow_trial_gets_fewer_samples_and_a_long_one_more_time(monkeypatch) -> None:
    now = [0.0]

    class Slow(Counted):
        def run(self, count: int) -> None:
            super().run(count)
            now[0] += count * 2.0**-10

    monkeypatch.setattr("scenarios.bench.timing.time.perf_counter", lambda: now[0])
    log: list[tuple[str, int]] = []
    rounds = Rounds(rounds=2, longest=0.125, usual=1000)
    take_turns([Slow("slow", 1000, log), Slow("long", 4000, log)], rounds)
    slow, long = (sum(n for name, n in log if name == which) for which in ("slow", "long"))
    assert (slow, long) == (25 + 128, 25 + 512)


def test_one_core_is_left_again() -> None:
    before = os.sched_getaffinity(0)
    with one_core() as core:
        assert os.sched_getaffinity(0) == {core}
    assert os.sched_getaffinity(0) == before


# Arms and ticks ----------------------------------------------------------------------------


@pytest.mark.parametrize("joints", [9, 14])
def test_arms_in_series_have_pinocchios_dynamics(joints: int) -> None:
    robot = serial_arm(joints)
    rng = np.random.default_rng(joints)
    q, v = robot.home + rng.normal(size=joints), rng.normal(size=joints)
    evaluate = Evaluator(dynamics_function(robot, TOOL))
    evaluate.inputs["q"][:], evaluate.inputs["v"][:] = q, v
    evaluate()
    expected = frame_terms(robot.model, q, v, TOOL)
    for name in ("M", "h", "J", "J_dot_v"):
        want = getattr(expected, name)
        assert np.abs(want).max() > 0.1
        gap = np.abs(evaluate.outputs[name] - want).max() / np.abs(want).max()
        assert gap < ROUND_OFF, name
    assert (np.abs(expected.M) > 1e-9).mean() > 0.9  # dense: every joint moves all that follows


def test_an_arm_in_series_ends_in_the_fr3() -> None:
    fr3, arm = load_robot("fr3"), serial_arm(9)
    assert serial_arm(7).nv == 7
    q = np.concatenate(([0.3, -0.2], fr3.home))
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    flange = fr3.model.frames[fr3.frame_id(TOOL)].placement
    X_WB = data.oMi[2] * flange  # the FR3 stands on the flange of the joints at the base
    own = fr3.pose(fr3.home, TOOL)
    assert np.allclose((X_WB * own).homogeneous, arm.pose(q, TOOL).homogeneous, atol=1e-12)
    with pytest.raises(InputError, match="need at least 7"):
        serial_arm(6)


@pytest.mark.parametrize(
    ("robot", "k"), [("planar_2r", 1), ("fr3", 1), ("fr3", 3), ("fr3", 5), ("9", 3)]
)
def test_states_of_a_course_move_along_its_contact(robot: str, k: int) -> None:
    arm = serial_arm(int(robot)) if robot.isdigit() else load_robot(robot)
    moments = course(arm, TOOL, k)
    q, v = (np.array([getattr(m, name) for m in moments]) for name in "qv")
    rate = (np.roll(q, -1, axis=0) - np.roll(q, 1, axis=0)) / (2 * DT)  # it has no end
    assert np.abs(v).max() > 0.05
    assert np.abs(rate - v).max() < DIFFERENCES * np.abs(v).max()
    assert np.ptp([arm.pose(one, TOOL).translation for one in q], axis=0).max() > 0.03
    controller = Controller(arm, [contact_mode(arm, TOOL, k)])
    memory = controller.start("contact", arm.home)
    terms = controller.engines["contact"].terms
    for i, moment in enumerate(moments[: SETTLED + 10]):
        measurement = Measurement(i * DT, moment.q, moment.v)
        _, report, memory = controller.step("contact", measurement, moment.references, memory)
        assert report.status is Status.OK
        assert not report.active or i < SETTLED
        V = frame_terms(arm.model, moment.q, moment.v, TOOL)
        A = terms["A0"]
        twist = (V.J @ moment.v)[: A.shape[1]]
        assert np.abs(A @ twist).max() < 1e-10 * max(np.abs(twist).max(), 1e-3)
        assert len(report.lam) == k
    assert all(
        not np.array_equal(one.references["motion"].X_WD, other.references["motion"].X_WD)
        for one, other in itertools.pairwise(moments)
    )


def test_a_humanoid_stands_where_it_stood_while_it_sways_and_reaches() -> None:
    robot, count = humanoid(), 400
    moments = standing_course(robot, count)
    assert [len(moments), robot.nv, robot.nu] == [count, 35, 29]
    poses = {
        space.frame: [robot.pose(moment.q, space.frame) for moment in moments]
        for space in (*SOLES.values(), HAND)
    }
    for sole in SOLES.values():
        stood = poses[sole.frame]
        off = [np.linalg.norm(pin.log6(stood[0].actInv(pose)).vector) for pose in stood]
        assert max(off) < 2e-4  # what steps of a millisecond leave of a foot that rests
    way = np.ptp([pose.translation for pose in poses[HAND.frame]], axis=0)
    assert (way > 0.01).all()


def test_the_wall_of_the_planar_arm_turns_before_its_tool_as_it_says() -> None:
    arm = load_robot("planar_2r")
    moments = course(arm, TOOL, 1)
    walls = [moment.references["wall"].arrays for moment in moments]
    for i in (100, 333, 800):
        V = (frame_terms(arm.model, moments[i].q, moments[i].v, TOOL).J @ moments[i].v)[:2]
        rate = (walls[i + 1]["A"] - walls[i - 1]["A"]) / (2 * DT)
        assert abs(walls[i]["A_dot_V"][0]) > 1e-3
        assert walls[i]["A_dot_V"] == pytest.approx(rate @ V, rel=DIFFERENCES)


def test_a_contact_that_no_arm_has_is_refused() -> None:
    with pytest.raises(InputError, match="k: got 2, allowed: 1, 3, 5"):
        contact_mode(load_robot("fr3"), TOOL, 2)


# The whole run -----------------------------------------------------------------------------


def test_a_run_has_every_line_with_figures_that_can_be_times(result: Result) -> None:
    names = {(row.section, row.name, row.joints, row.k) for row in result.rows}
    ticks = {("fr3", 7, 1), ("fr3", 7, 3), ("fr3", 7, 5), ("planar_2r", 2, 1), ("serial 9", 9, 3)}
    ticks.add((HUMANOID, 35, ROWS))
    assert {name[1:] for name in names if name[0] == "tick"} == ticks
    for section, count in (("saturated", 5), ("paced", 2), ("simulation", 4)):
        assert len(result.of(section)) == count
    for solver in TINY.solvers:
        for limits in ("no limit", "2 limits"):
            assert ("solver", f"{solver}, {limits}", 7, 3) in names
            assert ("solver", f"{solver}, {limits}, alone", 7, 3) in names
    parts = {row.name for row in result.of("part")}
    assert {"whole tick", "Python around them", "graph"} <= parts
    assert {"certificate", "dynamics alone"} <= parts  # a QP is solved where a limit binds
    for row in result.rows:
        assert math.isfinite(row.median_us), row.name
        assert 0 < row.median_us <= row.timing.max_us, row.name


def test_residuals_are_those_of_the_default_solver_and_limits_bind(result: Result) -> None:
    for row in (*result.of("tick"), *result.of("saturated"), *result.of("paced")):
        assert 0 < row.facts["kkt_max"] <= DEFAULT_KKT, row.name
        assert row.facts["fallback_ticks"] == 0
    assert all(row.facts["ratio"] > 0 for row in result.of("saturated"))
    active = {row.name: row.facts["limits_mean"] for row in result.of("saturated")}
    assert [active[f"{count} limited"] for count in COUNTS] == [0, 1, 2, 3]
    alone = [row for row in result.of("solver") if row.name.endswith("alone")]
    assert all(0 < row.facts["kkt_max"] < 1e-6 for row in alone)


COUNTS = ("no joint", "1 joint", "2 joints", "3 joints")


def test_results_are_json_tables_and_a_page(result: Result, tmp_path: Path) -> None:
    write_result(result, render_page(result), tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["bench.html", "bench.json"]
    kept = json.loads((tmp_path / "bench.json").read_text())
    assert len(kept["rows"]) == len(result.rows)
    assert {"median_us", "p99_us", "p999_us", "max_us", "samples"} <= set(kept["rows"][0])
    assert kept["plan"]["ticks"] == TINY.ticks
    page = (tmp_path / "bench.html").read_text()
    for sheet in sheets(result):
        assert sheet.title in page
        assert all(len(line) == len(sheet.heads) for line in sheet.lines)
    assert "n³" in page


def test_what_a_compiled_tick_is_made_of_is_timed_in_c() -> None:
    suite = Suite(plan=TINY, watch=lambda _: None)
    loop = suite.loop("planar_2r", 1, compiled=True)
    parts, qp = PartTrial(loop, TOOL, 50), InnerQpTrial("QP", loop, 50)
    take_turns([parts, qp], Rounds(rounds=2, longest=1.0, usual=50))
    rows = {row.name: row for row in parts.rows()}
    assert {
        "whole tick",
        "Python around them",
        "call",
        "graph",
        "QP",
        "certificate",
    } <= set(rows)
    assert rows["call"].facts["taken_off_us"] == 0
    assert rows["graph"].facts["taken_off_us"] > 0
    assert rows["call"].median_us < rows["whole tick"].median_us
    assert 0 < qp.row().facts["kkt_max"] <= DEFAULT_KKT
    engine = loop.controller.engines["contact"]
    before = [engine.parts.named["tau_qp"].copy(), engine.parts.named["kkt"].copy()]
    for call in calls_of(engine).values():
        call()
    assert np.array_equal(engine.parts.named["tau_qp"], before[0])
    assert np.array_equal(engine.parts.named["kkt"], before[1])


def test_without_a_compiler_all_is_interpreted_and_said(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CC", "false")
    monkeypatch.setenv("QPCTRL_CACHE", str(tmp_path))
    suite = Suite(plan=TINY, watch=lambda _: None)
    add_case(suite, "planar_2r", 1, compiled=True, required=False)
    add_case(suite, "planar_2r", 1, compiled=False, required=False)
    assert [trial.loop.compiled for trial in suite.ticks] == [False]
    assert len(suite.notes) == 1
    assert suite.notes[0].startswith("planar_2r, k = 1, only interpreted: ")
    with pytest.raises(InputError, match="cannot be compiled"):
        add_case(suite, "planar_2r", 1, compiled=True, required=True)


def test_goals_say_what_is_missed() -> None:
    facts = {"kkt_max": 1e-15}
    slow = timing(np.full(1001, 7e3), [False] * 1001)
    rows = [
        Row(section="tick", name="fr3", joints=7, k=3, compiled=True, timing=slow, facts=facts),
        Row(section="saturated", name="none", timing=slow, facts={"ratio": 1.0}),
        Row(section="saturated", name="3", timing=slow, facts={"ratio": 1.5}),
        Row(section="simulation", name="eraser", timing=slow, facts={"realtime_factor": 40.0}),
        Row(section="peer", name="qpctrl, met", timing=slow, facts={"ours_over_tsid": 0.5}),
    ]
    found = {goal.name: goal for goal in goals(rows, ())}
    assert [(goal.value, goal.passed) for goal in found.values()] == [
        *((7.0, False), (7.0, True), (1e-15, True)),
        *((1.5, True), (0.025, True), (0.5, False)),
    ]
    assert "our tick over TSID's, met" in found


def test_peers_need_an_environment(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="run make peers"):
        bench_command(["--peers"])


def test_what_peers_leave_out_stands_below_their_table(result: Result) -> None:
    ours = Row(section="peer", name="qpctrl, met", timing=timing([5e3]), facts={})
    theirs = Row(section="peer", name="tsid, met", timing=timing([9e3]), facts={"over_ours": 1.8})
    left_out = ("TSID leaves out <the certificate>.",)
    both = replace(result, rows=(*result.rows, ours, theirs), left_out=left_out)
    sheet = next(sheet for sheet in sheets(both) if sheet.title.startswith("Beside the peers"))
    assert sheet.remarks == left_out
    assert [line[0] for line in sheet.lines] == ["qpctrl, met", "tsid, met"]
    assert "1.8" in sheet.lines[1]
    assert "TSID leaves out &lt;the certificate&gt;." in render_page(both)
    assert not any(sheet.title.startswith("Beside") for sheet in sheets(result))


def test_a_folder_that_cannot_take_the_results_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bench.json").mkdir()
    with pytest.raises(InputError, match=r"bench\.json is a folder there"):
        usable_folder(tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--ticks", "0"], "ticks: got 0, need a number >= 1"),
        (["--rounds", "-1"], "rounds: got -1"),
        (["--solvers", "daqq"], "did you mean 'daqp'"),
        (["--out", "/proc/nowhere"], "output folder"),
        (["--compiled", "maybe"], "compiled"),
        (["--tick", "5"], "did you mean '--ticks'"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message) as refused:
        bench_command(arguments)
    assert "\n" not in str(refused.value)
