"""The passivity observer against energies that are known without it."""

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pinocchio as pin
import polars as pl
import pytest
from cases import SPACES, board, chain

from qpctrl import Controller, Measurement, Mode, Weighted
from scenarios.door import Door
from scenarios.eraser import Eraser
from scenarios.metric import energy_metrics
from scenarios.press import Press
from scenarios.report_energy import energy_panel
from scenarios.scenario import Options
from scenarios.simulation import simulate
from scenarios.sphere import Sphere
from tasks import (
    EnergyReference,
    EnergyTask,
    ForceReference,
    ForceTask,
    MotionReference,
    MotionTask,
    PostureTask,
)
from tasks.energy import energy_memory, observe_energy

DT = 1e-3

NO_WORK = 1e-13
"""J: round-off of 10 N along a metre, summed over ten thousand ticks."""

SPRINGS = 1e-3
"""Of the largest energy: the trapezoidal rule at ω dt = 0.1, the springs' fastest motion."""

CONE = 0.01
"""Of the energy: the creep of a regularised friction cone, and the sway of the measured force."""


def observed(dt: float, end: float = 1.0) -> float:
    """Return the energy that the observer sees when F and V of two axes swing for a second."""
    F, V, step = ca.SX.sym("F", 2), ca.SX.sym("V", 2), ca.SX.sym("dt")
    x = {key: ca.SX.sym(key, *np.shape(value)) for key, value in energy_memory(2).items()}
    given = observe_energy(F, V, x, step)
    function = ca.Function("observe", [F, V, step, *x.values()], [*given.memory.values()])
    memory, last = list(energy_memory(2).values()), np.zeros(2)
    for t in np.arange(round(end / dt) + 1) * dt:
        V_now = np.array([np.sin(3 * t), t * np.cos(t)])
        memory = [np.array(part) for part in function(last, V_now, dt, *memory)]
        last = np.array([np.cos(2 * t), np.exp(-t)])  # the sensor hands it on one tick later
    memory = function(last, V_now, dt, *memory)
    return float(memory[0])


def test_the_sum_is_accurate_to_second_order() -> None:
    fine = (np.arange(2_000_000) + 0.5) / 2_000_000
    power = np.sin(3 * fine) * np.cos(2 * fine) + fine * np.cos(fine) * np.exp(-fine)
    errors = [observed(dt) - power.mean() for dt in (0.02, 0.01, 0.005)]
    for coarse, finer in pairwise(errors):
        assert coarse / finer == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize(
    "scenario",
    [Eraser(plant="rigid", duration=0.5), Door(angle=10.0), Sphere(swing=10.0)],
    ids=lambda scenario: scenario.name,
)
def test_a_rigid_constraint_at_rest_takes_no_energy(scenario) -> None:
    table = simulate(scenario.prepare(Options()))
    assert way(table).sum() > 0.04
    assert largest_force(table) > 5.0
    assert table["force.energy.0"].abs().max() < NO_WORK
    assert abs(scenario.metrics(table)["energy_to_environment_J"]) < NO_WORK


def way(table: pl.DataFrame) -> np.ndarray:
    """Return the length [m] of each step of the tool."""
    p_W = table.select(f"motion.X_WF.{i}" for i in (9, 10, 11)).to_numpy()
    return np.linalg.norm(np.diff(p_W, axis=0), axis=1)


def largest_force(table: pl.DataFrame) -> float:
    """Return the largest true force [N] on the environment."""
    forces = table.select("wrench.fx", "wrench.fy", "wrench.fz").to_numpy()
    return float(np.linalg.norm(forces, axis=1).max())


@pytest.mark.parametrize("stiffness", [1e4, 1e5])
def test_springs_hold_what_was_given_but_for_what_their_dampers_took(stiffness: float) -> None:
    press = Press(payload_error=0.3, stiffness=stiffness, stiffness_rot=stiffness / 10)
    experiment = replace(press.prepare(Options()), horizon=2.3)
    table, robot = simulate(experiment), experiment.robot
    K = np.repeat([stiffness, stiffness / 10], 3)
    D = np.repeat([press.spring_damping, press.spring_damping_rot], 3)
    q, v = (table.select(f"{x}.{j}" for j in robot.joint_names).to_numpy() for x in "qv")
    data, frame = robot.model.createData(), robot.frame_id("flange")
    X_WA, local = robot.pose(robot.home, "flange"), pin.ReferenceFrame.LOCAL
    deflection, twist = np.zeros((len(q), 6)), np.zeros((len(q), 6))
    for i in range(len(q)):
        twist[i] = pin.computeFrameJacobian(robot.model, data, q[i], frame, local) @ v[i]
        pin.framesForwardKinematics(robot.model, data, q[i])
        deflection[i] = pin.log6(X_WA.actInv(data.oMf[frame])).vector
    taken = (twist**2 * D).sum(axis=1)
    taken = np.concatenate([[0.0], np.cumsum((taken[1:] + taken[:-1]) / 2 * DT)])
    expected = (deflection**2 * K).sum(axis=1) / 2 + taken
    found = table["force.energy.0"].to_numpy()[1:]  # of the tick before, whose wrench it is
    assert taken[-1] > 0.1 * expected[-1]
    assert found == pytest.approx(expected[:-1], abs=SPRINGS * expected.max())


