"""The QP solver in C: against other solvers, on degenerate, contradictory and spoiled problems."""

import ctypes
import itertools
import shutil
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from cases import draw, given_mode, states

from qpctrl import TaskSpace
from qpctrl.compiler import COMPILERS, find_compiler
from qpctrl.contact import FrictionCone
from qpctrl.limit import UNBOUNDED
from qpctrl.polish import Polish
from qpctrl.solver import QpData, make_solver
from qpctrl.spatial import AXES
from qpctrl.tick import build_tick
from scenarios.robot_file import load_robot

SOURCE = Path(__file__).parents[1] / "qpctrl" / "native" / "qp.c"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror")

SOLVED, INFEASIBLE, FAILED = 0, 1, 2

KKT = 1e-9
"""Promised residual of every solution."""

SHARP = 1e-12
"""Promised residual on ordinary ticks."""

AGREEMENT = 1e-8
"""Another solver's answer, or that of one linear solve on its active set, relative to the largest
entry; H has condition numbers up to 1e7."""

ROUGH = 1e-8
"""What refinement may change, relative to the largest entry; measured: up to 1e-10."""

BREAKDOWN = 1e-6
"""Residual beyond which the solver itself says that it failed."""

GUARD = 8
"""Numbers behind each array that must stay as they are."""

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, COMPILERS)), reason="needs a C compiler on PATH"
)
pytestmark = needs_compiler


class Answer(NamedTuple):
    """What the solver returned and wrote."""

    code: int
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    rough_x: np.ndarray

    def bits(self) -> bytes:
        """Return all of it, to compare two answers."""
        return b"".join(np.asarray(part).tobytes() for part in self)


class Problem(NamedTuple):
    """A QP and its minimiser without inequalities."""

    qp: QpData
    x_eq: np.ndarray
    y_eq: np.ndarray


Solve = Callable[..., Answer]


@pytest.fixture(scope="module")
def solve(tmp_path_factory: pytest.TempPathFactory) -> Solve:
    """Return a function that solves a `Problem`, with ``fill`` in the workspace before it."""
    compiler, path = find_compiler(), tmp_path_factory.mktemp("qp") / "qp.so"
    command = (*compiler.command, *compiler.flags, "-std=c99", str(SOURCE), "-o", str(path), "-lm")
    subprocess.run(command, check=True)
    library = ctypes.CDLL(str(path))

    def run(problem: Problem, fill: float = np.nan, *, always: bool = False) -> Answer:
        qp = problem.qp
        given = [np.asfortranarray(part, dtype=float) for part in (*qp, *problem[1:])]
        sizes = (n, m, r) = len(qp.g), len(qp.b), len(qp.lb)
        lengths = (n, m, r, n, library.qpctrl_qp_work(*sizes))
        made = [np.full(length + GUARD, fill) for length in lengths]
        iw = np.full(library.qpctrl_qp_iwork(*sizes) + GUARD, -1234, dtype=np.intc)
        places = [part.ctypes.data_as(ctypes.c_void_p) for part in (*given, *made, iw)]
        code = library.qpctrl_qp(*sizes, *places, always)
        for part, before in zip(given, (*qp, *problem[1:]), strict=True):
            assert np.array_equal(part, before, equal_nan=True)
        for part in made:
            assert np.array_equal(part[-GUARD:], np.full(GUARD, fill), equal_nan=True)
        assert (iw[-GUARD:] == -1234).all()
        return Answer(code, *(part[:-GUARD] for part in made[:4]))

    return run


# Judges ------------------------------------------------------------------------------------


def largest(*vectors: np.ndarray) -> float:
    """Return the largest absolute entry, or 1."""
    return max(1.0, *(float(np.abs(vector).max(initial=0)) for vector in vectors))


