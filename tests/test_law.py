"""The closed forms: identities of P, published numbers, and what the exact plant answers."""

from typing import NamedTuple

import numpy as np
import oracles
import pinocchio as pin
import pytest
from cases import (
    LAW_AGREEMENT,
    ROBOTS,
    ROUND_OFF,
    ROWS,
    SPACES,
    Draw,
    Given,
    draw,
    given_controller,
    given_mode,
    planar_2r,
    point_mass,
    random_rotation,
    states,
    tick,
)

from qpctrl import Controller, TaskSpace, from_pinocchio
from qpctrl.report import TickReport

FORCE_ON_PLANT = 1e-9
"""Relative: one more linear solve behind the law, conditioned like Λ."""

PRINTED = 5e-7
"""The published numbers have six digits."""

STATES = 25


class Case(NamedTuple):
    """One random tick: what the library says, and the independent terms."""

    report: TickReport
    outputs: dict[str, np.ndarray]
    terms: oracles.BodyTerms
    rows: oracles.Rows
    wanted: oracles.Wanted


def as_oracle(drawn: Draw) -> tuple[oracles.Rows, oracles.Wanted]:
    """Return the rows and the commands of a draw."""
    rows = oracles.Rows(drawn.A, drawn.A_dot_V, drawn.v_c_dot)
    return rows, oracles.Wanted(drawn.a_cmd, drawn.F_cmd, drawn.F_ext, drawn.a_post)


def random_cases(name: str, k: int, count: int = STATES) -> list[Case]:
    """Return random ticks of one robot with k rows."""
    controller, space, found = given_controller(name, k), SPACES[name], []
    for q, v, rng in states(controller.robot, space, count, seed=10 + k):
        drawn = draw(rng, k, space.n, controller.robot.nv)
        _, report, _ = tick(controller, q, v, drawn.references())
        outputs = {key: x.copy() for key, x in controller.engines["contact"].terms.items()}
        terms = oracles.body_terms(controller.robot.model, q, v, space.frame, space.index)
        found.append(Case(report, outputs, terms, *as_oracle(drawn)))
    return found


def close(found: np.ndarray, expected: np.ndarray, relative: float) -> bool:
    """Return whether the largest difference is small against the largest entry."""
    size = max(np.abs(expected).max(initial=0), np.abs(found).max(initial=0), 1.0)
    return bool(np.abs(found - expected).max(initial=0) <= relative * size)


@pytest.mark.parametrize(("name", "k"), ROWS)
def test_inertia_and_projector_are_those_of_the_formulas(name: str, k: int) -> None:
    for case in random_cases(name, k, count=10):
        assert close(case.outputs["Lambda0"], case.terms.Lambda, LAW_AGREEMENT)
        P = oracles.projector(case.rows.A, case.terms.Lambda_inv)
        assert close(case.outputs["P0"], P, LAW_AGREEMENT)


@pytest.mark.parametrize(("name", "k"), ROWS)
def test_the_projector_splits_motion_from_force(name: str, k: int) -> None:
    for case in random_cases(name, k, count=10):
        P, A, Lambda_inv = case.outputs["P0"], case.rows.A, case.terms.Lambda_inv
        n, identity = len(P), np.eye(len(P))
        size = 1 + np.abs(P).max()
        assert close(P @ P, P, ROUND_OFF * size)
        assert np.linalg.matrix_rank(P, tol=1e-8 * size) == n - k
        assert close(P @ A.T, np.zeros((n, k)), ROUND_OFF * size)
        assert close(
            A @ Lambda_inv @ P, np.zeros((k, n)), ROUND_OFF * size * np.abs(Lambda_inv).max()
        )
        assert close((identity - P) @ A.T, A.T, ROUND_OFF * size)


def ticked_projector(
    controller: Controller, q: np.ndarray, v: np.ndarray, A: np.ndarray
) -> np.ndarray:
    """Return the library's P for the rows ``A`` at (q, v)."""
    tick(controller, q, v, {"pfaffian": Given(A=A)})
    return controller.engines["contact"].terms["P0"].copy()


@pytest.mark.parametrize(("name", "k"), [(name, k) for name, k in ROWS if k > 1])
def test_the_projector_does_not_depend_on_how_the_rows_are_mixed(name: str, k: int) -> None:
    controller, space = given_controller(name, k), SPACES[name]
    for q, v, rng in states(controller.robot, space, 5):
        A, T = rng.normal(size=(k, space.n)), np.diag(10.0 ** rng.uniform(-2, 2, k))
        T = T @ np.linalg.qr(rng.normal(size=(k, k)))[0]
        P = ticked_projector(controller, q, v, A)
        assert close(
            ticked_projector(controller, q, v, T @ A), P, LAW_AGREEMENT * (1 + np.abs(P).max())
        )


