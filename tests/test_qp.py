"""The QP: equal to the hybrid law without limits, certified and explained with them."""

import numpy as np
import oracles
import pytest
from cases import (
    LAW_AGREEMENT,
    ROBOTS,
    ROUND_OFF,
    ROWS,
    SOLVER_FORMS,
    SOLVERS,
    SPACES,
    WEIGHTS,
    Draw,
    Given,
    draw,
    given_controller,
    given_mode,
    states,
    tick,
)

from qpctrl import Controller, InputError, Status, TickReport
from qpctrl.limit import POSITION_RATE, UNBOUNDED, VELOCITY_RATE

KKT = 1e-9
"""Promised residual of every accepted tick."""

SOLVER_AGREEMENT = 1e-7
"""Promised relative agreement of two solvers with limits active."""

INSIDE = 1e-9
"""Nm by which a torque may pass its limit: the promised residual of the inequality."""

STATES = 25
FREE = np.inf


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest difference against the largest entry."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("form", ["reduced", "full"])
@pytest.mark.parametrize(("name", "k"), ROWS)
def test_the_qp_is_the_hybrid_law_for_any_weights(name: str, k: int, form: str) -> None:
    controller, space = given_controller(name, k, form), SPACES[name]
    for q, v, rng in states(controller.robot, space, STATES):
        drawn = draw(rng, k, space.n, controller.robot.nv)
        terms = oracles.body_terms(controller.robot.model, q, v, "tool", space.index)
        rows = oracles.Rows(drawn.A, drawn.A_dot_V, drawn.v_c_dot)
        wanted = oracles.Wanted(drawn.a_cmd, drawn.F_cmd, drawn.F_ext, drawn.a_post)
        hybrid = oracles.hybrid(terms, rows, wanted)
        curvature = terms.J.T @ oracles.curvature_wrench(terms, rows)
        size = max(np.abs(hybrid).max(), np.abs(hybrid + curvature).max())
        for weights in WEIGHTS:
            command, report, _ = tick(controller, q, v, drawn.references(weights))
            assert report.status is Status.OK
            assert relative(command.tau, hybrid) < LAW_AGREEMENT
            gap = command.tau - (oracles.textbook(terms, rows, wanted) - curvature)
            assert np.abs(gap).max() < LAW_AGREEMENT * size
            assert report.law_gap < LAW_AGREEMENT
            assert report.unexplained_gap < LAW_AGREEMENT
            assert not report.active
            assert not report.yields


@pytest.mark.parametrize(("name", "k"), ROWS)
def test_the_report_measures_the_gaps_between_the_three_torques(name: str, k: int) -> None:
    controller, space = given_controller(name, k), SPACES[name]
    q, v, rng = next(states(controller.robot, space, 1))
    _, report, _ = tick(controller, q, v, draw(rng, k, space.n, controller.robot.nv).references())
    size = max(np.abs(report.tau_qp).max(), np.abs(report.tau_hybrid).max())
    textbook_gap = np.abs(report.tau_qp - report.tau_textbook).max() / size
    curvature = np.abs(report.tau_textbook - report.tau_hybrid).max() / size
    assert report.textbook_gap == pytest.approx(textbook_gap, abs=ROUND_OFF)
    assert report.curvature == pytest.approx(curvature, abs=ROUND_OFF)
    assert (report.curvature > 1e-4) == (k > 0)  # the rows of these draws do change
    assert ("curvature term" in report.explain()) == (k > 0)


@pytest.mark.parametrize(("name", "k"), ROWS)
def test_the_multipliers_are_those_of_the_plant_under_the_torque(name: str, k: int) -> None:
    controller, space = given_controller(name, k), SPACES[name]
    for q, v, rng in states(controller.robot, space, 5):
        drawn = draw(rng, k, space.n, controller.robot.nv)
        command, report, _ = tick(controller, q, v, drawn.references())
        terms = oracles.body_terms(controller.robot.model, q, v, "tool", space.index)
        rows = oracles.Rows(drawn.A, drawn.A_dot_V, drawn.v_c_dot)
        lam = oracles.plant(terms, rows, command.tau, drawn.F_ext).lam
        assert np.allclose(
            report.lam, lam, rtol=0, atol=LAW_AGREEMENT * (1 + np.abs(lam).max(initial=0))
        )


