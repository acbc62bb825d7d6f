"""The command ``qpctrl run SCENARIO``."""

import dataclasses
import json
import math
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from qpctrl.errors import InputError
from scenarios.catalogue import SCENARIOS, scenario_named
from scenarios.command import interactive, merged, parse
from scenarios.console import console
from scenarios.report import label
from scenarios.run import run_scenario
from scenarios.scenario import Options, Outcome, Scenario
from scenarios.video.run import Filmed, film_run
from scenarios.video.write import check_video

USAGE = f"""usage: qpctrl run SCENARIO [--help]

scenarios: {", ".join(SCENARIOS)}

example:
  qpctrl run eraser --force 15 --out runs/firm
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Running:
    """Flags of ``run`` that are the same for every scenario."""

    out: Path | None = None
    """Folder for the results; default runs/SCENARIO."""
    video: Path | None = None
    """File for moving pictures of the run: .gif, .webp, .png, .mp4 or .webm."""
    json: bool = False
    """Print the summary as JSON."""


def run_command(arguments: list[str]) -> bool:
    """Run a scenario, leave its files, print its criteria; return whether they hold.

    Raises:
        InputError: no or an unknown scenario, or flags that cannot be used.
    """
    if arguments[:1] in (["-h"], ["--help"]):
        print(USAGE, end="")
        return True
    kind = scenario_named(arguments)
    name = arguments[0]
    given: Any = parse(
        merged(f"Run{name.title()}", {"scenario": kind, "run": Options}, Running),
        arguments[1:],
        prog=f"qpctrl run {name}",
        description=f"{kind.__doc__}\n\nExample: qpctrl run {name} --out runs/{name}",
    )
    folder = given.out or Path("runs") / name
    if given.video is not None:
        _check_film(name, given.scenario, given.video)
    outcome = _watched_run(given.scenario, given.run, folder)
    if why := outcome.experiment.controller.interpreted:
        print(f"qpctrl: ticks are {why}", file=sys.stderr)
    if given.json:
        print(json.dumps(outcome.summary, indent=2, ensure_ascii=False))
    else:
        _print_outcome(outcome, folder)
    if given.video is not None:
        _watched_film(given.scenario, outcome, given.video)
    return outcome.passed


def _watched_run(scenario: Scenario, options: Options, out: Path) -> Outcome:
    if not interactive():
        return run_scenario(scenario, options, out=out)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(f"{scenario.name}", total=None)

        def watch(time: float, phase: str) -> None:
            progress.update(task, description=f"{scenario.name}: {phase}, {time:.1f} s simulated")

        return run_scenario(scenario, options, out=out, watch=watch)


def _check_film(name: str, scenario: Scenario, file: Path) -> None:
    if not isinstance(scenario, Filmed):
        filmed = ", ".join(name for name, kind in SCENARIOS.items() if issubclass(kind, Filmed))
        raise InputError(f"video: got scenario {name!r}, need one with a scene: {filmed}")
    check_video(file)


def _watched_film(scenario: Filmed, outcome: Outcome, file: Path) -> None:
    scene, robot, table = scenario.scene(outcome), outcome.experiment.robot, outcome.table
    if not interactive():
        film_run(file, scene, robot, table)
        return
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("video", total=None)

        def watch(picture: int) -> None:
            progress.update(task, description=f"video: picture {picture}")

        film_run(file, scene, robot, table, watch=watch)


def _print_outcome(outcome: Outcome, folder: Path) -> None:
    summary, out = outcome.summary, console()
    verdict = "[green]PASSED[/]" if outcome.passed else "[red]FAILED[/]"
    table = Table("criterion", "value", "limit", "unit", "", box=None, header_style="bold")
    for criterion in summary["criteria"]:
        value = criterion["value"]
        shown = "none" if value is None else f"{value:.4g}"
        mark = "[green]ok[/]" if criterion["passed"] else "[red]missed[/]"
        table.add_row(
            label(criterion["name"]), shown, f"≤ {criterion['limit']:g}", criterion["unit"], mark
        )
    out.print(f"[bold]{summary['scenario']}[/] {verdict}")
    out.print(table)
    for event in summary.get("events", ()):
        out.print(f"gave way: {event}", markup=False)
    if summary["config"]["actuator"] != "ideal":
        out.print(f"{summary['config']['actuator']} joints; the limits are those for ideal ones")
    metrics = {name: math.nan if v is None else v for name, v in summary["metrics"].items()}
    out.print(
        f"tick {metrics['tick_us_median']:.0f} µs median, {metrics['tick_us_p99']:.0f} µs p99; "
        f"run {metrics['realtime_factor']:.1f} × real time"
    )
    out.print(f"report: {folder / 'report.html'}", highlight=False, soft_wrap=True)
