"""The plan of a study: identities, seeds, and that it holds no tasks."""

import itertools
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scripted import X, Y, scripted

import scenarios
from qpctrl import InputError
from scenarios.study import plan as plan_module
from scenarios.study.design import Design
from scenarios.study.factor import Factor
from scenarios.study.plan import Plan, code_version
from scenarios.study.search import Worst
from scenarios.study.study import Limit

MEBIBYTE = 1 << 20


def identities(seed: int = 0, **of: Any) -> list[str]:
    """Return the identities of the rollouts of a scripted study."""
    return [task.identity for task in Plan(scripted(**of), seed)]


def test_every_rollout_has_its_place_controller_and_repeat() -> None:
    plan = Plan(scripted(controllers=("two", "one"), repeats=2, design=Design(size=3)), seed=4)
    found = [(task.row, task.repeat, task.point, task.controller) for task in plan]
    points = enumerate([(-10.0,), (0.0,), (10.0,)])
    each = itertools.product(points, (0, 1), ("two", "one"))
    assert found == [(row, repeat, point, name) for (row, point), repeat, name in each]
    assert len(plan) == len({task.identity for task in plan}) == 12


@pytest.mark.parametrize(
    ("kind", "size", "groups"),
    [("levels", 5, 1), ("map", 5, 1), ("sobol", 8, 8), ("indices", 8, 8), ("morris", 4, 4)],
)
def test_controllers_and_rows_that_are_compared_share_their_random_numbers(
    kind: str, size: int, groups: int
) -> None:
    """A row that differs in one factor must not differ in its random numbers, too."""
    design = Design(kind=kind, size=size)  # type: ignore[arg-type]
    tasks = list(Plan(scripted(controllers=("one", "two"), repeats=2, design=design), seed=4))
    seeds = [task.seed for task in tasks]
    assert seeds[::2] == seeds[1::2]
    of = np.array(seeds).reshape(groups, -1, 2, 2)  # group, row of it, repeat, controller
    assert (of == of[:, :1]).all()
    assert len(set(seeds)) == 2 * groups
    assert not set(seeds) & {task.seed for task in Plan(scripted(repeats=2), seed=5)}


CHANGES: list[dict[str, Any]] = [
    {"seed": 1},
    {"controllers": ("two",)},
    {"fixed": {"y": 0.2}},
    {"design": Design(size=4)},
    {"design": Design(kind="sobol", size=8)},
    {"factors": (Factor("x", "1", -10.0, 9.0),)},
    {"repeats": 2},
]


@pytest.mark.parametrize("change", CHANGES, ids=str)
def test_identities_hang_on_all_that_a_result_depends_on(change: dict[str, Any]) -> None:
    base = identities()
    assert base == identities()
    assert not set(base) & set(identities(**change))


def test_identities_do_not_hang_on_how_rows_are_read() -> None:
    reading = {"criteria": (Limit(measure="value_N", limit=1.0),), "show": ("value_N",)}
    assert identities() == identities(**reading)


@pytest.mark.parametrize("package", ["source", "numpy"])
def test_identities_hang_on_the_code(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    base, code = identities(), code_version()
    monkeypatch.setattr(plan_module, "code_version", lambda: {**code, package: "other"})
    assert not set(base) & set(identities())


def test_rollouts_of_one_point_are_told_apart_even_if_their_seeds_are_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of 10⁶ rollouts a hundred pairs share a seed of 32 bits; some have one point, or none."""
    same = np.random.SeedSequence(0)
    monkeypatch.setattr(np.random, "SeedSequence", lambda _: same)
    levels = identities(factors=(X, Y), design=Design(size=3))  # the middle of both is there twice
    searches = identities(search=Worst(measure="value_N"), repeats=50)
    assert (len(set(levels)), len(set(searches))) == (6, 50)


def test_the_code_is_that_of_models_and_drives_but_not_of_ready_made_studies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenarios, "__path__", [str(tmp_path)])
    seen = [code_version()["source"]]
    for name in ("a.py", "b.xml", "c.toml", "sub/a.py", "sub/d.toml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("x")
        seen.append(code_version()["source"])
    (tmp_path / "a.py").write_text("y")
    seen.append(code_version()["source"])
    assert len(set(seen)) == 7
    (tmp_path / "ready").mkdir()
    (tmp_path / "ready" / "mine.toml").write_text("x")
    (tmp_path / "page.html").write_text("x")
    assert code_version()["source"] == seen[-1]


def test_the_versions_are_those_that_decide_on_the_points() -> None:
    assert "scipy" in Plan(scripted(), 0).code
    assert not {"optuna", "SALib"} & Plan(scripted(), 0).code.keys()
    assert "SALib" in Plan(scripted(design=Design(kind="morris", size=4)), 0).code
    assert "optuna" in Plan(scripted(search=Worst(measure="value_N")), 0).code


@pytest.mark.parametrize("seed", [-1, 1 << 32])
def test_a_seed_that_not_every_library_takes_is_refused(seed: int) -> None:
    with pytest.raises(InputError, match=f"seed: got {seed}, need a number >= 0 and < 4294967296"):
        Plan(scripted(), seed)


def test_a_plan_of_a_million_rollouts_holds_no_tasks() -> None:
    tracemalloc.start()
    plan = Plan(scripted(controllers=("one", "two"), repeats=50, design=Design(size=10_000)), 0)
    some = itertools.islice(plan, 20_000)
    last = np.max([task.row for task in some])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (len(plan), last) == (1_000_000, 199)
    assert peak < 4 * MEBIBYTE
