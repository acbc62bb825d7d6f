"""Statistics of studies: sensitivity, rates, Pareto fronts, ISO 9283, against known answers."""

import sys
import time
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import binom, norm, t, ttest_rel

from qpctrl import InputError
from qpctrl.arrays import Matrix, Vector
from scenarios.iso9283 import cycles, path_criteria
from scenarios.study.pareto import pareto_front
from scenarios.study.rate import (
    Groups,
    bootstrap_means,
    effective_size,
    percentile_interval,
    wilson,
)
from scenarios.study.sensitivity import (
    morris,
    morris_effects,
    saltelli,
    sobol_indices,
)

ROUND_OFF = 1e-9
QUADRATURE_POINTS = 1 << 14
QUADRATURE = 0.004  # twice the largest error of any index over 20 seeds at that many base points
CHANCE = 1e-4  # of a run of coverage trials beyond these counts, if the interval is right
ISHIGAMI_FIRST, ISHIGAMI_TOTAL = [0.3139, 0.4424, 0.0], [0.5576, 0.4424, 0.2437]
G_COEFFICIENTS = np.array([0.0, 0.5, 3.0, 9.0])
SLOPES = np.array([3.0, -2.0, 0.5, 0.0])


def ishigami(points: Matrix) -> Vector:
    """Return sin x₁ + 7 sin² x₂ + 0.1 x₃⁴ sin x₁ of points in the unit cube."""
    x = (2 * points - 1) * np.pi
    return np.sin(x[:, 0]) * (1 + 0.1 * x[:, 2] ** 4) + 7 * np.sin(x[:, 1]) ** 2


def g_function(points: Matrix) -> Vector:
    """Return Sobol's product of (|4x − 2| + a) / (1 + a)."""
    return ((np.abs(4 * points - 2) + G_COEFFICIENTS) / (1 + G_COEFFICIENTS)).prod(axis=1)


def g_indices() -> tuple[Vector, Vector]:
    """Return the analytic first-order and total indices of `g_function`."""
    own = 1 / (3 * (1 + G_COEFFICIENTS) ** 2)
    variance = np.prod(1 + own) - 1
    return own / variance, own * np.prod(1 + own) / (1 + own) / variance


def random_blocks(count: int, size: int, rng: np.random.Generator) -> Matrix:
    """Return blocks like those of `saltelli`, of independent points."""
    base = rng.random((size, 2, count))
    block = np.repeat(base[:, :1], count + 2, axis=1)
    for i in range(count):
        block[:, i + 1, i] = base[:, 1, i]
    block[:, -1] = base[:, 1]
    return block.reshape(-1, count)


def within_binomial(hits: int, trials: int, share: float) -> bool:
    """Return whether so many hits are likely of trials that succeed with ``share``."""
    low, high = binom.ppf([CHANCE, 1 - CHANCE], trials, share)
    return bool(low <= hits <= high)


# Sobol indices -------------------------------------------------------------------------------


def test_ishigamis_indices_are_the_analytic_ones() -> None:
    found = sobol_indices(
        ishigami(saltelli(3, QUADRATURE_POINTS, seed=1)), 3, seed=2, resamples=200
    )
    assert found.first == pytest.approx(ISHIGAMI_FIRST, abs=QUADRATURE)
    assert found.total == pytest.approx(ISHIGAMI_TOTAL, abs=QUADRATURE)
    assert found.blocks == found.blocks_used == QUADRATURE_POINTS


def test_the_g_functions_indices_are_the_analytic_ones() -> None:
    found = sobol_indices(
        g_function(saltelli(4, QUADRATURE_POINTS, seed=1)), 4, seed=2, resamples=200
    )
    first, total = g_indices()
    assert found.first == pytest.approx(first, abs=QUADRATURE)
    assert found.total == pytest.approx(total, abs=QUADRATURE)
    assert (found.first_low < found.first).all()
    assert (found.total_high > found.total).all()


def test_indices_change_neither_with_the_unit_nor_with_an_offset() -> None:
    y = ishigami(saltelli(3, 64, seed=1))
    plain, shifted = (sobol_indices(v, 3, seed=2) for v in (y, 1e5 - 1e-3 * y))
    for before, after in zip(plain[:6], shifted[:6], strict=True):
        assert after == pytest.approx(before, abs=1e-6)  # 1e5 costs eight digits of 1e-3 y