def kkt(qp: QpData, found: Answer) -> float:
    """Return the KKT residual, each part over the largest of its terms or 1."""
    H, g, A, b, C, lb, ub = qp
    x, y, z = found.x, found.y, found.z
    terms = (H @ x, g, A.T @ y, C.T @ z)
    Ax, Cx = A @ x, C @ x
    room = np.where(
        z > 0, np.where(ub < UNBOUNDED, ub - Cx, 1), np.where(lb > -UNBOUNDED, Cx - lb, 1)
    )
    parts = [
        np.abs(np.sum(terms, axis=0)).max(initial=0) / largest(*terms),
        np.abs(Ax - b).max(initial=0) / largest(Ax, b),
        np.maximum(Cx - ub, lb - Cx).max(initial=0) / largest(Cx),
        np.abs(z * room).max(initial=0) / largest(z),
    ]
    assert np.isfinite(parts).all()
    return float(max(parts))


def freed(qp: QpData) -> Problem:
    """Return the QP with its minimiser without inequalities, by numpy."""
    n, m = len(qp.g), len(qp.b)
    K = np.block([[qp.H, qp.A.T], [qp.A, np.zeros((m, m))]])
    point = np.linalg.solve(K, np.concatenate([-qp.g, qp.b]))
    return Problem(qp, point[:n], point[n:])


def check(qp: QpData, found: Answer, solvers: tuple[str, ...], give_up: str = "") -> int:
    """Compare with other solvers, of which one may give up; return how many rows are active."""
    exact = Polish(len(qp.g), len(qp.b), len(qp.lb))
    assert found.code == SOLVED
    for name in solvers:
        other = make_solver(name).solve(qp)
        assert other.feasible or name == give_up, name
        if other.feasible:  # compared as it is or polished, which is NaN at a degenerate vertex
            theirs = np.array([other.x, exact.on_active_set(qp, other).x])
            gap = np.nanmin(np.abs(theirs - found.x).max(axis=1))
            assert gap <= AGREEMENT * largest(found.x), name
    assert kkt(qp, found) <= KKT
    assert (found.z[qp.ub >= UNBOUNDED] <= 0).all()
    assert (found.z[qp.lb <= -UNBOUNDED] >= 0).all()
    assert np.abs(found.x - found.rough_x).max() <= ROUGH * largest(found.x)
    return int(np.count_nonzero(found.z))


# The QPs of the controller -----------------------------------------------------------------

MODES = [
    *itertools.product(("planar_2r",), (0, 1), ("reduced", "full")),
    *itertools.product(("ur5", "fr3"), (0, 1, 3, 5, 6), ("reduced", "full")),
]
"""Robots, numbers of constraint rows, forms of the QP."""


def ticks(name: str, k: int, form: str, count: int) -> Iterator[Problem]:
    """Yield QPs of random states, with bounds on torques or accelerations or both.

    Constraint rows can only push, for k >= 3 within a friction cone. The bounds are near to a
    point that satisfies all other rows.
    """
    robot = load_robot(name)
    space = TaskSpace("flange", ("vx", "vy") if name == "planar_2r" else AXES)
    cones = (FrictionCone(space=space, mu=0.4),) if k >= 3 else ()
    mode = given_mode(robot, space, k, one_sided=True)
    tick = build_tick(robot, replace(mode, contact_limits=cones), form)
    for i, (q, v, rng) in enumerate(states(robot, space, count, seed=30 + k)):
        u = tick.inputs.vector()
        named, drawn = tick.inputs.views(u), draw(rng, k, space.n, robot.nv)
        weights = {task: 10.0 ** rng.uniform(-2, 2) for task in ("motion", "force", "posture")}
        for task, reference in drawn.references(weights).items():
            for key, value in reference.items():
                named[f"{task}.{key}"][...] = value
        named["dt"][...] = 1e-3
        results = tick.function(q, v, u, tick.memory.vector())
        out = dict(zip(tick.function.name_out(), map(np.array, results), strict=True))
        flat = {key: out[key].ravel() for key in ("g", "b", "lb", "ub", "t", "x_eq", "y_eq")}
        qp = QpData(out["H"], flat["g"], out["A"], flat["b"], out["C"], flat["lb"], flat["ub"])
        x = flat["x_eq"] * (1 + 0.3 * rng.normal(size=len(qp.g))) + 0.1 * rng.normal(size=len(qp.g))
        no_force = np.eye(len(x))[len(x) - k :]
        rows, right = np.vstack([qp.A, no_force]), np.concatenate([qp.b, np.zeros(k)])
        x -= np.linalg.pinv(rows) @ (rows @ x - right)
        bounded = slice(0 if i % 3 else robot.nu, robot.nu + (robot.nv if i % 3 != 1 else 0))
        qp.lb[: robot.nu + robot.nv], qp.ub[: robot.nu + robot.nv] = -UNBOUNDED, UNBOUNDED
        room = 0.02 * np.abs(qp.C @ x) + 0.01
        qp.lb[bounded], qp.ub[bounded] = (qp.C @ x - room)[bounded], (qp.C @ x + room)[bounded]
        yield Problem(qp, flat["x_eq"], flat["y_eq"])