@pytest.mark.parametrize("k", [1, 3, 5])
def test_the_projector_follows_the_frame_and_the_euclidean_one_does_not(k: int) -> None:
    robot, moved = ROBOTS["arm_6"](), ROBOTS["arm_6"]().model.copy()
    tool = moved.frames[moved.getFrameId("tool")]
    X = pin.SE3(random_rotation(4), np.array([0.1, -0.2, 0.15]))  # X_FG
    moved.addFrame(pin.Frame("grip", tool.parentJoint, 0, tool.placement * X, tool.type))
    here, there = given_controller("arm_6", k), frame_controller(moved, "grip", k)
    for q, v, rng in states(robot, SPACES["arm_6"], 5):
        A = rng.normal(size=(k, 6))
        P = ticked_projector(here, q, v, A)
        P_moved = ticked_projector(there, q, v, A @ X.action)
        expected = X.action.T @ P @ np.linalg.inv(X.action.T)
        assert close(P_moved, expected, LAW_AGREEMENT * np.abs(P).max())
        E, E_moved = (oracles.euclidean_projector(rows) for rows in (A, A @ X.action))
        assert np.abs(E_moved - X.action.T @ E @ np.linalg.inv(X.action.T)).max() > 1e-2


def frame_controller(model: pin.Model, frame: str, k: int) -> Controller:
    """Return the controller of given commands for another frame."""
    robot = from_pinocchio(model, home=ROBOTS["arm_6"]().home)
    return Controller(robot, [given_mode(robot, TaskSpace(frame), k)])


@pytest.mark.parametrize(("name", "k"), ROWS)
def test_both_laws_are_those_of_the_formulas(name: str, k: int) -> None:
    for case in random_cases(name, k):
        textbook = oracles.textbook(case.terms, case.rows, case.wanted)
        hybrid = oracles.hybrid(case.terms, case.rows, case.wanted)
        assert close(case.report.tau_textbook, textbook, LAW_AGREEMENT)
        assert close(case.report.tau_hybrid, hybrid, LAW_AGREEMENT)


@pytest.mark.parametrize(("name", "k"), ROWS)
def test_the_plant_pushes_and_moves_as_the_hybrid_law_wants(name: str, k: int) -> None:
    for case in random_cases(name, k):
        terms, rows, wanted = case.terms, case.rows, case.wanted
        P = oracles.projector(rows.A, terms.Lambda_inv)
        for tau in (case.report.tau_hybrid, case.report.tau_qp):
            response = oracles.plant(terms, rows, tau, wanted.F_ext)
            pushed = (np.eye(len(P)) - P) @ wanted.F_cmd
            assert close(rows.A.T @ response.lam, pushed, LAW_AGREEMENT)
            free = P @ terms.Lambda @ (response.V_dot - wanted.a_cmd)
            assert close(free, np.zeros(len(P)), LAW_AGREEMENT * np.abs(terms.Lambda).max())


@pytest.mark.parametrize(("name", "k"), [(name, k) for name, k in ROWS if k])
def test_the_textbook_law_pushes_by_the_curvature_term_too_much(name: str, k: int) -> None:
    for case in random_cases(name, k, count=10):
        terms, rows, wanted = case.terms, case.rows, case.wanted
        P = oracles.projector(rows.A, terms.Lambda_inv)
        response = oracles.plant(terms, rows, case.report.tau_textbook, wanted.F_ext)
        pushed = (np.eye(len(P)) - P) @ wanted.F_cmd + oracles.curvature_wrench(terms, rows)
        assert close(rows.A.T @ response.lam, pushed, LAW_AGREEMENT)


def test_the_posture_does_not_disturb_the_tool() -> None:
    controller, space = given_controller("arm_7", 3), SPACES["arm_7"]
    for q, v, rng in states(controller.robot, space, 10):
        drawn = draw(rng, 3, 6, 7)
        rows, wanted = as_oracle(drawn)
        terms = oracles.body_terms(controller.robot.model, q, v, "tool", space.index)
        taus = [
            tick(controller, q, v, drawn._replace(a_post=a_post).references())[0].tau
            for a_post in (np.zeros(7), drawn.a_post)
        ]
        moved = [oracles.plant(terms, rows, tau, wanted.F_ext) for tau in taus]
        assert close(moved[0].V_dot, moved[1].V_dot, LAW_AGREEMENT)
        assert close(moved[0].lam, moved[1].lam, LAW_AGREEMENT)
        assert np.abs(moved[0].a - moved[1].a).max() > 1e-3  # and yet the elbow moves


# Published numbers -------------------------------------------------------------------------


