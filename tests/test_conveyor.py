"""Wiping a board that moves: what exact knowledge of v_c gives, and what the textbook law loses."""

import functools
from dataclasses import replace

import numpy as np
import oracles
import pinocchio as pin
import polars as pl
import pytest
from runs import Ran, ran

from qpctrl import InputError, Robot
from qpctrl.constraint import FaceOnPlane, Moving, row_function
from scenarios.catalogue import SCENARIOS
from scenarios.conveyor import Conveyor, ConveyorJob
from scenarios.guided import FLANGE, PRESS_TIME
from scenarios.metric import rms_norm
from scenarios.plant_rigid import RigidPlant
from scenarios.ride import board_speed
from scenarios.robot_file import load_robot
from scenarios.scenario import Options, Outcome
from scenarios.simulation import simulate

EARLY = PRESS_TIME + 0.7  # s: far enough to compare laws, and cheaper
STEP = 1e-4  # s, of the central differences
FIRST, SECOND = 1e-6, 1e-4
"""Truncation of differences with that step, at rates of at most 10/s: a velocity, and twice that
for an acceleration by differences of differences."""

SLIP = 2e-4
"""N and Nm: the tool is some µm from its reference, where the board accelerates otherwise."""

DRIFT = 1e-6  # m, and rad: far below the µm that would matter, far above round-off
TIMES = (0.6, 1.1, 1.7, 2.4, 3.3, 4.6)
AXES = ("fx", "fy", "fz", "mx", "my", "mz")
ROWS = np.eye(6)[[2, 3, 4]]  # a face that stays aligned: into the board, and both tilts


def outcome() -> Ran:
    """Return the run with the QP, made once."""
    return ran("conveyor")


@functools.cache
def robot() -> Robot:
    """Return the arm."""
    return load_robot("fr3")


@functools.cache
def job() -> ConveyorJob:
    """Return what tool and board do."""
    return Conveyor().job(robot().pose(robot().home, "flange"))


def board() -> Moving:
    """Return the constraint, made apart from the scenario."""
    R_WE = robot().pose(robot().home, "flange").rotation
    return Moving(whole=FaceOnPlane(space=FLANGE, R_WE=R_WE))


def force_rmse(table: pl.DataFrame) -> float:
    """Return the error of the measured force [N] while the board moves, until `EARLY`."""
    early = table.filter((pl.col("phase") == "move") & (pl.col("time") < EARLY))
    meas = early.select(f"wrench_meas.{axis}" for axis in AXES[:3]).to_numpy()
    return rms_norm(meas - np.array([0.0, 0.0, 10.0]))


def rate(pose, t: float) -> np.ndarray:
    """Return the body twist of ``pose`` at ``t`` by a central difference."""
    behind, ahead = pose(t - STEP), pose(t + STEP)
    return pin.log6(behind.actInv(ahead)).vector / (2 * STEP)


def change(pose, t: float) -> np.ndarray:
    """Return the derivative of that twist."""
    return (rate(pose, t + STEP) - rate(pose, t - STEP)) / (2 * STEP)


def test_the_conveyor_meets_its_own_criteria_and_beats_the_floor() -> None:
    summary = outcome().summary
    assert summary["passed"], summary["criteria"]
    assert summary["metrics"]["force_rmse_N"] < 1e-4
    assert summary["metrics"]["curvature_term_max"] > 1e-2  # there is something to know
    assert outcome().table["wrench_meas.fz"][1000] == pytest.approx(10.0, abs=1e-3)


def test_the_tool_stays_on_the_moving_board_by_pose_alone() -> None:
    table, model = outcome().table, robot().model
    q = table.select(f"q.{joint}" for joint in robot().joint_names).to_numpy()
    time, worst, travelled = table["time"].to_numpy(), 0.0, []
    for i in range(0, len(table), 50):
        X_WF = oracles.frame_terms(model, q[i], np.zeros(7), "flange").X_WF
        X_EF = job().ride.at(time[i]).X_WE.actInv(X_WF)
        worst = max(worst, abs(X_EF.translation[2]), *np.abs(X_EF.rotation[:2, 2]))
        travelled.append(X_WF.translation)
    assert worst < DRIFT
    assert np.ptp(travelled, axis=0).max() > 0.1  # it rode along


def test_the_board_moves_along_all_three_rows_as_far_as_asked() -> None:
    ride = job().ride
    X_E0E = [ride.X_WE_start.actInv(ride.at(t).X_WE) for t in np.arange(0.0, 5.0, 0.01)]
    p = np.array([X.translation for X in X_E0E])
    tilt = np.degrees([np.linalg.norm(pin.log3(X.rotation)) for X in X_E0E])
    assert p.max(axis=0) == pytest.approx([0.0, 0.15, 0.015], abs=1e-4)
    assert p.min(axis=0) == pytest.approx([0.0, 0.0, -0.015], abs=1e-4)
    assert tilt.max() == pytest.approx(4.0, abs=1e-2)
    table = outcome().table[::50]
    v_c = board_speed(table, ride)
    assert (np.abs(v_c).max(axis=0) > 0.05).all()  # m/s, rad/s
    rows = row_function(board())
    for i, t in enumerate(table["time"]):
        X_WF = robot().pose(_q(table, i), "flange")
        shift, R_WE = ride.shift(t).arrays.values(), ride.X_WE_start.rotation
        found = rows(X_WF.rotation, X_WF.translation, np.zeros(6), R_WE, *shift)
        assert np.array(found[2]).ravel() == pytest.approx(v_c[i], abs=1e-12)


