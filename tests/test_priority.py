"""Strict priorities: every level's own KKT conditions, what levels keep, and other ways to it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
import quadprog

from qpctrl.errors import InputError
from qpctrl.limit import UNBOUNDED
from qpctrl.priority import Level, Priorities, Ranked
from qpctrl.priority.piece import Piece, minimiser
from qpctrl.solver import ActiveSet, QpData, Solution

KKT = 1e-9
"""Promised residual of every level; measured: 2e-14."""

KEPT = 1e-9
"""Promised change of what a level attains, over its size or 1; measured: 2e-12."""

AGREEMENT = 1e-7
"""Another way to the same values, over their size or 1; measured: 4e-9 with `ROOM`."""

ROOM = 1e-12
"""By what the oracle widens all bounds from level to level, or it finds them contradictory."""

EXACT = 1e-10
"""Round-off of two ways to the same x, over its size or 1."""

PROBLEMS = 1000


class Problem(NamedTuple):
    """Arguments of `Priorities.solve`."""

    levels: tuple[Level, ...]
    A: np.ndarray
    b: np.ndarray
    C: np.ndarray
    lb: np.ndarray
    ub: np.ndarray


def level(G: np.ndarray, r: np.ndarray, W: np.ndarray | None = None) -> Level:
    """Return the level ½ ‖G x − r‖²_W."""
    W = np.eye(len(G)) if W is None else W
    return Level(G.T @ W @ G, -G.T @ W @ r, G)


def solve(problem: Problem, solver: object = None) -> Ranked:
    """Return the solution, of an object of its own."""
    sizes = problem.C.shape[1], len(problem.b), len(problem.lb)
    return Priorities(*sizes, solver).solve(*problem)


def without_limits(problem: Problem) -> Problem:
    """Return the problem with equalities alone."""
    n = problem.C.shape[1]
    return problem._replace(C=np.zeros((0, n)), lb=np.zeros(0), ub=np.zeros(0))


def drawn(rng: np.random.Generator, largest: int = 50) -> Problem:
    """Return a problem of 8 and more variables and 2 to 4 levels, the last one about all of x."""
    n = int(rng.integers(8, largest + 1))
    m, r, count = rng.integers(0, n // 2), rng.integers(n // 2, 2 * n), rng.integers(2, 5)
    A, C, inside = rng.normal(size=(m, n)), rng.normal(size=(r, n)), rng.normal(size=n)
    room = np.exp(rng.uniform(np.log(0.2), np.log(3))) * np.sqrt(n)
    lb, ub = (C @ inside + sign * room * rng.uniform(0.1, 2, size=r) for sign in (-1, 1))
    levels = []
    for size in [*rng.integers(1, max(2, (n - m) // count), size=count - 1), n]:
        G, root = rng.normal(size=(size, n)), rng.normal(size=(size, size))
        r_des = rng.normal(size=size) * np.sqrt(n) * rng.uniform(0.1, 1.5)
        levels.append(level(G, r_des, root @ root.T / size + 0.3 * np.eye(size)))
    return Problem(tuple(levels), A, A @ inside, C, lb, ub)


@pytest.fixture(scope="module")
def solved() -> list[tuple[Problem, Ranked]]:
    """Return 1000 problems and their solutions."""
    problems = [drawn(np.random.default_rng(seed)) for seed in range(PROBLEMS)]
    return [(problem, solve(problem)) for problem in problems]


# Judges ------------------------------------------------------------------------------------


def largest(*arrays: np.ndarray) -> float:
    """Return the largest absolute entry, or 1."""
    return max(1.0, *(float(np.abs(array).max(initial=0)) for array in arrays))


def off(one: np.ndarray, other: np.ndarray) -> float:
    """Return the largest difference over the size of the second, or 1."""
    return float(np.abs(one - other).max(initial=0)) / largest(other)


def worst_kkt(problem: Problem, ranked: Ranked) -> float:
    """Return the largest KKT residual of any level's own QP, with the multipliers given."""
    worst, rows, rhs, C = 0.0, problem.A, problem.b, problem.C
    for given, found in zip(problem.levels, ranked.levels, strict=True):
        x, y, z = found.x, found.y, found.z
        assert len(y) == len(rows)
        terms = given.H @ x, given.g, rows.T @ y, C.T @ z
        Cx = C @ x
        slack = np.where(z > 0, problem.ub - Cx, np.where(z < 0, Cx - problem.lb, 0.0))
        worst = max(
            worst,
            np.abs(sum(terms)).max() / largest(*terms),
            off(rows @ x, rhs),
            np.maximum(Cx - problem.ub, problem.lb - Cx).max(initial=0) / largest(Cx),
            np.abs(z * slack).max(initial=0) / largest(z),
        )
        rows, rhs = np.vstack([rows, found.rows]), np.concatenate([rhs, found.rows @ x])
    return float(worst)


