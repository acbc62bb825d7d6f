"""A study whose processes are killed at random moments ends as an undisturbed one.

Moments are seeded shares of the time that the undisturbed study took to its first rows, so that
they fall into every phase - start, first rows, writing - on a fast machine and on a slow one.
"""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import polars as pl
import pytest

from scenarios.study.campaign import status
from scenarios.study.rollout import TIMING
from scenarios.study.store import chunk_files

QPCTRL = Path(sys.executable).parent / "qpctrl"
STUDY = ("--size", "8", "--controllers", "qp", "textbook", "--traces", "2")
ROWS, TRACES = 16, 4
KILLS, THIRD = 10, 3
PATIENCE = 120.0  # s
LOOK = 0.01  # s


class Undisturbed(NamedTuple):
    """What a study leaves that nobody kills."""

    table: pl.DataFrame
    traces: list[str]
    first: float
    """Time to its first rows [s]."""


def start(folder: Path) -> "subprocess.Popen[bytes]":
    """Return a study that has been started, or goes on, in ``folder``."""
    command = [QPCTRL, "study", "tilt", *STUDY, "--out", folder, "--resume"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until something holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(LOOK)


def wait_for_rows(folder: Path, running: "subprocess.Popen[bytes]") -> None:
    """Wait until there are more rows than now, or the study is over."""
    before = len(chunk_files(folder))
    wait_for(lambda: len(chunk_files(folder)) > before or running.poll() is not None)


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


def table_of(folder: Path) -> pl.DataFrame:
    """Return the rows in a folder, sorted, without timing."""
    return pl.read_parquet(folder / "chunks" / "*.parquet").drop(TIMING).sort("identity")


def traces_of(folder: Path) -> list[str]:
    """Return the names of the traces in a folder, all of which can be read."""
    files = sorted((folder / "traces").iterdir())
    assert all(len(pl.read_parquet(path)) > 0 for path in files)
    return [path.name for path in files]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    folder, started = tmp_path_factory.mktemp("undisturbed"), time.monotonic()
    running = start(folder)
    wait_for_rows(folder, running)
    first = time.monotonic() - started
    assert running.wait(PATIENCE) == 0
    found = Undisturbed(table_of(folder), traces_of(folder), first)
    assert (len(found.table), len(found.traces)) == (ROWS, TRACES)
    return found


def check_the_same(folder: Path, undisturbed: Undisturbed) -> None:
    """Assert that no row is lost, none twice, and all numbers are the same."""
    assert status(folder)[:3] == ("tilt", ROWS, ROWS)
    assert table_of(folder).equals(undisturbed.table)
    assert traces_of(folder) == undisturbed.traces


def test_a_study_killed_again_and_again_ends_as_an_undisturbed_one(
    tmp_path: Path, undisturbed: Undisturbed
) -> None:
    moment, seen = random.Random(1), [0]
    for kill in range(KILLS):
        running = start(tmp_path)
        if kill % THIRD == 2:  # while rows are made and written
            wait_for_rows(tmp_path, running)
            time.sleep(moment.uniform(0.0, 0.1) * undisturbed.first)
        else:
            time.sleep(moment.uniform(0.0, 1.0) * undisturbed.first)
        workers = workers_of(running.pid)
        assert running.poll() is None
        running.send_signal(signal.SIGKILL)
        running.wait()
        wait_for(lambda ended=workers: not any(alive(pid) for pid in ended))
        seen.append(status(tmp_path).done if (tmp_path / "study.json").exists() else 0)
    assert seen == sorted(seen)
    assert 0 < seen[3] < seen[-1] < ROWS  # there was something to lose, and something to do
    assert start(tmp_path).wait(PATIENCE) == 0
    check_the_same(tmp_path, undisturbed)


def test_a_study_whose_workers_are_killed_ends_as_an_undisturbed_one(
    tmp_path: Path, undisturbed: Undisturbed
) -> None:
    moment, running, killed = random.Random(2), start(tmp_path), set[int]()
    for kill in range(KILLS):
        if kill % THIRD == 2:
            wait_for_rows(tmp_path, running)
        wait_for(lambda: bool(set(workers_of(running.pid)) - killed))
        time.sleep(moment.uniform(0.0, 0.2) * undisturbed.first)
        victim = moment.choice(sorted(set(workers_of(running.pid)) - killed))
        assert running.poll() is None
        os.kill(victim, signal.SIGKILL)
        killed.add(victim)
    assert len(killed) == KILLS
    assert running.wait(PATIENCE) == 0
    check_the_same(tmp_path, undisturbed)
