"""Beside the peers, without their environments: the problem, what they are handed, their faults."""

import ast
import json
import re
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from qpctrl import Controller, InputError, Measurement, from_pinocchio
from scenarios.bench.course import Given
from scenarios.bench.peers import our_loops, our_round, peer_rounds, pythons
from scenarios.bench.peers.agreement import agreement
from scenarios.bench.peers.environment import STAMP, python_of
from scenarios.bench.peers.folder import MET, SATURATED, UNSATURATED, Course, courses, write
from scenarios.bench.peers.humanoid import humanoid
from scenarios.bench.peers.ours import Answer, contact_mode, moments
from scenarios.bench.peers.problem import (
    FORCE,
    FRICTION,
    LEAD,
    MOTION_GAINS,
    Problem,
    pose_problem,
)
from scenarios.bench.peers.rounds import OURS, over_rounds
from scenarios.bench.peers.run import SCRIPTS, PeerCourse, PeerError, run_peer
from scenarios.bench.peers.urdf import robot_urdf
from scenarios.bench.row import Row
from scenarios.bench.timing import Timing
from scenarios.robot_file import load_robot

ROUND_OFF = 1e-10
"""M [kg m²], h [Nm] and J of a model that was written and read: numbers keep all their digits."""
STILL = 1e-6
"""Speed [m/s] of a point that rests."""
DIFFERENCES = 1e-3
"""A derivative by central differences over 2 ms, over its largest entry."""
SAME = 1e-7
"""Torque [Nm] and force [N]; the oracle's QP solver stops at a KKT residual of 1e-9 of its own
costs, whose smallest weight is 1."""

TICKS = 200
SIZE = (TICKS / 4000) ** 2  # as much torque as on the whole way

ORACLE = f"""
import sys
sys.path.insert(0, {str(SCRIPTS)!r})
import numpy as np, pinocchio as pin, timed
from qpsolvers import solve_qp

problem = timed.given()
facts, given = problem.facts, problem.arrays
model = pin.buildModelFromXML((problem.folder / "robot.urdf").read_text())
model.armature = np.array(facts["armature"])
data, at = model.createData(), model.getFrameId(facts["frame"])
nv, world = model.nv, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

def terms(q, v):
    M = np.triu(pin.crba(model, data, q))
    return M + np.triu(M, 1).T, np.array(pin.nonLinearEffects(model, data, q, v))

def answer(k, variant):
    q, v = given["q"][k], given["v"][k]
    M, h = terms(q, v)
    J = pin.computeFrameJacobian(model, data, q, at, world)
    pin.forwardKinematics(model, data, q, v, np.zeros(nv))
    pin.updateFramePlacements(model, data)
    drift = pin.getFrameClassicalAcceleration(model, data, at, world).vector
    K_p, K_d = facts["motion_gains"]
    turn = K_p * pin.log3(given["R_WD"][k] @ data.oMf[at].rotation.T)
    turn += K_d * (given["omega"][k] - J[3:] @ v) + given["alpha"][k]
    K_p, K_d = facts["posture_gains"]
    lean = K_p * (np.array(facts["home"]) - q) - K_d * v
    weight = 1.0 if variant == "met" else 1e-4
    if variant == "met":
        lean = lean + given["met"][k]
    normal = np.array(facts["normal"])
    rows = np.vstack((np.hstack((J[3:], np.zeros((3, 3)))),
                      np.sqrt(weight) * np.eye(nv, nv + 3),
                      np.eye(3, nv + 3, nv)))
    wanted = np.concatenate((turn - drift[3:], np.sqrt(weight) * lean, facts["force"] * normal))
    torque = np.hstack((M, -J[:3].T))
    tau_max = np.array(facts["variants"][variant])
    x = solve_qp(rows.T @ rows, -rows.T @ wanted, np.vstack((torque, -torque)),
                 np.concatenate((tau_max - h, tau_max + h)),
                 np.hstack((J[:3], np.zeros((3, 3)))), -drift[:3], solver="daqp")
    return torque @ x + h, x[nv:]

def ticks(variant):
    def whole(k):
        tau, force = answer(k, variant)
        return True, tau, force
    return timed.Ticks(whole, {{"all": whole}}, None)

about = {{"versions": {{"oracle": "1"}}, "gaps": timed.model_gaps(problem, terms)}}
timed.run(problem, ticks, about)
"""
"""The peers' problem as TSID states it, on pinocchio and numpy, with daqp."""