@pytest.mark.parametrize(("name", "k", "form"), MODES)
def test_ticks_have_the_answer_of_other_solvers(solve: Solve, name: str, k: int, form: str) -> None:
    """Quadprog gives up at some tips of a friction cone, where 16 rows meet."""
    active = []
    for problem in ticks(name, k, form, 12):
        others = ("daqp", "quadprog") if form == "reduced" else ("daqp", "proxsuite")
        found = solve(problem)
        active.append(check(problem.qp, found, others, "quadprog" if k >= 3 else ""))
        assert kkt(problem.qp, found) <= SHARP
    assert np.median(active) >= 1


# Made-up QPs -------------------------------------------------------------------------------


def drawn(rng: np.random.Generator, n: int, m: int, r: int, *, zeros: int = 0) -> QpData:
    """Return a QP with a solution, tight bounds on half of its rows, and H zero in some rows."""
    B, A, C = (rng.normal(size=(rows, n)) for rows in (n, m, r))
    H = B @ B.T / n + 0.1 * np.eye(n)
    H[:zeros], H[:, :zeros] = 0, 0
    x, tight = rng.normal(size=n), 10.0 ** rng.uniform(-2, 1)
    lb, ub = (C @ x + side * tight * rng.exponential(size=r) for side in (-1, 1))
    one_sided = rng.random(r)
    lb[one_sided < 0.2], ub[one_sided > 0.8] = -UNBOUNDED, UNBOUNDED
    return QpData(H, 10 * rng.normal(size=n), A, A @ x, C, lb, ub)


def test_random_qps_with_many_active_rows_have_the_answer_of_other_solvers(solve: Solve) -> None:
    rng, active = np.random.default_rng(1), []
    for _ in range(60):
        n = int(rng.integers(1, 61))
        m, r = int(rng.integers(min(20, n))), int(rng.integers(1, 121))
        qp = drawn(rng, n, m, r)
        active.append(check(qp, solve(freed(qp)), ("daqp", "quadprog")))
    assert np.median(active) > 5
    assert max(active) > 30


def test_a_singular_hessian_is_enough_where_the_equalities_fix_the_rest(solve: Solve) -> None:
    rng, active = np.random.default_rng(2), []
    for _ in range(60):
        n = int(rng.integers(4, 25))
        m = int(rng.integers(2, n // 2 + 1))
        qp = drawn(rng, n, m, 2 * n, zeros=m)
        active.append(check(qp, solve(freed(qp)), ("daqp", "proxsuite")))
    assert np.median(active) >= 3


def by_hand(sign: float) -> tuple[QpData, list[np.ndarray]]:
    """Return min ½(x² + y²) − s(3x + y), x + y = 2s, |x| ≤ 1.5, and its x, y, z."""
    C = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, -1.0]])
    bound = np.array([1.5, 4.0, np.inf])
    A, b, g = np.ones((1, 2)), np.array([2.0 * sign]), -sign * np.array([3.0, 1.0])
    qp = QpData(np.eye(2), g, A, b, C, -bound, bound)
    return qp, [sign * np.array(part) for part in ([1.5, 0.5], [0.5], [1.0, 0.0, 0.0])]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_point_and_multipliers_are_those_found_by_hand(solve: Solve, sign: float) -> None:
    qp, expected = by_hand(sign)
    found = solve(Problem(qp, sign * np.array([2.0, 0.0]), sign * np.ones(1)))
    assert found.code == SOLVED
    for ours, theirs in zip((found.x, found.y, found.z), expected, strict=True):
        assert ours == pytest.approx(theirs, abs=1e-15)