def _q(table: pl.DataFrame, i: int) -> np.ndarray:
    return np.array(table.select(f"q.{joint}" for joint in robot().joint_names).row(i))


@pytest.mark.parametrize("t", TIMES)
def test_the_motion_of_board_and_tool_is_the_derivative_of_their_poses(t: float) -> None:
    ride = job().ride
    board, shift, tool = ride.at(t), ride.shift(t), job().reference(t)
    for pose, V, V_dot in (
        (lambda s: ride.at(s).X_WE, board.V, board.V_dot),
        (lambda s: ride.shift(s).X_shift, shift.V_env, shift.V_dot_env),
        (lambda s: job().reference(s).X_WD, tool.V_des, tool.V_dot_des),
    ):
        assert rate(pose, t) == pytest.approx(V, abs=FIRST)
        assert change(pose, t) == pytest.approx(V_dot, abs=SECOND)
        assert np.abs(V_dot).max() > 1e-2
    assert (shift.X_shift * ride.X_WE_start).isApprox(board.X_WE)


def test_board_and_tool_are_at_rest_until_they_set_off_and_after_they_are_back() -> None:
    for t in (0.0, PRESS_TIME, PRESS_TIME + job().ride.duration):
        shift, tool = job().ride.shift(t), job().reference(t)
        assert pin.log6(shift.X_shift).vector == pytest.approx(np.zeros(6), abs=1e-12)
        for motion in (shift.V_env, shift.V_dot_env, tool.V_des, tool.V_dot_des):
            assert motion == pytest.approx(np.zeros(6), abs=1e-12)


@functools.cache
def printed() -> pl.DataFrame:
    """Return the record of the textbook law, until `EARLY`."""
    return simulate(replace(Conveyor().prepare(Options(law="textbook")), horizon=EARLY))


def test_the_textbook_law_errs_on_the_moving_board_and_the_qp_does_not() -> None:
    assert force_rmse(printed()) >= 5 * force_rmse(outcome().table)
    assert force_rmse(printed()) > 0.1  # N
    assert printed()["unexplained_gap"].max() <= 1e-8
    assert printed()["textbook_gap"].max() > 1e-2


def test_the_textbook_law_presses_too_much_by_the_curvature_term() -> None:
    table, largest = printed(), 0.0
    wrench = table.select(f"wrench_meas.{axis}" for axis in AXES).to_numpy()
    F_cmd = table.select(f"force.F_cmd.{i}" for i in range(6)).to_numpy()
    v = table.select(f"v.{joint}" for joint in robot().joint_names).to_numpy()
    for i in range(600, len(table) - 1, 50):
        terms = oracles.body_terms(robot().model, _q(table, i), v[i], "flange", [*range(6)])
        acceleration = ROWS @ change(lambda t: job().reference(t).X_WD, table["time"][i])
        rows = oracles.Rows(ROWS, np.zeros(3), acceleration)
        asked = (np.eye(6) - oracles.projector(ROWS, terms.Lambda_inv)) @ F_cmd[i]
        excess = wrench[i + 1] - asked  # the sensor is one tick late
        assert excess == pytest.approx(oracles.curvature_wrench(terms, rows), abs=SLIP)
        largest = max(largest, np.abs(excess).max())
    assert largest > 1.0


def test_a_plant_whose_environment_rests_is_the_plant_without_one() -> None:
    still = job().ride.shift(0.0).arrays
    plants = [
        RigidPlant(robot(), board(), environment=environment)
        for environment in (None, lambda time: still)
    ]
    states = [plant.reset(robot().home) for plant in plants]
    for _ in range(20):
        states = [plant.step(np.ones(7)) for plant in plants]
    assert states[0].q == pytest.approx(states[1].q, abs=1e-12)
    assert states[0].wrench == pytest.approx(states[1].wrench, abs=1e-9)


def test_the_pictures_show_the_path_on_the_board_and_how_the_board_moves() -> None:
    experiment = Conveyor().prepare(Options())
    run = Outcome(experiment=experiment, table=outcome().table, summary=outcome().summary)
    panels = {panel.key: panel for panel in Conveyor().panels(run)}
    assert all(panel.figure for panel in panels.values())
    drawn = {trace["name"]: trace for trace in panels["path"].figure["data"]}
    actual = np.column_stack([drawn["actual path"]["x"], drawn["actual path"]["y"]])
    assert np.abs(actual).max(axis=0) == pytest.approx([60.0, 30.0], abs=0.1)  # mm, on the board
    assert np.abs(panels["board_speed"].figure["data"][0]["y"]).max() > 30  # mm/s


@pytest.mark.parametrize(
    "name", ["force", "speed", "board_speed", "distance", "heave", "rock", "frequency"]
)
def test_the_conveyor_refuses_what_makes_no_sense(name: str) -> None:
    assert SCENARIOS["conveyor"] is Conveyor
    for value in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match=f"{name}: .*") as refused:
            Conveyor(**{name: value})
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["speed", "board_speed"])
def test_the_conveyor_refuses_what_no_arm_can_follow(name: str) -> None:
    with pytest.raises(InputError, match=f"{name}: got 1000.0, need at most 5 m/s"):
        Conveyor(**{name: 1e3})