# Limits ------------------------------------------------------------------------------------


def torque_limited(
    name: str, k: int, count: int
) -> list[tuple[np.ndarray, np.ndarray, Draw, np.ndarray]]:
    """Return states, commands and torque limits of which some bind."""
    controller, space = given_controller(name, k), SPACES[name]
    found = []
    for q, v, rng in states(controller.robot, space, count, seed=20 + k):
        drawn = draw(rng, k, space.n, controller.robot.nv)
        command, _, _ = tick(controller, q, v, drawn.references())
        tau_max = np.abs(command.tau) * rng.uniform(0.4, 1.4, controller.robot.nv)
        tau_max[rng.integers(controller.robot.nv)] *= 0.3 / 1.4
        found.append((q, v, drawn, np.maximum(tau_max, 0.1)))
    return found


def limited_controller(
    name: str, k: int, form: str = "reduced", solver: str = "proxsuite"
) -> Controller:
    """Return a controller of its own, as limits stay in its inputs."""
    robot = ROBOTS[name]()
    return Controller(robot, [given_mode(robot, SPACES[name], k)], form=form, solver=solver)


@pytest.mark.parametrize(("name", "k"), ROWS)
def test_limited_torque_stays_inside_is_certified_and_is_the_optimum(name: str, k: int) -> None:
    controller, space = limited_controller(name, k), SPACES[name]
    bound = 0
    for i, (q, v, drawn, tau_max) in enumerate(torque_limited(name, k, STATES)):
        weights = WEIGHTS[i % len(WEIGHTS)]
        references = {**drawn.references(weights), "limits": Given(tau_max=tau_max)}
        command, report, _ = tick(controller, q, v, references)
        assert report.status is Status.OK
        assert report.kkt_residual <= KKT
        assert (np.abs(command.tau) <= tau_max + INSIDE).all()
        terms = oracles.body_terms(controller.robot.model, q, v, "tool", space.index)
        rows = oracles.Rows(drawn.A, drawn.A_dot_V, drawn.v_c_dot)
        wanted = oracles.Wanted(drawn.a_cmd, drawn.F_cmd, drawn.F_ext, drawn.a_post)
        best = oracles.limited_optimum(
            terms, rows, wanted, tuple(weights.values()), -tau_max, tau_max
        )
        assert relative(command.tau, best.tau) < SOLVER_AGREEMENT
        at_limit = np.abs(command.tau) > tau_max - 1e-7 * (1 + tau_max)
        names = {limit.name for limit in report.active}
        joints = controller.robot.joint_names
        assert names <= {f"torque {joints[i]}" for i in np.flatnonzero(at_limit)}
        bound += len(names)
    assert bound >= STATES // 2


@pytest.mark.parametrize("name", ["planar_2r", "arm_6", "arm_7"])
def test_all_solvers_and_both_forms_agree_with_limits_active(name: str) -> None:
    k = 1 if name == "planar_2r" else 3
    cases = torque_limited(name, k, 8)
    torques = []
    for solver, form in SOLVER_FORMS:
        controller = limited_controller(name, k, form, solver)
        for q, v, drawn, tau_max in cases:
            references = {**drawn.references(), "limits": Given(tau_max=tau_max)}
            command, report, _ = tick(controller, q, v, references)
            assert report.status is Status.OK, (solver, form)
            assert report.kkt_residual <= KKT, (solver, form)
            torques.append(command.tau)
    by_backend = np.array(torques).reshape(len(SOLVER_FORMS), len(cases), -1)
    for case in range(len(cases)):
        for other in by_backend[1:, case]:
            assert relative(other, by_backend[0, case]) < SOLVER_AGREEMENT


def test_a_solver_that_cannot_take_the_form_is_refused() -> None:
    with pytest.raises(InputError, match="cannot solve the full form"):
        limited_controller("planar_2r", 1, "full", "quadprog")


