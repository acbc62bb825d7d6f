"""Searches of studies: boundaries by bisection, and the worst case by an optimiser."""

import builtins
import math
import random
from typing import Any

import pytest
from scripted import X, Y, diverge, scripted

from qpctrl import InputError
from scenarios.study.factor import Factor
from scenarios.study.plan import Plan
from scenarios.study.rollout import TIMING, roll_out
from scenarios.study.search import FINEST, Boundary, Worst
from scenarios.study.study import Study
from scenarios.study.system import Measures, Setting

PEAK_X, PEAK_Y, PEAK = 3.0, 0.2, 10.0
CLOSE = 0.05  # of the maximum, and of the ranges; promised after 64 rollouts
COUNT = Factor("count", "1", 0.0, 6.0, whole=True)
COLOUR = Factor("colour", "choice", 0.0, 2.0, whole=True, values=(0.0, 1.0, 2.0))
WORST = Worst(measure="value_N")


def hill(setting: Setting, controller: str, seed: int) -> Measures:
    """Return a paraboloid over x and log y with its top inside both ranges."""
    down = ((setting["x"] - PEAK_X) / 10) ** 2 + math.log10(setting["y"] / PEAK_Y) ** 2
    return {"value_N": PEAK * (1 - down)}


def root(setting: Setting, controller: str, seed: int) -> Measures:
    """Return √y · count."""
    return {"value_N": math.sqrt(setting["y"]) * setting["count"]}


def rows(study: Study, seed: int = 0) -> list[dict[str, Any]]:
    """Return the rows of a study in the order of its plan, without timing."""
    made = [roll_out(study, task).row for task in Plan(study, seed)]
    return [{k: v for k, v in row.items() if k not in TIMING} for row in made]


# Boundaries ----------------------------------------------------------------------------------


def bisected(script: Any = root, edge: float | None = None, **of: Any) -> list[dict[str, Any]]:
    """Return the rows of a study that seeks how far y can be raised, for counts 1, 2 and 6."""
    search = Boundary(**{"parameter": "y", "low": 0.01, "high": 100.0, "measure": "value_N"} | of)
    counts = Factor("count", "1", 1.0, 6.0, whole=True, values=(1.0, 2.0, 6.0))
    return rows(scripted(script, edge=edge, factors=(counts,), search=search))


@pytest.mark.parametrize(
    ("scale", "tolerance", "rollouts"),
    [("linear", 0.02, 2 + 13), ("log", 1e-3, 2 + 14)],  # each rollout halves the interval
)
def test_a_bisection_finds_the_known_edge_within_its_tolerance(
    scale: str, tolerance: float, rollouts: int
) -> None:
    found = bisected(limit=6.0, scale=scale, tolerance=tolerance, edge=9.0)
    for row, edge in zip(found, (36.0, 9.0, 1.0), strict=True):
        width = tolerance * (edge if scale == "log" else 1.0)
        assert row["y_limit"] == pytest.approx(edge, abs=width / 2)
        assert row["y_limit"] != edge
        assert row["y_limit_closed"] == 9.0
        assert row["y_limit_gap"] == pytest.approx(abs(row["y_limit"] / 9 - 1))
        assert (row["outcome"], row["reason"], row["rollouts"]) == ("ok", "", rollouts)


def test_a_bisection_without_an_edge_has_no_number_and_a_reason() -> None:
    low, middle, high = bisected(limit=12.0, edge=9.0)
    assert (low["y_limit"], low["y_limit_gap"]) == (None, None)
    assert (low["reason"], low["rollouts"]) == ("holds up to the end", 2)
    assert middle["y_limit"] == pytest.approx(36, abs=0.005)
    assert high["y_limit"] == pytest.approx(4, abs=0.005)
    never = bisected(limit=0.01)
    assert [(row["y_limit"], row["reason"]) for row in never] == [
        (None, "does not hold at the start")
    ] * 3
    assert [row["rollouts"] for row in never] == [1] * 3


def test_a_rollout_that_diverges_does_not_hold() -> None:
    def script(setting: Setting, *_: Any) -> Measures:
        return diverge(setting, "", 0) if setting["y"] > 20 else {"value_N": 0.0}

    for row in bisected(script, limit=1.0):
        assert row["y_limit"] == pytest.approx(20, abs=0.005)


def test_a_bisection_stays_in_its_range_and_ends_at_the_finest_tolerance() -> None:
    seen: list[float] = []

    def script(setting: Setting, *_: Any) -> Measures:
        seen.append(setting["y"])
        return {"value_N": setting["y"]}

    first = bisected(script, limit=7.0, scale="log", tolerance=2e4 * FINEST)[0]
    assert first["y_limit"] == pytest.approx(7, rel=1e4 * FINEST)
    assert 0.01 <= min(seen) < 0.0100001
    assert max(seen) == 100.0  # though exp log 100 is more


