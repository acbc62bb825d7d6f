"""Pure force control against springs: what each law of force does with a gravity error."""

import json
import math

import numpy as np
import pinocchio as pin
import polars as pl
import pytest

from qpctrl import ContactPhase, InputError
from scenarios.environment import Springs
from scenarios.plant_compliant import CompliantPlant
from scenarios.press import GAINS, SETTLE_TIME, Press
from scenarios.robot_file import load_robot
from scenarios.run import run_scenario
from scenarios.scenario import Options, Outcome
from scenarios.simulation import simulate

SETTLED = 1e-3
"""N: what the springs' own motion leaves 1 s after a change without an integral."""

SHORT = 1.5  # s of pressing
AXES = ("fx", "fy", "fz", "mx", "my", "mz")
LAWS = tuple(GAINS)
PRESS, LOSS = ContactPhase.PRESS, ContactPhase.LOSS


def error(table: pl.DataFrame) -> np.ndarray:
    """Return measured − desired wrench (ticks×6)."""
    measured = table.select(f"wrench_meas.{axis}" for axis in AXES).to_numpy()
    return measured - table.select(f"force.F_des.{i}" for i in range(6)).to_numpy()


def run(**parameters) -> Outcome:
    """Return a short run."""
    return run_scenario(Press(**{"duration": SHORT, **parameters}), Options())


@pytest.mark.parametrize("feedback", LAWS)
def test_press_meets_its_criteria(feedback: str) -> None:
    outcome = run(feedback=feedback)
    assert not [c for c in outcome.summary["criteria"] if not c["passed"]]


@pytest.mark.parametrize("k_fp", [0.0, 0.5])
def test_without_integral_the_weight_stays_divided_by_one_plus_the_gain(k_fp: float) -> None:
    table = run(feedback="feedforward", k_fp=k_fp, payload_error=0.8).table
    found = error(table)[-1]
    weight = 0.8 * 9.81 / (1 + k_fp)
    assert np.linalg.norm(found[:3]) == pytest.approx(weight, abs=SETTLED)
    assert found[0] == pytest.approx(-weight, rel=1e-3)  # at home the flange's x axis points up
    assert np.abs(found[3:]).max() < SETTLED


@pytest.mark.parametrize(("k_fp", "k_fi"), [(0.5, 2.0), (0.0, 2.0), (0.25, 1.0)])
def test_pi_removes_the_error_at_its_rate(k_fp: float, k_fi: float) -> None:
    table = run(feedback="pi", k_fp=k_fp, k_fi=k_fi).table
    along = error(table)[:, 0]
    early, late = along[500], along[1500]  # 1 s apart, while the set-point is zero
    assert math.log(early / late) == pytest.approx(k_fi / (1 + k_fp), rel=0.02)


def test_the_measured_wrench_reaches_every_component_of_the_set_point() -> None:
    force = (-4.0, 6.0, 8.0, 0.5, -0.4, 0.2)
    table = run(force=force, payload_error=0.0).table
    measured = [table[f"wrench_meas.{axis}"][-1] for axis in AXES]
    assert measured == pytest.approx(list(force), abs=5e-3)


def bounded(*, integral_max: float, freeze: bool) -> np.ndarray:
    """Return the force error along the weight (ticks) of a PI run with a bound or a freeze."""
    scenario = Press(feedback="pi", k_fp=0.0, k_fi=2.0, duration=1.0)
    experiment = scenario.prepare(Options())
    experiment.controller.engines["tied"].inputs["force.integral_max"][...] = integral_max
    if freeze:
        direct = experiment.guide.direct

        def lost(state):
            directive = direct(state)
            return directive and directive._replace(contact=PRESS if state.time < 0.5 else LOSS)

        object.__setattr__(experiment.guide, "direct", lost)
    return error(simulate(experiment))[:, 0]


def test_a_saturated_integral_removes_just_its_share() -> None:
    found = bounded(integral_max=1.0, freeze=False)
    assert found[-1] == pytest.approx(-(0.5 * 9.81 - 2.0 * 1.0), abs=SETTLED * 5)


def test_a_frozen_integral_holds_the_force_error() -> None:
    found = bounded(integral_max=50.0, freeze=True)
    assert found[510] == pytest.approx(-0.5 * 9.81 * math.exp(-2.0 * 0.5), rel=0.02)
    assert found[1900] == pytest.approx(found[600], rel=1e-3)
    assert np.abs(np.diff(found[600:1900])).max() < SETTLED


def test_the_spring_plant_rests_where_its_springs_carry_the_payload() -> None:
    robot = load_robot("fr3")
    K, D = np.repeat([1e4, 1e3], 3), np.repeat([800.0, 40.0], 3)
    plant = CompliantPlant(robot, "flange", Springs(K, D), payload=1.0)
    state = plant.reset(robot.home)
    X_WA, data = robot.pose(robot.home, "flange"), robot.model.createData()
    for _ in range(1500):
        brake = pin.rnea(robot.model, data, state.q, np.zeros(7), np.zeros(7)) - 5.0 * state.v
        state = plant.step(brake)
    sag = robot.pose(state.q, "flange").translation - X_WA.translation
    assert sag == pytest.approx([0.0, 0.0, -9.81 / 1e4], abs=2e-5)
    assert state.wrench_meas[:3] == pytest.approx([-9.81, 0.0, 0.0], abs=2e-2)


def test_the_report_is_written_without_a_board(tmp_path) -> None:
    run_scenario(Press(duration=0.5), Options(), out=tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Steady force error against its closed form" in page
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["metrics"]


def test_two_runs_are_the_same_but_for_timing() -> None:
    first, second = (run(duration=0.3).table.drop("tick_us") for _ in range(2))
    assert first.equals(second, null_equal=True)
    assert first["time"][-1] == pytest.approx(SETTLE_TIME + 0.3, abs=2e-3)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"stiffness": -1.0}, "stiffness: .*values > 0"),
        ({"stiffness_rot": math.nan}, "stiffness_rot: .*finite"),
        ({"spring_damping": -1.0}, "spring_damping: .*>= 0"),
        ({"payload_error": math.nan}, "payload_error: .*finite"),
        ({"k_fp": -0.1}, "k_fp: .*>= 0"),
        ({"force": (1.0, 2.0)}, "force: got 2 numbers, need 6"),
        ({"force": (math.inf, *[0.0] * 5)}, "force: .*finite"),
        ({"duration": 1e5}, "0.3 to 3600"),
        ({"feedback": "pid"}, "feedback: got 'pid'"),
    ],
    ids=str,
)
def test_what_cannot_be_used_is_refused_in_one_line(wrong, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        Press(**wrong)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"robot": "planar_2r"}, "six directions"),
        ({"robot": "ur5", "home": (0.0, -1.2, 1.5, 0.0, 0.0, 0.0)}, "six directions"),
        ({"tool": "nothing"}, "unknown frame"),
    ],
    ids=str,
)
def test_a_robot_that_cannot_press_everywhere_is_refused(wrong, words: str) -> None:
    with pytest.raises(InputError, match=words):
        Press(**wrong).prepare(Options())


@pytest.mark.parametrize(
    ("wrong", "words"),
    [({"substeps": 0}, "substeps"), ({"payload": -1.0}, "payload"), ({"dt": 0.0}, "dt")],
    ids=str,
)
def test_the_spring_plant_refuses_what_it_cannot_use(wrong, words: str) -> None:
    with pytest.raises(InputError, match=words):
        CompliantPlant(load_robot("fr3"), "flange", Springs(np.ones(6), np.ones(6)), **wrong)
