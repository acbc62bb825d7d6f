"""Impedance and admittance laws against their closed forms, written anew from the textbook."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import oracles
import pinocchio as pin
import pytest
from cases import ROBOTS, SPACES, states

from qpctrl import (
    Controller,
    FaceOnPlane,
    InputError,
    Measurement,
    Mode,
    Robot,
    TaskSpace,
    Weighted,
)
from qpctrl.memory import remember
from tasks import (
    AdmittanceReference,
    AdmittanceTask,
    ForceReference,
    ForceTask,
    ImpedanceReference,
    ImpedanceTask,
    MotionReference,
    MotionTask,
    PostureTask,
)

SPACE = SPACES["arm_7"]
AGREEMENT = 1e-9
"""Nm, relative to the largest torque: two double-precision evaluations of one law."""

rng = np.random.default_rng(11)


def spd(seed: int, sizes: np.ndarray) -> np.ndarray:
    """Return a symmetric positive definite matrix (n×n) with eigenvalues ``sizes``."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(sizes), len(sizes))))[0]
    matrix = turn @ np.diag(sizes) @ turn.T
    return (matrix + matrix.T) / 2


K_V = spd(1, np.array([900.0, 700.0, 500.0, 40.0, 30.0, 20.0]))
B_V = spd(2, np.array([90.0, 70.0, 50.0, 4.0, 3.0, 2.0]))
M_V = spd(3, np.array([6.0, 5.0, 4.0, 0.3, 0.2, 0.1]))


def arm() -> Robot:
    """Return the 7-joint arm."""
    return ROBOTS["arm_7"]()


def torque(task: ImpedanceTask | AdmittanceTask, reference, q, v, memory=()) -> np.ndarray:
    """Return the torque of one tick; ``memory`` sets parts of the task's memory before it."""
    robot = arm()
    tasks = (Weighted(task), Weighted(PostureTask(q_ref=q, K_d=0.0)))
    controller = Controller(robot, [Mode(name="answer", tasks=tasks)])
    start = controller.start("answer", q)
    x = start.x.copy()
    views = controller.engines["answer"].tick.memory.views(x)
    for name, value in dict(memory).items():
        views[f"{task.name}.{name}"][...] = value
    before = remember("answer", start.tau, start.q, x)
    found = controller.step("answer", Measurement(1e-3, q, v), {task.name: reference}, before)
    assert found[1].law_gap < 1e-8
    return found[1].tau_qp


def scene(index: int):
    """Return q, v, the terms there, and a reference pose, twist and rate nearby."""
    robot = arm()
    state = list(states(robot, SPACE, index + 1, seed=5))[index]
    terms = oracles.body_terms(robot.model, state.q, state.v, SPACE.frame, SPACE.index)
    X_WD = terms.X_WF * pin.exp6(np.array([0.04, -0.03, 0.05, 0.3, -0.2, 0.25]))
    V_des, V_dot_des = np.linspace(-0.3, 0.4, 6), np.linspace(0.5, -0.6, 6)
    return state.q, state.v, terms, X_WD, V_des, V_dot_des


def law(terms: oracles.BodyTerms, a_cmd: np.ndarray, F_ext: np.ndarray | float = 0.0):
    """Return τ of an arm that follows ``a_cmd`` and compensates ``F_ext``, at rest otherwise."""
    free = oracles.Rows(np.zeros((0, 6)), np.zeros(0), np.zeros(0))
    F_ext = np.broadcast_to(F_ext, (6,))
    wanted = oracles.Wanted(a_cmd, np.zeros(6), F_ext, np.zeros(len(terms.h)))
    return oracles.textbook(terms, free, wanted)


def assert_same(found: np.ndarray, expected: np.ndarray) -> None:
    assert np.abs(found - expected).max() < AGREEMENT * np.abs(expected).max()


@pytest.mark.parametrize("index", range(3))
@pytest.mark.parametrize("mass", [None, M_V], ids=["own inertia", "mass term"])
def test_impedance_in_twists_is_the_printed_law(index: int, mass: np.ndarray | None) -> None:
    q, v, terms, X_WD, V_des, V_dot_des = scene(index)
    V_dot = np.linspace(-2.0, 1.0, 6)
    measured = ImpedanceReference(
        X_WD=X_WD, V_des=V_des, V_dot_des=V_dot_des, V_dot_meas=None if mass is None else V_dot
    )
    task = ImpedanceTask(space=SPACE, K_v=K_V, B_v=B_V, M_v=mass, cutoff=1e6)
    x = -oracles.pose_error(terms.X_WF, X_WD)
    x_dot = terms.V - oracles.transported(terms.X_WF, X_WD, V_des)
    ahead = oracles.transport_rate(terms.X_WF, terms.V_full, X_WD, V_des, V_dot_des)
    F = -(B_V @ x_dot + K_V @ x)
    a_cmd = ahead + terms.Lambda_inv @ F
    if mass is not None:
        a_cmd = V_dot + terms.Lambda_inv @ (F - M_V @ (V_dot - ahead))
    found = torque(task, measured, q, v)
    assert np.abs(found - law(terms, a_cmd)).max() < 1e-7 * np.abs(found).max()  # differences