# The worst case ------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_the_worst_case_of_a_hill_is_its_top(seed: int) -> None:
    study = scripted(hill, factors=(X, Y), search=WORST)
    (row,) = rows(study, seed)
    assert row["worst_value_N"] == pytest.approx(PEAK, rel=CLOSE)
    assert row["worst_x_1"] == pytest.approx(PEAK_X, abs=CLOSE * 20)
    assert math.log10(row["worst_y_m"] / PEAK_Y) == pytest.approx(0, abs=CLOSE * 2)
    assert (
        row["worst_value_N"]
        == hill({"x": row["worst_x_1"], "y": row["worst_y_m"]}, "", 0)["value_N"]
    )
    assert (row["rollouts"], row["outcome"], row["reason"]) == (64, "ok", "")


def test_whole_numbers_and_choices_are_searched_as_what_they_are() -> None:
    asked: list[tuple[float, float]] = []

    def script(setting: Setting, *_: Any) -> Measures:
        asked.append((setting["count"], setting["colour"]))
        return {"value_N": -abs(setting["count"] - 4) + 3 * (setting["colour"] == 2)}

    (row,) = rows(scripted(script, factors=(COUNT, COLOUR), search=WORST))
    assert (row["worst_count_1"], row["worst_colour_choice"], row["worst_value_N"]) == (4, 2, 3)
    assert {count for count, _ in asked} == {0, 1, 2, 3, 4, 5, 6}
    assert {colour for _, colour in asked} == {0, 1, 2}


def test_a_search_repeats_whatever_was_searched_before() -> None:
    study = scripted(hill, factors=(X, Y), search=WORST, repeats=3, controllers=("one", "two"))
    whole = rows(study)
    assert whole == rows(study)
    tasks = list(Plan(study, 0))
    shuffled = random.Random(0).sample(tasks, len(tasks))
    again = {task.identity: roll_out(study, task).row for task in shuffled}
    assert [{**again[row["identity"]], "elapsed_s": 0} for row in whole] == [
        {**row, "elapsed_s": 0} for row in whole
    ]


def test_repeats_search_from_other_seeds_and_controllers_from_the_same() -> None:
    study = scripted(hill, factors=(X, Y), search=WORST, repeats=3, controllers=("one", "two"))
    found = [(row["repeat"], row["controller"], row["worst_x_1"]) for row in rows(study)]
    assert [(repeat, name) for repeat, name, _ in found] == [
        (repeat, name) for repeat in range(3) for name in ("one", "two")
    ]
    assert len({x for _, _, x in found}) == 3
    assert [x for _, name, x in found if name == "one"] == [x for *_, x in found[1::2]]


@pytest.mark.parametrize("kind", ["diverged", "lost"])
def test_a_rollout_that_is_lost_is_the_worst_of_all_and_ends_the_search(kind: str) -> None:
    def script(setting: Setting, *_: Any) -> Measures:
        if setting["x"] < -5:
            if kind == "diverged":
                return diverge(setting, "", 0)
            return {"value_N": 1.0, "longest_loss_ms": 80.0}
        return {"value_N": 100.0}

    study = scripted(script, factors=(X,), search=WORST)
    (row,) = rows(study)
    assert row["outcome"] == kind
    assert row["worst_x_1"] < -5
    assert row["worst_value_N"] == (1.0 if kind == "lost" else None)
    assert row["reason"] == ("left all bounds" if kind == "diverged" else "")
    assert row["rollouts"] == len(study.system.calls) < 64


def test_the_outcome_is_that_of_the_worst_rollout() -> None:
    def script(setting: Setting, *_: Any) -> Measures:
        return {"value_N": setting["x"], "fallback_ticks": float(setting["x"] > 9)}

    (row,) = rows(scripted(script, factors=(X,), search=WORST))
    assert row["worst_value_N"] > 9
    assert row["outcome"] == "degraded"


def test_rollouts_without_the_measure_are_passed_over() -> None:
    def script(setting: Setting, *_: Any) -> Measures:
        return {"value_N": None if setting["x"] > 0 else setting["x"]}

    (row,) = rows(scripted(script, factors=(X,), search=WORST))
    assert -0.5 < row["worst_value_N"] == row["worst_x_1"] <= 0
    (row,) = rows(scripted(lambda *_: {}, factors=(X,), search=WORST))
    assert (row["worst_value_N"], row["worst_x_1"]) == (None, None)
    assert (row["outcome"], row["reason"]) == ("ok", "no rollout has value_N")


def test_a_search_says_nothing_on_the_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    rows(scripted(hill, factors=(X, Y), search=Worst(measure="value_N", trials=20)))
    assert capfd.readouterr() == ("", "")


def test_without_the_optimiser_a_study_is_refused_before_it_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    normal = builtins.__import__

    def lacking(name: str, *more: Any) -> Any:
        if name == "optuna":
            raise ImportError(name)
        return normal(name, *more)

    study = scripted(hill, factors=(X, Y), search=WORST)
    monkeypatch.setattr(builtins, "__import__", lacking)
    with pytest.raises(InputError, match=r"needs the extra: pip install 'qpctrl\[studies\]'"):
        Plan(study, 0)