def test_bootstrap_intervals_of_indices_cover_as_often_as_they_say() -> None:
    rng, first, total = np.random.default_rng(5), *g_indices()
    trials, hits = 200, np.zeros((2, 4))
    for trial in range(trials):
        y = g_function(random_blocks(4, 512, rng))
        found = sobol_indices(y, 4, seed=trial, confidence=0.9, resamples=400)
        hits[0] += (found.first_low <= first) & (first <= found.first_high)
        hits[1] += (found.total_low <= total) & (total <= found.total_high)
    for count in hits.ravel():
        assert within_binomial(int(count), trials, 0.9), hits


def test_a_block_with_a_diverged_rollout_is_left_out_whole_and_counted() -> None:
    y = ishigami(saltelli(3, 64, seed=1))
    lost = [3, 17, 40]
    broken = y.copy()
    broken[[5 * 3 + 1, 5 * 17, 5 * 17 + 4, 5 * 40 + 2]] = [np.nan, np.nan, np.inf, np.nan]
    kept = np.delete(y.reshape(-1, 5), lost, axis=0).ravel()
    found, answer = sobol_indices(broken, 3, seed=2), sobol_indices(kept, 3, seed=2)
    assert (found.blocks, found.blocks_used) == (64, 61)
    for got, expected in zip(found[:6], answer[:6], strict=True):
        assert np.array_equal(got, expected)
    assert not np.array_equal(found.first, sobol_indices(y, 3, seed=2).first)


def test_too_few_whole_blocks_are_refused_with_the_numbers() -> None:
    y = ishigami(saltelli(3, 8, seed=1))
    sobol_indices(y, 3, seed=0)
    y[0] = np.nan
    with pytest.raises(InputError, match=r"blocks: 7 of 8 .* need at least 8"):
        sobol_indices(y, 3, seed=0)


@pytest.mark.parametrize("offset", [0.0, 5.7, -3e8])
def test_a_constant_has_no_indices(offset: float) -> None:
    found = sobol_indices(np.full(80, offset), 3, seed=0)
    assert np.isnan(np.stack(found[:6])).all()
    assert found.blocks_used == 16


def test_an_event_in_one_block_alone_has_indices_but_no_interval() -> None:
    y = np.zeros(80)
    y[7] = 1.0  # x₂ of b, in the second block
    y[5] = 1.0
    found = sobol_indices(y, 3, seed=0)
    assert np.isfinite([*found.first, *found.total]).all()
    assert np.isnan(np.stack(found[2:6])).all()


def test_a_saltelli_block_swaps_one_factor_at_a_time() -> None:
    points = saltelli(3, 16, seed=4)
    assert points.shape == (80, 3)
    for a, *mixed, b in points.reshape(16, 5, 3):
        assert (a != b).all()
        for i, row in enumerate(mixed):
            assert np.array_equal(row, np.where(np.arange(3) == i, b, a))
    assert np.array_equal(points, saltelli(3, 16, seed=4))
    assert not np.array_equal(points, saltelli(3, 16, seed=5))
    strata = np.floor(points.reshape(16, 5, 3)[:, 0] * 16)
    assert [sorted(column) for column in strata.T.tolist()] == [list(range(16))] * 3


def test_same_seed_same_interval() -> None:
    y = ishigami(saltelli(3, 32, seed=1))
    one, again, other = (sobol_indices(y, 3, seed=s) for s in (7, 7, 8))
    assert np.array_equal(one.first_low, again.first_low)
    assert not np.array_equal(one.first_low, other.first_low)
    assert np.array_equal(one.first, other.first)


@pytest.mark.parametrize(
    ("size", "nearest"), [(12, 8), (13, 16), (100, 128), (4, 8), (0, 8), (-3, 8)]
)
def test_a_size_that_is_no_power_of_two_is_refused_with_the_nearest(
    size: int, nearest: int
) -> None:
    with pytest.raises(InputError, match=rf"Sobol size: got {size}, .*; nearest {nearest}$"):
        saltelli(3, size, seed=0)


# Morris effects ------------------------------------------------------------------------------


