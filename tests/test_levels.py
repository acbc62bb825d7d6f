"""Strict priorities in a controller: who gives way, and that nobody above does."""

import casadi as ca
import numpy as np
import oracles
import pinocchio as pin
import pytest

from qpctrl import (
    Command,
    Controller,
    InputError,
    Measurement,
    Mode,
    Robot,
    Status,
    TaskSpace,
    TickReport,
    Weighted,
)
from qpctrl.constraint import Pfaffian
from qpctrl.export import project_files
from scenarios.robot_file import load_robot
from tasks import (
    ForceReference,
    ForceTask,
    MotionReference,
    MotionTask,
    PostureReference,
    PostureTask,
)

KEPT = 1e-9
"""Promised: most that a lower task changes of a higher one's residual, over its size or 1."""

AGREEMENT = 1e-8
"""Promised of QP and law, relative."""

STATES = 1000

LOWER = ("elbow", "posture")

HAND, ELBOW = TaskSpace("flange", ("vx", "vy", "vz")), TaskSpace("link5", ("vy",))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("fr3")


def ranked(robot: Robot, metric: str = "inertia", upper: int = 0) -> Controller:
    """Return a hand on a wall above an elbow above a posture."""
    wall = Pfaffian(space=HAND, A=np.array([[0.0, 0.0, 1.0]]), name="wall")
    tasks = (
        Weighted(MotionTask(space=HAND, name="hand"), 1.0, upper),
        Weighted(ForceTask(space=HAND, ramp=1e9, name="press"), 1.0, upper),
        Weighted(MotionTask(space=ELBOW, name="elbow"), 1.0, upper + 1),
        Weighted(PostureTask(q_ref=robot.home), 1.0, upper + 2),
    )
    mode = Mode(name="ranked", tasks=tasks, constraints=(wall,), metric=metric)  # type: ignore[arg-type]
    return Controller(robot, [mode])


def sent(
    controller: Controller, q: np.ndarray, v: np.ndarray, references: dict[str, object]
) -> tuple[Command, TickReport, np.ndarray]:
    """Return command, report and acceleration of a first tick."""
    memory = controller.start("ranked", q)
    measured = Measurement(0.001, q, v)
    command, report, _ = controller.step("ranked", measured, references, memory)  # type: ignore[arg-type]
    return command, report, controller.engines["ranked"].parts.point[0][: len(v)].copy()


def drawn(robot: Robot, rng: np.random.Generator, far: float) -> dict[str, object]:
    """Return references around home; those of the lower tasks are up to ``far`` times as far."""

    def pose(frame: str, size: float) -> pin.SE3:
        return robot.pose(robot.home, frame) * pin.exp6(size * rng.uniform(-1, 1, 6))

    push = np.array([0.0, 0.0, 20.0])
    return {
        "hand": MotionReference(X_WD=pose("flange", 0.05)),
        "press": ForceReference(F_ref=push, F_meas=push),
        "elbow": MotionReference(X_WD=pose("link5", 0.05 * far)),
        "posture": PostureReference(q_ref=robot.home + far * rng.uniform(-1, 1, robot.nv)),
    }


def residuals(
    robot: Robot, report: TickReport, q: np.ndarray, v: np.ndarray, a: np.ndarray, space: TaskSpace
) -> np.ndarray:
    """Return V̇ along the axes of a space, from pinocchio: what the task there got."""
    terms = oracles.frame_terms(robot.model, q, v, space.frame)
    return (terms.J @ a + terms.J_dot_v)[space.index]


