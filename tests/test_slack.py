"""Constraints with slack: the hybrid law until a limit binds, then a solution where none was."""

import functools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import oracles
import pytest
from cases import (
    LAW_AGREEMENT,
    ROBOTS,
    ROWS,
    SOLVER_FORMS,
    SPACES,
    WEIGHTS,
    Draw,
    Given,
    board,
    draw,
    given_mode,
    planar_2r,
    states,
    tick,
)

from qpctrl import (
    Controller,
    InputError,
    Pfaffian,
    Status,
    TickReport,
    Weighted,
    from_pinocchio,
)
from qpctrl.contact import FrictionCone, MaxForce, WrenchLimit
from tasks import PostureTask

KKT = 1e-9
"""Promised residual of every accepted tick."""

SOLVER_AGREEMENT = 1e-7
"""Promised relative agreement with another solver where limits are active."""

INSIDE = 1e-9
"""Nm: the promised residual of the inequality."""

STILL = 1e-9
"""m/s², rad/s²: round-off of an acceleration of 100."""

STATES = 20
SPACE = SPACES["arm_7"]
MODE = given_mode(ROBOTS["arm_7"](), SPACE, 3)
HELD = [(name, k) for name, k in ROWS if k]
SLACKS = [0.02, 0.3, 1.0, 100.0]
"""Weights w_s, each with those of `WEIGHTS` at its place: four decades between them."""


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest difference against the largest entry."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def soft(name: str, k: int, form: str = "reduced", **options: Any) -> Controller:
    """Return a controller of k given rows with slack."""
    robot = ROBOTS[name]()
    mode = replace(given_mode(robot, SPACES[name], k), slack=1.0)
    return Controller(robot, [mode], form=form, **options)


def references(drawn: Draw, i: int, **limits: np.ndarray) -> dict[str, Given]:
    """Return the draw with the weights and the slack at place ``i``, and limits."""
    slack = {"slack": Given(weight=np.array(SLACKS[i]))}
    return {**drawn.references(WEIGHTS[i]), **slack, "limits": Given(limits)}