STATED = """
import json, sys
import numpy as np
folder, out = sys.argv[-2:]
facts = json.load(open(folder + "/problem.json"))
found = {}
for name, tau_max in facts["variants"].items():
    n = facts["ticks"]
    found[name + " samples"] = np.full(n, 2000)
    found[name + " lost"] = np.zeros(n, dtype=bool)
    found[name + " solved"] = np.ones(n, dtype=bool)
    found[name + " tau"] = np.zeros((n, len(tau_max)))
    found[name + " force"] = np.zeros((n, 3))
    found[name + " parts"] = np.full((n, 2), (500, 1500))
about = {"versions": {"fake": "1"}, "gaps": {"M": 0.0, "h": 0.0}, "parts": ["half", "rest"]}
"""
"""Answers of two microseconds; what follows may spoil them."""
SAID = "np.savez(out, **found); print(json.dumps(about))\n"


@pytest.fixture(scope="module")
def problem() -> Problem:
    return pose_problem(load_robot("fr3"), "flange", TICKS, SIZE)


@pytest.fixture(scope="module")
def variants(problem: Problem) -> dict[str, Course]:
    return courses(problem)


@pytest.fixture
def folder(variants: dict[str, Course], tmp_path: Path) -> Path:
    write(variants, tmp_path, ticks=TICKS, core=None)
    return tmp_path


@pytest.fixture
def spoilt(variants: dict[str, Course], folder: Path) -> Callable[[str], None]:
    def run(script: str) -> None:
        path = folder / "script.py"
        path.write_text(script)
        torques = dict.fromkeys(variants, 7)
        run_peer("fake", Path(sys.executable), torques, folder, time_limit=20, script=path)

    return run


