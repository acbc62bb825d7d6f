"""Tipping over an edge: contact changes, torque stays smooth, pressure goes where it is sent."""

import functools
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
import oracles
import polars as pl
import pytest

from qpctrl import InputError
from scenarios.catalogue import SCENARIOS
from scenarios.edge import Edge
from scenarios.plant_mujoco import MujocoPlant
from scenarios.run import run_scenario
from scenarios.scenario import Options, Outcome
from scenarios.simulation import simulate
from scenarios.tipping import FREE
from scenarios.world import EDGE, TOOL, build_world

STEPS = ("touch", "press", "lean", "tip", "hold", "return", "feel", "spread")
RATE = 1.0  # Nm, the torque-rate limit of this arm over one tick
TRACKING = 0.02
"""deg: what feedback leaves of the moments of a contact that the model does not have."""


class Truth(NamedTuple):
    """What the simulator knows at one tick, beyond the sensor."""

    points: np.ndarray
    """Contact points (m×3) [m], along the axes of the board."""
    forces: np.ndarray
    """Normal force at each (m) [N]."""


@functools.cache
def run() -> tuple[Outcome, list[Truth]]:
    """Return the run and the contacts of each tick, made once."""
    experiment, truths = Edge().prepare(Options()), []
    plant, X_WE = experiment.plant, experiment.geometry["X_WE"]
    honest_reset, honest_step = plant.reset, plant.step

    def seen(state):
        data, wrench = plant._data, np.zeros(6)
        contacts = range(data.ncon)
        points = [(data.contact[i].pos - X_WE[:3, 3]) @ X_WE[:3, :3] for i in contacts]
        forces = []
        for i in contacts:
            mujoco.mj_contactForce(plant._model, data, i, wrench)
            forces.append(wrench[0])
        truths.append(Truth(np.array(points).reshape(-1, 3), np.array(forces)))
        return state

    plant.reset = lambda q: seen(honest_reset(q))
    plant.step = lambda tau: seen(honest_step(tau))
    prepared = functools.partial(lambda options: experiment)
    scenario = Edge()
    object.__setattr__(scenario, "prepare", prepared)
    return run_scenario(scenario, Options()), truths


def table() -> pl.DataFrame:
    """Return the record."""
    return run()[0].table


def when(phase: str) -> np.ndarray:
    """Return the ticks of a phase."""
    return np.flatnonzero((table()["phase"] == phase).to_numpy())


def tipped(i: int) -> float:
    """Return the angle [deg] between tool and board at tick ``i``, with pinocchio."""
    experiment = run()[0].experiment
    robot, normal = experiment.robot, experiment.geometry["X_WE"][:3, 2]
    q = np.array(table().select(f"q.{joint}" for joint in robot.joint_names).row(i))
    R_WF = oracles.frame_terms(robot.model, q, np.zeros(7), EDGE).X_WF.rotation
    return float(np.degrees(np.arccos(np.clip(R_WF[:, 2] @ normal, -1, 1))))


def test_the_edge_meets_its_own_criteria_and_goes_through_every_phase() -> None:
    outcome = run()[0]
    assert outcome.passed, outcome.summary["criteria"]
    assert tuple(table()["phase"].unique(maintain_order=True)) == STEPS
    modes = table()["mode"].rle().struct.field("value").to_list()
    assert modes == [FREE, "face", "line", "face"]
    assert table()["contact"].rle().struct.field("value").to_list() == ["TOUCH", "PRESS"]
    rows = [name for name in table().columns if name.startswith("lam.")]
    counts = np.isfinite(table().select(rows).to_numpy()).sum(axis=1)
    assert [counts[when(p)[-1]] for p in ("touch", "lean", "hold", "spread")] == [0, 3, 2, 3]


def test_the_tool_tips_by_twenty_degrees_and_comes_back() -> None:
    held = [tipped(i) for i in when("hold")[::50]]
    assert held == pytest.approx([20.0] * len(held), abs=0.5)
    assert tipped(len(table()) - 1) < 0.1
    for phase in ("tip", "hold", "return", "feel"):
        error = np.degrees(table()["motion.X_e.3"].to_numpy()[when(phase)])
        assert np.abs(error).max() < TRACKING


def test_the_pad_truly_stands_on_four_corners_then_two_then_four() -> None:
    truths = run()[1]
    flat, tipped_, back = (truths[when(phase)[-1]] for phase in ("press", "hold", "spread"))
    assert [len(truth.points) for truth in (flat, tipped_, back)] == [4, 2, 4]
    assert np.sort(tipped_.points[:, 0]) == pytest.approx([-0.06, 0.06], abs=1e-4)
    assert tipped_.points[:, 1] == pytest.approx([0.025, 0.025], abs=1e-4)  # one long edge
    assert tipped_.forces == pytest.approx([5.0, 5.0], abs=0.1)
    assert all(len(truth.points) for truth in truths[when("press")[0] :])  # never in the air


