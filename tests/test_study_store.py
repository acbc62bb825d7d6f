"""A study's folder: what is finished stays, what is missing is made, once; whoever is killed."""

import errno
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import polars as pl
import pytest

from qpctrl import InputError
from qpctrl.arrays import Matrix
from scenarios.scenario import Criterion
from scenarios.study.campaign import run_study, status
from scenarios.study.factor import Factor
from scenarios.study.machine import Here, MachineError, ProcessPool
from scenarios.study.rollout import TIMING
from scenarios.study.store import chunk_files, open_store
from scenarios.study.study import Plan, plan_study

QPCTRL = Path(sys.executable).parent / "qpctrl"
STUDY = ("--levels", "8", "--controllers", "qp", "textbook")
ROWS = 16
PATIENCE = 60.0  # s

calls: list[float] = []
"""Points that rollouts of `Squares` were made at."""


@dataclass(frozen=True, kw_only=True)
class Squares:
    """A study that is done in no time."""

    name: ClassVar[str] = "squares"
    summary: ClassVar[str] = "squares of numbers"
    controllers: ClassVar[tuple[str, ...]] = ("qp",)
    measures: ClassVar[tuple[str, ...]] = ("square",)
    shown: ClassVar[dict[str, str]] = {"square": "square"}
    factors: ClassVar[tuple[Factor, ...]] = (Factor("x", "1", -1.0, 1.0),)
    size: int = 40

    def design(self, seed: int) -> Matrix:
        """Return numbers from −1 to 1."""
        return np.linspace(-1, 1, self.size)[:, None]

    def run(self, point: dict[str, float], controller: str, seed: int) -> dict[str, float]:
        """Return the square; note the call."""
        calls.append(point["x"])
        return {"square": point["x"] ** 2}

    def judge(self, table: pl.DataFrame) -> tuple[Criterion, ...]:
        """Return that all rows are there."""
        return (Criterion("missing", float(self.size - len(table)), 0.0, "rows"),)

    def panels(self, table: pl.DataFrame) -> tuple[()]:
        """Return no picture."""
        return ()


@pytest.fixture
def plan() -> Plan:
    calls.clear()
    return plan_study(Squares(), 0)


def table_of(folder: Path) -> pl.DataFrame:
    """Return the rows in a folder, sorted, without timing."""
    return pl.read_parquet(folder / "chunks" / "*.parquet").drop(TIMING).sort("identity")


# In one process ------------------------------------------------------------------------------


def test_all_rows_are_there_in_the_order_of_the_plan(plan: Plan, tmp_path: Path) -> None:
    found = run_study(plan, Here(), tmp_path)
    assert found.passed
    assert found.table["identity"].to_list() == [task.identity for task in plan.tasks]
    assert found.table["square"].to_numpy() == pytest.approx(np.linspace(-1, 1, 40) ** 2)
    assert status(tmp_path) == ("squares", 40, 40)


def test_what_is_missing_is_made_and_nothing_else(plan: Plan, tmp_path: Path) -> None:
    whole = run_study(plan, Here(), tmp_path).table.drop(TIMING)
    gone = [chunk_files(tmp_path)[i] for i in (1, 4, 5)]
    missing = sorted(x for path in gone for x in pl.read_parquet(path)["x_1"])
    for path in gone:
        path.unlink()
    assert status(tmp_path).done == 40 - len(missing)
    calls.clear()
    assert run_study(plan, Here(), tmp_path, resume=True).table.drop(TIMING).equals(whole)
    assert sorted(calls) == missing
    calls.clear()
    run_study(plan, Here(), tmp_path, resume=True)
    assert not calls


def test_a_folder_with_results_is_not_touched_unless_asked(plan: Plan, tmp_path: Path) -> None:
    run_study(plan, Here(), tmp_path)
    with pytest.raises(InputError, match="holds results of this study; go on with --resume"):
        run_study(plan, Here(), tmp_path)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (lambda plan: plan_study(Squares(size=39), 0), "configuration.size is 40 there and 39"),
        (lambda plan: plan_study(Squares(), 1), "seed is 0 there and 1 here"),
        (lambda plan: plan._replace(code=plan.code | {"numpy": "0.1"}), "code.numpy is '.*' there"),
        (lambda plan: plan._replace(code=plan.code | {"source": "x"}), "code.source is '.*' there"),
    ],
)
def test_results_of_something_else_are_refused(
    other: Callable[[Plan], Plan], said: str, plan: Plan, tmp_path: Path
) -> None:
    run_study(plan, Here(), tmp_path)
    with pytest.raises(InputError, match=f"holds another study: {said}"):
        run_study(other(plan), Here(), tmp_path, resume=True)


