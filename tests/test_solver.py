"""Every back-end against QPs solved by hand, with the signs of their multipliers."""

from typing import Any

import numpy as np
import pytest
from cases import SOLVERS

from qpctrl import Controller, InputError
from qpctrl.limit import UNBOUNDED
from qpctrl.polish import Polish
from qpctrl.solver import QpData, Solution, make_solver

FAST = 1e-5
"""Interior-point back-ends stop here; `Polish` takes them to 1e-9, which test_qp.py asserts."""

ROUND_OFF = 1e-14
"""Two computations of numbers of order 1 by the same steps; memory that is aligned otherwise may
change the order of sums in proxsuite."""

EXACT = 1e-10
"""After a polish: one linear solve."""


def hand(sign: float) -> tuple[QpData, Solution]:
    """Return min ½(x² + y²) − s(3x + y), x + y = 2s, and |x| ≤ 1.5 on the side that binds.

    Without the bound x = 2s, y = 0. With it x = 1.5s, y = 0.5s; stationarity in y gives the
    equality's multiplier s/2, in x the bound's s: positive at the top, negative at the bottom.
    """
    qp = QpData(
        H=np.eye(2),
        g=-sign * np.array([3.0, 1.0]),
        A=np.ones((1, 2)),
        b=np.array([2.0 * sign]),
        C=np.array([[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]]),
        lb=np.array([-1.5, -4.0, -UNBOUNDED]),
        ub=np.array([1.5, 4.0, UNBOUNDED]),
    )
    x, y, z = np.array([1.5, 0.5]), np.array([0.5]), np.array([1.0, 0.0, 0.0])
    return qp, Solution(sign * x, sign * y, sign * z)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", SOLVERS)
def test_point_and_multipliers_are_those_found_by_hand(name: str, sign: float) -> None:
    qp, expected = hand(sign)
    found = make_solver(name).solve(qp)
    assert found.feasible
    assert found.x == pytest.approx(expected.x, abs=FAST)
    assert found.y == pytest.approx(expected.y, abs=FAST)
    assert found.z == pytest.approx(expected.z, abs=FAST)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_qp_without_equalities_or_active_bounds_is_a_linear_solve(name: str) -> None:
    H = np.array([[4.0, 1.0], [1.0, 2.0]])
    g = np.array([1.0, -3.0])
    qp = QpData(
        H, g, np.zeros((0, 2)), np.zeros(0), np.eye(2), np.full(2, -9.0), np.full(2, UNBOUNDED)
    )
    found = make_solver(name).solve(qp)
    assert found.x == pytest.approx(-np.linalg.solve(H, g), abs=FAST)
    assert found.z == pytest.approx([0, 0], abs=FAST)


@pytest.mark.parametrize("name", SOLVERS)
def test_an_infeasible_qp_is_a_value_and_the_next_one_is_solved(name: str) -> None:
    qp, expected = hand(1.0)
    solver = make_solver(name)
    impossible = qp._replace(b=np.array([50.0]))  # x + y ≤ 5.5
    assert not solver.solve(impossible).feasible
    again = solver.solve(qp)
    assert again.feasible
    assert again.x == pytest.approx(expected.x, abs=FAST)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_solver_that_is_used_again_gives_the_answer_of_the_new_data(name: str) -> None:
    solver = make_solver(name)
    for sign in (1.0, -1.0, 1.0):
        qp, expected = hand(sign)
        assert solver.solve(qp).x == pytest.approx(expected.x, abs=FAST)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_solver_that_is_reset_answers_like_a_new_one(name: str) -> None:
    """Proxsuite's answer after a warm start is off by 3e-10 here: more than round-off."""
    (qp, _), (other, _) = hand(1.0), hand(-1.0)
    solver, new = make_solver(name), make_solver(name).solve(qp)
    solver.solve(other)
    solver.reset()
    again = solver.solve(qp)
    for found, expected in zip(again[:3], new[:3], strict=True):
        assert found == pytest.approx(expected, abs=ROUND_OFF)


def test_polish_makes_a_rough_point_exact() -> None:
    for sign in (1.0, -1.0):
        qp, expected = hand(sign)
        rough = Solution(
            expected.x + 1e-4, expected.y - 1e-3, expected.z + 1e-3 * np.array([1, -1, 0])
        )
        repaired = Polish(2, 1, 3).on_active_set(qp, rough)
        assert repaired.x == pytest.approx(expected.x, abs=EXACT)
        assert repaired.y == pytest.approx(expected.y, abs=EXACT)
        assert repaired.z == pytest.approx(expected.z, abs=EXACT)
        assert repaired.feasible


def test_polish_does_not_invent_active_bounds() -> None:
    qp, _ = hand(1.0)
    wide = qp._replace(ub=np.array([3.0, 4.0, UNBOUNDED]))
    repaired = Polish(2, 1, 3).on_active_set(
        wide, Solution(np.array([1.999, 0.001]), np.array([0.9]), np.zeros(3))
    )
    assert repaired.x == pytest.approx([2.0, 0.0], abs=EXACT)
    assert not repaired.z.any()


@pytest.mark.parametrize(("typed", "meant"), [("proxsuit", "proxsuite"), ("dagp", "daqp")])
def test_an_unknown_solver_is_refused_with_the_nearest_name(typed: str, meant: str) -> None:
    with pytest.raises(InputError, match=rf"unknown solver '{typed}'; allowed: .*mean '{meant}'"):
        make_solver(typed)


def test_the_controller_hands_the_name_on() -> None:
    robot: Any = None
    from cases import ROBOTS, SPACES, given_mode

    robot = ROBOTS["planar_2r"]()
    with pytest.raises(InputError, match="unknown solver 'fast'"):
        Controller(robot, [given_mode(robot, SPACES["planar_2r"], 1)], solver="fast")


@pytest.mark.parametrize("name", SOLVERS)
def test_a_bound_that_is_widened_is_noticed(name: str) -> None:
    """The answer from before is still inside and stationary, but presses on nothing."""
    qp, _ = hand(1.0)
    solver = make_solver(name)
    solver.solve(qp)
    found = solver.solve(qp._replace(ub=np.array([1.8, 4.0, UNBOUNDED])))
    assert found.x == pytest.approx([1.8, 0.2], abs=FAST)
    assert found.z == pytest.approx([0.4, 0.0, 0.0], abs=FAST)


@pytest.mark.parametrize("name", SOLVERS)
def test_bounds_that_meet_are_an_equality(name: str) -> None:
    """X = 1.8 from both sides; its multiplier is that of the side on which the cost presses."""
    for x in (1.8, 2.2):
        qp, _ = hand(1.0)
        met = qp._replace(lb=np.array([x, -4.0, -UNBOUNDED]), ub=np.array([x, 4.0, UNBOUNDED]))
        found = make_solver(name).solve(met)
        assert found.feasible
        assert found.x == pytest.approx([x, 2 - x], abs=FAST)
        assert found.z == pytest.approx([2 * (2 - x), 0.0, 0.0], abs=FAST)