def test_there_are_at_least_two_solvers_to_agree() -> None:
    assert "proxsuite" in SOLVERS
    assert len(SOLVERS) >= 2


@pytest.mark.parametrize("form", ["reduced", "full"])
def test_who_gives_way_is_named_with_the_amount(form: str) -> None:
    controller, space = limited_controller("arm_7", 3, form), SPACES["arm_7"]
    for q, v, drawn, tau_max in torque_limited("arm_7", 3, 10):
        references = {**drawn.references(), "limits": Given(tau_max=tau_max)}
        command, report, _ = tick(controller, q, v, references)
        terms = oracles.body_terms(controller.robot.model, q, v, "tool", space.index)
        rows = oracles.Rows(drawn.A, drawn.A_dot_V, drawn.v_c_dot)
        wanted = oracles.Wanted(drawn.a_cmd, drawn.F_cmd, drawn.F_ext, drawn.a_post)
        got, law = (
            oracles.plant(terms, rows, tau, drawn.F_ext)
            for tau in (command.tau, oracles.hybrid(terms, rows, wanted))
        )
        M_N = terms.M - terms.J.T @ terms.Lambda @ terms.J
        expected = {
            "motion": (got.V_dot - law.V_dot, "m/s²"),
            "force": (rows.A.T @ (got.lam - law.lam), "N"),
            "posture": (M_N @ (got.a - law.a), "Nm"),
        }
        assert [lost.task for lost in report.yields] == list(expected)
        for lost in report.yields:
            amount, unit = expected[lost.task]
            scale = 1 + np.abs(amount).max() + np.abs(terms.Lambda).max()
            assert np.abs(lost.amount - amount).max() < SOLVER_AGREEMENT * scale
            assert lost.units[0] == unit
            assert len(lost.axes) == len(lost.units) == len(amount)
            axis, most, _ = lost.largest()
            assert most == lost.amount[lost.axes.index(axis)]
        assert "gave way by" in report.explain()


@pytest.mark.parametrize(("favoured", "loser"), [("motion", "force"), ("force", "motion")])
def test_the_task_with_the_small_weight_gives_way(favoured: str, loser: str) -> None:
    controller, space = limited_controller("arm_7", 3), SPACES["arm_7"]
    equal = dict.fromkeys(WEIGHTS[0], 1.0)
    for q, v, drawn, tau_max in torque_limited("arm_7", 3, 8):
        terms = oracles.body_terms(controller.robot.model, q, v, "tool", space.index)
        metric = {"motion": terms.Lambda, "force": terms.Lambda_inv}
        lost = []
        for weights in (equal, {**equal, favoured: 1e3}):
            references = {**drawn.references(weights), "limits": Given(tau_max=tau_max)}
            _, report, _ = tick(controller, q, v, references)
            amount = {lost.task: lost.amount for lost in report.yields}
            lost.append({task: amount[task] @ m @ amount[task] for task, m in metric.items()})
        assert lost[1][favoured] <= lost[0][favoured] * (1 + SOLVER_AGREEMENT)
        assert lost[1][loser] >= lost[0][loser] * (1 - SOLVER_AGREEMENT)


