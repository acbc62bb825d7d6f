"""The command ``qpctrl study NAME | status DIR``."""

import contextlib
import dataclasses
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rich import progress
from rich.console import Console
from rich.table import Table

from qpctrl.errors import InputError, unknown_name
from scenarios.command import interactive, merged, parse
from scenarios.console import console
from scenarios.study.campaign import Campaign, run_study, status
from scenarios.study.catalogue import STUDIES
from scenarios.study.machine import ProcessPool
from scenarios.study.store import json_text
from scenarios.study.study import plan_study

USAGE = f"""usage: qpctrl study NAME [--help]
       qpctrl study status DIR

studies: {", ".join(STUDIES)}

examples:
  qpctrl study tilt --levels 9 --low -10 --high 10 --controllers qp textbook
  qpctrl study tilt --out runs/tilt --resume
  qpctrl study status runs/tilt
"""

MOST_ROWS = 40
"""Rollouts that are printed; the files hold all of them."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Running:
    """Flags that are the same for every study."""

    out: Path | None = None
    """Folder for the results; default runs/study-NAME."""
    resume: bool = False
    """Go on in a folder that holds results of this study: what is missing is made."""
    workers: int = 2
    """Processes that run at once."""
    seed: int = 0
    """Seed of the design and of every random number."""
    json: bool = False
    """Print the summary as JSON."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Looking:
    """Flags of ``study status``."""

    json: bool = False
    """Print JSON."""


def study_command(arguments: list[str]) -> bool:
    """Run a study, or look how far one is; return whether its criteria hold, or it is complete.

    Raises:
        InputError: an unknown study, or flags or a folder that cannot be used.
    """
    if not arguments:
        raise InputError(f"missing NAME; allowed: {', '.join(STUDIES)}, status DIR, --help")
    if arguments[0] in ("-h", "--help"):
        print(USAGE, end="")
        return True
    if arguments[0] == "status":
        return _status(arguments[1:])
    if arguments[0] not in STUDIES:
        raise unknown_name("study", arguments[0], (*STUDIES, "status"))
    return _run(arguments[0], arguments[1:])


def _run(name: str, arguments: list[str]) -> bool:
    kind = STUDIES[name]
    given: Any = parse(
        merged(f"Study{name.title()}", {"study": kind}, Running),
        arguments,
        prog=f"qpctrl study {name}",
        description=f"Study {name}: {kind.summary}.\n\nExample: qpctrl study {name} --levels 9 "
        f"--out runs/{name}",
    )
    plan, machine = plan_study(given.study, given.seed), ProcessPool(given.workers)
    folder = given.out or Path("runs") / f"study-{name}"
    try:
        with _progress(name) as watch:
            campaign = run_study(plan, machine, folder, resume=given.resume, watch=watch)
    except KeyboardInterrupt:
        print("qpctrl: interrupted; finished rows are kept, go on with --resume", file=sys.stderr)
        sys.exit(130)
    if given.json:
        print(json_text(campaign.summary), end="")
    else:
        _print(campaign, folder)
    return campaign.passed


def _status(arguments: list[str]) -> bool:
    if not arguments or arguments[0].startswith("-"):
        if arguments[:1] in (["-h"], ["--help"]):
            print(USAGE, end="")
            return True
        raise InputError("study status: missing DIR, the folder of a study")
    flags = parse(
        Looking,
        arguments[1:],
        prog="qpctrl study status DIR",
        description="Say how many rows of a study are there; exit code 1 while some are missing."
        "\n\nExample: qpctrl study status runs/tilt",
    )
    found = status(Path(arguments[0]))
    if flags.json:
        print(json.dumps({**found._asdict(), "complete": found.done == found.rows}))
    else:
        print(f"study {found.study}: {found.done} of {found.rows} rows")
    return found.done == found.rows


@contextlib.contextmanager
def _progress(name: str) -> Iterator[Callable[[int, int], None] | None]:
    """Yield what shows rollouts, their rate and the time left to a person, if there is one."""
    if not interactive():
        yield None
        return
    columns = (
        *(progress.TextColumn("{task.description}"), progress.BarColumn()),
        *(progress.MofNCompleteColumn(), progress.TextColumn("{task.fields[rate]}")),
        *(progress.TextColumn("ETA"), progress.TimeRemainingColumn()),
    )
    with progress.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=None, rate="")

        def watch(done: int, rows: int) -> None:
            speed = bar.tasks[0].speed
            rate = f"{speed:.2f} rollouts/s" if speed else ""
            bar.update(task, completed=done, total=rows, rate=rate)

        yield watch


def _print(campaign: Campaign, folder: Path) -> None:
    out, study = console(), campaign.plan.study
    verdict = "[green]PASSED[/]" if campaign.passed else "[red]FAILED[/]"
    counts = campaign.summary["outcomes"]
    said = ", ".join(f"{count} {kind}" for kind, count in counts.items() if count)
    out.print(f"[bold]study {study.name}[/], {len(campaign.table)} rollouts ({said}) {verdict}")
    out.print(_rows(campaign))
    table = Table("criterion", "value", "limit", "unit", "", box=None, header_style="bold")
    for c in campaign.criteria:
        mark = "[green]ok[/]" if c.passed else "[red]missed[/]"
        value = f"{c.value:.3g}" if c.value == c.value else "none"
        table.add_row(c.name, value, f"≤ {c.limit:g}", c.unit, mark)
    out.print("", table, sep="\n")
    timing = campaign.summary["timing"]
    out.print(
        f"{timing['rows_made']} rollouts made in {timing['elapsed_s']:.1f} s, "
        f"{timing['rollouts_per_s']:.1f} /s"
    )
    out.print(f"report: {folder / 'report.html'}", soft_wrap=True)


def _rows(campaign: Campaign) -> Table:
    """Return the first `MOST_ROWS` rollouts."""
    study, rows = campaign.plan.study, campaign.table.head(MOST_ROWS)
    table = Table(box=None, header_style="bold")
    for factor in study.factors:
        table.add_column(f"{factor.name}\n{factor.unit}", justify="right")
    table.add_column("controller")
    for head in study.shown.values():
        table.add_column(head, justify="right")
    table.add_column("outcome")
    for row in rows.iter_rows(named=True):
        point = [f"{row[factor.column]:+.4g}" for factor in study.factors]
        numbers = [_number(name, row[name]) for name in study.shown]
        table.add_row(*point, row["controller"], *numbers, row["outcome"])
    if len(rows) < len(campaign.table):
        table.caption = f"the first {len(rows)} of {len(campaign.table)} rollouts"
    return table


def _number(name: str, value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.1e}" if name.endswith("_gap") else f"{round(value, 5) + 0.0:.5f}"