def test_the_free_minimiser_comes_back_to_the_bit_where_it_keeps_all_rows(solve: Solve) -> None:
    rng = np.random.default_rng(3)
    for r in (0, 1, 7, 40):
        qp = drawn(rng, 9, 2, r)
        problem = freed(qp._replace(lb=np.full(r, -np.inf), ub=np.full(r, UNBOUNDED)))
        found = solve(problem)
        assert (found.code, found.z.tolist()) == (SOLVED, [0.0] * r)
        _, x_eq, y_eq = problem
        for ours, theirs in ((found.x, x_eq), (found.rough_x, x_eq), (found.y, y_eq)):
            assert ours.tobytes() == theirs.tobytes()


def test_an_inexact_minimiser_is_refined_where_that_is_asked_for(solve: Solve) -> None:
    rng = np.random.default_rng(4)
    for r in (0, 7, 40):
        qp = drawn(rng, 9, 2, r)
        exact = freed(qp._replace(lb=np.full(r, -np.inf), ub=np.full(r, UNBOUNDED)))
        spoilt = exact._replace(x_eq=exact.x_eq * (1 + 1e-8), y_eq=exact.y_eq * (1 - 1e-8))
        guess = spoilt.x_eq.copy()
        left, found = solve(spoilt), solve(spoilt, always=True)
        assert (found.code, found.z.tolist()) == (SOLVED, [0.0] * r)
        assert found.rough_x.tobytes() == guess.tobytes()
        assert found.x.tobytes() == spoilt.x_eq.tobytes()  # refined in place
        scale = np.abs(exact.x_eq).max()
        assert np.abs(left.x - exact.x_eq).max() > 1e-9 * scale
        assert np.abs(found.x - exact.x_eq).max() < 1e-13 * scale


def test_the_free_minimiser_is_found_from_nothing_and_told_where_rows_bind(solve: Solve) -> None:
    rng, bound = np.random.default_rng(5), 0
    for _ in range(50):
        problem = freed(drawn(rng, 12, 4, 20))
        nothing = problem._replace(x_eq=np.zeros(12), y_eq=np.zeros(4))
        known, found = solve(problem), solve(nothing, always=True)
        assert (known.code, found.code) == (SOLVED, SOLVED)
        scale = np.abs(problem.x_eq).max()
        assert np.abs(nothing.x_eq - problem.x_eq).max() < 1e-11 * scale
        assert np.abs(found.x - known.x).max() < 1e-11 * scale
        bound += bool(known.z.any())
    assert bound > 10


@pytest.mark.parametrize("missed", [1e-11, 1e-6, 1.0])
def test_a_bound_that_is_missed_by_little_is_kept(solve: Solve, missed: float) -> None:
    qp = drawn(np.random.default_rng(17), 6, 2, 9)
    qp.lb[:], qp.ub[:] = -UNBOUNDED, UNBOUNDED
    problem = freed(qp)
    qp.lb[4] = qp.C[4] @ problem.x_eq + missed
    found = solve(problem)
    assert np.flatnonzero(found.z).tolist() == [4]
    assert qp.C[4] @ found.x == pytest.approx(qp.lb[4], rel=0, abs=1e-13)


def test_as_many_equalities_as_variables_leave_only_a_verdict(solve: Solve) -> None:
    rng = np.random.default_rng(4)
    problem = freed(drawn(rng, 4, 4, 6)._replace(lb=np.full(6, -99.0), ub=np.full(6, 99.0)))
    assert solve(problem).x.tobytes() == problem.x_eq.tobytes()
    high = problem.qp.C @ problem.x_eq + 0.1
    assert solve(problem._replace(qp=problem.qp._replace(lb=high))).code == INFEASIBLE