def run_limited(
    limits: Given, a_cmd: np.ndarray, v: np.ndarray, tau_last: np.ndarray | None = None
) -> tuple[TickReport, oracles.Response, np.ndarray]:
    """Run the planar arm in free space with its joints commanded, a limit set."""
    controller = limited_controller("planar_2r", 0)
    q = np.array([0.4, 0.9])
    terms = oracles.body_terms(controller.robot.model, q, v, "tool", [0, 1])
    wanted = {
        "motion": Given(a_cmd=terms.J @ a_cmd + terms.J_dot_v),
        "limits": limits,
    }
    command, report, _ = tick(controller, q, v, wanted, tau_last=tau_last)
    assert report.status is Status.OK
    none = oracles.Rows(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    return report, oracles.plant(terms, none, command.tau), command.tau


@pytest.mark.parametrize(("push", "side"), [(1.0, "upper"), (-1.0, "lower")])
def test_a_torque_rate_binds_and_is_named(push: float, side: str) -> None:
    tau_last, rate = np.array([20.0, 5.0]), np.array([1e9, 500.0])
    report, _, tau = run_limited(
        Given(tau_rate=rate), push * np.array([30.0, 30.0]), np.zeros(2), tau_last
    )
    assert [limit.name for limit in report.active] == ["torque rate elbow"]
    assert tau[1] == pytest.approx(5.0 + push * 0.5, abs=INSIDE)
    assert np.sign(report.active[0].dual) == push
    assert f"torque rate elbow at its {side} limit" in report.explain()


@pytest.mark.parametrize("push", [1.0, -1.0])
def test_a_torque_limit_binds_and_is_named(push: float) -> None:
    report, _, tau = run_limited(
        Given(tau_max=np.array([8.0, 1e9])), push * np.array([30.0, 0.0]), np.zeros(2)
    )
    assert [limit.name for limit in report.active] == ["torque shoulder"]
    assert tau[0] == pytest.approx(push * 8.0, abs=INSIDE)
    assert np.sign(report.active[0].dual) == push


@pytest.mark.parametrize("push", [1.0, -1.0])
def test_a_velocity_limit_binds_and_is_named(push: float) -> None:
    v = push * np.array([0.2, 1.95])
    report, got, _ = run_limited(Given(v_max=np.array([9.0, 2.0])), push * np.array([0, 50.0]), v)
    assert [limit.name for limit in report.active] == ["velocity elbow"]
    assert got.a[1] == pytest.approx(push * VELOCITY_RATE * 0.05, rel=1e-8)


@pytest.mark.parametrize("push", [1.0, -1.0])
def test_a_position_limit_binds_and_is_named(push: float) -> None:
    v, room = push * np.array([0.0, 0.5]), 0.03
    stop = (
        {"q_max": np.array([9.0, 0.9 + room])}
        if push > 0
        else {"q_min": np.array([-9.0, 0.9 - room])}
    )
    report, got, _ = run_limited(Given(stop), push * np.array([0, 50.0]), v)
    assert [limit.name for limit in report.active] == ["position elbow"]
    barrier = POSITION_RATE**2 * room - 2 * POSITION_RATE * 0.5
    assert got.a[1] == pytest.approx(push * barrier, rel=1e-8)


def test_a_contact_that_can_only_push_is_not_pulled_and_is_named() -> None:
    robot, space = ROBOTS["arm_7"](), SPACES["arm_7"]
    one_sided = Controller(robot, [given_mode(robot, space, 1, one_sided=True)])
    two_sided = given_controller("arm_7", 1)
    seen = 0
    for q, v, rng in states(robot, space, 10):
        references = draw(rng, 1, 6, 7).references()
        lam = tick(two_sided, q, v, references)[1].lam[0]
        _, report, _ = tick(one_sided, q, v, references)
        assert report.lam[0] == pytest.approx(max(lam, 0.0), abs=1e-6 * (1 + abs(lam)))
        names = [limit.name for limit in report.active]
        assert names == (["unilateral pfaffian.row0"] if lam < 0 else [])
        seen += lam < 0
    assert 0 < seen < 10


def test_rows_of_the_qp_are_named_in_both_forms() -> None:
    for form in ("reduced", "full"):
        rows = given_controller("planar_2r", 1, form, one_sided=True).engines["contact"].tick.rows
        dynamics = ("dynamics shoulder", "dynamics elbow") if form == "full" else ()
        assert rows.equality == ("pfaffian.row0", *dynamics)
        assert rows.inequality == (
            "torque shoulder",
            "torque elbow",
            "acceleration shoulder",
            "acceleration elbow",
            "unilateral pfaffian.row0",
        )


def test_limits_that_are_not_there_are_no_rows_of_size_infinity() -> None:
    controller = given_controller("arm_6", 3)
    q, v, rng = next(states(controller.robot, SPACES["arm_6"], 1))
    tick(controller, q, v, draw(rng, 3, 6, 6).references())
    bounds = controller.engines["contact"].terms
    assert np.isfinite(bounds["lb"]).all()
    assert np.isfinite(bounds["ub"]).all()
    assert (np.abs(bounds["ub"]) <= UNBOUNDED).all()