def test_a_folder_of_anything_else_is_refused_and_left_alone(plan: Plan, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("long")
    with pytest.raises(InputError, match="is not empty and holds no study"):
        run_study(plan, Here(), tmp_path, resume=True)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_two_cannot_write_one_folder(plan: Plan, tmp_path: Path) -> None:
    with (
        open_store(tmp_path, plan, resume=False),
        pytest.raises(InputError, match="is in use by another process"),
    ):
        run_study(plan, Here(), tmp_path, resume=True)


def test_unfinished_and_broken_files(plan: Plan, tmp_path: Path) -> None:
    run_study(plan, Here(), tmp_path)
    left = tmp_path / "chunks" / ".writing-abc.parquet"
    left.write_bytes(b"half a ch")
    assert status(tmp_path).done == 40
    run_study(plan, Here(), tmp_path, resume=True)
    assert not left.exists()
    chunk_files(tmp_path)[0].write_bytes(b"not a table")
    with pytest.raises(InputError, match=r"cannot be read .*remove it and go on with --resume"):
        run_study(plan, Here(), tmp_path, resume=True)


def test_a_row_that_is_there_twice_is_noticed(plan: Plan, tmp_path: Path) -> None:
    run_study(plan, Here(), tmp_path)
    first = chunk_files(tmp_path)[0]
    first.with_name("copy.parquet").write_bytes(first.read_bytes())
    with pytest.raises(InputError, match="rows are twice"):
        status(tmp_path)


def test_a_full_disk_is_one_line_and_finished_chunks_stay(
    plan: Plan, tmp_path: Path, monkeypatch
) -> None:
    written = pl.DataFrame.write_parquet

    def fill(self: pl.DataFrame, file: Any, **more: Any) -> None:
        if len(chunk_files(tmp_path)) == 3:
            Path(file).write_bytes(b"part")
            raise OSError(errno.ENOSPC, "No space left on device")
        written(self, file, **more)

    monkeypatch.setattr(pl.DataFrame, "write_parquet", fill)
    with pytest.raises(InputError, match="cannot be written: No space left on device"):
        run_study(plan, Here(), tmp_path)
    monkeypatch.undo()
    assert len(list((tmp_path / "chunks").iterdir())) == 3
    assert 0 < status(tmp_path).done < 40
    assert run_study(plan, Here(), tmp_path, resume=True).passed


# Processes that die --------------------------------------------------------------------------


def test_workers_that_always_die_end_the_study_in_one_line() -> None:
    with pytest.raises(MachineError, match="workers died 5 times in a row"):
        list(ProcessPool(1).run(os._exit, [3]))


def test_chunks_are_taken_only_as_workers_need_them() -> None:
    taken: list[int] = []

    def chunks():
        for i in range(50):
            taken.append(i)
            yield -i

    results = ProcessPool(2).run(abs, chunks())
    first = [next(results) for _ in range(3)]
    assert len(taken) <= 3 + 2 * 2
    assert sorted([*first, *results]) == list(range(50))


def start(folder: Path) -> "subprocess.Popen[bytes]":
    """Return a study that has been started, or goes on, in ``folder``."""
    command = [QPCTRL, "study", "tilt", *STUDY, "--out", folder, "--resume"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until something holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def workers_of(pid: int) -> list[int]:
    """Return the processes that work for ``pid``."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return [
            int(p) for p in children if b"spawn_main" in Path(f"/proc/{p}/cmdline").read_bytes()
        ]
    except FileNotFoundError:
        return []


def alive(pid: int) -> bool:
    """Return whether a process runs, and is not just waiting to be buried."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> pl.DataFrame:
    folder = tmp_path_factory.mktemp("undisturbed")
    assert start(folder).wait(PATIENCE) == 0
    table = table_of(folder)
    assert len(table) == ROWS
    return table


def test_a_study_killed_again_and_again_ends_as_an_undisturbed_one(
    tmp_path: Path, undisturbed: pl.DataFrame
) -> None:
    moment, seen = random.Random(1), []
    for rows in (0, 2, 1, 3):
        before, running = len(chunk_files(tmp_path)), start(tmp_path)
        wait_for(lambda b=before, r=rows: len(chunk_files(tmp_path)) >= b + r)
        time.sleep(moment.uniform(0.0, 0.5))
        workers = workers_of(running.pid)
        running.send_signal(signal.SIGKILL)
        running.wait()
        wait_for(lambda ended=workers: not any(alive(pid) for pid in ended))
        seen.append(status(tmp_path).done if (tmp_path / "study.json").exists() else 0)
    assert seen == sorted(seen)
    assert 0 < seen[1] < seen[-1] < ROWS  # there was something to lose, and something to do
    assert start(tmp_path).wait(PATIENCE) == 0
    assert status(tmp_path) == ("tilt", ROWS, ROWS)
    assert table_of(tmp_path).equals(undisturbed)


def test_a_study_whose_workers_are_killed_ends_as_an_undisturbed_one(
    tmp_path: Path, undisturbed: pl.DataFrame
) -> None:
    moment, running = random.Random(2), start(tmp_path)
    for rows in (1, 5):
        wait_for(lambda r=rows: len(chunk_files(tmp_path)) >= r)
        time.sleep(moment.uniform(0.0, 0.3))
        os.kill(moment.choice(workers_of(running.pid)), signal.SIGKILL)
    assert running.wait(PATIENCE) == 0
    assert table_of(tmp_path).equals(undisturbed)
