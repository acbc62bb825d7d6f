"""A study's folder: what is finished stays, what is missing is made, once."""

import builtins
import errno
import itertools
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from scripted import Scripted, diverge, scripted

from qpctrl import InputError
from scenarios.study import campaign
from scenarios.study import plan as plan_module
from scenarios.study.campaign import run_study, status
from scenarios.study.design import Design
from scenarios.study.machine import Here, MachineError, ProcessPool
from scenarios.study.plan import Plan, code_version
from scenarios.study.query import query
from scenarios.study.rollout import TIMING, Tracing
from scenarios.study.store import chunk_files, open_store, read_manifest
from scenarios.study.study import Limit

ROWS = 40
POSITIVE = Limit(measure="value_N", limit=100.0)


def calls(plan: Plan) -> list[float]:
    """Return where rollouts were made, and forget it."""
    system = plan.study.system
    assert isinstance(system, Scripted)
    made = [setting["x"] for setting, _, _ in system.calls]
    system.calls.clear()
    return made


def squares(size: int = ROWS, seed: int = 0) -> Plan:
    """Return a plan that is done in no time."""
    return Plan(scripted(design=Design(size=size), criteria=(POSITIVE,)), seed)


@pytest.fixture(autouse=True)
def few_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make eight chunks for each worker, five rows each."""
    monkeypatch.setattr(campaign, "CHUNKS_FOR_EACH", 8)


@pytest.fixture
def plan() -> Plan:
    return squares()


def test_all_rows_are_there_in_the_order_of_the_plan(tmp_path: Path) -> None:
    study = scripted(controllers=("two", "one"), repeats=2, design=Design(size=10))
    plan = Plan(study, 0)
    found = run_study(plan, Here(), tmp_path)
    assert found.table["identity"].to_list() == [task.identity for task in plan]
    expected = np.repeat(np.linspace(-10, 10, 10) ** 2, 4)
    assert found.table["value_N"].to_numpy() == pytest.approx(expected)
    assert len(chunk_files(tmp_path)) == 8  # as many as keep all workers busy to the end
    assert status(tmp_path) == ("squares", ROWS, ROWS, {"ok": ROWS})


def test_what_is_missing_is_made_and_nothing_else(plan: Plan, tmp_path: Path) -> None:
    whole = run_study(plan, Here(), tmp_path).table.drop(TIMING)
    gone = [chunk_files(tmp_path)[i] for i in (1, 4, 5)]
    missing = sorted(x for path in gone for x in pl.read_parquet(path)["x_1"])
    for path in gone:
        path.unlink()
    assert status(tmp_path).done == ROWS - len(missing)
    calls(plan)
    assert run_study(plan, Here(), tmp_path, resume=True).table.drop(TIMING).equals(whole)
    assert sorted(calls(plan)) == missing
    run_study(plan, Here(), tmp_path, resume=True)
    assert not calls(plan)


def test_progress_counts_what_was_there_before(plan: Plan, tmp_path: Path) -> None:
    run_study(plan, Here(), tmp_path)
    for path in chunk_files(tmp_path)[:2]:
        path.unlink()
    seen: list[tuple[int, int]] = []
    run_study(
        plan,
        Here(),
        tmp_path,
        resume=True,
        watch=lambda now: seen.append((now.done, now.outcomes["ok"])),
    )
    assert seen[0][0] < ROWS
    assert [done for done, _ in seen] == sorted({done for done, _ in seen})
    assert all(done == ok for done, ok in seen)
    assert seen[-1] == (ROWS, ROWS)


def test_a_study_passes_by_its_criteria_on_the_rows_that_have_the_measure(tmp_path: Path) -> None:
    def script(setting: Any, *_: Any) -> Any:
        return diverge(setting, "", 0) if setting["x"] > 5 else {"value_N": setting["x"]}

    limits = [("value_N", 5.0, "max"), ("value_N", -2.5, "mean"), ("diverged", 0.2, "max")]
    criteria = tuple(Limit(measure=m, limit=v, statistic=s) for m, v, s in limits)  # type: ignore[arg-type]
    found = run_study(Plan(scripted(script, criteria=criteria), 0), Here(), tmp_path)
    assert [c.value for c in found.criteria] == pytest.approx([5.0, -2.5, 0.2])
    assert [c.passed for c in found.criteria] == [True, True, True]
    assert found.passed
    none = Limit(measure="fallback_ticks", limit=1.0)
    again = run_study(Plan(scripted(criteria=(none,)), 0), Here(), tmp_path / "none")
    assert not again.passed  # no rollout has it
    assert again.summary["criteria"][0]["value"] is None


def test_a_folder_with_results_is_not_touched_unless_asked(plan: Plan, tmp_path: Path) -> None:
    run_study(plan, Here(), tmp_path)
    with pytest.raises(InputError, match="holds results of this study; go on with --resume"):
        run_study(plan, Here(), tmp_path)


def other(package: str) -> Callable[[pytest.MonkeyPatch], Plan]:
    """Return what makes a plan of another version of the code."""

    def make(patch: pytest.MonkeyPatch) -> Plan:
        code = {**code_version(), package: "0.1"}
        patch.setattr(plan_module, "code_version", lambda: code)
        return squares()

    return make


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda _: squares(39), "configuration.design.size is 40 there and 39 here"),
        (lambda _: squares(seed=1), "seed is 0 there and 1 here"),
        (
            lambda _: Plan(
                scripted(design=Design(size=40), criteria=(POSITIVE,), fixed={"y": 1}), 0
            ),
            "configuration.fixed.y is None there and 1 here",
        ),
        (other("numpy"), "code.numpy is '.*' there and '0.1' here"),
        (other("source"), "code.source is '.*' there and '0.1' here"),
    ],
)
def test_results_of_something_else_are_refused_by_the_first_difference(
    make: Callable[[pytest.MonkeyPatch], Plan],
    said: str,
    plan: Plan,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run_study(plan, Here(), tmp_path)
    with pytest.raises(InputError, match=f"holds another study: {said}; give another --out"):
        run_study(make(monkeypatch), Here(), tmp_path, resume=True)


def test_new_criteria_judge_the_rows_that_are_there(plan: Plan, tmp_path: Path) -> None:
    run_study(plan, Here(), tmp_path)
    limit = Limit(measure="value_N", limit=-1.0, statistic="min")
    stricter = Plan(scripted(design=Design(size=ROWS), criteria=(limit,)), 0)
    found = run_study(stricter, Here(), tmp_path, resume=True)
    assert (found.summary["timing"]["rows_made"], found.passed) == (0, False)
    assert read_manifest(tmp_path)["configuration"]["criteria"][0]["statistic"] == "min"


def test_a_gap_that_is_missing_where_its_closed_form_is_known_misses_every_limit() -> None:
    limit, known = Limit(measure="x_gap", limit=1.0), pl.Series("x_closed", [1.0, 1.0, None])
    good = pl.DataFrame({"x_gap": [0.1, 0.2, None], "outcome": ["ok"] * 3}).with_columns(known)
    assert limit.judge(good).value == 0.2
    assert not limit.judge(good.with_columns(x_gap=pl.lit(None, dtype=pl.Float64))).passed
    assert not limit.judge(good.with_columns(x_gap=pl.Series([0.1, None, None]))).passed


def test_a_rollout_that_diverged_misses_every_limit_unless_some_may() -> None:
    rows = pl.DataFrame({"value_N": [1.0, None], "outcome": ["ok", "diverged"]})
    value, some = Limit(measure="value_N", limit=2.0), Limit(measure="diverged", limit=0.5)
    none = replace(some, limit=0.0)
    for limits in ((value,), (value, none)):
        assert not any(c.passed for c in scripted(criteria=limits).judge(rows))
    assert [c.passed for c in scripted(criteria=(value, some)).judge(rows)] == [True, True]


@pytest.mark.parametrize("name", ["thesis.tex", "chunks"])
def test_a_folder_of_anything_else_is_refused_and_left_alone(
    name: str, plan: Plan, tmp_path: Path
) -> None:
    (tmp_path / name).mkdir()
    with pytest.raises(InputError, match="is not empty and holds no study"):
        run_study(plan, Here(), tmp_path, resume=True)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("text", ["", "[]", '{"study": "a"}', '{"study": 1, "rows": "x"}'])
def test_a_broken_manifest_is_refused(text: str, plan: Plan, tmp_path: Path) -> None:
    (tmp_path / "study.json").write_text(text)
    for refused in (lambda: run_study(plan, Here(), tmp_path), lambda: status(tmp_path)):
        with pytest.raises(InputError, match=r"study.json' (cannot be read|is not that of)"):
            refused()


def test_two_cannot_write_one_folder(plan: Plan, tmp_path: Path) -> None:
    with (
        open_store(tmp_path, plan, resume=False),
        pytest.raises(InputError, match="is in use by another process"),
    ):
        run_study(plan, Here(), tmp_path, resume=True)
    assert run_study(plan, Here(), tmp_path, resume=True).passed


def test_a_system_that_cannot_lock_is_refused_in_one_line(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    normal = builtins.__import__

    def lacking(name: str, *more: Any) -> Any:
        if name == "fcntl":
            raise ImportError(name)
        return normal(name, *more)

    monkeypatch.setattr(builtins, "__import__", lacking)
    with pytest.raises(InputError, match="need Linux or macOS"):
        run_study(plan, Here(), tmp_path)


def test_unfinished_and_broken_files(plan: Plan, tmp_path: Path) -> None:
    run_study(plan, Here(), tmp_path)
    left = tmp_path / "chunks" / ".writing-abc.parquet"
    left.write_bytes(b"half a ch")
    assert status(tmp_path).done == ROWS
    run_study(plan, Here(), tmp_path, resume=True)
    assert not left.exists()
    broken = chunk_files(tmp_path)[0]
    for content in (b"not a table", b""):
        broken.write_bytes(content)
        with pytest.raises(InputError, match=r"cannot be read .*remove it and go on with --resume"):
            run_study(plan, Here(), tmp_path, resume=True)
    broken.unlink()
    assert run_study(plan, Here(), tmp_path, resume=True).passed


def test_what_others_leave_in_deeper_folders_is_not_removed(plan: Plan, tmp_path: Path) -> None:
    theirs = tmp_path / ".cache" / ".writing-thesis"
    theirs.mkdir(parents=True)
    run_study(plan, Here(), tmp_path)
    assert theirs.is_dir()


def test_rows_that_are_there_twice_or_belong_to_another_study_are_noticed(
    plan: Plan, tmp_path: Path
) -> None:
    run_study(plan, Here(), tmp_path / "one")
    run_study(squares(seed=1), Here(), tmp_path / "other")
    first = chunk_files(tmp_path / "one")[0]
    copy = first.with_name("copy.parquet")
    copy.write_bytes(first.read_bytes())
    with pytest.raises(InputError, match="5 rows are twice"):
        status(tmp_path / "one")
    copy.write_bytes(chunk_files(tmp_path / "other")[0].read_bytes())
    with pytest.raises(InputError, match="holds 45 rows, need the 40 of this study and no others"):
        run_study(plan, Here(), tmp_path / "one", resume=True)


def test_a_machine_that_loses_a_chunk_is_noticed(plan: Plan, tmp_path: Path) -> None:
    class Forgetful(Here):
        def run(self, work: Callable[[Any], Any], chunks: Any) -> Iterator[Any]:
            yield from itertools.islice(super().run(work, chunks), 3)

    with pytest.raises(InputError, match="holds 15 rows, need the 40 of this study"):
        run_study(plan, Forgetful(), tmp_path)
    assert run_study(plan, Here(), tmp_path, resume=True).passed


# Disks ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("fails", [0, 3])
def test_a_full_disk_is_one_line_and_finished_chunks_stay(
    fails: int, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = pl.DataFrame.write_parquet

    def fill(self: pl.DataFrame, file: Any, **more: Any) -> None:
        if len(chunk_files(tmp_path)) == fails:
            Path(file).write_bytes(b"part")
            raise OSError(errno.ENOSPC, "No space left on device")
        written(self, file, **more)

    monkeypatch.setattr(pl.DataFrame, "write_parquet", fill)
    with pytest.raises(InputError, match="cannot be written: No space left on device"):
        run_study(plan, Here(), tmp_path)
    monkeypatch.undo()
    assert len(list((tmp_path / "chunks").iterdir())) == fails
    assert status(tmp_path).done == 5 * fails
    assert run_study(plan, Here(), tmp_path, resume=True).passed


def test_a_file_that_the_system_refuses_to_let_grow_is_one_line(plan: Plan, tmp_path: Path) -> None:
    """The limit lets study.json through and chunks, but not the page."""
    command = (
        "import sys; from test_study_store import squares, run_study, Here, Path;"
        "run_study(squares(), Here(), Path(sys.argv[1]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", command, tmp_path],
        cwd=Path(__file__).parent,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr.splitlines()[-1].endswith("cannot be written: File too large")
    assert status(tmp_path).done == ROWS
    assert run_study(plan, Here(), tmp_path, resume=True).passed


# Traces --------------------------------------------------------------------------------------


def test_traces_are_of_the_asked_rollouts_and_hold_all_ticks(tmp_path: Path) -> None:
    def script(setting: Any, *_: Any) -> Any:
        return diverge(setting, "", 0) if setting["x"] == 10 else {"value_N": 1.0}

    plan = Plan(scripted(script, controllers=("one", "two")), 0)
    run_study(plan, Here(), tmp_path, tracing=Tracing(rows=2, of=5, failures=True))
    wanted = [task for task in plan if task.row in (2, 4)]
    kept = {path.stem: pl.read_parquet(path) for path in (tmp_path / "traces").iterdir()}
    assert sorted(kept) == sorted(task.identity[:24] for task in wanted)
    # one that diverged has the ticks until then
    assert {len(kept[task.identity[:24]]) for task in wanted} == {3}
    assert kept[wanted[0].identity[:24]]["x"].to_list() == [0.0] * 3


def test_a_row_counts_as_done_only_when_its_trace_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The trace of the first chunk is on disk when its rows cannot be written."""

    def fail(self: pl.DataFrame, file: Any, **_: Any) -> None:
        if isinstance(file, Path):
            raise OSError(errno.ENOSPC, "No space left on device")
        written(self, file)

    written = pl.DataFrame.write_parquet
    monkeypatch.setattr(pl.DataFrame, "write_parquet", fail)
    with pytest.raises(InputError, match="No space left"):
        run_study(Plan(scripted(), 0), Here(), tmp_path, tracing=Tracing(rows=5, of=5))
    assert len(list((tmp_path / "traces").iterdir())) == 1
    assert status(tmp_path).done == 0


