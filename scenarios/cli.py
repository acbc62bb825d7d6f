"""The command line: ``qpctrl list | run | compare``.

Exit codes: 0 all of the command's own criteria hold, 1 they do not, 2 bad input (one line).
"""

import dataclasses
import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from qpctrl.errors import InputError, QpctrlError, unknown_name
from scenarios.catalogue import SCENARIOS
from scenarios.command import interactive, merged, parse
from scenarios.compare import CASES, Row, compare
from scenarios.eraser import Eraser
from scenarios.report import label
from scenarios.run import Outcome, run_scenario
from scenarios.scenario import Options, Scenario

USAGE = """usage: qpctrl COMMAND [--help]

commands:
  list              scenarios that can be run
  run SCENARIO      run one and write summary.json, ticks.parquet and report.html
  compare           QP against the closed-form laws over random states

examples:
  qpctrl run eraser --force 15 --speed 0.1 --out runs/slow
  qpctrl run eraser --robot arm.urdf --tool tool0 --home 0 -1.2 1.5 0 1.2 0
  qpctrl compare --states 200
"""

RUN_USAGE = f"""usage: qpctrl run SCENARIO [--help]

scenarios: {", ".join(SCENARIOS)}

example:
  qpctrl run eraser --force 15 --out runs/firm
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Listing:
    """Flags of ``list``."""

    json: bool = False
    """Print JSON."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Running:
    """Flags of ``run`` that are the same for every scenario."""

    out: Path | None = None
    """Folder for the results; default runs/SCENARIO."""
    json: bool = False
    """Print the summary as JSON."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparing:
    """Flags of ``compare``."""

    states: int = 1000
    """Random states for each arm and number of constraint rows."""
    solver: str = "proxsuite"
    """Solver under test."""
    second: str = "daqp"
    """Solver to agree with where limits are active."""
    form: Literal["reduced", "full"] = "reduced"
    """Variables of the QP: (a, λ) or (a, τ, λ)."""
    seed: int = 0
    """Seed of the random states."""
    json: bool = False
    """Print JSON."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        passed = _dispatch(list(arguments))
    except QpctrlError as error:
        print(f"qpctrl: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        sys.exit(1)
    except KeyboardInterrupt:
        print("qpctrl: interrupted, nothing written", file=sys.stderr)
        sys.exit(130)
    sys.exit(0 if passed else 1)


def _dispatch(arguments: list[str]) -> bool:
    commands: dict[str, Callable[[list[str]], bool]] = {
        "list": _list,
        "run": _run,
        "compare": _compare,
    }
    if not arguments:
        raise InputError(f"missing COMMAND; allowed: {', '.join(commands)}, --help")
    if arguments[0] in ("-h", "--help"):
        print(USAGE, end="")
        return True
    if arguments[0] not in commands:
        raise unknown_name("command", arguments[0], commands)
    return commands[arguments[0]](arguments[1:])


def _list(arguments: list[str]) -> bool:
    listing = parse(
        Listing,
        arguments,
        prog="qpctrl list",
        description="List the scenarios.\n\nExample: qpctrl list --json",
    )
    found = {name: str(scenario.summary) for name, scenario in SCENARIOS.items()}
    if listing.json:
        print(json.dumps(found, indent=2))
        return True
    table = Table("scenario", "what happens", box=None, header_style="bold")
    for name, summary in found.items():
        table.add_row(name, summary)
    _console().print(table)
    return True


def _run(arguments: list[str]) -> bool:
    if not arguments:
        raise InputError(f"missing SCENARIO; allowed: {', '.join(SCENARIOS)}")
    if arguments[0] in ("-h", "--help"):
        print(RUN_USAGE, end="")
        return True
    name = arguments[0]
    if name not in SCENARIOS:
        raise unknown_name("scenario", name, SCENARIOS)
    kind = SCENARIOS[name]
    given: Any = parse(
        merged(f"Run{name.title()}", {"scenario": kind, "options": Options}, Running),
        arguments[1:],
        prog=f"qpctrl run {name}",
        description=f"{kind.__doc__}\n\nExample: qpctrl run {name} --out runs/{name}",
    )
    folder = given.out or Path("runs") / name
    outcome = _watched_run(given.scenario, given.options, folder)
    if given.json:
        print(json.dumps(outcome.summary, indent=2, ensure_ascii=False))
    else:
        _print_outcome(outcome, folder)
    return outcome.passed


def _watched_run(scenario: Scenario, options: Options, out: Path) -> Outcome:
    if not interactive():
        return run_scenario(scenario, options, out=out)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(f"{scenario.name}", total=None)

        def watch(time: float, phase: str) -> None:
            progress.update(task, description=f"{scenario.name}: {phase}, {time:.1f} s simulated")

        return run_scenario(scenario, options, out=out, watch=watch)


def _print_outcome(outcome: Outcome, folder: Path) -> None:
    summary, console = outcome.summary, _console()
    verdict = "[green]PASSED[/]" if outcome.passed else "[red]FAILED[/]"
    table = Table("criterion", "value", "limit", "unit", "", box=None, header_style="bold")
    for criterion in summary["criteria"]:
        value = criterion["value"]
        shown = "none" if value is None else f"{value:.4g}"
        mark = "[green]ok[/]" if criterion["passed"] else "[red]missed[/]"
        table.add_row(
            label(criterion["name"]), shown, f"≤ {criterion['limit']:g}", criterion["unit"], mark
        )
    console.print(f"[bold]{summary['scenario']}[/] {verdict}")
    console.print(table)
    metrics = {name: math.nan if v is None else v for name, v in summary["metrics"].items()}
    console.print(
        f"tick {metrics['tick_us_median']:.0f} µs median, {metrics['tick_us_p99']:.0f} µs p99; "
        f"run {metrics['realtime_factor']:.1f} × real time"
    )
    console.print(f"report: {folder / 'report.html'}", highlight=False, soft_wrap=True)


def _compare(arguments: list[str]) -> bool:
    given = parse(
        Comparing,
        arguments,
        prog="qpctrl compare",
        description="Compare the QP with the closed-form laws over random states, and with a "
        "second solver where torque limits are active; then run the eraser.\n\n"
        "Example: qpctrl compare --states 200",
    )
    with Progress(
        console=Console(stderr=True), transient=True, disable=not interactive()
    ) as progress:
        task = progress.add_task("compare", total=given.states * len(CASES))
        rows = list(
            compare(
                states=given.states,
                solver=given.solver,
                second=given.second,
                form=given.form,
                seed=given.seed,
                watch=lambda case, done: progress.update(task, advance=50),
            )
        )
        progress.update(task, description="eraser")
        eraser = run_scenario(Eraser(duration=2.0), Options(solver=given.solver, form=given.form))
    failed = [c for row in rows for c in row.criteria() if not c.passed]
    gap = eraser.summary["metrics"]["qp_law_gap_max"]
    passed = not failed and eraser.passed
    if given.json:
        table = [dataclasses.asdict(row) for row in rows]
        print(json.dumps({"passed": passed, "table": table, "eraser_law_gap": gap}, indent=2))
        return passed
    console = _console()
    console.print(_equivalence_table(rows))
    console.print(
        f"eraser, wiping 2 s: QP − hybrid {gap:.1e} of max |τ|, "
        f"criteria {'all hold' if eraser.passed else 'missed'}"
    )
    for criterion in failed:
        console.print(
            f"[red]missed[/] {criterion.name}: {criterion.value:.2e} > {criterion.limit:g}"
        )
    console.print("[green]PASSED[/]" if passed else "[red]FAILED[/]")
    return passed


def _equivalence_table(rows: list[Row]) -> Table:
    table = Table(
        *(
            "arm",
            "k",
            "states",
            "QP − hybrid",
            "unpolished",
            "QP − textbook",
            "… + curvature",
            "KKT",
        ),
        *("limited", "two solvers", "singular", "unsolved"),
        box=None,
        header_style="bold",
        caption="largest over the states, relative to max |τ|; polish: what it changes in the "
        "solver's own answer; limited: states with active torque limits; singular: Λ damped, no "
        "equality claimed",
    )
    for row in rows:
        gaps = (row.law_gap, row.own_gap, row.textbook_gap, row.curvature_gap, row.kkt)
        table.add_row(
            *(row.robot, str(row.k), str(row.states), *(f"{gap:.1e}" for gap in gaps)),
            *(str(row.limited), f"{row.solver_gap:.1e}", str(row.damped), str(row.unsolved)),
        )
    return table


def _console() -> Console:
    width = None if sys.stdout.isatty() else 120
    return Console(width=width, highlight=False)
