"""A study from its plan to its results: missing rows are made, finished ones are kept."""

import contextlib
import functools
import itertools
import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from scenarios.scenario import Criterion
from scenarios.study.machine import Machine
from scenarios.study.page import render_study
from scenarios.study.rollout import OutcomeClass, roll_out_all
from scenarios.study.store import (
    Store,
    chunk_files,
    json_text,
    open_store,
    read_identities,
    read_manifest,
    write_text,
)
from scenarios.study.study import Plan, Task

LARGEST_CHUNK = 64
CHUNKS_FOR_EACH = 8  # worker, so that all of them end at about the same time


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


def run_study(
    plan: Plan,
    machine: Machine,
    folder: Path,
    *,
    resume: bool = False,
    watch: Callable[[int, int], None] | None = None,
) -> Campaign:
    """Make the rollouts that are missing in ``folder``, and judge them all.

    Leaves study.json, chunks/*.parquet, summary.json and report.html.

    Args:
        plan: the rollouts.
        machine: where they run.
        folder: for the results.
        resume: whether the folder may hold results already.
        watch: called with rows that are there and rows in all, at the start and for each chunk.

    Raises:
        InputError: the folder cannot be used or written; finished chunks stay valid.
    """
    with open_store(folder, plan, resume=resume) as store:
        started, done = time.perf_counter(), store.done()
        missing = [task for task in plan.tasks if task.identity not in done]
        count = len(done)
        work = functools.partial(roll_out_all, plan.study)
        if watch is not None:
            watch(count, len(plan.tasks))
        with contextlib.closing(_made(machine, work, missing)) as made:
            for rows in made:
                store.add(rows)
                count += len(rows)
                if watch is not None:
                    watch(count, len(plan.tasks))
        elapsed = time.perf_counter() - started
        return _conclude(store, made=len(missing), elapsed=elapsed)


def status(folder: Path) -> Progress:
    """Return how many rows of how many are in ``folder``.

    Raises:
        InputError: it holds no study, or a file that cannot be read.
    """
    manifest = read_manifest(folder)
    done = read_identities(folder) if chunk_files(folder) else []
    return Progress(str(manifest["study"]), len(done), int(manifest["rows"]))


def _made(
    machine: Machine,
    work: Callable[[Sequence[Task]], list[dict[str, Any]]],
    missing: Sequence[Task],
) -> Generator[list[dict[str, Any]], None, None]:
    """Yield the rows of each chunk of the missing rollouts."""
    size = len(missing) // (CHUNKS_FOR_EACH * machine.workers)
    size = min(max(size, 1), LARGEST_CHUNK)
    rest = iter(missing)
    yield from machine.run(work, iter(lambda: tuple(itertools.islice(rest, size)), ()))


def _conclude(store: Store, *, made: int, elapsed: float) -> Campaign:
    plan, table = store.plan, store.table()
    criteria = plan.study.judge(table)
    columns = [f.column for f in plan.study.factors]
    kept = ["row", *columns, "controller", "outcome", "reason", *plan.study.measures]
    counts = dict(table["outcome"].value_counts().iter_rows())
    summary = {
        **plan.manifest(),
        "passed": all(c.passed for c in criteria),
        "criteria": [
            {**c._asdict(), "value": _known(c.value), "passed": c.passed} for c in criteria
        ],
        "outcomes": {str(kind): int(counts.get(str(kind), 0)) for kind in OutcomeClass},
        "table": table.select(kept).to_dicts(),
        "timing": {
            "rows_made": made,
            "elapsed_s": elapsed,
            "rollouts_per_s": made / elapsed,
            "rollout_s_sum": float(table["elapsed_s"].sum()),
        },
    }
    write_text(store.folder / "summary.json", json_text(summary))
    write_text(store.folder / "report.html", render_study(plan.study, table, criteria, summary))
    return Campaign(plan, table, summary, criteria)


def _known(value: float) -> float | None:
    return value if value == value else None
