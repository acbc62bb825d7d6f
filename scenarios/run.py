"""One run of a scenario, from parameters to the three files it leaves behind."""

import contextlib
import dataclasses
import importlib.metadata
import json
import math
import platform
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from polars.exceptions import PolarsError

from qpctrl.errors import InputError, reason_of
from scenarios.record import write_parquet
from scenarios.report import render_report
from scenarios.scenario import Eventful, Options, Outcome, Scenario
from scenarios.simulation import simulate

FILES = ("summary.json", "ticks.parquet", "report.html")
"""What a run leaves behind."""

VERSIONED = ("qpctrl", "casadi", "mujoco", "numpy", "pin", "proxsuite", "qpsolvers")


def run_scenario(
    scenario: Scenario,
    options: Options,
    *,
    out: Path | None = None,
    watch: Callable[[float, str], None] | None = None,
) -> Outcome:
    """Run a scenario and judge it by its own criteria.

    Args:
        scenario: what to run.
        options: how to run it.
        out: folder for summary.json, ticks.parquet and report.html; none writes nothing.
        watch: called with simulated time [s] and phase, now and then.

    Raises:
        InputError: the parameters cannot be used, or the folder cannot be written; nothing
            has been run or written then.
    """
    experiment = scenario.prepare(options)
    if out is not None:
        writable_folder(out)
    started = time.perf_counter()
    table = simulate(experiment, watch=watch)
    elapsed = time.perf_counter() - started
    metrics = scenario.metrics(table)
    metrics["duration_s"] = float(table["time"][-1]) if len(table) else 0.0
    metrics["realtime_factor"] = metrics["duration_s"] / elapsed
    criteria = scenario.judge(metrics)
    summary = {
        "scenario": scenario.name,
        "passed": all(criterion.passed for criterion in criteria),
        "criteria": [{**c._asdict(), "passed": c.passed} for c in criteria],
        **({"events": scenario.events(table)} if isinstance(scenario, Eventful) else {}),
        "metrics": metrics,
        "config": {**dataclasses.asdict(scenario), **dataclasses.asdict(options)},  # type: ignore[call-overload]
        "seed": options.seed,
        "versions": versions(),
    }
    outcome = Outcome(experiment=experiment, table=table, summary=plain(summary))
    if out is not None:
        write_outcome(scenario, outcome, out)
    return outcome


def versions() -> dict[str, str]:
    """Return the versions that the numbers of a run depend on."""
    found = {name: importlib.metadata.version(name) for name in VERSIONED}
    return {**found, "python": platform.python_version(), "machine": platform.machine()}


def writable_folder(path: Path, files: Sequence[str] = FILES) -> Path:
    """Return ``path`` as an existing folder that can be written.

    Args:
        path: the folder.
        files: names of what shall be written there.

    Raises:
        InputError: it cannot be made or written, or one of the names is a folder there.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except (OSError, ValueError) as error:  # ValueError: a name that no file system takes
        raise InputError(f"output folder {str(path)!r}: {reason_of(error)}") from error
    for name in files:
        if (path / name).is_dir():
            raise InputError(f"output folder {str(path)!r}: {name} is a folder there")
    return path


def write_outcome(scenario: Scenario, outcome: Outcome, folder: Path) -> None:
    """Write summary.json, ticks.parquet and report.html; all of them or none.

    Raises:
        InputError: the folder cannot be written.
    """
    with all_or_none(writable_folder(folder)) as staging:
        write_parquet(outcome.table, staging / "ticks.parquet")
        text = json.dumps(outcome.summary, indent=2, ensure_ascii=False, allow_nan=False)
        (staging / "summary.json").write_text(text + "\n", encoding="utf-8")
        html = render_report(outcome.summary, outcome.table, scenario.panels(outcome))
        (staging / "report.html").write_text(html, encoding="utf-8")


@contextlib.contextmanager
def all_or_none(folder: Path) -> Iterator[Path]:
    """Give a place to write files, which then go to ``folder`` together; none if that fails.

    Raises:
        InputError: the folder cannot be written.
    """
    try:
        staging = Path(tempfile.mkdtemp(dir=folder, prefix=".writing-"))
        try:
            yield staging
            for file in sorted(staging.iterdir()):
                file.replace(folder / file.name)
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    except (OSError, PolarsError) as error:
        raise InputError(f"output folder {str(folder)!r}: {reason_of(error)}") from error


def plain(value: Any) -> Any:
    """Return ``value`` as JSON knows it; NaN and infinities become null."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
