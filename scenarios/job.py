"""Runs of scenarios side by side, each worker a process of its own."""

import contextlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from pathlib import Path
from typing import NamedTuple

from qpctrl.errors import InputError
from scenarios.processes import worker_pool
from scenarios.record import LIMITED, fallback_count
from scenarios.run import run_scenario
from scenarios.scenario import Options, Scenario

WORKERS = 2
"""Processes that run at once, at most."""


class Job(NamedTuple):
    """One run."""

    scenario: Scenario
    options: Options
    out: Path | None = None
    """Folder for its files; none: it leaves nothing."""


class Finding(NamedTuple):
    """What is kept of a run whose record is not."""

    metrics: dict[str, float | None]
    """Of the scenario; none: no number."""
    saturated: float
    """Share of all ticks at which a limit of the controller binds [1]."""
    motor_limited: int
    """Ticks at which a motor met its limit of current or voltage."""
    torque_limited: bool
    """Whether a limit of torque bound in any tick, or a motor met its own."""
    fallback_ticks: int
    """Of the whole run."""

    def metric(self, name: str) -> float:
        """Return a metric; NaN where the scenario has none or it is no number."""
        value = self.metrics.get(name)
        return float("nan") if value is None else value


def workers() -> contextlib.AbstractContextManager[Executor]:
    """Return processes that wait for jobs, one thread each; they end with the block."""
    return worker_pool(min(WORKERS, os.cpu_count() or 1))


def run_jobs(
    pool: Executor, jobs: Sequence[Job], watch: Callable[[], None] | None = None
) -> list[Finding | InputError]:
    """Return what each job found, in their order; an error where its parameters cannot be used.

    Args:
        pool: what runs them.
        jobs: what to run.
        watch: called whenever one is done.
    """
    futures = [pool.submit(run_job, job) for job in jobs]
    for _ in as_completed(futures):
        if watch is not None:
            watch()
    return [future.result() for future in futures]


def run_job(job: Job) -> Finding | InputError:
    """Return what a job found, or why it cannot be run."""
    try:
        outcome = run_scenario(job.scenario, job.options, out=job.out)
    except InputError as error:
        return error
    table = outcome.table
    motor = int(table[LIMITED].sum()) if LIMITED in table.columns else 0
    return Finding(
        metrics=outcome.summary["metrics"],
        saturated=float(table["saturated"].to_numpy().mean()),
        motor_limited=motor,
        torque_limited=motor > 0 or bool(table["active"].str.contains("torque").any()),
        fallback_ticks=fallback_count(table),
    )