def presses(ranked: Ranked) -> bool:
    """Return whether a limit has a multiplier at some level."""
    return any(found.z.any() for found in ranked.levels)


# Random problems ---------------------------------------------------------------------------


def test_every_level_satisfies_its_own_kkt_conditions(
    solved: list[tuple[Problem, Ranked]],
) -> None:
    for problem, ranked in solved:
        assert worst_kkt(problem, ranked) <= KKT
        assert ranked.kkt <= KKT
        assert ranked.unique
        assert np.array_equal(ranked.solution.x, ranked.levels[-1].x)
    assert np.mean([presses(ranked) for _, ranked in solved]) > 0.9
    assert np.mean([ranked.levels[0].z.any() for _, ranked in solved]) > 0.2


def test_the_residual_it_reports_is_the_one_it_has() -> None:
    problem = without_limits(drawn(np.random.default_rng(0)))
    last = problem.levels[-1]
    wrong = problem._replace(levels=(*problem.levels[:-1], last._replace(G=last.G[:3])))
    found = solve(wrong)  # G is not all that H is about
    assert solve(problem).kkt < KKT < 1e-3 < found.kkt
    assert found.kkt == pytest.approx(worst_kkt(wrong, found), rel=1e-6)


def test_what_lower_levels_want_changes_nothing_above(
    solved: list[tuple[Problem, Ranked]],
) -> None:
    moved = []
    for seed, (problem, ranked) in enumerate(solved):
        rng = np.random.default_rng(seed)
        changed = int(rng.integers(1, len(problem.levels)))
        levels = list(problem.levels)
        for i in range(changed, len(levels)):
            G = levels[i].G
            levels[i] = level(G, 100 * np.sqrt(G.shape[1]) * rng.normal(size=len(G)))
        x = solve(problem._replace(levels=tuple(levels))).solution.x
        for kept, found in zip(levels[:changed], ranked.levels, strict=False):
            assert off(kept.G @ x, kept.G @ ranked.solution.x) <= KEPT
            assert off(kept.G @ x, found.value) <= KEPT
        moved.append(off(x, ranked.solution.x))
    assert np.median(moved) > 0.1


def lexicographic(problem: Problem) -> list[np.ndarray]:
    """Return what each level attains, by a cascade of its own with quadprog.

    Rows of the levels above are equalities, out of which an SVD takes the null space; the cost is
    made strictly convex around its own last answer until that stays.
    """
    rows, rhs, attained = problem.A, problem.b, []
    for i, (H, g, G) in enumerate(problem.levels):
        left, sizes, right = np.linalg.svd(rows)
        rank = int((sizes > 1e-9 * sizes.max(initial=0)).sum())
        x, N = right[:rank].T @ (left[:, :rank].T @ rhs / sizes[:rank]), right[rank:].T
        if N.size:
            D, Cx, room = problem.C @ N, problem.C @ x, i * ROOM
            bounds = np.concatenate([Cx - problem.ub, problem.lb - Cx]) - room
            cost, g_N, u = N.T @ H @ N, N.T @ (H @ x + g), np.zeros(N.shape[1])
            eps = 1e-4 * np.trace(cost) / len(u)
            for _ in range(60):
                convex, last = cost + eps * np.eye(len(u)), u
                u = quadprog.solve_qp(convex, eps * u - g_N, np.vstack([-D, D]).T, bounds)[0]
                if off(u, last) < 1e-13:
                    break
            x = x + N @ u
        attained.append(G @ x)
        rows, rhs = np.vstack([rows, G]), np.concatenate([rhs, G @ x])
    return attained


