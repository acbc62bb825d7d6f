"""The command ``qpctrl compare-actuators SCENARIO``: one job with each of the five actuators."""

import contextlib
import dataclasses
import json
import math
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Column, Table

from qpctrl.compiled import CompileMode
from qpctrl.errors import InputError, unknown_name
from scenarios.actuator.inner import INNER_RATE
from scenarios.actuator_comparison import ACTUATORS, Comparison, Watch, compare_actuators
from scenarios.actuator_comparison_page import (
    CRITERIA,
    HEADS,
    render_comparison,
    row_words,
    shown,
    study_words,
)
from scenarios.catalogue import SCENARIOS
from scenarios.command import interactive, merged, parse
from scenarios.console import console
from scenarios.joint_level import Actuator
from scenarios.run import plain, versions, writable_folder
from scenarios.scenario import Options

WITH_FORCE = (
    *("eraser", "gap", "edge", "conveyor", "sphere", "door", "drawer", "crank", "valve"),
    "press",
)
"""Scenarios with a metric ``force_rmse_N`` that joints with drives can do."""

FILES = ("summary.json", "report.html")
"""What the command leaves behind beside a folder for each actuator."""

METRICS = {
    "force_mae": "force_mae_N",
    "force_rmse": "force_rmse_N",
    "position_rmse": "position_rmse_mm",
    "torque_error": "torque_error_rms_Nm",
    "saturated": "saturated_fraction",
    "motor_limited": "motor_limited_fraction",
    "motor_limited_ticks": "motor_limited_ticks",
    "fallback_ticks": "fallback_ticks_total",
    "realtime_factor": "realtime_factor",
}
"""Names in summary.json of what a row holds."""

USAGE = f"""usage: qpctrl compare-actuators SCENARIO [--help]

scenarios: {", ".join(WITH_FORCE)}

example:
  qpctrl compare-actuators eraser --force 15 --out runs/actuators
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparing:
    """Flags of ``compare-actuators`` that are the same for every scenario."""

    out: Path | None = None
    """Folder for the results; default runs/actuators-SCENARIO."""
    json: bool = False
    """Print the summary as JSON."""
    no_ablations: bool = False
    """Do not find out why they differ, which takes most of the time."""
    seed: int = 0
    """Seed of every random number."""
    inner_rate: float = INNER_RATE
    """Rate of the drives' current and torque loops [Hz]."""
    compiled: CompileMode = "auto"
    """Whether ticks and inner loop run as generated C, which takes seconds the first time."""


def compare_actuators_command(arguments: list[str]) -> bool:
    """Run a job with every actuator, leave its page, print the table; return whether it passes.

    Raises:
        InputError: no or an unknown scenario, one without a force, or flags that cannot be used.
    """
    if arguments and arguments[0] in ("-h", "--help"):
        print(USAGE, end="")
        return True
    name = _scenario_name(arguments)
    kind = SCENARIOS[name]
    given: Any = parse(
        merged(f"Compare{name.title()}", {"scenario": kind}, Comparing),
        arguments[1:],
        prog=f"qpctrl compare-actuators {name}",
        description=f"Run {name} with ideal, direct-drive, geared, strain-gauge and series-elastic "
        "joints; then repeat it with friction, compliance, noise … taken away from the drives, to "
        f"see which of them explains the difference.\n\nExample: qpctrl compare-actuators {name} "
        f"--out runs/{name}",
    )
    options = Options(seed=given.seed, inner_rate=given.inner_rate, compiled=given.compiled)
    folder = given.out or Path("runs") / f"actuators-{name}"
    with _staging(folder) as stage, _progress(name) as watch:
        comparison = compare_actuators(
            given.scenario, options, out=stage, ablations=not given.no_ablations, watch=watch
        )
        summary = summarise(comparison)
        text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
        page = render_comparison(comparison, summary)
        for file, content in zip(FILES, (text + "\n", page), strict=True):
            (stage / file).write_text(content, encoding="utf-8")
    if given.json:
        print(text)
    else:
        _print_comparison(comparison, folder)
    return comparison.passed