@pytest.mark.parametrize("mass", [None, M_V], ids=["own inertia", "mass term"])
def test_impedance_in_minimal_coordinates_is_the_printed_law(mass: np.ndarray | None) -> None:
    q, v, terms, X_WD, _, _ = scene(1)
    V_dot = np.linspace(-2.0, 1.0, 6)
    reference = ImpedanceReference(X_WD=X_WD, V_dot_meas=None if mass is None else V_dot)
    task = ImpedanceTask(space=SPACE, K_v=K_V, B_v=B_V, M_v=mass, coordinates="minimal", cutoff=1e6)
    step = 1e-4

    def coordinates(t: float) -> np.ndarray:
        """Position with roll, pitch, yaw in the reference, along the twist and its rate."""
        moved = terms.X_WF * pin.exp6(t * terms.V_full + t * t / 2 * V_dot)
        seen = X_WD.actInv(moved)
        return np.r_[seen.translation, pin.rpy.matrixToRpy(seen.rotation)]

    def rate(V: np.ndarray) -> np.ndarray:
        ahead, behind = (
            X_WD.actInv(terms.X_WF * pin.exp6(sign * step * V)) for sign in (1.0, -1.0)
        )
        turn = pin.rpy.matrixToRpy(ahead.rotation) - pin.rpy.matrixToRpy(behind.rotation)
        return np.r_[ahead.translation - behind.translation, turn] / (2 * step)

    E = np.column_stack([rate(axis) for axis in np.eye(6)])
    x, x_dot = coordinates(0.0), E @ terms.V_full
    x_ddot = (coordinates(step) - 2 * x + coordinates(-step)) / step**2
    F = -E.T @ (B_V @ x_dot + K_V @ x)
    a_cmd = terms.Lambda_inv @ F
    if mass is not None:
        a_cmd = V_dot + terms.Lambda_inv @ (F - E.T @ (M_V @ x_ddot))
    found, expected = torque(task, reference, q, v), law(terms, a_cmd)
    assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max()  # second differences


def test_without_an_accelerometer_the_twists_are_differenced_and_filtered() -> None:
    q, v, terms, X_WD, _, _ = scene(0)
    last, before, cutoff = terms.V - np.linspace(1e-3, -2e-3, 6), np.linspace(0.4, -0.3, 6), 50.0
    task = ImpedanceTask(space=SPACE, K_v=K_V, B_v=B_V, M_v=M_V, cutoff=cutoff)
    memory = {"V_last": last, "V_dot": before, "begun": 1.0}
    follow = 1 - math.exp(-2 * math.pi * cutoff * 1e-3)
    V_dot = before + follow * ((terms.V - last) / 1e-3 - before)
    F = -(B_V @ terms.V - K_V @ oracles.pose_error(terms.X_WF, X_WD))
    a_cmd = V_dot + terms.Lambda_inv @ (F - M_V @ V_dot)
    found = torque(task, ImpedanceReference(X_WD=X_WD), q, v, memory)
    assert_same(found, law(terms, a_cmd))
    first = torque(task, ImpedanceReference(X_WD=X_WD), q, v)  # no twist before: no jump
    assert_same(first, law(terms, terms.Lambda_inv @ F))


@pytest.mark.parametrize("index", range(3))
def test_admittance_moves_the_virtual_mass_and_compensates_the_reading(index: int) -> None:
    q, v, terms, X_WD, V_des, V_dot_des = scene(index)
    F_meas, before, cutoff = np.linspace(-9.0, 12.0, 6), np.linspace(3.0, -2.0, 6), 40.0
    task = AdmittanceTask(space=SPACE, M_v=M_V, B_v=B_V, K_v=K_V, cutoff=cutoff)
    reference = AdmittanceReference(X_WD=X_WD, F_meas=F_meas, V_des=V_des, V_dot_des=V_dot_des)
    filtered = before + (1 - math.exp(-2 * math.pi * cutoff * 1e-3)) * (F_meas - before)
    x = -oracles.pose_error(terms.X_WF, X_WD)
    x_dot = terms.V - oracles.transported(terms.X_WF, X_WD, V_des)
    ahead = oracles.transport_rate(terms.X_WF, terms.V_full, X_WD, V_des, V_dot_des)
    a_cmd = ahead + np.linalg.solve(M_V, -filtered - B_V @ x_dot - K_V @ x)
    found = torque(task, reference, q, v, {"F_ext": before})
    assert np.abs(found - law(terms, a_cmd, filtered)).max() < 1e-7 * np.abs(found).max()