@pytest.mark.parametrize("levels", [2, 4, 6])
def test_a_linear_functions_effects_are_its_slopes(levels: int) -> None:
    points = morris(4, 10, levels, seed=3)
    assert points.shape == (50, 4)
    assert points.min() == 0
    assert points.max() == 1
    found = morris_effects(points, 7 + points @ SLOPES, seed=0)
    assert found.mu == pytest.approx(SLOPES, abs=ROUND_OFF)
    assert found.mu_star == pytest.approx(np.abs(SLOPES), abs=ROUND_OFF)
    assert found.sigma == pytest.approx(np.zeros(4), abs=ROUND_OFF)
    assert found.mu_star_low == pytest.approx(np.abs(SLOPES), abs=ROUND_OFF)
    assert found.mu_star_high == pytest.approx(np.abs(SLOPES), abs=ROUND_OFF)


def test_effects_of_an_interaction_have_their_expected_moments() -> None:
    """Of y = x₁ (x₂ − ½), on two levels, e₁ is ±½ and e₂ is 0 or 1, at even odds."""
    points = morris(2, 4000, 2, seed=3)
    found = morris_effects(points, points[:, 0] * (points[:, 1] - 0.5), seed=0)
    assert found.mu == pytest.approx([0, 0.5], abs=0.04)  # five standard errors, 0.5 / √4000
    assert found.mu_star == pytest.approx([0.5, 0.5], abs=0.04)
    assert found.sigma == pytest.approx([0.5, 0.5], abs=0.01)
    assert found.mu_star_high[0] - found.mu_star_low[0] == pytest.approx(0, abs=ROUND_OFF)
    width = 2 * 1.96 * 0.5 / np.sqrt(4000)
    assert found.mu_star_high[1] - found.mu_star_low[1] == pytest.approx(width, rel=0.1)


def test_effects_are_per_unit_of_the_points() -> None:
    points = morris(4, 10, 4, seed=3) * [10, 1, 0.1, 5] - 3
    found = morris_effects(points, points @ SLOPES, seed=0)
    assert found.mu == pytest.approx(SLOPES, abs=ROUND_OFF)


def test_a_trajectory_with_a_diverged_rollout_is_left_out_whole_and_counted() -> None:
    points = morris(3, 12, 4, seed=1)
    y = ishigami(points)
    broken = y.copy()
    broken[[9, 10, 46]] = np.nan  # trajectories 2 and 11
    keep = np.delete(np.arange(48).reshape(12, 4), [2, 11], axis=0).ravel()
    found = morris_effects(points, broken, seed=2)
    answer = morris_effects(points[keep], y[keep], seed=2)
    assert (found.trajectories, found.trajectories_used) == (12, 10)
    for got, expected in zip(found[:5], answer[:5], strict=True):
        assert np.array_equal(got, expected)
    broken[::4][:9] = np.nan
    with pytest.raises(InputError, match=r"trajectories: 2 of 12 .* need at least 4"):
        morris_effects(points, broken, seed=2)


# Bad input -----------------------------------------------------------------------------------

