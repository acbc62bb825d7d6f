"""Factors, parameters and designs of studies."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from scripted import X, Y, scripted

from qpctrl import InputError
from scenarios.study.design import Design
from scenarios.study.factor import Factor
from scenarios.study.parameter import Parameter, choice
from scenarios.study.search import Worst

OFFSET = Factor("offset", "m", -0.01, 0.03)
COUNT = Factor("count", "1", 0.0, 6.0, whole=True)
COLOUR = Factor("colour", "choice", 0.0, 2.0, values=(0.0, 2.0))
SHARES = np.array([0.0, 0.1, 0.5, 0.9, 1.0])
ROUND_OFF = 1e-9

# Factors -------------------------------------------------------------------------------------


@pytest.mark.parametrize("ends", [(1.0, -1.0), (1.0, 1.0), (math.nan, 1.0), (0.0, math.inf)])
def test_a_factor_refuses_an_empty_or_endless_range(ends: tuple[float, float]) -> None:
    with pytest.raises(InputError, match=r"factor 'tilt'.*need"):
        Factor("tilt", "deg", *ends)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"distribution": "log-uniform"}, "got low -1 deg, need more than 0"),
        ({"distribution": "lognormal"}, "unknown factor 'tilt': distribution 'lognormal'.*did you"),
        ({"values": (0.0, 1.0, 0.0)}, "the same value twice"),
        ({"values": (0.0, 1.0), "distribution": "normal"}, "a distribution beside values"),
    ],
)
def test_a_factor_refuses_what_contradicts_itself(more: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Factor("tilt", "deg", -1.0, 1.0, **more)


def test_a_random_design_draws_from_the_distribution_of_a_factor() -> None:
    assert Factor("x", "1", -2.0, 6.0).at(SHARES) == pytest.approx([-2, -1.2, 2, 5.2, 6])
    log = Factor("x", "1", 0.01, 100.0, "log-uniform").at(SHARES)
    assert np.log10(log) == pytest.approx([-2, -1.6, 0, 1.6, 2])
    normal = Factor("x", "1", -6.0, 12.0, "normal").at(SHARES)
    inside = norm.cdf(3) - norm.cdf(-3)
    tenth = norm.ppf(norm.cdf(-3) + 0.1 * inside)
    assert normal == pytest.approx([-6, 3 + 3 * tenth, 3, 3 - 3 * tenth, 12])


def test_whole_numbers_and_given_values_have_equal_shares() -> None:
    shares = (np.arange(700) + 0.5) / 700
    assert np.unique(COUNT.at(shares), return_counts=True)[1].tolist() == [100] * 7
    assert np.unique(COUNT.at(np.array([0.0, 1.0]))).tolist() == [0, 6]
    assert np.unique(COLOUR.at(shares), return_counts=True)[1].tolist() == [350] * 2
    assert COLOUR.at(np.array([0.0, 1.0])).tolist() == [0, 2]


def test_whole_numbers_on_a_logarithmic_scale_are_drawn_more_often_where_they_are_small() -> None:
    drawn = Factor("n", "1", 1.0, 100.0, "log-uniform", whole=True).at(np.linspace(0, 1, 5001))
    assert set(drawn) == set(range(1, 101))
    share = np.mean(drawn == 1)
    assert share == pytest.approx(math.log(1.5 / 0.5) / math.log(100.5 / 0.5), abs=1e-3)


# Parameters ----------------------------------------------------------------------------------

LENGTH = Parameter("m", 0.1, -1.0, 2.0, "a length")
ROBOT = choice("the arm", "fr3", "ur5")


def test_a_choice_is_given_by_its_name_or_its_number() -> None:
    assert (ROBOT.value("ur5", "robot"), ROBOT.value(1, "robot")) == (1.0, 1.0)


@pytest.mark.parametrize(
    ("parameter", "given", "said"),
    [
        (LENGTH, 2.1, "got 2.1, need -1 to 2 m"),
        (LENGTH, math.nan, "got nan, need a finite number"),
        (LENGTH, 10**400, "got inf, need a finite number"),
        (LENGTH, "long", "got 'long', need a number"),
        (LENGTH, "1", "got '1', need a number"),
        (LENGTH, True, "got True, need a number"),
        (LENGTH, [1], r"got \[1\], need a number"),
        (ROBOT, "ur6", "unknown value of 'it' 'ur6'; allowed: fr3, ur5; did you mean 'ur5'"),
        (ROBOT, 2, "got 2, need fr3, ur5"),
        (ROBOT, 0.5, "got 0.5, need a whole number"),
    ],
)
def test_a_parameter_refuses_what_it_cannot_be(parameter: Parameter, given: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        parameter.value(given, "it")


# Designs -------------------------------------------------------------------------------------


def test_levels_reach_both_ends_of_one_factor_while_the_others_keep_their_usual_value() -> None:
    points = Design(size=5).points((X, OFFSET), {"offset": 0.0, "x": 99.0}, seed=0)
    assert points[:5, 0] == pytest.approx([-10, -5, 0, 5, 10])
    assert points[:5, 1] == pytest.approx(np.zeros(5))
    assert points[5:, 0] == pytest.approx(np.zeros(5))  # 99 is out of range: the middle
    assert points[5:, 1] == pytest.approx([-0.01, 0, 0.01, 0.02, 0.03])


def test_a_factor_of_given_values_takes_no_other_while_another_varies() -> None:
    steps = Factor("steps", "1", -6.0, 6.0, values=(-6.0, 2.0, 6.0))
    points = Design(size=2).points((X, steps), {"steps": 0.0}, seed=0)
    assert set(points[:2, 1]) == {2.0}
    assert Design(size=2).points((X, steps), {"steps": 6.0}, seed=0)[0, 1] == 6.0


def test_a_map_visits_every_level_of_each_factor_with_every_level_of_the_others() -> None:
    points = Design(kind="map", size=3).points((X, Y, COLOUR), {}, seed=0)
    expected = [[x, y, c] for x in (-10, 0, 10) for y in (0.01, 0.1, 1) for c in (0, 2)]
    assert points == pytest.approx(np.array(expected))


def test_a_sobol_design_fills_every_cell_once_and_repeats_with_its_seed() -> None:
    sobol = Design(kind="sobol", size=64)
    points = sobol.points((X, OFFSET), {}, seed=3)
    low, high = np.array([-10, -0.01]), np.array([10, 0.03])
    cells = np.floor((points - low) / (high - low) * 64)
    assert [sorted(column) for column in cells.T.tolist()] == [list(range(64))] * 2
    assert np.array_equal(points, sobol.points((X, OFFSET), {}, seed=3))
    assert not np.array_equal(points, sobol.points((X, OFFSET), {}, seed=4))


@pytest.mark.parametrize(("kind", "rows"), [("indices", 8 * 4), ("morris", 8 * 3)])
def test_a_design_for_sensitivity_lies_in_the_ranges_of_the_factors(kind: str, rows: int) -> None:
    points = Design(kind=kind, size=8).points((X, Y), {}, seed=1)
    assert points.shape == (rows, 2)
    assert np.abs(points[:, 0]).max() <= 10 * (1 + ROUND_OFF)
    assert 0.01 * (1 - ROUND_OFF) <= points[:, 1].min() < 0.1 < points[:, 1].max() <= 1 + ROUND_OFF
    moved = (np.diff(points.reshape(8, -1, 2), axis=1) != 0).sum(axis=2)
    if kind == "morris":
        assert moved.tolist() == [[1, 1]] * 8  # one factor at a time


@pytest.mark.parametrize(("size", "nearest"), [(12, 8), (13, 16), (100, 128)])
def test_a_sobol_size_that_is_no_power_of_two_is_refused_with_the_nearest(
    size: int, nearest: int
) -> None:
    with pytest.raises(InputError, match=rf"got {size}, need a power of two; nearest {nearest}$"):
        Design(kind="sobol", size=size).points((X,), {}, seed=0)


@pytest.mark.parametrize(
    ("of", "said"),
    [
        ({"kind": "grid"}, "unknown design 'grid'"),
        ({"size": 1}, "design levels: got size 1, need at least 2"),
        ({"kind": "sobol", "size": 1 << 30}, "makes 1073741824 points, need at most 10000000"),
        ({"kind": "map", "size": 4000}, "makes 16000000 points"),
        ({"size": 10**9}, "makes 2000000000 points"),
    ],
)
def test_a_design_that_cannot_be_made_is_refused(of: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Design(**of).points((X, Y), {}, seed=0)


def test_a_study_keeps_fixed_and_usual_values_where_nothing_varies() -> None:
    study = scripted(factors=(X, Y), fixed={"count": 3.0}, design=Design(size=3))
    points = study.points(seed=0)
    assert points[:3, 1] == pytest.approx([0.1] * 3)  # the usual value
    assert study.setting({"x": 5.0, "y": 0.5}) == {"x": 5.0, "y": 0.5, "count": 3.0, "colour": 0.0}


def test_a_worst_case_search_is_one_point_without_columns() -> None:
    study = scripted(search=Worst(measure="value_N"))
    assert study.points(seed=0).shape == (1, 0)
    assert study.columns == ()