def summarise(comparison: Comparison) -> dict[str, Any]:
    """Return what summary.json holds; what does not exist is null."""
    scenario, options = comparison.scenario, comparison.options
    config = dataclasses.asdict(scenario) | dataclasses.asdict(options)  # type: ignore[call-overload]
    return {
        "scenario": scenario.name,
        "passed": comparison.passed,
        "criteria": [
            {**c._asdict(), "value": plain(c.value), "passed": c.passed}
            for c in comparison.criteria
        ],
        "phase": comparison.phase,
        "actuators": {name: _actuator(comparison, name) for name in ACTUATORS},
        "study_duration_s": getattr(comparison.short, "duration", None),
        "config": {key: config[key] for key in config if key not in ("actuator", "drives")},
        "seed": options.seed,
        "versions": versions(),
    }


def _actuator(comparison: Comparison, name: Actuator) -> dict[str, Any]:
    row, study = comparison.rows[name], comparison.studies.get(name)
    found: dict[str, Any] = {key: plain(getattr(row, field)) for field, key in METRICS.items()}
    if study is None:
        return found
    return found | {
        "reason": study.sentence(),
        "cause": study.cause,
        "study": {
            "force_rmse_N": plain(study.whole),
            "ideal_force_rmse_N": plain(study.ideal),
            "without": {key: plain(value) for key, value in study.without.items()},
            "without_all": None if study.together is None else plain(study.together),
        },
    }


def _scenario_name(arguments: list[str]) -> str:
    if not arguments:
        raise InputError(f"missing SCENARIO; allowed: {', '.join(WITH_FORCE)}")
    name = arguments[0]
    if name not in SCENARIOS:
        raise unknown_name("scenario", name, WITH_FORCE)
    if name not in WITH_FORCE:
        raise InputError(
            f"scenario {name!r} cannot be compared with drives; those that can: "
            f"{', '.join(WITH_FORCE)}"
        )
    return name


@contextlib.contextmanager
def _staging(folder: Path) -> Iterator[Path]:
    """Yield a folder whose files are moved to ``folder`` at the end; all of them or none."""
    fresh = not folder.exists()
    writable_folder(folder)
    for name in ACTUATORS:
        if (folder / name).exists():
            writable_folder(folder / name)
    stage = Path(tempfile.mkdtemp(dir=folder, prefix=".writing-"))
    try:
        yield stage
        for file in sorted(path for path in stage.rglob("*") if path.is_file()):
            target = folder / file.relative_to(stage)
            target.parent.mkdir(exist_ok=True)
            file.replace(target)
    except OSError as error:
        raise InputError(f"output folder {str(folder)!r}: {error.strerror}") from error
    finally:
        shutil.rmtree(stage, ignore_errors=True)
        if fresh:
            with contextlib.suppress(OSError):  # it holds the results, or was taken away
                folder.rmdir()


@contextlib.contextmanager
def _progress(name: str) -> Iterator[Watch | None]:
    """Yield what shows the progress to a person, if there is one."""
    if not interactive():
        yield None
        return
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(f"{name}: five actuators", total=len(ACTUATORS))
        yield lambda done, known: progress.update(task, completed=done, total=known)


def _print_comparison(comparison: Comparison, folder: Path) -> None:
    out = console()
    verdict = "[green]PASSED[/]" if comparison.passed else "[red]FAILED[/]"
    out.print(f"[bold]{comparison.scenario.name}[/], five actuators {verdict}")
    out.print(_rows(comparison))
    out.print(f"[dim]{row_words(comparison)}[/]")
    if comparison.studies:
        out.print(f"\n[bold]Why they differ.[/] {study_words(comparison)}")
        for name, study in comparison.studies.items():
            out.print(f"[bold]{name}[/]: {study.sentence()}")
    table = Table("criterion", "value", "limit", "unit", "", box=None, header_style="bold")
    for c in comparison.criteria:
        mark = "[green]ok[/]" if c.passed else "[red]missed[/]"
        shown_value = "none" if math.isnan(c.value) else f"{c.value:.4g}"
        table.add_row(CRITERIA[c.name], shown_value, f"≤ {c.limit:g}", c.unit, mark)
    out.print("", table, sep="\n")
    out.print(f"report: {folder / 'report.html'}", highlight=False, soft_wrap=True)


def _rows(comparison: Comparison) -> Table:
    columns = [Column(f"{words}\n{unit}", justify="right") for words, unit in HEADS.values()]
    table = Table("actuator", *columns, box=None, header_style="bold")
    for name, row in comparison.rows.items():
        table.add_row(name, *(shown(key, getattr(row, key)) for key in HEADS))
    return table