def test_friction_takes_its_share_of_the_force_along_the_way() -> None:
    scenario = Eraser(duration=1.5)
    table = simulate(scenario.prepare(Options()))
    wipe = table.filter(pl.col("phase") == "wipe")
    pressed = wipe["wrench.fz"].to_numpy()
    expected = float((0.3 * (pressed[1:] + pressed[:-1]) / 2 * way(wipe)).sum())
    given = wipe["force.energy.0"].to_numpy()
    assert expected == pytest.approx(0.3 * 10.0 * 0.2 * (1.5 - 0.375), rel=0.02)
    assert given[-1] - given[0] == pytest.approx(expected, rel=CONE)
    total = scenario.metrics(table)["energy_to_environment_J"]
    assert total == pytest.approx(expected, rel=0.03)  # with touch and lift


def test_a_record_without_an_observer_has_no_energy() -> None:
    table = pl.DataFrame({"time": [0.0, 1.0], "force.F_des.0": [1.0, 2.0]})
    assert energy_metrics(table) == {}
    assert energy_panel(table).figure is None
    seen = table.with_columns(pl.Series("push.energy.0", [1.0, np.nan]))
    assert energy_panel(seen, "push").figure is not None


def test_the_energy_of_a_run_is_true_force_times_the_speed_of_the_same_instant() -> None:
    time = np.linspace(0.0, 2.0, 2001)
    speed = {f"motion.V.{i}": np.cos(3 * time) * (i == 0) for i in range(6)}
    force = {f"wrench.{n}": np.r_[0.0, 5.0 * np.cos(3 * time[:-1])] for n in ("fx", "fy", "fz")}
    moment = {f"wrench.{n}": 0 * time for n in ("mx", "my", "mz")}
    table = pl.DataFrame({"time": time, **speed, **force, **moment})
    expected = 5.0 * (1.0 + np.sin(12.0) / 12.0)  # ∫ 5 cos²(3t) over 2 s
    found = energy_metrics(table)["energy_to_environment_J"]
    assert found == pytest.approx(expected, abs=6e-3)  # the last period is not over yet


SPACE = SPACES["arm_7"]
WRENCH = np.array([1.0, -2.0, 8.0, 0.1, 0.2, -0.3])


def modes() -> tuple[Mode, ...]:
    """Return ``free``, ``watched``, which only observes, and ``contact``."""
    motion, posture = MotionTask(space=SPACE), PostureTask(q_ref=chain(7, seed=7).home)
    own = {"free": (), "watched": (EnergyTask(space=SPACE),), "contact": (ForceTask(space=SPACE),)}
    return tuple(
        Mode(
            name=name,
            tasks=tuple(Weighted(task) for task in (motion, *tasks, posture)),
            constraints=(board(SPACE),) if name == "contact" else (),
        )
        for name, tasks in own.items()
    )


def test_the_observer_asks_for_nothing_and_hands_the_energy_on() -> None:
    robot = chain(7, seed=7)
    controller = Controller(robot, modes(), dt=DT)
    memory, v = controller.start("watched", robot.home), 0.1 * np.cos(np.arange(7.0))
    data, local = robot.model.createData(), pin.ReferenceFrame.LOCAL
    tool = robot.frame_id(SPACE.frame)
    J = pin.computeFrameJacobian(robot.model, data, robot.home, tool, local)
    power, energies = float(WRENCH @ J @ v), []
    for i, mode in enumerate(("watched", "watched", "contact", "contact", "watched")):
        measured = Measurement((i + 1) * DT, robot.home, v)
        push = ForceReference(F_ref=np.zeros(6), F_meas=WRENCH)
        watch = EnergyReference(F_meas=WRENCH)
        references = {"motion": MotionReference(X_WD=robot.pose(robot.home, SPACE.frame))}
        if mode == "watched":
            start = controller.start("free", robot.home)
            plain, _, _ = controller.step("free", measured, references, start)
        references["force"] = push if mode == "contact" else watch
        command, report, memory = controller.step(mode, measured, references, memory)
        energies.append(signal(controller, mode, report.signals))
        if mode == "watched":
            assert command.tau == pytest.approx(plain.tau, abs=1e-12)
    assert energies == pytest.approx([0.0, *(power * DT * np.array([0.5, 1.5, 2.5, 3.5]))])


def signal(controller: Controller, mode: str, packed: np.ndarray) -> float:
    """Return the energy among the packed signals of a tick."""
    sizes = controller.engines[mode].tick.signals
    before = list(sizes).index("force.energy")
    return float(packed[sum(list(sizes.values())[:before])])
