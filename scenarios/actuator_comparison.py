"""One job with each of the five actuators, side by side, and why they differ."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar, get_args

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix
from qpctrl.errors import InputError
from scenarios.actuator.ablation import ABLATIONS
from scenarios.actuator.inner import INNER_RATE
from scenarios.actuator_reason import WORDS, Study
from scenarios.force_error import ForceError, find_force_error
from scenarios.job import Finding, Job, run_jobs, workers
from scenarios.joint_level import Actuator
from scenarios.metric import column, rms
from scenarios.scenario import Criterion, Options, Scenario

ACTUATORS: tuple[Actuator, ...] = get_args(Actuator)

SHORT = 2.0
"""Longest ``duration`` [s] of the job that is repeated with parts of the drives taken away."""

FASTER = 4
"""Times the inner rate at which stiffer drives run, and drives whose sampling is taken away."""

UNFAILING: tuple[Actuator, ...] = ("direct-drive", "strain-gauge", "series-elastic")
"""Actuators that must never need the fallback torque."""

SHARE = 0.2
"""Of the geared drive's force error that torque feedback may leave."""

WHOLE = "whole"
"""The key of a run from which nothing is taken away."""

Key = TypeVar("Key")

Watch = Callable[[int, int], None]
"""Called with the jobs done and those known of."""


class Row(NamedTuple):
    """One line of the comparison; NaN: the scenario has no such number."""

    force_mae: float
    """Mean magnitude of the force error [N], of the judged phase."""
    force_rmse: float
    """RMS of the force error [N], as the scenario reports it."""
    position_rmse: float
    """The same of the position [mm]."""
    torque_error: float
    """RMS of delivered − commanded torque over joints and ticks of the judged phase [Nm]."""
    saturated: float
    """Share of all ticks at which a limit of the controller binds [1]."""
    motor_limited: float
    """Share of all ticks at which a motor met its limit of current or voltage [1]."""
    motor_limited_ticks: int
    fallback_ticks: int
    """Of the whole run."""
    realtime_factor: float
    """Simulated time over that of the run, with another run beside it [1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Five runs of one job, and what explains their differences."""

    scenario: Scenario
    options: Options
    """What all five have in common."""
    rows: Mapping[Actuator, Row]
    tables: Mapping[Actuator, pl.DataFrame]
    """The records, one row a tick."""
    error: ForceError | None
    """When and along what the force is judged; none: not to be found, the whole run counts."""
    short: Scenario
    """The job that the studies repeat."""
    studies: Mapping[Actuator, Study]
    """Of each actuator but the ideal one; empty: none was made."""

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """What must hold."""
        rows = self.rows
        share = rows["strain-gauge"].force_rmse / (rows["geared"].force_rmse or math.nan)
        met = sum(row.motor_limited_ticks for row in rows.values())
        fallbacks = sum(rows[name].fallback_ticks for name in UNFAILING)
        return (
            Criterion("fallback_ticks", fallbacks, 0, "ticks"),
            Criterion("strain_gauge_share", share, SHARE, "× geared"),
            Criterion("motor_limited_ticks", met, 0, "ticks"),
        )

    @property
    def passed(self) -> bool:
        """Whether all of it holds."""
        return all(criterion.passed for criterion in self.criteria)

    @property
    def phase(self) -> str | None:
        """The phase that is judged; none: the whole run is."""
        return self.error and self.error.phase


def compare_actuators(
    scenario: Scenario,
    options: Options,
    *,
    out: Path,
    ablations: bool = True,
    watch: Watch | None = None,
) -> Comparison:
    """Run a scenario with every actuator, and again without parts of their drives.

    Args:
        scenario: what to run.
        options: how to run it; its actuator and drives are not used.
        out: folder in which every actuator gets a folder with the three files of its run.
        ablations: whether to find out why they differ.
        watch: called now and then.

    Raises:
        InputError: the parameters cannot be used with one of the actuators.
    """
    bare = replace(options, drives=(), without=())
    plain = {name: replace(bare, actuator=name) for name in ACTUATORS}
    plain["ideal"] = replace(plain["ideal"], inner_rate=INNER_RATE)  # these have no loops
    short = _shortened(scenario) if ablations else scenario
    with workers() as pool:
        crew = _Crew(pool, watch)
        found = crew.run({name: Job(scenario, plain[name], out / name) for name in ACTUATORS})
        runs = {name: _done(name, finding) for name, finding in found.items()}
        studies = crew.studies(short, plain, runs) if ablations else {}
    tables = {name: pl.read_parquet(out / name / "ticks.parquet") for name in ACTUATORS}
    error = find_force_error(tables["ideal"], runs["ideal"].metric("force_rmse_N"))
    return Comparison(
        scenario=scenario,
        options=options,
        rows={name: _row(runs[name], tables[name], error) for name in ACTUATORS},
        tables=tables,
        error=error,
        short=short,
        studies=studies,
    )