POINTS, VALUES = np.tile([[0.0, 0], [1, 0], [1, 1]], (5, 1)), np.arange(15.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: saltelli(0, 8, 0), "factors: got 0"),
        (lambda: saltelli(3, 8, -1), "seed: got -1"),
        (lambda: morris(2, 4, 3, 0), "levels: got 3, need an even"),
        (lambda: morris(2, 1, 4, 0), "trajectories: got 1, need at least 4"),
        (lambda: sobol_indices(np.ones(41), 3, 0), r"values: got shape \(41,\), need blocks of 5"),
        (lambda: sobol_indices(VALUES, 3, 0, confidence=1.0), "confidence: got 1.0"),
        (lambda: sobol_indices(np.arange(50), 3, 0, resamples=0), "resamples: got 0"),
        (lambda: sobol_indices(np.arange(50), 3, -2), "seed: got -2"),
        (lambda: morris_effects(POINTS[:, :1], VALUES, 0), "points: got shape"),
        (lambda: morris_effects(POINTS[::-1] + POINTS, VALUES, 0), "no Morris design"),
        (lambda: morris_effects(POINTS, VALUES[:12], 0), "values: got 12, need 15"),
        (lambda: wilson(3, 2), "rate: got 3 of 2"),
        (lambda: wilson(-1, 2), "rate: got -1 of 2"),
        (lambda: wilson(1, 2, 0.0), "confidence: got 0.0"),
        (
            lambda: wilson(1, 2, worth=3.0),
            "rate: got 2 rollouts that are worth 3.0, need 0 < worth",
        ),
        (lambda: bootstrap_means(POINTS, 0, groups=np.arange(14)), r"groups: got shape \(14,\)"),
        (lambda: percentile_interval(POINTS, 0.95, 1), "groups: got 1, need at least 2"),
        (lambda: pareto_front([1.0, 2.0]), r"costs: got shape \(2,\)"),
        (lambda: cycles(np.ones((5, 3)), 6), "got 5 ticks, need 6"),
        (lambda: cycles(np.ones((5, 2)), 2), r"positions: got shape \(5, 2\)"),
        (lambda: cycles(np.ones((5, 3)), 0), "got period 0"),
    ],
)
def test_bad_input_is_refused_in_one_clear_line(call: Any, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_without_salib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [n for n in sys.modules if n.split(".")[0] == "SALib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "SALib", None)
    for call in (lambda: saltelli(3, 8, 0), lambda: morris(3, 8, 4, 0)):
        with pytest.raises(InputError, match=r"needs? the extra: pip install 'qpctrl\[studies\]'"):
            call()


# Rates and means -----------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "of"), [(8, 10), (1, 7), (250, 1000), (0, 12), (12, 12)])
@pytest.mark.parametrize("confidence", [0.8, 0.95])
@pytest.mark.parametrize("worth", [None, 4.5])
def test_the_ends_of_wilsons_interval_solve_the_score_equation(
    count: int, of: int, confidence: float, worth: float | None
) -> None:
    rate, z = wilson(count, of, confidence, worth=worth), norm.ppf((1 + confidence) / 2)

    def score(p: float) -> float:
        return (count / of - p) / np.sqrt(p * (1 - p) / (worth or of))

    low = brentq(lambda p: score(p) - z, 1e-12, 1 - 1e-12, xtol=1e-14) if count else 0.0
    high = brentq(lambda p: score(p) + z, 1e-12, 1 - 1e-12, xtol=1e-14) if count < of else 1.0
    assert rate.value == count / of
    assert rate.low == pytest.approx(low, abs=ROUND_OFF)
    assert rate.high == pytest.approx(high, abs=ROUND_OFF)


def test_of_nothing_nothing_is_known() -> None:
    rate = wilson(0, 0)
    assert np.isnan(rate.value)
    assert rate[1:] == (0, 1)


def shared(
    draws: int, levels: int, rng: np.random.Generator, alike: float = 0.8
) -> tuple[Matrix, Groups]:
    """Return numbers (levels x draws) of mean 0 and variance 1, and the draw of each.

    ``alike`` is the correlation of two of one draw.
    """
    own, common = rng.normal(size=(levels, draws)), rng.normal(size=draws)
    values = np.sqrt(alike) * common + np.sqrt(1 - alike) * own
    return values, np.tile(np.arange(draws), (levels, 1))


def interval(
    values: Matrix, seed: int, *, groups: Groups | None = None, count: int | None = None, **of: Any
) -> tuple[float, float]:
    """Return the bootstrap interval of the mean of all values."""
    confidence = of.pop("confidence", 0.95)
    own = None if groups is None else groups.ravel()
    means = bootstrap_means(values.reshape(-1, 1), seed, groups=own, **of)
    low, high = percentile_interval(means, confidence, count)
    return float(low[0]), float(high[0])


def test_the_bootstrap_interval_of_a_mean_covers_as_often_as_it_says() -> None:
    rng, trials, hits = np.random.default_rng(6), 400, 0
    for trial in range(trials):
        values = rng.gamma(4.0, 0.5, 100)
        low, high = interval(values, trial, confidence=0.9, resamples=400)
        hits += low <= 2 <= high
    assert within_binomial(hits, trials, 0.9), hits


def test_what_shares_draws_is_covered_by_whole_draws_and_not_by_rows() -> None:
    """At 7 levels, alike by 0.8, the mean has √(1 + 6 · 0.8) = 2.4 times the error of 7 draws."""
    rng, trials, whole, rows = np.random.default_rng(7), 2000, 0, 0
    for trial in range(trials):
        values, draws = shared(40, 7, rng)
        low, high = interval(values, trial, groups=draws, count=40)
        whole += low <= 0 <= high
        if trial < trials // 4:
            low, high = interval(values, trial, resamples=400)
            rows += low <= 0 <= high
    assert within_binomial(whole, trials, 0.95), whole
    assert 0.93 <= whole / trials <= 0.97
    share = 2 * norm.cdf(1.96 / np.sqrt(1 + 6 * 0.8)) - 1  # 58 %
    assert within_binomial(rows, trials // 4, share), rows
    assert rows / (trials // 4) < 0.8


@pytest.mark.parametrize("alike", [0.0, 0.3, 0.9])
def test_the_width_is_the_standard_error_of_a_mean_with_intraclass_correlation(
    alike: float,
) -> None:
    draws, levels = 3000, 5
    values, own = shared(draws, levels, np.random.default_rng(1), alike)
    error = np.sqrt((1 + (levels - 1) * alike) / (draws * levels))
    low, high = interval(values, 1, groups=own, count=draws, resamples=4000)
    assert high - low == pytest.approx(2 * 1.96 * error, rel=0.08)  # four errors of both ends


def test_of_few_draws_the_interval_is_students_and_covers() -> None:
    rng, trials, hits, widths = np.random.default_rng(3), 500, 0, []
    for trial in range(trials):
        values, draws = shared(10, 7, rng)
        low, high = interval(values, trial, groups=draws, count=10)
        hits += low <= 0 <= high
        student = 2 * t.ppf(0.975, 9) * values.mean(axis=0).std(ddof=1) / np.sqrt(10)
        many = np.subtract(*interval(values, trial, groups=draws)[::-1])
        widths.append([(high - low) / student, many / student])
    assert within_binomial(hits, trials, 0.95), hits
    assert np.median(widths, axis=0) == pytest.approx([1.0, 0.82], abs=0.03)


def test_the_interval_of_a_paired_difference_is_that_of_the_paired_t_test() -> None:
    rng, draws = np.random.default_rng(4), 24
    common, own = shared(draws, 7, rng)
    pair = 3 * common[..., None] + 0.2 * rng.normal(size=(7, draws, 2)) + [0.0, 0.1]
    means = bootstrap_means(pair.reshape(-1, 2), 0, 20_000, groups=own.ravel())
    low, high = percentile_interval(means[:, :1] - means[:, 1:], 0.95, draws)
    test = ttest_rel(*pair.mean(axis=0).T).confidence_interval()
    width = test.high - test.low
    assert [low[0], high[0]] == pytest.approx([test.low, test.high], abs=0.05 * width)
    one, other = (interval(pair[..., i], 0, groups=own, count=draws) for i in (0, 1))
    assert min(np.subtract(*x[::-1]) for x in (one, other)) > 10 * width


def test_each_row_a_draw_of_its_own_is_as_without_draws() -> None:
    rows = np.random.default_rng(1).normal(size=(40, 3))
    found = bootstrap_means(rows, seed=2, groups=np.arange(40) * 7)
    assert np.array_equal(found, bootstrap_means(rows, seed=2))


def test_a_draw_is_drawn_whole_and_counts_as_often_as_it_has_rows() -> None:
    rows, draws = np.array([[1.0], [2.0], [3.0], [10.0]]), np.array([5, 5, 5, 2])
    found, times = np.unique(bootstrap_means(rows, 0, 4000, groups=draws), return_counts=True)
    assert found.tolist() == [2.0, 4.0, 10.0]
    assert times / 4000 == pytest.approx([0.25, 0.5, 0.25], abs=0.03)


@pytest.mark.parametrize("levels", [1, 7])
@pytest.mark.parametrize("ends", ["alike", "never", "always"])
def test_draws_that_end_alike_are_worth_one_rollout_each(levels: int, ends: str) -> None:
    happened = {"alike": np.arange(12) % 3 == 0, "never": np.zeros(12), "always": np.ones(12)}
    values = np.tile(happened[ends].astype(float), (levels, 1))
    draws = np.tile(np.arange(12), (levels, 1))
    assert effective_size(values.ravel(), draws.ravel()) == pytest.approx(12, rel=ROUND_OFF)


def test_rollouts_that_end_as_they_like_are_worth_nearly_as_many_as_they_are() -> None:
    rng = np.random.default_rng(2)
    values, draws = shared(1000, 5, rng, alike=0.0)
    assert effective_size((values > 0).ravel() + 0.0, draws.ravel()) > 0.93 * 5000
    level = (np.arange(5) > 2)[:, None] + np.zeros(1000)  # the level alone decides
    assert effective_size(level.ravel() + 0.0, draws.ravel()) == 5000


@pytest.mark.parametrize(("share", "alike", "rows"), [(0.1, 0.95, 0.65), (0.3, 0.5, 0.8)])
def test_the_interval_of_a_rate_covers_where_draws_are_shared(
    share: float, alike: float, rows: float
) -> None:
    rng, trials, hits = np.random.default_rng(8), 600, np.zeros(2)
    for _ in range(trials):
        values, draws = shared(20, 7, rng, alike)
        failed = (values < norm.ppf(share)).ravel() + 0.0
        for i, worth in enumerate((effective_size(failed, draws.ravel()), None)):
            rate = wilson(int(failed.sum()), 140, worth=worth)
            hits[i] += rate.low <= share <= rate.high
    assert 0.93 <= hits[0] / trials <= 0.99, hits
    assert hits[1] / trials < rows


def test_the_bootstrap_of_a_mean_is_seeded_and_its_width_is_the_standard_error() -> None:
    values = np.random.default_rng(1).normal(5, 2, 400)
    one, again, other = (interval(values, s, resamples=4000) for s in (1, 1, 2))
    assert one == again
    assert one != other
    assert one[1] - one[0] == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.06)


def test_rows_are_drawn_whole_and_alike_in_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.random.default_rng(1).random((50, 2)) @ [[1.0, 2.0, -1.0], [0.0, 0.0, 3.0]]
    means = bootstrap_means(rows, seed=1, resamples=30)
    assert means[:, 1] == pytest.approx(2 * means[:, 0], rel=ROUND_OFF)
    assert np.ptp(means[:, 0]) > 0.01
    monkeypatch.setattr("scenarios.study.rate.LARGEST_BATCH", 130)
    assert bootstrap_means(rows, seed=1, resamples=30) == pytest.approx(means, rel=ROUND_OFF)


# Pareto fronts -------------------------------------------------------------------------------


@pytest.mark.parametrize("columns", [1, 2, 3, 4])
@pytest.mark.parametrize("seed", range(5))
def test_the_front_is_what_comparing_every_pair_says(columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    costs = rng.integers(-3, 4, (60, columns)) * rng.choice([0.0, 1.0, -1.0], (60, columns))
    costs[rng.random((60, columns)) < 0.05] = np.inf
    costs[rng.random((60, columns)) < 0.05] = np.nan
    expected = [
        not np.isnan(row).any()
        and not any((other <= row).all() and (other < row).any() for other in costs)
        for row in costs
    ]
    assert 0 < sum(expected) < 60
    assert pareto_front(costs).tolist() == expected


def test_equal_rows_share_their_place_and_a_row_with_nan_has_none() -> None:
    costs = [[1, 2], [1, 2], [1, 3], [np.nan, 0], [2, 1], [2, 1.5], [-0.0, 9], [0.0, 9]]
    on = [True, True, False, False, True, False, True, True]
    assert pareto_front(costs).tolist() == on
    assert pareto_front(np.full((2, 2), np.nan)).tolist() == [False, False]
    assert pareto_front(np.empty((0, 2))).shape == (0,)


@pytest.mark.parametrize("shape", ["cloud", "all on the front"])
def test_a_front_of_a_hundred_thousand_rows_takes_less_than_half_a_second(shape: str) -> None:
    costs = np.random.default_rng(1).random((100_000, 2))
    if shape != "cloud":
        costs[:, 1] = 1 - costs[:, 0]
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        front = pareto_front(costs)
        best = min(best, time.perf_counter() - start)
    assert best < 0.5
    assert (front.sum() == 100_000) == (shape != "cloud")


# ISO 9283 ------------------------------------------------------------------------------------

RADIUS, POINTS_OF_CIRCLE = 0.1, 400
STEP = 2 * np.pi / POINTS_OF_CIRCLE
CHORD = 1.02 * RADIUS * STEP**2 / 8  # sag [m] of the line between two points at 102 mm: 3 µm

SCATTER_OF_CHORDS = 4 * CHORD  # mean and deviation of distances up to a sag are each at most that


def circle(phase: Vector, radius: Any = RADIUS, height: Any = 0.0) -> Matrix:
    """Return points (ticks × 3) [m] of a tilted circle."""
    x, y, z = radius * np.cos(phase), radius * np.sin(phase), height + 0 * phase
    return np.stack([0.6 * x - 0.8 * z, y, 0.8 * x + 0.6 * z], axis=1)


PHASE = np.arange(POINTS_OF_CIRCLE) * STEP
COMMAND = circle(PHASE)


def test_offsets_and_scatter_across_the_path_are_found_by_hand() -> None:
    """Heights of 1, 2, 6 mm: barycentre 3, distances 2, 1, 3, so l̄ = 2 and S = 1."""
    attained = np.stack([circle(PHASE, height=h) for h in (1e-3, 2e-3, 6e-3)])
    found = path_criteria(attained, COMMAND, closed=True)
    assert found.accuracy == pytest.approx(3e-3, rel=ROUND_OFF)
    assert found.repeatability == pytest.approx(5e-3, rel=ROUND_OFF)
    assert found.points == found.points_used == POINTS_OF_CIRCLE


def test_the_worst_point_decides() -> None:
    bump = 4e-3 * np.exp(-(((PHASE - PHASE[127]) / 0.1) ** 2))
    attained = np.stack([circle(PHASE, RADIUS + s * bump) for s in (1.0, 0.5)])
    found = path_criteria(attained, COMMAND)
    assert found.accuracy == pytest.approx(3e-3, rel=ROUND_OFF)
    assert found.repeatability == pytest.approx(1e-3, rel=ROUND_OFF)  # both l the same: S = 0


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("ticks", [-30.3, -0.5, 7.7, 30.0])
def test_lag_along_the_path_is_no_deviation(closed: bool, ticks: float) -> None:
    """At 30 ticks of lag the point itself is 46 mm off."""
    phase = np.arange(5 * POINTS_OF_CIRCLE) * STEP - ticks * STEP
    attained = cycles(circle(phase, RADIUS + 1e-3), POINTS_OF_CIRCLE)
    found = path_criteria(attained, COMMAND, closed=closed)
    assert found.accuracy == pytest.approx(1e-3, abs=CHORD)
    assert found.repeatability < 1e-12
    assert found.points - found.points_used <= abs(ticks) + 1
    assert found.points > found.points_used or abs(ticks) < 1


def test_a_jitter_of_the_lag_is_no_scatter() -> None:
    rng = np.random.default_rng(3)
    lag = rng.uniform(-2, 2, (6, 1)) * STEP
    attained = np.stack([circle(PHASE - own) for own in lag])
    found = path_criteria(attained, COMMAND)
    assert found.accuracy <= CHORD
    assert found.repeatability <= SCATTER_OF_CHORDS
    pointwise = np.linalg.norm(attained - attained.mean(axis=0), axis=2).mean(axis=0).max()
    assert pointwise > 0.5e-3


@pytest.mark.parametrize("late", [True, False])
def test_a_closed_path_is_followed_into_the_next_cycle_and_the_one_before(late: bool) -> None:
    """A lag of 9.5 ticks takes the last 10 points of each cycle but the last, which makes it up.

    A lead takes the first 10, but of the first. Heights there are 1, 1, 1, 2 mm: barycentre 1.25,
    distances ¼, ¼, ¼, ¾, so l̄ = ⅜ and S = ¼.
    """
    cycle = np.arange(4.0 * POINTS_OF_CIRCLE) / POINTS_OF_CIRCLE
    lag = np.interp(cycle, [3, 3.5], [9.5, 0]) if late else np.interp(cycle, [0.5, 1], [0, -9.5])
    attained = cycles(circle(2 * np.pi * cycle - lag * STEP, height=1e-3), POINTS_OF_CIRCLE)
    raised = attained[3, -10:] if late else attained[0, :10]
    raised += [-0.8e-3, 0, 0.6e-3]
    open_, closed = (path_criteria(attained, COMMAND, closed=c) for c in (False, True))
    assert (open_.points_used, closed.points_used) == (POINTS_OF_CIRCLE - 10, POINTS_OF_CIRCLE)
    assert open_.repeatability < SCATTER_OF_CHORDS
    assert closed.accuracy == pytest.approx(1.25e-3, abs=CHORD)
    assert closed.repeatability == pytest.approx(1.125e-3, abs=SCATTER_OF_CHORDS)


@pytest.mark.parametrize("corner", [0, 3, 7])
def test_the_planes_of_a_closed_path_bisect_each_of_its_corners(corner: int) -> None:
    octagon = circle(np.arange(8) * np.pi / 4)
    attained = np.stack([octagon, octagon])
    attained[:, corner] *= [[1.1], [1.3]]
    found = path_criteria(attained, octagon, closed=True)
    assert found.accuracy == pytest.approx(0.2 * RADIUS, rel=ROUND_OFF)
    assert found.repeatability == pytest.approx(0.1 * RADIUS, rel=ROUND_OFF)


def test_a_path_that_one_cycle_does_not_follow_has_no_criteria() -> None:
    attained = np.stack([COMMAND] * 3)
    attained[2, 370:] = COMMAND[370]
    late = path_criteria(attained, COMMAND)
    assert (late.accuracy, late.points_used) == (pytest.approx(0, abs=ROUND_OFF), 371)
    attained[2, 300:] = COMMAND[300]
    stuck = path_criteria(attained, COMMAND)
    assert np.isnan([stuck.accuracy, stuck.repeatability]).all()
    assert (stuck.points, stuck.points_used) == (400, 301)
    attained = np.stack([COMMAND, 0 * COMMAND + COMMAND[0], COMMAND])
    standing = path_criteria(attained, COMMAND, closed=True)
    assert np.isnan(standing.accuracy)
    assert standing.points_used <= 2  # the point it stands at, and the one across the circle


def test_random_scatter_gives_the_expected_repeatability() -> None:
    """Normal to a line the distances are Rayleigh's: mean σ√(π/2), deviation σ√(2 − π/2)."""
    rng, sigma, n = np.random.default_rng(2), 1e-3, 4000
    command = np.stack([np.linspace(0, 1, 5), np.zeros(5), np.zeros(5)], axis=1)
    noise = rng.normal(0, sigma, (n, 5, 3)) * [0, 1, 1]
    found = path_criteria(command + noise, command)
    expected = sigma * (np.sqrt(np.pi / 2) + 3 * np.sqrt(2 - np.pi / 2))
    assert found.repeatability == pytest.approx(expected, rel=0.05)  # the worst of five points
    assert found.accuracy < 5 * sigma / np.sqrt(n)


def test_cycles_are_cut_from_their_start_and_the_rest_is_left() -> None:
    p = np.arange(36.0).reshape(12, 3)
    found = cycles(p, 4, start=3)
    assert found.shape == (2, 4, 3)
    assert np.array_equal(found[1], p[7:11])


@pytest.mark.parametrize(
    ("attained", "commanded", "message"),
    [
        (COMMAND[None], COMMAND, "need at least 2 cycles"),
        (COMMAND, COMMAND, "need at least 2 cycles"),
        (np.stack([COMMAND] * 2)[:, :-1], COMMAND, r"attained: got shape \(2, 399, 3\)"),
        (np.stack([COMMAND] * 2), COMMAND[:1], "commanded: got shape"),
        (np.stack([COMMAND, COMMAND * np.nan]), COMMAND, "attained: 1200 numbers are not finite"),
        (np.stack([COMMAND] * 2), COMMAND * 0, "stands still or turns back at point 0"),
    ],
)
def test_paths_that_cannot_be_judged_are_refused(
    attained: Matrix, commanded: Matrix, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        path_criteria(attained, commanded)