class Case(NamedTuple):
    """A random state with commands, and the same for the oracles."""

    q: np.ndarray
    v: np.ndarray
    drawn: Draw
    terms: oracles.BodyTerms
    rows: oracles.Rows
    wanted: oracles.Wanted
    hybrid: np.ndarray
    rng: np.random.Generator

    def slack_under(self, tau: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return A V̇ + Ȧ V − v̇_c (k) of the arm alone, under a torque and a wrench Aᵀ λ."""
        load = self.terms.J.T @ (self.rows.A.T @ lam + self.wanted.F_ext)
        a = np.linalg.solve(self.terms.M, tau - self.terms.h - load)
        V_dot = self.terms.J @ a + self.terms.J_dot_v
        return self.rows.A @ V_dot + self.rows.A_dot_V - self.rows.v_c_dot


def cases(name: str, k: int, count: int, seed: int = 5) -> Iterator[Case]:
    """Yield random states and commands, none of them zero."""
    robot, space = ROBOTS[name](), SPACES[name]
    for q, v, rng in states(robot, space, count, seed=seed + k):
        drawn = draw(rng, k, space.n, robot.nv)
        terms = oracles.body_terms(robot.model, q, v, "tool", space.index)
        rows = oracles.Rows(drawn.A, drawn.A_dot_V, drawn.v_c_dot)
        wanted = oracles.Wanted(drawn.a_cmd, drawn.F_cmd, drawn.F_ext, drawn.a_post)
        hybrid = oracles.hybrid(terms, rows, wanted)
        yield Case(q, v, drawn, terms, rows, wanted, hybrid, rng)


@functools.cache
def tight(name: str, k: int, count: int) -> list[tuple[Case, np.ndarray]]:
    """Return cases with torque limits far below what the law asks for, in every joint."""
    return [
        (case, 0.1 + np.abs(case.hybrid) * case.rng.uniform(0.05, 0.6, len(case.hybrid)))
        for case in cases(name, k, count)
    ]


@pytest.mark.parametrize("form", ["reduced", "full"])
@pytest.mark.parametrize(("name", "k"), HELD)
def test_without_limits_the_qp_is_the_hybrid_law_for_any_slack(
    name: str, k: int, form: str
) -> None:
    controller = soft(name, k, form)
    for case in cases(name, k, STATES):
        for i in range(len(SLACKS)):
            command, report, _ = tick(controller, case.q, case.v, references(case.drawn, i))
            assert report.status is Status.OK
            assert relative(command.tau, case.hybrid) < LAW_AGREEMENT
            assert report.law_gap < LAW_AGREEMENT
            assert report.kkt_residual < KKT
            assert not report.active
            assert not report.yields


def test_the_command_across_the_rows_would_otherwise_move_them() -> None:
    """The draws do ask for motion across A: a cost of all of V̇ − a_cmd would not leave s = 0."""
    across = [
        np.abs(case.rows.A @ case.drawn.a_cmd + case.rows.A_dot_V - case.rows.v_c_dot).min()
        for case in cases("arm_7", 3, STATES)
    ]
    assert max(across) > 0.5


@pytest.mark.parametrize("form", ["reduced", "full"])
@pytest.mark.parametrize(("name", "k"), HELD)
def test_with_torque_limits_it_is_the_optimum_and_the_slack_is_that_of_the_arm(
    name: str, k: int, form: str
) -> None:
    controller, joints = soft(name, k, form), ROBOTS[name]().joint_names
    for i, (case, tau_max) in enumerate(tight(name, k, STATES)):
        i %= len(SLACKS)
        given = references(case.drawn, i, tau_max=tau_max)
        command, report, _ = tick(controller, case.q, case.v, given)
        assert report.status is Status.OK
        assert report.kkt_residual <= KKT
        assert (np.abs(command.tau) <= tau_max + INSIDE).all()
        weights = tuple(WEIGHTS[i].values())
        best = oracles.limited_optimum(
            case.terms, case.rows, case.wanted, weights, -tau_max, tau_max, SLACKS[i]
        )
        assert relative(command.tau, best.tau) < SOLVER_AGREEMENT
        assert {limit.name for limit in report.active} <= {f"torque {j}" for j in joints}
        given_way = report.yields[-1]
        s = case.slack_under(command.tau, report.lam)
        assert np.abs(given_way.amount - s).max() < SOLVER_AGREEMENT * (1 + np.abs(s).max())
        assert given_way.task == "slack"
        assert given_way.axes == tuple(f"pfaffian.row{j}" for j in range(k))
        assert np.abs(s).max() > 1e-3
        assert "; slack gave way by" in report.explain()


@pytest.mark.parametrize("name", ["planar_2r", "arm_6", "arm_7"])
def test_all_solvers_and_both_forms_agree_with_limits_active(name: str) -> None:
    k = 1 if name == "planar_2r" else 3
    found = []
    for solver, form in SOLVER_FORMS:
        controller = soft(name, k, form, solver=solver)
        for i, (case, tau_max) in enumerate(tight(name, k, 8)):
            given = references(case.drawn, i % len(SLACKS), tau_max=tau_max)
            command, report, _ = tick(controller, case.q, case.v, given)
            assert report.status is Status.OK, (solver, form)
            assert report.kkt_residual <= KKT, (solver, form)
            found.append(command.tau)
    by_backend = np.array(found).reshape(len(SOLVER_FORMS), 8, -1)
    for i in range(8):
        for other in by_backend[1:, i]:
            assert relative(other, by_backend[0, i]) < SOLVER_AGREEMENT


def slack_of(report: TickReport) -> np.ndarray:
    """Return how far each row gave way."""
    return {lost.task: lost.amount for lost in report.yields}["slack"]


WEAK = Given(tau_max=np.full(7, 0.3))
SLOW = Given(q_max=np.full(7, 3.0), q_min=np.full(7, -3.0), v_max=np.full(7, 1.0))


@pytest.mark.parametrize("form", ["reduced", "full"])
@pytest.mark.parametrize(
    ("k", "one_sided", "carried", "limits"),
    [
        (3, True, (), WEAK),
        (3, False, (FrictionCone(space=SPACE, mu=0.3), MaxForce(space=SPACE, limit=5.0)), WEAK),
        (6, False, (), SLOW),
    ],
    ids=["one-sided rows, weak joints", "cone, largest force, weak joints", "slow joints"],
)
def test_it_has_a_solution_where_rows_that_hold_have_none(
    k: int, one_sided: bool, carried: tuple[WrenchLimit, ...], limits: Given, form: str
) -> None:
    robot = ROBOTS["arm_7"]()
    mode = replace(given_mode(robot, SPACE, k, one_sided=one_sided), contact_limits=carried)
    rigid = Controller(robot, [mode], form=form)
    with_slack = Controller(robot, [replace(mode, slack=1.0)], form=form)
    unsolved = 0
    for case in cases("arm_7", k, STATES):
        given = {**case.drawn.references(), "limits": limits}
        command, report, _ = tick(with_slack, case.q, case.v, given)
        assert report.status is Status.OK
        assert report.kkt_residual <= KKT
        assert not command.fallback
        s = case.slack_under(command.tau, report.lam)
        assert np.abs(slack_of(report) - s).max() < SOLVER_AGREEMENT * (1 + np.abs(s).max())
        command, report, _ = tick(rigid, case.q, case.v, given)
        if report.status is not Status.OK:
            assert command.fallback
            assert np.abs(s).max() > 0.1
            unsolved += 1
    assert unsolved > STATES // 2


def test_what_a_contact_can_carry_alone_moves_no_row() -> None:
    """Contact limits act on λ, the slack on a: without torque limits they do not meet."""
    robot, bound = ROBOTS["arm_7"](), 0
    carried = (FrictionCone(space=SPACE, mu=0.3), MaxForce(space=SPACE, limit=5.0))
    mode = replace(given_mode(robot, SPACE, 3), contact_limits=carried)
    rigid, with_slack = Controller(robot, [mode]), Controller(robot, [replace(mode, slack=0.02)])
    for case in cases("arm_7", 3, STATES):
        expected, _, _ = tick(rigid, case.q, case.v, case.drawn.references())
        command, report, _ = tick(with_slack, case.q, case.v, case.drawn.references())
        assert relative(command.tau, expected.tau) < LAW_AGREEMENT
        if report.active:
            bound += 1
            assert np.abs(slack_of(report)).max() < STILL
    assert bound > STATES // 2


def test_the_dearer_the_slack_the_nearer_to_rows_that_hold() -> None:
    """At w_s the torque is off by a term of order 1/w_s; the slack shrinks on the way."""
    controller, rigid = soft("arm_7", 3), Controller(ROBOTS["arm_7"](), [MODE])
    for case, tau_max in tight("arm_7", 3, 10):
        given = {**case.drawn.references(), "limits": Given(tau_max=tau_max)}
        expected, report, _ = tick(rigid, case.q, case.v, given)
        assert report.status is Status.OK
        apart, moved = [], []
        S_inv = np.linalg.inv(case.rows.A @ case.terms.Lambda_inv @ case.rows.A.T)
        for w_s in (1.0, 10.0, 1e4, 1e5):
            slack = {"slack": Given(weight=np.array(w_s))}
            command, report, _ = tick(controller, case.q, case.v, {**given, **slack})
            apart.append(relative(command.tau, expected.tau))
            moved.append(slack_of(report) @ S_inv @ slack_of(report))
        assert moved[0] > moved[1] > moved[2] > moved[3]
        assert apart[3] < 1e-2
        assert moved[2] / moved[3] == pytest.approx(100.0, rel=0.1)


def test_the_scale_and_mix_of_the_rows_do_not_matter() -> None:
    controller = soft("arm_7", 3)
    for case, tau_max in tight("arm_7", 3, 10):
        mix = case.rng.normal(size=(3, 3)) + 3 * np.eye(3)
        names = ("A", "A_dot_V", "v_c_dot")
        mixed = Given({name: mix @ getattr(case.drawn, name) for name in names})
        given = references(case.drawn, 0, tau_max=tau_max)
        command, report, _ = tick(controller, case.q, case.v, given)
        given["pfaffian"] = mixed
        other, other_report, _ = tick(controller, case.q, case.v, given)
        assert relative(other.tau, command.tau) < SOLVER_AGREEMENT
        assert relative(slack_of(other_report), mix @ slack_of(report)) < SOLVER_AGREEMENT


def test_its_rows_are_no_equalities_and_are_named_with_their_units() -> None:
    robot = ROBOTS["arm_7"]()
    mode = replace(given_mode(robot, SPACE, 0), constraints=(board(SPACE),), slack=2.0)
    for form, equalities in (("reduced", 0), ("full", 7)):
        engine = Controller(robot, [mode], form=form).engines["contact"]
        tick_ = engine.tick
        assert len(tick_.rows.equality) == len(engine.terms["b"]) == equalities
        assert tick_.rows.constraint == ("plane.vz", "plane.wx", "plane.wy")
        assert tick_.mode_rows == 3
        give = tick_.gives[-1]
        assert (give.task, give.axes) == ("slack", tick_.rows.constraint)
        assert give.units == ("m/s²", "rad/s²", "rad/s²")
        assert engine.inputs["slack.weight"] == 2.0


def test_a_cheap_slack_does_not_look_like_motion_that_is_undetermined() -> None:
    """Home is all but stretched, and the row lies along the arm: J, not w_s, is judged there."""
    home = np.array([0.4, 1e-3])
    robot = from_pinocchio(planar_2r().model, home=home, tau_rate=1e9)
    mode = given_mode(robot, SPACES["planar_2r"], 1)
    no_posture = tuple(task for task in mode.tasks if task.task.name != "posture")
    Controller(robot, [replace(mode, tasks=no_posture, slack=1e-6)])


def test_dependent_rows_with_slack_are_still_refused_or_dropped_by_name() -> None:
    robot, A = ROBOTS["arm_7"](), np.eye(6)[[0, 1, 1]]
    mode = replace(MODE, constraints=(Pfaffian(space=SPACE, A=A, name="twice"),), slack=1e6)
    with pytest.raises(InputError, match=r"constraint row twice\.row2 depends.*'drop'"):
        Controller(robot, [mode])
    dropped = Controller(robot, [mode], dependent_rows="drop").engines["contact"].tick
    assert dropped.rows.constraint == ("twice.row0", "twice.row1")
    q, v, _ = next(states(robot, SPACE, 1))
    _, report, _ = tick(soft("arm_7", 3), q, v, {"pfaffian": Given(A=A)})
    assert report.status is Status.DEPENDENT_ROWS
    assert report.dependent_rows == ("pfaffian.row2",)


def test_both_forms_agree_where_a_joint_is_not_driven() -> None:
    """No closed form: the comparator is the QP without its inequalities, slack and all."""
    B = np.array([[1.0], [0.0]])
    robot = from_pinocchio(planar_2r().model, home=np.array([0.4, 0.9]), B=B, tau_rate=1e9)
    mode = replace(given_mode(robot, SPACES["planar_2r"], 1), slack=0.3)
    forms = [Controller(robot, [mode], form=form) for form in ("reduced", "full")]
    for case in cases("planar_2r", 1, 10):
        given = {**case.drawn.references(), "limits": Given(tau_max=np.array([1e9]))}
        free, _, _ = tick(forms[0], case.q, case.v, given)
        for tau_max in (np.array([1e9]), 0.5 * np.abs(free.tau)):
            given["limits"] = Given(tau_max=tau_max)
            one, other = (tick(form, case.q, case.v, given) for form in forms)
            for report in (one[1], other[1]):
                assert report.status is Status.OK
                assert report.kkt_residual <= KKT
                assert report.saturated == (tau_max[0] < 1e9)
                assert report.saturated or report.law_gap < LAW_AGREEMENT
            assert relative(other[0].tau, one[0].tau) < SOLVER_AGREEMENT
            assert relative(other[1].lam, one[1].lam) < SOLVER_AGREEMENT


@pytest.mark.parametrize("w_s", [0.0, -1.0, 1e-7, 1e7, np.inf, np.nan])
def test_a_weight_that_is_none_is_refused_in_one_line(w_s: float) -> None:
    with pytest.raises(
        InputError, match=r"slack of mode 'contact': got .*, need a number from 1e-6 to 1e6$"
    ):
        replace(MODE, slack=w_s)


def test_slack_without_rows_or_beside_a_task_of_that_name_is_refused() -> None:
    robot = ROBOTS["arm_7"]()
    with pytest.raises(InputError, match="mode 'contact': slack needs a constraint"):
        replace(given_mode(robot, SPACE, 0), slack=1.0)
    named = (*MODE.tasks, Weighted(PostureTask(name="slack", q_ref=robot.home)))
    replace(MODE, tasks=named)
    with pytest.raises(InputError, match=r"names must differ, got .*slack, .*slack"):
        replace(MODE, tasks=named, slack=1.0)