def test_on_a_surface_the_force_task_alone_compensates_what_is_measured() -> None:
    """10 N measured on 10 N asked for leave 10 N, not 20, whichever task moves the tool."""
    robot, push = arm(), np.array([0.0, 0.0, 10.0, 1.0, 0.0, 0.0])
    X_WF = robot.pose(robot.home, SPACE.frame)
    board = FaceOnPlane(space=SPACE, R_WE=X_WF.rotation)
    pressed = []
    for task, reference in (
        (MotionTask(space=SPACE), MotionReference(X_WD=X_WF)),
        (AdmittanceTask(space=SPACE), AdmittanceReference(X_WD=X_WF, F_meas=push)),
    ):
        force = ForceTask(space=SPACE, ramp=1e9)
        tasks = (Weighted(task), Weighted(force), Weighted(PostureTask(q_ref=robot.home)))
        controller = Controller(robot, [Mode(name="press", tasks=tasks, constraints=(board,))])
        references = {task.name: reference, "force": ForceReference(F_ref=push, F_meas=push)}
        start = controller.start("press", robot.home)
        report = controller.step(
            "press", Measurement(1e-3, robot.home, np.zeros(7)), references, start
        )[1]
        pressed.append((report.lam, report.tau_qp))
    assert pressed[1][0][0] == pytest.approx(10.0, abs=1e-9)
    assert pressed[1][0] == pytest.approx(pressed[0][0], abs=1e-9)
    assert robot.nv == len(pressed[1][1])


@pytest.mark.parametrize("simulated", ["spring", "damper"])
def test_a_spring_or_a_damper_alone_is_followed_by_the_motion_loop(simulated: str) -> None:
    q, v, terms, X_WD, _, _ = scene(2)
    F_meas, K_p, K_d = np.linspace(-9.0, 12.0, 6), 300.0, 35.0
    task = AdmittanceTask(
        space=SPACE, B_v=B_V, K_v=K_V, simulated=simulated, cutoff=0.0, K_p=K_p, K_d=K_d
    )
    x = -oracles.pose_error(terms.X_WF, X_WD)
    a_cmd = {
        "spring": K_p * (-np.linalg.solve(K_V, F_meas) - x) - K_d * terms.V,
        "damper": K_d * (-np.linalg.solve(B_V, F_meas) - terms.V),
    }[simulated]
    found = torque(task, AdmittanceReference(X_WD=X_WD, F_meas=F_meas), q, v)
    assert_same(found, law(terms, a_cmd, F_meas))


INDEFINITE = np.diag([1.0, 1.0, -1e-3, 1.0, 1.0, 1.0])
LOPSIDED = np.eye(6) + np.eye(6, k=1)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: ImpedanceTask(space=SPACE, K_v=1, B_v=1, M_v=0.0), "impedance.M_v.*definite"),
        (lambda: ImpedanceTask(space=SPACE, K_v=1, B_v=1, M_v=INDEFINITE), "positive definite"),
        (lambda: ImpedanceTask(space=SPACE, K_v=1, B_v=1, M_v=LOPSIDED), "symmetric"),
        (lambda: ImpedanceTask(space=SPACE, K_v=INDEFINITE, B_v=1), "K_v.*semidefinite"),
        (lambda: ImpedanceTask(space=SPACE, K_v=1, B_v=-1.0), "B_v.*semidefinite"),
        (lambda: ImpedanceTask(space=SPACE, K_v=math.nan, B_v=1), "K_v.*finite"),
        (lambda: ImpedanceTask(space=SPACE, K_v=np.ones(3), B_v=1), "K_v.*shape"),
        (lambda: ImpedanceTask(space=SPACE, K_v=1, B_v=1, cutoff=0.0), "cutoff.*> 0"),
        (
            lambda: ImpedanceTask(
                space=TaskSpace("tool", ("vx",)), K_v=1, B_v=1, coordinates="minimal"
            ),
            "axes",
        ),
        (lambda: AdmittanceTask(space=SPACE, M_v=INDEFINITE), "admittance.M_v.*definite"),
        (lambda: AdmittanceTask(space=SPACE, M_v=-np.eye(6)), "positive definite"),
        (lambda: AdmittanceTask(space=SPACE, K_v=0.0, simulated="spring"), "K_v.*definite"),
        (lambda: AdmittanceTask(space=SPACE, B_v=0.0, simulated="damper"), "B_v.*definite"),
        (lambda: AdmittanceTask(space=SPACE, cutoff=-1.0), "cutoff.*>= 0"),
    ],
)
def test_what_cannot_be_rendered_is_refused_in_one_line(build, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        build()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("built", "says"),
    [
        ("ImpedanceTask(space=space, K_v=1, B_v=1, coordinates='minimul')", "'minimal'"),
        ("AdmittanceTask(space=space, simulated='sprung')", "'spring'"),
    ],
)
def test_unknown_words_are_refused_with_the_nearest_one(built: str, says: str) -> None:
    code = f"from qpctrl import *\nfrom tasks import *\nspace = TaskSpace('tool')\n{built}"
    ran = subprocess.run(  # without the checker of annotations, as users run it
        [sys.executable, "-c", code], cwd=Path(__file__).parents[1],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert f"did you mean {says}?" in ran.stderr.splitlines()[-1]