def world_terms(robot_masses: tuple[float, float], q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Λ and P of the 2R arm against the wall x = const, along the axes of the world."""
    robot, space = planar_2r(*robot_masses), SPACES["planar_2r"]
    controller = Controller(robot, [given_mode(robot, space, 1)])
    R_WF = robot.pose(q, "tool").rotation[:2, :2]
    wall = np.array([[1.0, 0.0]]) @ R_WF
    tick(controller, q, np.zeros(2), {"pfaffian": Given(A=wall)})
    terms = controller.engines["contact"].terms
    return R_WF @ terms["Lambda0"] @ R_WF.T, R_WF @ terms["P0"] @ R_WF.T


@pytest.mark.parametrize(
    ("degrees", "printed"),
    [((0, 90), [[1, 0], [0, 2]]), ((0, 150), [[4, -np.sqrt(3)], [-np.sqrt(3), 2]])],
)
def test_the_planar_arm_has_the_inertia_of_the_textbook(
    degrees: tuple[float, float], printed: list[list[float]]
) -> None:
    Lambda, _ = world_terms((1.0, 1.0), np.deg2rad(degrees))
    assert np.allclose(Lambda, printed, atol=ROUND_OFF)


def test_the_planar_arm_at_the_wall_has_the_published_projector() -> None:
    Lambda, P = world_terms((2.0, 1.0), np.array([0.3, 0.9]))
    assert np.allclose(Lambda, [[1.427976, 1.100818], [1.100818, 3.831471]], atol=PRINTED)
    assert np.allclose(P, [[0, 0.287310], [0, 1]], atol=PRINTED)


def test_a_handle_is_pulled_by_its_centripetal_force_under_the_textbook_law_alone() -> None:
    """M v²/r = 5 · 0.25² / 0.5 = 0.625 N for the law as printed, nothing for the others."""
    m, r, speed = 5.0, 0.5, 0.25
    robot, space = point_mass(m), TaskSpace("tool", ("vx", "vy"))
    controller = Controller(robot, [given_mode(robot, space, 1)])
    angle = 0.7
    radial, tangent = (
        np.array([np.cos(angle), np.sin(angle)]),
        np.array([-np.sin(angle), np.cos(angle)]),
    )
    rows = oracles.Rows(radial[None], np.array([speed**2 / r]), np.zeros(1))
    wanted = {
        "motion": Given(a_cmd=0.3 * tangent - speed**2 / r * radial),
        "force": Given(F_cmd=2.0 * radial),
        "pfaffian": Given(A=rows.A, A_dot_V=rows.A_dot_V),
    }
    v = speed * tangent
    _, report, _ = tick(controller, r * radial, v, wanted)
    terms = oracles.body_terms(robot.model, r * radial, v, "tool", [0, 1])
    laws = (report.tau_textbook, report.tau_hybrid, report.tau_qp)
    error = [oracles.plant(terms, rows, tau).lam[0] - 2.0 for tau in laws]
    assert error == pytest.approx([0.625, 0.0, 0.0], abs=FORCE_ON_PLANT)
    assert all(
        oracles.plant(terms, rows, tau).V_dot @ tangent == pytest.approx(0.3) for tau in laws
    )


def test_the_euclidean_projector_moves_correctly_but_pushes_wrongly() -> None:
    """Zero desired force and 1 m/s² along the plane: the trap presses with newtons."""
    controller, space = given_controller("arm_6", 3), SPACES["arm_6"]
    trap, ours = [], []
    for q, _, rng in states(controller.robot, space, 40):
        v = np.zeros(6)
        terms = oracles.body_terms(controller.robot.model, q, v, "tool", space.index)
        rows = oracles.Rows(oracles.face_rows(np.eye(3), terms.X_WF), np.zeros(3), np.zeros(3))
        a_cmd = oracles.without_components(rows.A, np.r_[rng.normal(size=3), np.zeros(3)])
        a_cmd /= np.linalg.norm(a_cmd)
        wanted = oracles.Wanted(a_cmd, np.zeros(6), np.zeros(6), np.zeros(6))
        given = {"motion": Given(a_cmd=a_cmd), "force": Given(F_cmd=np.zeros(6), F_ext=np.zeros(6))}
        _, report, _ = tick(
            controller,
            q,
            v,
            {**given, "pfaffian": Given(A=rows.A, A_dot_V=np.zeros(3), v_c_dot=np.zeros(3))},
        )
        euclidean = oracles.textbook(terms, rows, wanted, P=oracles.euclidean_projector(rows.A))
        right, wrong = (oracles.plant(terms, rows, tau) for tau in (report.tau_qp, euclidean))
        assert close(right.V_dot, a_cmd, LAW_AGREEMENT)
        assert close(wrong.V_dot, a_cmd, LAW_AGREEMENT)  # the motion shows nothing
        trap.append(abs(wrong.lam[0]))
        ours.append(np.abs(right.lam).max())
    assert max(ours) < FORCE_ON_PLANT
    assert np.median(trap) > 0.5
    assert np.quantile(trap, 0.95) > 2.0