def slanted() -> pin.Model:
    """Return a branched model with a sliding joint and axes along no axis of a frame."""
    model, rng = pin.Model(), np.random.default_rng(3)
    axes = [pin.Quaternion(rng.normal(size=4)).normalized().toRotationMatrix()[0] for _ in range(4)]
    parents = (0, 1, 1, 3)
    for i, (axis, parent) in enumerate(zip(axes, parents, strict=True)):
        kind = pin.JointModelPrismaticUnaligned if i == 2 else pin.JointModelRevoluteUnaligned
        joint = model.addJoint(parent, kind(axis), pin.SE3.Random(), f"j{i}")
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Random())
    model.addFrame(pin.Frame("tool", 3, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    model.upperPositionLimit, model.lowerPositionLimit = np.full(4, 2.0), np.full(4, -1.0)
    return model


@pytest.mark.parametrize("name", ["fr3", "ur5", "planar_2r", "slanted"])
def test_a_written_robot_is_read_as_it_was(name: str) -> None:
    robot = from_pinocchio(slanted()) if name == "slanted" else load_robot(name)
    frame = "tool" if name == "slanted" else robot.frame_names[-1]
    read, rng = pin.buildModelFromXML(robot_urdf(robot, frame)), np.random.default_rng(0)
    data, other = robot.model.createData(), read.createData()
    local, theirs = robot.frame_id(frame), read.getFrameId(frame)
    assert tuple(read.names)[1:] == robot.joint_names
    for _ in range(10):
        q, v = rng.normal(size=robot.nv), rng.normal(size=robot.nv)
        M = np.triu(pin.crba(robot.model, data, q)) - np.diag(robot.model.armature)
        assert np.abs(np.triu(pin.crba(read, other, q)) - M).max() < ROUND_OFF
        h = pin.nonLinearEffects(robot.model, data, q, v)
        assert np.abs(pin.nonLinearEffects(read, other, q, v) - h).max() < ROUND_OFF
        assert np.abs(h).max() > 0.01
        J = pin.computeFrameJacobian(robot.model, data, q, local, pin.LOCAL)
        J_read = pin.computeFrameJacobian(read, other, q, theirs, pin.LOCAL)
        assert np.abs(J_read - J).max() < ROUND_OFF
    again = from_pinocchio(read).limits
    for limit in ("q_min", "q_max", "tau_max", "v_max"):
        assert getattr(again, limit) == pytest.approx(getattr(robot.limits, limit))


def test_the_states_satisfy_the_contact(problem: Problem) -> None:
    robot, world = problem.robot, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    data, fid = robot.model.createData(), robot.frame_id("flange")
    turned = []
    for q, v, R_WD in zip(problem.q, problem.v, problem.R_WD, strict=True):
        V = pin.computeFrameJacobian(robot.model, data, q, fid, world) @ v
        pin.framesForwardKinematics(robot.model, data, q)
        assert np.abs(V[:3]).max() < STILL
        assert np.abs(data.oMf[fid].translation - problem.X_WE.translation).max() < STILL
        turned.append((V[3:], pin.log3(R_WD @ data.oMf[fid].rotation.T)))
    speeds, errors = (np.array(part) for part in zip(*turned, strict=True))
    assert np.abs(speeds).max() > 0.05
    off = np.linalg.norm(errors, axis=1) / (LEAD * SIZE)
    assert off.min() > 0.5
    assert off.max() < 2.0


def test_velocities_are_derivatives_and_the_path_closes(problem: Problem) -> None:
    around = [np.roll(problem.q, shift, axis=0) for shift in (-1, 1)]
    slope = (around[0] - around[1]) / 2e-3
    assert np.abs(slope - problem.v).max() < DIFFERENCES * np.abs(problem.v).max() * 5
    turn = [pin.log3(b @ a.T) / 1e-3 for a, b in pairwise(problem.R_WD)]
    middle = (problem.omega[1:] + problem.omega[:-1]) / 2
    assert np.abs(np.array(turn) - middle).max() < 5 * DIFFERENCES * np.abs(middle).max()
    rate = (np.roll(problem.omega, -1, axis=0) - np.roll(problem.omega, 1, axis=0)) / 2e-3
    assert np.abs(rate - problem.alpha).max() < 1e-2 * np.abs(problem.alpha).max()


def test_our_answer_presses_turns_and_leans_as_asked(variants: dict[str, Course]) -> None:
    problem, answer = variants[UNSATURATED]
    model, data = problem.robot.model, problem.robot.model.createData()
    fid, world = problem.robot.frame_id("flange"), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    assert np.abs(answer.force + FORCE * problem.normal).max() < SAME
    for k in range(0, problem.ticks, 20):
        q, v = problem.q[k], problem.v[k]
        J = pin.computeFrameJacobian(model, data, q, fid, world)
        a = pin.aba(model, data, q, v, answer.tau[k] - J[:3].T @ answer.force[k])
        pin.forwardKinematics(model, data, q, v, a)
        pin.updateFramePlacements(model, data)
        V_dot = pin.getFrameClassicalAcceleration(model, data, fid, world)
        omega = J[3:] @ v
        off = pin.log3(problem.R_WD[k] @ data.oMf[fid].rotation.T)
        asked = problem.alpha[k] + np.cross(problem.omega[k], omega)
        asked = asked + MOTION_GAINS[0] * off + MOTION_GAINS[1] * (problem.omega[k] - omega)
        assert np.abs(V_dot.linear).max() < SAME
        assert np.abs(V_dot.angular - asked).max() < SAME
        assert np.abs(asked).max() > 0.01


def test_limits_bind_in_the_saturated_variant_alone(variants: dict[str, Course]) -> None:
    for name, bound in ((UNSATURATED, False), (SATURATED, True)):
        problem, answer = variants[name]
        share = np.abs(answer.tau) / problem.robot.limits.tau_max
        assert share.max() < 1 + SAME
        on_limit = (share > 1 - 1e-6).mean(axis=0)
        assert (on_limit > 0.1).sum() == (2 if bound else 0)


def test_friction_and_size_of_the_force_are_limited_along_the_plane(problem: Problem) -> None:
    controller = Controller(problem.robot, [contact_mode(problem)], dt=1e-3)
    for limit in ("tau_rate", "tau_max"):
        controller.engines["contact"].inputs[f"limits.{limit}"][:] = 1e9
    memory, first = controller.start("contact", problem.q[0]), moments(problem)[0]
    R_WF = problem.robot.pose(first.q, "flange").rotation
    for i, (x, z, pressed) in enumerate(
        ((40.0, 30.0, None), (-40.0, 30.0, None), (0.0, 500.0, 200.0), (0.0, -9.0, 1.0)), start=1
    ):
        wanted = R_WF.T @ problem.X_WE.rotation @ np.array([x, 0.0, z])
        force = {"F_ref": np.concatenate((wanted, np.zeros(3)))}
        references = {**first.references, "force": Given({**force, "F_meas": force["F_ref"]})}
        now = Measurement(i * 1e-3, first.q, first.v)
        _, report, memory = controller.step("contact", now, references, memory)
        assert report.active
        if pressed is None:
            assert report.lam[0] == pytest.approx(np.sign(x) * FRICTION * report.lam[2])
            assert report.lam[2] > 25.0
        else:
            assert report.lam[2] == pytest.approx(pressed)


def test_an_oracle_that_reads_the_folder_finds_our_answer(
    variants: dict[str, Course], tmp_path: Path
) -> None:
    script = tmp_path / "oracle.py"
    script.write_text(ORACLE)
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} {script} "$4" "$5"\n')
    python.chmod(0o755)
    people = {"tsid": python}
    found = peer_rounds(lambda variant, ticks: a_row(1.0), variants, people, rounds=1, ticks=10)
    assert found.faults == ()
    free, limited, met = found.agreements
    assert (free.variant, limited.variant, met.variant) == (UNSATURATED, SATURATED, MET)
    assert met.torque_Nm < SAME
    assert met.force_N < SAME
    # with limits, and with another posture, the tool still rests, and ours is the better answer
    assert free.torque_Nm > 10 * free.torque_beyond_elbow_Nm
    assert 0 < free.torque_beyond_elbow_Nm < 0.1
    assert limited.rest < SAME
    assert limited.limited > 0.5
    assert limited.dearer_most > limited.dearer_least >= -SAME
    assert limited.dearer_most > 1e-4
    assert found.versions == {"tsid": {"oracle": "1"}}
    side = found.side("tsid", SATURATED)
    assert side is not None
    assert 0 < side.timing.median_us < side.timing.max_us
    assert any("same problem" in words for words in found.left_out)


def test_a_wrong_mass_is_seen(variants: dict[str, Course], folder: Path) -> None:
    facts = json.loads((folder / "problem.json").read_text())
    facts["armature"][2] += 0.25
    (folder / "problem.json").write_text(json.dumps(facts))
    (folder / "oracle.py").write_text(ORACLE)
    torques = dict.fromkeys(variants, 7)
    run = run_peer("tsid", Path(sys.executable), torques, folder, script=folder / "oracle.py")
    assert run.M_gap == pytest.approx(0.25)
    assert run.h_gap < ROUND_OFF


def a_row(median: float) -> Row:
    timing = Timing(100, median, 2 * median, None, 3 * median)
    return Row(section="peer", name="ours", timing=timing, facts={"kkt_max": median * 1e-12})


def fake(folder: Path, name: str, script: str) -> Path:
    """Return a Python that runs ``script`` whatever it is told to run."""
    (folder / f"{name}.py").write_text(script)
    python = folder / name
    python.write_text(f'#!/bin/sh\nexec {sys.executable} {folder / name}.py "$@"\n')
    python.chmod(0o755)
    return python


def test_rounds_alternate_and_give_medians_over_them(
    variants: dict[str, Course], tmp_path: Path
) -> None:
    turns: list[str] = []
    medians = iter((1.0, 10.0, 5.0, 30.0, 3.0, 20.0))
    people = {name: fake(tmp_path, name, STATED + SAID) for name in ("tsid", "placo")}
    found = peer_rounds(
        lambda variant, ticks: a_row(next(medians)),
        variants,
        people,
        rounds=3,
        ticks=10,
        watch=turns.append,
    )
    assert turns[2:] == [OURS, "tsid", "placo"] * 3
    ours, theirs = found.side(OURS, UNSATURATED), found.side("placo", SATURATED)
    assert ours is not None
    assert theirs is not None
    assert [one.median_us for one in ours.rounds] == [1.0, 5.0, 3.0]
    assert ours.timing.median_us == 3.0
    assert theirs.timing.median_us == 2.0
    assert theirs.timing.samples == 30
    assert theirs.facts == {"half [µs]": 0.5, "rest [µs]": 1.5}
    assert found.ratio("tsid", UNSATURATED) == 1.5
    assert found.ratio("tsid", SATURATED) == 10.0
    rows = {row.name: row for row in found.rows(joints=7, compiled=True)}
    assert rows["qpctrl, saturated"].facts["ours_over_tsid"] == 10.0
    assert rows["qpctrl, saturated"].facts["kkt_max"] == pytest.approx(30e-12)
    assert rows["placo, unsaturated"].facts["over_ours"] == pytest.approx(2 / 3)
    assert rows["placo, unsaturated"].compiled is None


def test_a_peer_that_fails_is_named_once_and_the_rest_goes_on(
    variants: dict[str, Course], tmp_path: Path
) -> None:
    people = {
        "placo": fake(tmp_path, "placo", "raise SystemExit('out of luck')"),
        "tsid": fake(tmp_path, "tsid", STATED + SAID),
    }
    found = peer_rounds(lambda variant, ticks: a_row(1.0), variants, people, rounds=2, ticks=5)
    assert found.faults == ("peer 'placo': ended with code 1: out of luck",)
    assert {side.name for side in found.sides} == {OURS, "tsid"}
    assert found.ratio("placo", UNSATURATED) is None
    alone = peer_rounds(lambda variant, ticks: a_row(1.0), variants, {}, rounds=1, ticks=5)
    assert [side.name for side in alone.sides] == [OURS, OURS]
    with pytest.raises(InputError, match="rounds and ticks: got 0 and 5"):
        peer_rounds(lambda variant, ticks: a_row(1.0), variants, {}, rounds=0, ticks=5)


FAULTS = {
    "import os; os.abort()": "ended with code -6: nothing said",
    "1 / 0": "ended with code 1: ZeroDivisionError: division by zero",
    "": "makes no sense: it printed '', need one line of JSON",
    "print('hello')": "makes no sense: it printed 'hello', need one line of JSON",
    "print('[1, 2]')": "need versions, gaps and parts",
    STATED + "print(json.dumps(about))": "it wrote no times",
    STATED + "open(out, 'w').write('hello'); print(json.dumps(about))": "makes no sense",
    STATED + "about['gaps']['M'] = float('nan')\n" + SAID: "need a finite number",
    STATED + "about['gaps'] = None\n" + SAID: "makes no sense",
    STATED + "del found['met tau']\n" + SAID: "met tau is missing",
    STATED + "found['met tau'] = found['met tau'][:, 1:]\n" + SAID: "met tau: got float64 of shape",
    STATED + "found['met tau'][3, 1] = np.nan\n" + SAID: "whose answer is not finite",
    STATED + "found['met samples'][2] = 0\n" + SAID: "need times above zero",
    STATED + "found['met samples'] = np.zeros(0)\n" + SAID: "need times above zero",
    STATED + "found['met parts'] = np.array('x')\n" + SAID: "met parts: got <U1 of shape",
    STATED + "found['met force'] = np.array([{}], dtype=object)\n" + SAID: "makes no sense",
}


@pytest.mark.parametrize("script", FAULTS)
def test_a_peer_that_makes_no_sense_is_told_in_one_line(
    script: str, spoilt: Callable[[str], None]
) -> None:
    with pytest.raises(PeerError, match=re.escape(FAULTS[script])) as error:
        spoilt(script)
    assert str(error.value).startswith("peer 'fake': ")
    assert "\n" not in str(error.value)


def test_ticks_without_a_solution_are_counted_not_compared(
    variants: dict[str, Course], tmp_path: Path
) -> None:
    some = "found['saturated solved'][:4] = False; found['saturated tau'][:4] = np.nan\n"
    people = {"tsid": fake(tmp_path, "tsid", STATED + some + SAID)}
    found = peer_rounds(lambda variant, ticks: a_row(1.0), variants, people, rounds=1, ticks=5)
    by_variant = {one.variant: one for one in found.agreements}
    assert by_variant[SATURATED].unsolved == 4
    assert by_variant[UNSATURATED].unsolved == 0
    largest = np.abs(variants[SATURATED].answer.tau[4:]).max()
    assert by_variant[SATURATED].torque_Nm == pytest.approx(largest)
    assert by_variant[SATURATED].force_N == pytest.approx(
        np.abs(variants[SATURATED].answer.force[4:]).max()
    )
    assert "4 ticks without a solution, saturated" in " ".join(found.left_out)


def test_a_peer_that_hangs_is_ended(folder: Path) -> None:
    (folder / "script.py").write_text("import time; time.sleep(60)")
    started = time.monotonic()
    with pytest.raises(PeerError, match=r"peer 'tsid': no answer within 0\.5 s"):
        run_peer(
            *("tsid", Path(sys.executable), {UNSATURATED: 7}, folder),
            time_limit=0.5,
            script=folder / "script.py",
        )
    assert time.monotonic() - started < 30


def test_answers_of_an_earlier_run_are_not_taken_for_new(
    spoilt: Callable[[str], None],
) -> None:
    spoilt(STATED + SAID)
    with pytest.raises(PeerError, match="it wrote no times"):
        spoilt(STATED + "print(json.dumps(about))")


def test_a_python_that_cannot_start_is_named(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(PeerError, match="peer 'tsid': cannot be started"):
        run_peer("tsid", tmp_path / "none", {UNSATURATED: 7}, folder)


def test_the_humanoid_says_where_its_environment_comes_from(tmp_path: Path) -> None:
    with pytest.raises(PeerError, match="peer 'tsid, humanoid': ended with code 1: Module"):
        humanoid(Path(sys.executable), ticks=2)
    short = STATED.replace("len(tau_max)", "32") + SAID
    row = humanoid(fake(tmp_path, "python", short), ticks=20)
    assert (row.joints, row.timing.median_us, row.facts["unsolved"]) == (38, 2.0, 0)


def test_environments_are_found_when_they_are_complete(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"peer 'tsid': no complete environment .* make peers"):
        python_of("tsid", tmp_path)
    home = tmp_path / "tsid" / "bin"
    home.mkdir(parents=True)
    (home / "python").touch()
    found, faults = pythons(folder=tmp_path)
    assert found == {}
    assert [words.split(":")[0] for words in faults] == ["peer 'tsid'", "peer 'placo'"]
    (tmp_path / "tsid" / STAMP).touch()
    found, faults = pythons(folder=tmp_path)
    assert found == {"tsid": home / "python"}
    assert len(faults) == 1
    for unknown in (python_of, lambda peer, where: pythons([peer], where)):
        with pytest.raises(InputError, match=r"unknown peer 'tsidd'.*did you mean 'tsid'"):
            unknown("tsidd", tmp_path)


def test_our_turn_times_each_variant_with_its_limits(variants: dict[str, Course]) -> None:
    run = our_round(our_loops(variants, compiled=False))
    free, limited = run(UNSATURATED, 60), run(SATURATED, 60)
    assert (free.timing.samples, free.k, free.joints) == (60, 3, 7)
    assert free.facts["fallback_ticks"] == limited.facts["fallback_ticks"] == 0
    assert float(limited.facts["limits_mean"] or 0) > float(free.facts["limits_mean"] or 0) == 0


def test_figures_over_rounds_are_medians_and_largest() -> None:
    rounds = (
        Timing(10, 1.0, 2.0, None, 50.0, 1, None, 4.0),
        Timing(10, 3.0, 9.0, None, 20.0, 2, None, 7.0),
        Timing(20, 2.0, 4.0, 5.0, 30.0, None, None, None),
    )
    assert over_rounds(rounds) == Timing(40, 2.0, 4.0, 5.0, 50.0, 3, None, 7.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"ticks": 101}, "ticks: got 101, need an even number >= 100"),
        ({"ticks": 10}, "ticks: got 10"),
        ({"robot": "planar_2r"}, "has 2 joints, need 6 or more"),
        ({"frame": "nose"}, "unknown frame 'nose'"),
    ],
)
def test_a_problem_that_cannot_be_posed_is_refused(change: dict[str, str], words: str) -> None:
    given = {"robot": "fr3", "frame": "flange", "ticks": 100, **change}
    with pytest.raises(InputError, match=re.escape(words)):
        pose_problem(load_robot(given["robot"]), given["frame"], given["ticks"])