def test_another_solver_attains_the_same_values(solved: list[tuple[Problem, Ranked]]) -> None:
    for problem, ranked in solved:
        for value, found in zip(lexicographic(problem), ranked.levels, strict=True):
            assert off(found.value, value) <= AGREEMENT


def test_without_limits_it_is_the_null_space_recursion() -> None:
    for seed in range(50):
        problem = without_limits(drawn(np.random.default_rng(seed)))
        n = problem.C.shape[1]
        x, N = np.linalg.pinv(problem.A) @ problem.b, np.eye(n)
        N = N - np.linalg.pinv(problem.A) @ problem.A
        for H, g, G in problem.levels:
            W = np.linalg.pinv(G.T) @ H @ np.linalg.pinv(G)
            root = np.linalg.cholesky(W[: len(G), : len(G)]).T
            r = -np.linalg.solve(W, np.linalg.pinv(G.T) @ g)
            inverse = np.linalg.pinv(root @ G @ N, rcond=1e-10)
            x = x + N @ inverse @ root @ (r - G @ x)
            N = N @ (np.eye(n) - inverse @ root @ G @ N)
        assert off(solve(problem).solution.x, x) <= EXACT


def test_it_is_the_limit_of_ever_larger_weights() -> None:
    rates = []
    for seed in range(40):
        problem = drawn(np.random.default_rng(seed), largest=20)
        problem = problem._replace(levels=(problem.levels[0], problem.levels[-1]))
        ranked = solve(problem)
        first, last = problem.levels
        gaps = []
        for weight in (1e4, 1e5):
            rows = np.vstack([problem.A, -problem.C, problem.C])
            bounds = np.concatenate([problem.b, -problem.ub, problem.lb])
            H, g = weight * first.H + last.H, weight * first.g + last.g
            x = quadprog.solve_qp(H, -g, rows.T, bounds, len(problem.b))[0]
            gaps.append(off(x, ranked.solution.x))
        if gaps[0] > 1e-7:  # else both levels have all they want
            rates.append(gaps[0] / gaps[1])
    assert len(rates) > 20
    assert np.median(rates) == pytest.approx(10, rel=0.01)
    assert np.mean(np.array(rates) > 9) > 0.8  # some limits want even more weight


# By hand -----------------------------------------------------------------------------------


def test_a_limit_that_presses_once_presses_for_good() -> None:
    """x₀ + x₁ ≤ 1 and x₀ − x₁ ≤ 1 hold x₀ at 1, and with it x₁ at 0, whatever is wanted of it."""
    axes = np.eye(3)
    problem = Problem(
        levels=tuple(level(axes[[i]], np.array([r])) for i, r in enumerate((10.0, 3.0, 4.0))),
        A=np.zeros((0, 3)),
        b=np.zeros(0),
        C=np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]]),
        lb=np.full(3, -UNBOUNDED),
        ub=np.array([1.0, 1.0, 2.0]),
    )
    ranked = solve(problem)
    assert ranked.solution.x == pytest.approx([1, 0, 2])
    assert ranked.levels[0].z == pytest.approx([4.5, 4.5, 0])
    assert ranked.levels[0].residual == pytest.approx([-9, 0, 0])
    assert ranked.levels[1].z == pytest.approx([3, 0, 0])
    assert ranked.levels[1].y == pytest.approx([-3])
    assert ranked.solution.z == pytest.approx([0, 0, 2])
    assert ranked.kkt < KKT
    assert ranked.unique