# Contradictions ----------------------------------------------------------------------------


def test_contradictions_are_found_and_leave_nothing_behind(solve: Solve) -> None:
    rng = np.random.default_rng(5)
    for _ in range(100):
        n, m, r = int(rng.integers(2, 20)), int(rng.integers(0, 2)), int(rng.integers(2, 30))
        qp = drawn(rng, n, m, r)
        part = rng.exponential(size=r) * (rng.random(r) < 0.5)
        part[rng.integers(r)] = 1.0
        ub = np.minimum(qp.ub, 9.0)  # where part·C x ≤ part·ub, part·C x cannot be larger
        C, above = np.vstack([qp.C, part @ qp.C]), part @ ub + 10.0 ** rng.uniform(-3, 1)
        lb, ub = np.append(np.full(r, -UNBOUNDED), above), np.append(ub, UNBOUNDED)
        impossible = qp._replace(C=C, lb=lb, ub=ub)
        assert solve(freed(impossible)).code == INFEASIBLE
        assert not make_solver("daqp").solve(impossible).feasible
        assert solve(freed(qp)).code == SOLVED


@pytest.mark.parametrize(
    ("lb", "ub"),
    [(2.0, 1.0), (UNBOUNDED, np.inf), (np.inf, np.inf), (-np.inf, -UNBOUNDED), (-np.inf, -np.inf)],
)
def test_bounds_that_no_number_keeps_are_a_contradiction(
    solve: Solve, lb: float, ub: float
) -> None:
    qp = QpData(*map(np.array, ([[2.0]], [1.0], np.zeros((0, 1)), [], [[1.0]], [lb], [ub])))
    assert solve(freed(qp)).code == INFEASIBLE


# Degenerate vertices -----------------------------------------------------------------------


def test_the_tip_of_a_friction_cone_is_found_from_every_side(solve: Solve) -> None:
    """λ nearest to F in the pyramid: F itself, the tip, or something between."""
    rng, tips = np.random.default_rng(7), 0
    angle = 2 * np.pi * np.arange(16) / 16
    sides = np.column_stack([np.cos(angle), np.sin(angle), np.full(16, -0.4)])
    C = np.vstack([sides, [[0, 0, 1]]])
    lb, ub = np.r_[np.full(16, -UNBOUNDED), 0], np.r_[np.zeros(16), UNBOUNDED]
    for _ in range(200):
        B = rng.normal(size=(3, 3))
        H, F = B @ B.T + 0.1 * np.eye(3), 20 * rng.normal(size=3)
        qp = QpData(H, -H @ F, np.zeros((0, 3)), np.zeros(0), C, lb, ub)
        found = solve(Problem(qp, F, np.zeros(0)))
        assert found.code == SOLVED
        assert kkt(qp, found) <= SHARP
        tips += bool(np.abs(found.x).max() < SHARP)
    assert 20 < tips < 180


def test_corners_where_many_faces_meet_are_found(solve: Solve) -> None:
    """Small whole numbers: faces meet exactly, rows repeat, bounds coincide."""
    rng, codes = np.random.default_rng(8), []
    for _ in range(300):
        n, r = int(rng.integers(1, 9)), int(rng.integers(1, 40))
        C = rng.integers(-1, 2, size=(r, n)).astype(float)
        lb, ub = (sign * rng.integers(-1, 3, size=r).astype(float) for sign in (-1, 1))
        g = rng.integers(-5, 6, size=n).astype(float)
        qp = QpData(np.eye(n), g, np.zeros((0, n)), np.zeros(0), C, lb, ub)
        codes.append(solve(freed(qp)).code)
        other = make_solver("daqp").solve(qp)
        assert codes[-1] == (SOLVED if other.feasible else INFEASIBLE)
        assert codes[-1] or kkt(qp, solve(freed(qp))) <= SHARP
    assert min(codes.count(code) for code in (SOLVED, INFEASIBLE)) > 20