class _Crew:
    """Workers, and how much they have done."""

    def __init__(self, pool: Executor, watch: Watch | None) -> None:
        self._pool, self._watch = pool, watch
        self._done = self._known = 0

    def run(self, jobs: Mapping[Key, Job]) -> dict[Key, Finding | InputError]:
        """Return what each job found."""
        self._known += len(jobs)
        return dict(zip(jobs, run_jobs(self._pool, list(jobs.values()), self._tell), strict=True))

    def studies(
        self,
        short: Scenario,
        plain: Mapping[Actuator, Options],
        runs: Mapping[Actuator, Finding],
    ) -> dict[Actuator, Study]:
        """Return what explains the difference of each actuator from ideal joints.

        Args:
            short: the job to repeat.
            plain: options of each actuator with all its drives have.
            runs: what the whole job found; it tells whose limits matter.
        """
        jobs = {(name, WHOLE): Job(short, plain[name]) for name in ACTUATORS}
        for name in ACTUATORS[1:]:
            for change in WORDS:
                if change != "limits" or runs[name].torque_limited:
                    jobs[name, change] = Job(short, _changed(plain[name], (change,)))
        found = self._force_errors(jobs)
        studies = {
            name: Study(
                whole=found.get((name, WHOLE), math.nan),
                ideal=found.get(("ideal", WHOLE), math.nan),
                without={w: found[name, w] for w in WORDS if (name, w) in found},
            )
            for name in ACTUATORS[1:]
        }
        return self._explained_together(short, plain, studies)

    def _explained_together(
        self,
        short: Scenario,
        plain: Mapping[Actuator, Options],
        studies: Mapping[Actuator, Study],
    ) -> dict[Actuator, Study]:
        """Return the studies with all imperfections taken away where no single one explains."""
        open_ones = [n for n, study in studies.items() if study.needs_reason and not study.cause]
        jobs = {
            name: Job(short, _changed(plain[name], studies[name].imperfections))
            for name in open_ones
        }
        together = self._force_errors(jobs)
        return {
            name: replace(study, together=together.get(name)) for name, study in studies.items()
        }

    def _force_errors(self, jobs: Mapping[Key, Job]) -> dict[Key, float]:
        """Return force errors [N], without the jobs whose drives have nothing to take away."""
        return {
            key: finding.metric("force_rmse_N")
            for key, finding in self.run(jobs).items()
            if isinstance(finding, Finding)
        }

    def _tell(self) -> None:
        self._done += 1
        if self._watch is not None:
            self._watch(self._done, self._known)


def _shortened(scenario: Scenario) -> Scenario:
    """Return the scenario with `SHORT` of its duration, where it has one that is longer."""
    duration = getattr(scenario, "duration", 0.0)
    return replace(scenario, duration=SHORT) if duration > SHORT else scenario  # type: ignore[type-var]


def _changed(options: Options, changes: Sequence[str]) -> Options:
    """Return the options of a run in which these things are taken away."""
    faster = {"sampling", "compliance"} & set(changes)
    return replace(
        options,
        without=tuple(name for name in ABLATIONS if name in changes),
        inner_rate=options.inner_rate * (FASTER if faster else 1),
    )


def _done(name: Actuator, finding: Finding | InputError) -> Finding:
    if isinstance(finding, InputError):
        raise InputError(f"actuator {name!r}: {finding}") from finding
    return finding


def _row(run: Finding, table: pl.DataFrame, error: ForceError | None) -> Row:
    judged = error.judged(table) if error else table
    mae = error.magnitude(judged).mean() if error and len(judged) else math.nan
    return Row(
        force_mae=float(mae),
        force_rmse=run.metric("force_rmse_N"),
        position_rmse=run.metric("position_rmse_mm"),
        torque_error=rms(torque_errors(judged)) if len(judged) else math.nan,
        saturated=run.saturated,
        motor_limited=run.motor_limited / len(table),
        motor_limited_ticks=run.motor_limited,
        fallback_ticks=run.fallback_ticks,
        realtime_factor=run.metric("realtime_factor"),
    )


def torque_errors(table: pl.DataFrame) -> Matrix:
    """Return delivered − commanded torque (ticks×joints) [Nm]."""
    joints = [name.removeprefix("tau.") for name in table.columns if name.startswith("tau.")]
    pairs = [(column(table, f"tau_delivered.{j}"), column(table, f"tau.{j}")) for j in joints]
    return np.stack([delivered - asked for delivered, asked in pairs], axis=1)