def test_a_wrong_answer_is_seen(variants: dict[str, Course]) -> None:
    course = variants[UNSATURATED]
    nudge = np.zeros(7)
    nudge[3] = 0.5
    wrong = Answer(course.answer.tau + nudge, course.answer.force - np.array([0.0, 2.0, 0.0]))
    solved = np.arange(TICKS) == 7
    given = PeerCourse(timing=a_row(1.0).timing, parts_us={}, answer=wrong, solved=solved)
    found = agreement("tsid", UNSATURATED, course, course.answer, given)
    assert found.torque_Nm == pytest.approx(0.5)
    assert found.force_N == pytest.approx(2.0)
    assert found.rest > 0.1
    assert found.unsolved == TICKS - 1
    cost = cost_of(course.problem, 7, nudge, np.array([0.0, -2.0, 0.0]))
    assert (found.dearer_least, found.dearer_most) == pytest.approx((cost, cost))


def cost_of(problem: Problem, k: int, d_tau: np.ndarray, d_force: np.ndarray) -> float:
    """Return what the QP's three costs are beside their minimum, each in its own metric."""
    model, data, q = problem.robot.model, problem.robot.model.createData(), problem.q[k]
    M = np.triu(pin.crba(model, data, q))
    M = M + np.triu(M, 1).T
    at, world = problem.robot.frame_id("flange"), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    J = pin.computeFrameJacobian(model, data, q, at, world)
    Lambda_inv = J @ np.linalg.inv(M) @ J.T
    a = np.linalg.inv(M) @ (d_tau - J[:3].T @ d_force)
    free = (np.eye(7) - np.linalg.inv(M) @ J.T @ np.linalg.inv(Lambda_inv) @ J) @ a
    wrench = np.concatenate((d_force, np.zeros(3)))
    moved = J @ a @ np.linalg.inv(Lambda_inv) @ J @ a
    return float(moved + wrench @ Lambda_inv @ wrench + free @ M @ free) / 2