# Rows that depend on each other ------------------------------------------------------------


def repeated(qp: QpData, rng: np.random.Generator) -> QpData:
    """Return the QP with copies of rows, reversed copies, multiples, and sums of equalities."""
    row = rng.integers(len(qp.lb), size=len(qp.lb))
    by = rng.choice([1.0, -1.0, 0.3, -7.0], size=len(row))
    low, high = by * qp.lb[row], by * qp.ub[row]
    part = rng.normal(size=(3, len(qp.b)))
    C = np.vstack([qp.C, by[:, None] * qp.C[row], part @ qp.A, np.zeros((1, len(qp.g)))])
    lb = np.concatenate([qp.lb, np.minimum(low, high), part @ qp.b, [-1.0]])
    ub = np.concatenate([qp.ub, np.maximum(low, high), part @ qp.b, [0.0]])
    return qp._replace(C=C, lb=lb, ub=ub)


def test_rows_that_say_the_same_again_change_nothing(solve: Solve) -> None:
    rng, active = np.random.default_rng(9), 0
    for _ in range(300):
        n = int(rng.integers(2, 20))
        qp = drawn(rng, n, int(rng.integers(n)), int(rng.integers(1, 30)))
        once, again = solve(freed(qp)), solve(freed(repeated(qp, rng)))
        assert (once.code, again.code) == (SOLVED, SOLVED)
        assert again.x == pytest.approx(once.x, rel=0, abs=AGREEMENT * largest(once.x))
        active += int(np.count_nonzero(again.z))
    assert active > 300