@pytest.mark.parametrize("metric", ["inertia", "home"])
def test_a_lower_task_changes_nothing_above_it_with_limits_active(
    robot: Robot, metric: str
) -> None:
    controller, rng = ranked(robot, metric), np.random.default_rng(11)
    limits = controller.engines["ranked"].inputs
    limits["limits.tau_rate"][:] = 1e7
    worst, bound, moved = 0.0, 0, 0.0
    for _ in range(STATES // 2):
        q = robot.home + rng.uniform(-0.3, 0.3, robot.nv)
        v = 0.3 * rng.normal(size=robot.nv)
        near = drawn(robot, rng, 1.0)
        far = {
            **near,
            **{k: x for k, x in drawn(robot, rng, 20.0).items() if k in LOWER},
        }
        limits["limits.tau_max"][:] = rng.uniform(0.1, 0.4) * robot.limits.tau_max
        one, other = (sent(controller, q, v, given) for given in (near, far))
        if Status.INFEASIBLE in (one[1].status, other[1].status):
            continue  # the hand's limits leave nothing: there is no answer to compare
        assert [one[1].status, other[1].status] == [Status.OK] * 2
        bound += bool(one[1].active) and bool(other[1].active)
        hands = [residuals(robot, report, q, v, a, HAND) for _, report, a in (one, other)]
        size = max(1.0, *(np.abs(hand).max() for hand in hands))
        worst = max(worst, np.abs(hands[0] - hands[1]).max() / size)
        worst = max(worst, np.abs(one[1].lam - other[1].lam).max() / max(1.0, *np.abs(one[1].lam)))
        elbows = [residuals(robot, report, q, v, a, ELBOW) for _, report, a in (one, other)]
        moved = max(moved, float(np.abs(elbows[0] - elbows[1]).max()))
        assert max(one[1].kkt_residual, other[1].kkt_residual) <= KEPT
    assert bound > STATES // 4
    assert moved > 1.0  # the lower references do something
    assert worst <= KEPT


def test_without_limits_it_is_the_operational_space_hierarchy(robot: Robot) -> None:
    controller, rng = ranked(robot), np.random.default_rng(3)
    inputs = controller.engines["ranked"].inputs
    for name in ("tau_max", "tau_rate", "tau_stall", "q_max", "v_max"):
        inputs[f"limits.{name}"][:] = 1e9
    inputs["limits.q_min"][:] = -1e9
    for _ in range(50):
        q, v = robot.home + rng.uniform(-0.3, 0.3, robot.nv), 0.3 * rng.normal(size=robot.nv)
        references = drawn(robot, rng, 1.0)
        command, report, a = sent(controller, q, v, references)
        assert not report.active
        wanted = hierarchy(robot, controller, q, v, a)
        assert np.abs(command.tau - wanted).max() <= AGREEMENT * np.abs(wanted).max()
        assert report.law_gap <= AGREEMENT


def hierarchy(
    robot: Robot, controller: Controller, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> np.ndarray:
    """Return the torque of the levels, each in what the dynamically consistent null space leaves.

    Khatib's law for the hand on the wall, then the elbow and then the posture by pseudo-inverses
    weighted with M in the null spaces of those above. Source: Khatib1987; Sentis2005.
    """
    engine, mode = controller.engines["ranked"], controller.engines["ranked"].tick
    terms = oracles.frame_terms(robot.model, q, v, "flange")
    A = engine.terms["A0"]
    M, J, drift = terms.M, terms.J[:3], terms.J_dot_v[:3]
    a_cmd, F_cmd = commanded(engine, mode)
    Lambda_inv = J @ np.linalg.solve(M, J.T)
    S = A @ Lambda_inv @ A.T
    rate = engine.qp.b[: len(A)] + A @ drift  # v̇_c − Ȧ V
    V_dot = a_cmd["hand"] + Lambda_inv @ A.T @ np.linalg.solve(S, rate - A @ a_cmd["hand"])
    lam = np.linalg.solve(S, A @ Lambda_inv @ F_cmd)
    bar = np.linalg.solve(M, J.T) @ np.linalg.inv(Lambda_inv)
    a_hand = bar @ (V_dot - drift)
    elbow = oracles.frame_terms(robot.model, q, v, "link5")
    E, N = elbow.J[1:2], np.eye(robot.nv) - bar @ J
    left = a_cmd["elbow"] - elbow.J_dot_v[1:2] - E @ a_hand
    metric = np.linalg.cholesky(np.linalg.inv(E @ np.linalg.solve(M, E.T))).T
    E = metric @ E @ N  # what of the elbow, in its metric, moves while the hand is held
    back = np.linalg.solve(M, E.T) @ np.linalg.pinv(E @ np.linalg.solve(M, E.T), rcond=1e-9)
    a_elbow = back @ metric @ left
    rest = N - back @ E
    a_all = a_hand + a_elbow + rest @ (a_cmd["posture"] - a_elbow)
    assert np.abs(a_all - a).max() <= AGREEMENT * max(1.0, np.abs(a).max())
    return M @ a_all + terms.h + J.T @ A.T @ lam


def commanded(engine, tick) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return a_cmd of both motions and F_cmd, as the graph has them: its inputs are trusted."""
    model = tick.model
    found = {}
    for item in model.tasks:
        objective = item.written.objective
        for key in {"a_cmd", "F_cmd", "a_post"} & set(objective._fields):
            function = ca.Function(
                "f",
                [model.dynamics.q, model.dynamics.v, model.u_vector, model.x_vector],
                [ca.densify(getattr(objective, key))],
            )
            inputs = engine.parts.inputs
            value = np.array(function(*(inputs[name] for name in ("q", "v", "u", "x")))).ravel()
            found[item.task.name] = value
    return found, found["press"]


def test_numbers_of_priorities_count_by_their_order(robot: Robot) -> None:
    rng = np.random.default_rng(5)
    q, v = robot.home + 0.1, 0.2 * rng.normal(size=robot.nv)
    references = drawn(robot, rng, 1.0)
    one, other = (sent(ranked(robot, upper=upper), q, v, references)[0].tau for upper in (0, -4))
    assert np.array_equal(one, other)


def test_one_priority_is_no_hierarchy_and_slack_excludes_several(robot: Robot) -> None:
    controller = ranked(robot)
    tasks = controller.engines["ranked"].tick.mode.tasks
    wall = controller.engines["ranked"].tick.mode.constraints
    with pytest.raises(InputError, match="slack and priorities exclude each other"):
        Mode(name="m", tasks=tasks, constraints=wall, slack=1.0)
    same = tuple(weighted._replace(priority=7) for weighted in tasks)
    assert Mode(name="m", tasks=same, constraints=wall, slack=1.0).priorities == (7,)


def test_a_hierarchy_is_not_exported(robot: Robot) -> None:
    with pytest.raises(InputError, match="mode 'ranked' has strict priorities, which C has no"):
        project_files(ranked(robot), "arm")