STANDARD = {"gc", "json", "os", "resource", "sys", "time", "collections", "importlib", "pathlib"}
SCRIPTS_OF_PEERS = ("timed.py", "tsid_tick.py", "tsid_humanoid.py", "placo_tick.py")


@pytest.mark.parametrize("script", SCRIPTS_OF_PEERS)
def test_scripts_of_the_peers_need_nothing_of_ours(script: str) -> None:
    found = set()
    for node in ast.walk(ast.parse((SCRIPTS / script).read_text())):
        if isinstance(node, ast.Import):
            found |= {name.name.partition(".")[0] for name in node.names}
        if isinstance(node, ast.ImportFrom):
            found.add((node.module or ".").partition(".")[0])
    allowed = {"numpy", "pinocchio", "timed", "typing", script.partition("_")[0]}
    assert found <= STANDARD | allowed


@pytest.mark.parametrize("name", ["tsid.txt", "placo.txt", "humanoid.txt"])
def test_environments_are_pinned(name: str) -> None:
    lines = (SCRIPTS / name).read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert pins
    assert all(re.fullmatch(r"[\w-]+==[\w.]+", line) for line in pins)


def test_another_limit_is_another_problem(variants: dict[str, Course]) -> None:
    free, limited = (variants[name].problem.robot.limits for name in (UNSATURATED, SATURATED))
    changed = free.tau_max != limited.tau_max
    assert changed.sum() == 2
    assert (limited.tau_max[changed] < free.tau_max[changed]).all()
    assert replace(limited, tau_max=free.tau_max).tau_rate == pytest.approx(free.tau_rate)