# Queries -------------------------------------------------------------------------------------


def test_a_query_sees_the_rows_in_order_and_changes_none(plan: Plan, tmp_path: Path) -> None:
    run_study(plan, Here(), tmp_path)
    found = query(tmp_path, "SELECT x_1, value_N AS squared FROM rows WHERE value_N > 80")
    x = np.linspace(-10, 10, ROWS)
    assert found["x_1"].to_numpy() == pytest.approx(x[x**2 > 80])
    assert found.columns == ["x_1", "squared"]
    for changing in ("DELETE FROM rows", "DROP TABLE rows", "", "SELEC x_1"):
        with pytest.raises(InputError, match="need a SELECT; rows are never changed"):
            query(tmp_path, changing)
    assert query(tmp_path, "SELECT count(*) AS n FROM rows")["n"].to_list() == [ROWS]


@pytest.mark.parametrize(
    ("sql", "said"),
    [
        ("SELECT valu FROM rows", 'unable to find column "valu"; valid columns: .*"value_N"'),
        ("SELECT x_1 FROM raws", "relation 'raws' was not found"),
        ("SELECT * FROM read_csv('other.csv')", "got read_csv"),
        ("SELECT sum(controller) FROM rows", "`sum` operation not supported for dtype `str`$"),
        ("SELECT 1; SELECT 2", "one .* statement"),
    ],
)
def test_a_query_that_cannot_be_run_is_refused_in_one_line(
    sql: str, said: str, plan: Plan, tmp_path: Path
) -> None:
    run_study(plan, Here(), tmp_path)
    with pytest.raises(InputError, match=f"^query: .*{said}"):
        query(tmp_path, sql)


def test_a_query_of_a_folder_without_rows_is_refused(plan: Plan, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no study"):
        query(tmp_path, "SELECT 1")
    with open_store(tmp_path, plan, resume=False):
        pass
    with pytest.raises(InputError, match="holds no rows yet"):
        query(tmp_path, "SELECT 1")


# Machines ------------------------------------------------------------------------------------


def test_workers_that_always_die_end_the_study_in_one_line() -> None:
    with pytest.raises(MachineError, match="workers died 5 times in a row"):
        list(ProcessPool(1).run(os._exit, [3]))


def test_chunks_are_taken_only_as_workers_need_them() -> None:
    taken: list[int] = []

    def chunks() -> Iterator[int]:
        for i in range(50):
            taken.append(i)
            yield -i

    results = ProcessPool(2).run(abs, chunks())
    first = [next(results) for _ in range(3)]
    assert len(taken) <= 3 + 2 * 2
    assert sorted([*first, *results]) == list(range(50))