def test_bounds_that_meet_are_equalities_also_where_they_are_too_many(solve: Solve) -> None:
    """A third of the rows are combinations of the equalities, which nothing can move."""
    rng = np.random.default_rng(10)
    for _ in range(300):
        n, r = int(rng.integers(2, 16)), int(rng.integers(2, 40))
        m = int(rng.integers(n))
        qp = drawn(rng, n, m, r)
        qp.C[: r // 3] = rng.normal(size=(r // 3, m)) @ qp.A
        x, fixed = np.linalg.pinv(qp.A) @ qp.b, rng.random(r) < 0.5
        lb, ub = qp.C @ x - ~fixed, qp.C @ x + ~fixed
        problem = freed(qp._replace(lb=lb, ub=ub))
        found = solve(problem)
        assert found.code == SOLVED
        assert kkt(problem.qp, found) <= KKT
        if fixed[r // 3 :].sum() >= n - m:
            assert found.x == pytest.approx(x, rel=0, abs=AGREEMENT * largest(problem.x_eq))


@pytest.mark.parametrize(("off", "code"), [(1e-12, SOLVED), (1e-6, INFEASIBLE)])
def test_what_the_equalities_fix_is_kept_up_to_round_off(
    solve: Solve, off: float, code: int
) -> None:
    rng = np.random.default_rng(18)
    for _ in range(50):
        qp = drawn(rng, 9, 4, 6)
        C = np.vstack([qp.C, rng.normal(size=(2, 4)) @ qp.A])
        implied = C[-2:] @ np.linalg.pinv(qp.A) @ qp.b + off
        lb, ub = np.append(qp.lb, implied), np.append(qp.ub, implied)
        problem = freed(qp._replace(C=C, lb=lb, ub=ub))
        found = solve(problem)
        assert found.code == code
        assert code or kkt(problem.qp, found) <= KKT


def test_rows_that_repeat_each_other_in_unlike_units_are_one_row(solve: Solve) -> None:
    """H has a condition number of 1e8; the rows hold as equalities, or not at all."""
    rng, codes = np.random.default_rng(11), []
    for i in range(400):
        n, r = int(rng.integers(4, 30)), int(rng.integers(1, 4))
        qp = drawn(rng, n, int(rng.integers(n // 3)), r)
        turn = np.linalg.qr(rng.normal(size=(n, n)))[0] if i % 2 else np.eye(n)
        H = (turn * 10.0 ** rng.uniform(-4, 4, size=n)) @ turn.T
        C = np.vstack([qp.C, rng.normal(size=(4, r)) @ qp.C])
        lb = C @ rng.normal(size=n)
        possible = bool(rng.random() < 0.5)
        lb[-1] += 0 if possible else 10.0 ** rng.uniform(-4, 0)
        problem = freed(qp._replace(H=(H + H.T) / 2, C=C, lb=lb, ub=lb))
        found = solve(problem)
        codes.append(found.code)
        assert found.code == (SOLVED if possible else INFEASIBLE)
        assert not possible or kkt(problem.qp, found) <= 10 * KKT  # round-off of H x
    assert 150 < codes.count(SOLVED) < 250


def test_the_only_point_that_is_left_is_found_from_far_away(solve: Solve) -> None:
    """Rows through one point that leave nothing else: which W implies is decided on W itself."""
    rng, alone = np.random.default_rng(15), 0
    for _ in range(200):
        n = int(rng.integers(1, 12))
        m = int(rng.integers(n))
        qp = drawn(rng, n, m, 3 * n)
        lb, ub = np.full(3 * n, -UNBOUNDED), np.zeros(3 * n)
        problem = freed(qp._replace(g=1e6 * qp.g, b=np.zeros(m), lb=lb, ub=ub))
        found = solve(problem)
        assert found.code == SOLVED
        alone += bool(np.abs(found.x).max() < 1e-9)
        assert kkt(problem.qp, found) <= KKT * largest(found.x)
    assert 50 < alone < 200


def test_a_free_minimiser_that_is_a_little_off_is_put_right(solve: Solve) -> None:
    """Refinement then uncovers rows that pull, and rows that are violated."""
    rng, active = np.random.default_rng(16), 0
    for _ in range(400):
        n = int(rng.integers(2, 16))
        qp, x_eq, y_eq = freed(drawn(rng, n, int(rng.integers(n)), 2 * n))
        off = 10.0 ** rng.uniform(-6, 0) * rng.normal(size=n)
        found = solve(Problem(qp, x_eq + off, y_eq + 1))
        assert found.code == SOLVED
        if found.z.any():
            active += 1
            assert kkt(qp, found) <= KKT
    assert active > 200


# What is no QP -----------------------------------------------------------------------------

PARTS = (*QpData._fields, "x_eq", "y_eq")


def binding(seed: int = 12) -> Problem:
    """Return a QP of which rows are active, and others are not."""
    return freed(drawn(np.random.default_rng(seed), 5, 2, 9))


def spoiled(problem: Problem, part: str, change: Callable[[float], float]) -> Iterator[Problem]:
    """Yield the problem with each entry of one part changed in turn."""
    given = dict(zip(PARTS, (*problem.qp, *problem[1:]), strict=True))
    for i in range(given[part].size):
        changed = np.array(given[part])
        changed.flat[i] = change(changed.flat[i])
        *data, x_eq, y_eq = (given | {part: changed}).values()
        yield Problem(QpData(*data), x_eq, y_eq)


@pytest.mark.parametrize("free", [True, False])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("part", PARTS)
def test_a_number_that_is_not_finite_is_refused_wherever_it_is(
    solve: Solve, part: str, value: float, free: bool
) -> None:
    problem = binding()
    if free:
        wide = np.full(9, 99.0)
        problem = problem._replace(qp=problem.qp._replace(lb=-wide, ub=wide))
    assert solve(problem).z.any() != free
    if part in ("lb", "ub") and np.isinf(value):
        return  # a bound that is none, or that nothing keeps: tested elsewhere
    codes = {solve(other).code for other in spoiled(problem, part, lambda _: value)}
    assert codes == {FAILED}


def test_a_free_minimiser_that_is_not_finite_is_refused_also_without_rows(solve: Solve) -> None:
    problem = freed(drawn(np.random.default_rng(12), 5, 2, 0))
    codes = {solve(other).code for other in spoiled(problem, "x_eq", lambda _: np.nan)}
    assert codes == {FAILED}


def test_an_infinite_bound_is_none(solve: Solve) -> None:
    problem = binding()
    infinite = [np.where(np.abs(v) < UNBOUNDED, v, np.inf * v) for v in problem.qp[5:]]
    assert np.isinf(infinite).any(axis=1).all()
    wide = problem._replace(qp=problem.qp._replace(lb=infinite[0], ub=infinite[1]))
    assert solve(wide).bits() == solve(problem).bits()


def test_a_qp_without_a_unique_minimiser_fails(solve: Solve) -> None:
    qp, *point = binding()
    flat, twice = qp.H.copy(), qp.A.copy()
    flat[0], flat[:, 0], twice[1] = 0, 0, 2 * twice[0]
    for broken in (
        qp._replace(H=-qp.H),
        qp._replace(H=qp.A.T @ qp.A),
        qp._replace(H=np.outer(qp.g, qp.g)),
        qp._replace(H=flat, A=np.eye(5)[3:]),
        qp._replace(A=twice),
        qp._replace(A=np.zeros((2, 5))),
        qp._replace(A=np.arange(35.0).reshape(7, 5) ** 2, b=np.ones(7)),
    ):
        y_eq = np.zeros(len(broken.b))
        assert solve(Problem(broken, point[0], y_eq)).code == FAILED


def honest(qp: QpData, found: Answer) -> bool:
    """Return whether the answer is a solution, or says that it is none."""
    if found.code != SOLVED:
        return True
    return bool(np.isfinite(found.x).all()) and (not found.z.any() or kkt(qp, found) <= BREAKDOWN)


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e160, 1e300])
@pytest.mark.parametrize("part", PARTS)
def test_numbers_of_any_size_end_in_an_honest_answer(solve: Solve, part: str, size: float) -> None:
    for seed in range(12):
        for other in spoiled(binding(seed), part, lambda value: size * value):
            assert honest(other.qp, solve(other))


def test_a_hessian_with_any_condition_number_ends_in_an_honest_answer(solve: Solve) -> None:
    rng, codes = np.random.default_rng(19), []
    for _ in range(200):
        n = int(rng.integers(2, 12))
        qp = drawn(rng, n, int(rng.integers(n)), 2 * n)
        turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
        H = (turn * 10.0 ** rng.uniform(-12, 12, size=n)) @ turn.T
        qp = qp._replace(H=(H + H.T) / 2)
        found = solve(Problem(qp, rng.normal(size=n), np.zeros(len(qp.b))))
        codes.append(found.code)
        assert honest(qp, found)
    assert min(codes.count(code) for code in (SOLVED, FAILED)) > 20


# In C --------------------------------------------------------------------------------------


def test_what_is_in_the_workspace_before_does_not_matter(solve: Solve) -> None:
    rng = np.random.default_rng(13)
    for n in range(1, 14):
        problem = freed(drawn(rng, n, n // 3, 2 * n))
        answers = {solve(problem, fill).bits() for fill in (np.nan, 0.0, -1e300)}
        assert len(answers) == 1


def test_threads_do_not_disturb_each_other(solve: Solve) -> None:
    rng = np.random.default_rng(14)
    problems = [freed(drawn(rng, 50, 5, 150)) for _ in range(20)] * 10
    expected = [solve(problem).bits() for problem in problems]
    with ThreadPoolExecutor(4) as pool:
        assert [found.bits() for found in pool.map(solve, problems)] == expected


@pytest.mark.parametrize("optimise", ["-O0", "-O1", "-O2", "-O3"])
@pytest.mark.parametrize("compiler", [name for name in COMPILERS if shutil.which(name)])
def test_the_source_is_c99_without_warnings(tmp_path: Path, compiler: str, optimise: str) -> None:
    command = (compiler, *STRICT, optimise, "-c", str(SOURCE), "-o", str(tmp_path / "qp.o"))
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
