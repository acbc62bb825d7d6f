"""A study from its plan to its results: missing rows are made, finished ones are kept."""

import contextlib
import functools
import itertools
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from scenarios.scenario import Criterion
from scenarios.study.machine import Machine
from scenarios.study.page import render_study
from scenarios.study.plan import Plan, Task
from scenarios.study.rollout import Made, Tracing, roll_out_all
from scenarios.study.store import (
    Store,
    json_text,
    open_store,
    read_done,
    read_manifest,
    write_text,
)
from scenarios.study.summary import conclude

LARGEST_CHUNK = 64
CHUNKS_FOR_EACH = 32  # worker, so that all of them end at about the same time


class Campaign(NamedTuple):
    """A finished study."""

    plan: Plan
    table: pl.DataFrame
    """One row a rollout, in the order of the plan."""
    summary: dict[str, Any]
    """What summary.json holds."""
    criteria: tuple[Criterion, ...]

    @property
    def passed(self) -> bool:
        """Whether every criterion of the study holds."""
        return all(criterion.passed for criterion in self.criteria)


class Progress(NamedTuple):
    """How far a folder is."""

    study: str
    done: int
    rows: int
    outcomes: Counter[str]
    """Rows by class of outcome."""


class Timing(NamedTuple):
    """How long it took."""

    made: int
    """Rows that were made."""
    elapsed: float
    """[s]."""
    workers: int


def run_study(
    plan: Plan,
    machine: Machine,
    folder: Path,
    *,
    resume: bool = False,
    tracing: Tracing = Tracing(),  # noqa: B008
    watch: Callable[[Progress], None] | None = None,
) -> Campaign:
    """Make the rollouts that are missing in ``folder``, and judge them all.

    Leaves study.json, chunks/*.parquet, traces/*.parquet, summary.json and report.html.

    Args:
        plan: the rollouts.
        machine: where they run.
        folder: for the results.
        resume: whether the folder may hold results already.
        tracing: of which rollouts every tick is kept.
        watch: called at the start and for each chunk.

    Raises:
        InputError: the folder cannot be used or written; finished chunks stay valid.
    """
    with open_store(folder, plan, resume=resume) as store:
        started, rows = time.perf_counter(), store.done()
        done = frozenset(rows["identity"])
        progress = Progress(plan.study.name, len(done), len(plan), Counter(rows["outcome"]))
        missing = (task for task in plan if task.identity not in done)
        work = functools.partial(roll_out_all, plan.study, tracing, plan.code["source"])
        if watch is not None:
            watch(progress)
        chunks = _chunks(missing, len(plan) - len(done), machine.workers)
        with contextlib.closing(_generator(machine.run(work, chunks))) as made:
            for rollouts in made:
                store.add(rollouts)
                progress.outcomes.update(r.row["outcome"] for r in rollouts)
                progress = progress._replace(done=progress.done + len(rollouts))
                if watch is not None:
                    watch(progress)
        timing = Timing(len(plan) - len(done), time.perf_counter() - started, machine.workers)
        return _conclude(store, timing)


def status(folder: Path) -> Progress:
    """Return how many rows of how many are in ``folder``.

    Raises:
        InputError: it holds no study, or a file that cannot be read.
    """
    manifest = read_manifest(folder)
    rows = read_done(folder)
    return Progress(str(manifest["study"]), len(rows), manifest["rows"], Counter(rows["outcome"]))


def _chunks(missing: Iterable[Task], count: int, workers: int) -> Iterator[tuple[Task, ...]]:
    """Return the missing tasks in chunks."""
    size = min(max(count // (CHUNKS_FOR_EACH * max(workers, 1)), 1), LARGEST_CHUNK)
    rest = iter(missing)
    return iter(lambda: tuple(itertools.islice(rest, size)), ())


def _generator(made: Iterator[list[Made]]) -> Generator[list[Made], None, None]:
    yield from made


def _conclude(store: Store, timing: Timing) -> Campaign:
    """Write the summary and the report of a finished study."""
    plan, table = store.plan, store.table()
    took = {
        "rows_made": timing.made,
        "elapsed_s": timing.elapsed,
        "rows_per_s": timing.made / timing.elapsed,
        "rollout_s_sum": float(table["elapsed_s"].sum()),
        "workers": timing.workers,
    }
    criteria, summary = conclude(plan.study, plan.manifest(), table, took)
    write_text(store.folder / "summary.json", json_text(summary))
    write_text(store.folder / "report.html", render_study(plan.study, table, criteria, summary))
    return Campaign(plan, table, summary, criteria)