def test_a_limit_that_is_met_without_pressing_is_left_again() -> None:
    """x₀ presses as above; x₂ must come up to 2, where nothing presses, and then goes on to 5."""
    limits = np.array([[1.0, 1.0, 0.0, 0.0], [1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    expected = np.array([1.0, 0.0, 5.0, -3.0])
    for seed in range(50):
        turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(4, 4)))
        problem = Problem(
            (level(turn[:1], np.array([10.0])), level(turn[2:], expected[2:])),
            np.zeros((0, 4)),
            np.zeros(0),
            limits @ turn,
            np.array([-UNBOUNDED, -UNBOUNDED, 2.0]),
            np.array([1.0, 1.0, UNBOUNDED]),
        )
        ranked = solve(problem)
        assert turn @ ranked.solution.x == pytest.approx(expected, abs=1e-12)
        assert ranked.levels[0].z == pytest.approx([4.5, 4.5, 0])


def test_a_limit_is_kept_to_round_off() -> None:
    problem = Problem(
        (level(np.eye(2), np.array([1 + 1e-8, 0.5])),),
        *(np.zeros((0, 2)), np.zeros(0), np.eye(2), -np.ones(2), np.ones(2)),
    )
    ranked = solve(problem)
    assert ranked.solution.x[0] == pytest.approx(1, abs=1e-15)
    assert ranked.solution.z == pytest.approx([1e-8, 0], rel=1e-6)


def test_freedom_that_nobody_wants_is_said_to_be_undecided() -> None:
    problem = drawn(np.random.default_rng(3))
    some = without_limits(problem)._replace(levels=problem.levels[:1])
    ranked = solve(some)
    assert not ranked.unique
    assert ranked.kkt < KKT
    assert solve(without_limits(problem)).unique


# Levels that want nothing, the impossible, or the same --------------------------------------


def idle(problem: Problem) -> Level:
    """Return a level of no rows."""
    n = problem.C.shape[1]
    return level(np.zeros((0, n)), np.zeros(0))


def impossible(problem: Problem) -> Level:
    """Return a level that wants what A and the first level decide to be something else."""
    rows = np.vstack([problem.A, problem.levels[0].G])
    return level(rows, np.full(len(rows), 1e3))


def again(problem: Problem) -> Level:
    """Return the first level's rows with another target."""
    first = problem.levels[0]
    return first._replace(g=-3.0 * first.g)


def worthless(problem: Problem) -> Level:
    """Return a level of weight 0."""
    last = problem.levels[-1]
    return Level(0.0 * last.H, 0.0 * last.g, last.G)


@pytest.mark.parametrize("made", [idle, impossible, again, worthless])
def test_a_level_that_can_decide_nothing_changes_nothing(made: Callable[[Problem], Level]) -> None:
    for seed in range(40):
        problem = drawn(np.random.default_rng(seed))
        first, *others = problem.levels
        more = problem._replace(levels=(first, made(problem), *others))
        ranked, before = solve(more), solve(problem)
        assert worst_kkt(more, ranked) <= KKT
        assert off(ranked.solution.x, before.solution.x) <= EXACT


def test_a_level_alone_or_twice_is_the_same() -> None:
    problem = drawn(np.random.default_rng(5))
    twice = problem._replace(levels=tuple(one for one in problem.levels for _ in range(2)))
    assert off(solve(twice).solution.x, solve(problem).solution.x) <= EXACT


def test_rows_of_weight_zero_are_left_to_the_levels_below() -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        problem = drawn(rng)
        n = problem.C.shape[1]
        G, r = rng.normal(size=(5, n)), rng.normal(size=5)
        some = level(G, r, np.diag([2.0, 0.0, 1.0, 0.0, 0.5]))
        without = level(G[::2], r[::2], np.diag([2.0, 1.0, 0.5]))
        one, other = (
            solve(problem._replace(levels=(first, *problem.levels))) for first in (some, without)
        )
        assert one.kkt <= KKT
        assert off(one.solution.x, other.solution.x) <= EXACT


def test_rows_that_depend_on_each_other_count_once() -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        problem = drawn(rng)
        m, r = len(problem.b), len(problem.lb)
        mix, tight = rng.normal(size=(2, m)), rng.normal(size=(2, m))
        twice = rng.integers(0, r, size=r // 2)
        more = problem._replace(
            A=np.vstack([problem.A, mix @ problem.A]),
            b=np.concatenate([problem.b, mix @ problem.b]),
            C=np.vstack([problem.C, problem.C[twice], -2 * problem.C[:2], tight @ problem.A]),
            lb=np.concatenate(
                [problem.lb, problem.lb[twice], -2 * problem.ub[:2], tight @ problem.b]
            ),
            ub=np.concatenate(
                [problem.ub, problem.ub[twice], -2 * problem.lb[:2], tight @ problem.b]
            ),
        )
        ranked = solve(more)
        assert worst_kkt(more, ranked) <= KKT
        assert off(ranked.solution.x, solve(problem).solution.x) <= EXACT


# Degenerate problems -----------------------------------------------------------------------


def whole_numbers(rng: np.random.Generator) -> Problem:
    """Return a problem of small whole numbers: many rows meet in one point."""
    n = int(rng.integers(3, 16))
    m, r = int(rng.integers(0, n // 3 + 1)), int(rng.integers(n, 4 * n))
    A, C = (rng.integers(-k, k + 1, size=(p, n)).astype(float) for k, p in ((2, m), (1, r)))
    inside = rng.integers(-2, 3, size=n).astype(float)
    lb, ub = (C @ inside + sign * rng.integers(0, 4, size=r) for sign in (-1, 1))
    levels = []
    for size in (*rng.integers(1, n, size=3), n):
        G = rng.integers(-1, 2, size=(size, n)).astype(float) if size < n else np.eye(n)
        levels.append(level(G, rng.integers(-5, 6, size=size).astype(float)))
    return Problem(tuple(levels), A, A @ inside, C, lb, ub)


def friction_cones(rng: np.random.Generator) -> Problem:
    """Return accelerations with limits and forces in cones, whose apex is where they let go."""
    contacts, joints = int(rng.integers(1, 5)), int(rng.integers(4, 12))
    n = joints + 3 * contacts
    cone = np.array([[1, 0, -0.5], [-1, 0, -0.5], [0, 1, -0.5], [0, -1, -0.5], [0, 0, -1]])
    cones = np.hstack([np.zeros((5 * contacts, joints)), np.kron(np.eye(contacts), cone)])
    limits, none = np.full(joints, 50.0), np.full(5 * contacts, UNBOUNDED)
    A = rng.normal(size=(int(rng.integers(1, joints)), n))
    forces, motion = np.eye(n)[joints:], np.zeros((4, n))
    motion[:, :joints] = rng.normal(size=(4, joints))
    levels = [level(forces, 20 * rng.normal(size=len(forces))), level(motion, np.full(4, 30.0))]
    return Problem(
        (*levels[:: int(rng.choice([-1, 1]))], level(np.eye(n), 20 * rng.normal(size=n))),
        A,
        A[:, :joints] @ rng.normal(size=joints),
        np.vstack([cones, np.eye(n)[:joints]]),
        np.concatenate([-none, -limits]),
        np.concatenate([0 * none, limits]),
    )


def no_interior(rng: np.random.Generator) -> Problem:
    """Return a problem with one-sided rows that together leave no room."""
    problem = drawn(rng, largest=30)
    inside = np.linalg.pinv(problem.A) @ problem.b
    rows = rng.normal(size=(3, len(inside)))
    rows = np.vstack([rows, -rows.sum(axis=0)])
    Cx = problem.C @ inside
    return problem._replace(
        C=np.vstack([problem.C, rows]),
        lb=np.concatenate([np.minimum(problem.lb, Cx - 0.1), np.full(4, -UNBOUNDED)]),
        ub=np.concatenate([np.maximum(problem.ub, Cx + 0.1), rows @ inside]),
    )


def other_units(rng: np.random.Generator) -> Problem:
    """Return a problem whose variables, rows and levels have units of their own."""
    problem = drawn(rng)
    units = 10 ** rng.uniform(-2, 3, size=problem.C.shape[1])
    scales = 10 ** rng.uniform(-2, 2, size=len(problem.lb))
    levels = []
    for H, g, G in problem.levels:
        weight = 10 ** rng.uniform(-3, 4)
        levels.append(Level(weight * H / units / units[:, None], weight * g / units, G / units))
    return problem._replace(
        levels=tuple(levels),
        A=problem.A / units,
        C=scales[:, None] * problem.C / units,
        lb=scales * problem.lb,
        ub=scales * problem.ub,
    )


def nearly_implied(problem: Problem, rng: np.random.Generator, part: float) -> list[Level]:
    """Return the first two levels, one row of the second implied by the first but for a part."""
    first, second = problem.levels[:2]
    G, mix = second.G.copy(), rng.normal(size=len(first.G))
    G[0] = mix / np.linalg.norm(mix) @ first.G + part * G[0]
    return [first, level(G, rng.normal(size=len(G)))]


def parallel_levels(rng: np.random.Generator) -> Problem:
    """Return a problem of which a row of the second level is implied but for 1 in 10 000."""
    problem = drawn(rng, largest=30)
    levels = (*nearly_implied(problem, rng, 1e-4), *problem.levels[2:])
    return problem._replace(levels=levels)


DEGENERATE = {
    whole_numbers: 1e-11,
    friction_cones: 1e-11,
    no_interior: 1e-11,
    other_units: 3e-12,
    parallel_levels: KKT,
}
"""Problems, and the residual to which they are solved; measured: a tenth, over 4000 of each."""


@pytest.mark.parametrize("made", DEGENERATE)
def test_degenerate_problems_are_solved_exactly(
    made: Callable[[np.random.Generator], Problem],
) -> None:
    pressed = []
    for seed in range(200):
        problem = made(np.random.default_rng(seed))
        ranked = solve(problem)
        assert ranked.solution.feasible, seed
        assert worst_kkt(problem, ranked) <= DEGENERATE[made], seed
        pressed.append(presses(ranked))
    assert np.mean(pressed) > 0.7


@pytest.mark.parametrize("seed", [672, 723, 773, 1914, 1954])
def test_no_walk_goes_in_circles_where_very_many_limits_meet(seed: int) -> None:
    problem = whole_numbers(np.random.default_rng(seed))
    ranked = solve(problem)
    assert worst_kkt(problem, ranked) <= KKT


@pytest.mark.parametrize("part", [10.0**-e for e in range(2, 17)])
def test_a_row_that_is_nearly_implied_is_kept_and_never_left_undecided_in_secret(
    part: float,
) -> None:
    """Between `RANK` and √FLAT a level cannot decide on such a row, and its residual says so."""
    unsure = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        problem = drawn(rng, largest=20)
        levels, n = nearly_implied(problem, rng, part), problem.C.shape[1]
        ends = [level(np.eye(n), size * rng.normal(size=n)) for size in (1, 10)]
        problems = [problem._replace(levels=(*levels, end)) for end in ends]
        one, other = map(solve, problems)
        for kept in levels:
            assert off(kept.G @ one.solution.x, kept.G @ other.solution.x) <= KEPT
        assert worst_kkt(problems[0], one) <= max(KKT, 2 * one.kkt)
        unsure += one.kkt > KKT
    if part >= 1e-3 or part <= 1e-12:
        assert unsure == 0
    if 1e-9 <= part <= 1e-8:
        assert unsure > 10


# The solver behind it ----------------------------------------------------------------------


class Feasible:
    """A solver that finds no more than the smallest point that keeps the rows."""

    def __init__(self) -> None:
        self.calls = 0

    def solve(self, qp: QpData) -> Solution:
        """Return that point, without multipliers."""
        self.calls += 1
        found = ActiveSet().solve(qp._replace(H=np.eye(len(qp.g)), g=0.0 * qp.g))
        return found._replace(z=0.0 * found.z)

    def reset(self) -> None:
        """Forget nothing."""


class Helpless(Feasible):
    """A solver that finds nothing from the second call on."""

    def solve(self, qp: QpData) -> Solution:
        """Return a solution once."""
        found = super().solve(qp)
        return found if self.calls == 1 else found._replace(feasible=False)


def test_from_any_point_that_keeps_the_rows_it_walks_to_the_solution() -> None:
    calls = 0
    for seed in range(100):
        problem, solver = drawn(np.random.default_rng(seed), largest=30), Feasible()
        ranked = solve(problem, solver)
        assert worst_kkt(problem, ranked) <= KKT
        assert off(ranked.solution.x, solve(problem).solution.x) <= EXACT
        calls += solver.calls
    assert calls > 50


def test_a_level_that_is_not_solved_stays_where_it_is_and_says_so() -> None:
    missed = 0
    for seed in range(100):
        problem = drawn(np.random.default_rng(seed))
        problem = problem._replace(levels=(problem.levels[0], *problem.levels))
        ranked = solve(problem, Helpless())
        assert ranked.solution.feasible
        over = np.maximum(problem.C @ ranked.solution.x - problem.ub, 0.0)
        assert over.max() <= KKT * largest(problem.ub)
        assert worst_kkt(problem, ranked) == pytest.approx(ranked.kkt, abs=KKT)
        missed += ranked.kkt > KKT
    assert missed > 10


def test_a_row_that_no_variable_of_the_level_moves_is_no_matter() -> None:
    piece = Piece(
        np.array([3.0]),
        np.array([[1.0], [0.0]]),
        np.zeros((2, 0)),
        *(np.array([-1.0, 1.0]), np.array([2.0, 2.0])),
        1.0,
        0.0,
    )
    point = minimiser(piece, Feasible())
    assert point.settled
    assert point.w == pytest.approx([2.0])
    assert point.z == pytest.approx([1.0, 0.0])


# No solution, no number, wrong shapes ------------------------------------------------------


def nothing(ranked: Ranked) -> bool:
    """Return whether the outcome is that there is no solution."""
    whole = np.concatenate([ranked.solution.x, ranked.solution.y, ranked.solution.z])
    said = not (ranked.solution.feasible or ranked.unique or ranked.levels)
    return said and ranked.kkt == np.inf and bool(np.isnan(whole).all())


def test_rows_that_contradict_each_other_have_no_solution() -> None:
    problem = drawn(np.random.default_rng(8))
    A, b, C, lb, ub = problem[1:]
    first, far = C[0], np.full(len(lb), 1e3)
    twice = problem._replace(A=np.vstack([A, A[:1]]), b=np.concatenate([b, b[:1] + 1]))
    rows = problem._replace(
        C=np.vstack([C, first]), lb=np.append(lb, ub[0] + 1), ub=np.append(ub, ub[0] + 2)
    )
    both = problem._replace(
        C=np.vstack([C, A[0]]), lb=np.append(lb, b[0] + 1), ub=np.append(ub, far[0])
    )
    crossed = problem._replace(lb=ub, ub=lb)
    for contradiction in (twice, rows, both, crossed):
        assert nothing(solve(contradiction))
    assert not nothing(solve(problem))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_number_that_is_not_finite_has_no_solution(bad: float) -> None:
    problem = drawn(np.random.default_rng(9))
    spoiled = []
    for name in ("A", "b", "C", "lb", "ub"):
        array = getattr(problem, name).copy()
        array.flat[1] = bad
        spoiled.append(problem._replace(**{name: array}))
    for name in Level._fields:
        one = problem.levels[1]
        array = getattr(one, name).copy()
        array.flat[1] = bad
        levels = (problem.levels[0], one._replace(**{name: array}), *problem.levels[2:])
        spoiled.append(problem._replace(levels=levels))
    if bad == np.inf:
        assert not nothing(solve(spoiled.pop(4)))  # an upper bound may be infinite
    for one in spoiled:
        assert nothing(solve(one))


def test_what_was_solved_before_leaves_no_trace() -> None:
    problem, other = (drawn(np.random.default_rng(seed), largest=8) for seed in (1, 2))
    sizes = 8, len(problem.b), len(problem.lb)
    other = Problem(other.levels, problem.A, problem.b, problem.C, problem.lb, problem.ub)
    priorities = Priorities(*sizes)
    first = priorities.solve(*problem)
    priorities.solve(*other)
    priorities.solve(*problem._replace(b=np.full(len(problem.b), np.nan)))
    again = priorities.solve(*problem)
    for one, two in zip(first.solution[:3], again.solution[:3], strict=True):
        assert one.tobytes() == two.tobytes()


WRONG = {
    "levels: got none": {"levels": ()},
    "A: got shape (0, 7), need (0, 8)": {"A": np.zeros((0, 7))},
    "ub: got shape (1,), need (2,)": {"ub": np.zeros(1)},
    "level 0, g: got shape (7,), need (8,)": {
        "levels": (Level(np.eye(8), np.zeros(7), np.eye(8)),)
    },
    "level 1, G: got shape (2, 7), need (2, 8)": {
        "levels": (
            level(np.eye(8), np.zeros(8)),
            Level(np.eye(8), np.zeros(8), np.zeros((2, 7))),
        )
    },
}


@pytest.mark.parametrize("message", WRONG)
def test_arrays_that_do_not_fit_are_refused(message: str) -> None:
    right = Problem(
        (level(np.eye(8), np.ones(8)),),
        *(np.zeros((0, 8)), np.zeros(0), np.eye(8)[:2], np.zeros(2), np.ones(2)),
    )
    priorities = Priorities(8, 0, 2)
    assert priorities.solve(*right).solution.x == pytest.approx(np.ones(8))
    with pytest.raises(InputError) as refused:
        priorities.solve(*right._replace(**WRONG[message]))
    assert str(refused.value).startswith(message)