def test_the_pressure_goes_to_the_edge_and_returns_to_the_middle() -> None:
    def centre(i: int) -> float:
        points, forces = run()[1][i]
        return float(forces @ points[:, 1] / forces.sum())

    assert centre(when("press")[-1]) == pytest.approx(0.0, abs=5e-4)
    assert centre(when("lean")[-1]) == pytest.approx(0.025, abs=2.5e-3)
    assert centre(when("spread")[-1]) == pytest.approx(0.0, abs=1e-3)
    metrics = run()[0].summary["metrics"]  # from the sensor's moment
    assert metrics["pressure_to_edge_mm"] == pytest.approx(
        1e3 * abs(0.025 - centre(when("lean")[-1])), abs=0.1
    )


def test_the_force_on_the_edge_is_the_set_point_while_it_tips() -> None:
    truths = run()[1]
    for phase in ("tip", "hold", "return", "feel"):
        force = np.array([truths[i].forces.sum() for i in when(phase)])
        assert force == pytest.approx(np.full(len(force), 10.0), abs=0.1)


def test_no_torque_jumps_where_the_contact_changes() -> None:
    joints = run()[0].experiment.robot.joint_names
    tau = table().select(f"tau.{joint}" for joint in joints).to_numpy()
    step = np.abs(np.diff(tau, axis=0)).max(axis=1)
    mode = table()["mode"].to_numpy()
    switches = np.flatnonzero(mode[1:] != mode[:-1])
    metrics = run()[0].summary["metrics"]
    assert len(switches) == 3
    assert metrics["torque_step_max"] == pytest.approx(step.max() / RATE)
    assert metrics["torque_step_switch_max"] == pytest.approx(step[switches].max() / RATE)
    assert step.max() < 0.2 * RATE
    bound = set(",".join(table()["active"].unique().to_list()).split(", "))
    assert not any("torque" in name for name in bound)  # the limit is not what makes it smooth


def test_another_arm_tips_faster_on_a_smooth_board() -> None:
    outcome = run_scenario(Edge(robot="ur5", angle=10.0, rate=40.0, friction=0.0), Options())
    assert not [c for c in outcome.summary["criteria"] if not c["passed"]]


def test_the_wrench_is_given_at_the_frame_that_was_asked_for() -> None:
    world = build_world("fr3")
    states = []
    for frame in (TOOL, EDGE):
        plant = MujocoPlant(world, frame=frame)
        plant.reset(world.robot.home)
        plant.push_tool(np.array([3.0, -4.0, 5.0, 0.1, 0.2, -0.3]))
        states.append(plant.step(plant._data.qfrc_bias).wrench)
    force = states[0][:3]
    assert np.linalg.norm(force) > 5
    assert states[1][:3] == pytest.approx(force, abs=1e-9)
    lever = np.array([0.0, -0.025, 0.0])  # from the edge to the middle
    assert states[1][3:] == pytest.approx(states[0][3:] + np.cross(lever, force), abs=1e-9)
    with pytest.raises(InputError, match="unknown frame"):
        MujocoPlant(world, frame="eraser/corner")


def test_a_run_that_ends_early_fails_without_a_crash() -> None:
    scenario = Edge()
    experiment = replace(scenario.prepare(Options()), horizon=0.5)
    metrics = scenario.metrics(simulate(experiment))
    assert not all(criterion.passed for criterion in scenario.judge(metrics))


def test_the_pictures_show_angle_pressure_force_and_steps() -> None:
    panels = {panel.key: panel for panel in Edge().panels(run()[0])}
    assert list(panels) == ["tilt", "centre", "force", "step"]
    highest = {key: np.nanmax(panel.figure["data"][0]["y"]) for key, panel in panels.items()}
    assert highest["tilt"] == pytest.approx(20.0, abs=0.1)
    assert highest["centre"] == pytest.approx(25.0, abs=0.1)
    assert highest["force"] == pytest.approx(10.0, abs=0.2)
    assert 0.0 < highest["step"] < 0.2


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"force": 0.0}, "force: .*> 0"),
        ({"angle": -20.0}, "angle: .*> 0"),
        ({"angle": 1.0}, "angle: got 1.0, need 1.5 < angle <= 60 deg"),
        ({"angle": 90.0}, "angle: got 90.0, need 1.5 <"),
        ({"rate": float("nan")}, "rate: .*finite"),
        ({"friction": -0.1}, "friction: .*>= 0"),
    ],
    ids=str,
)
def test_the_edge_refuses_what_makes_no_sense(wrong, words: str) -> None:
    assert SCENARIOS["edge"] is Edge
    with pytest.raises(InputError, match=words) as refused:
        Edge(**wrong)
    assert "\n" not in str(refused.value)
