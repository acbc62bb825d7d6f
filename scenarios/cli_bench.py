"""The command ``qpctrl bench``."""

import contextlib
import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from qpctrl.compiled import CompileMode
from qpctrl.solver import solver_names
from scenarios.bench.page import render_page
from scenarios.bench.peer import need_peers
from scenarios.bench.plan import Plan, quick
from scenarios.bench.result import (
    HOW,
    WHAT_IS_TIMED,
    Result,
    measure,
    usable_folder,
    write_result,
)
from scenarios.bench.sheet import Sheet, sheets
from scenarios.command import interactive, parse
from scenarios.console import console

CODES: dict[CompileMode, tuple[bool, ...]] = {
    "auto": (True, False),
    "yes": (True,),
    "no": (False,),
}
"""Whether compiled ticks, interpreted ones, or both are measured."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Benching:
    """Flags of ``bench``."""

    ticks: int = Plan.ticks
    """Ticks of each case; 7 joints, k = 3, compiled has ten times as many."""
    rounds: int = Plan.rounds
    """Blocks in which each case gets them, in turns with all others."""
    compiled: CompileMode = "auto"
    """auto: compiled beside interpreted, where a compiler works; yes, no: only one of them."""
    solvers: tuple[str, ...] = ()
    """Back-ends of the QP to measure; default: all that are installed."""
    quick: bool = False
    """A rough look: fewer ticks, 7 and 14 joints."""
    peers: bool = False
    """Measure TSID and placo too, in the environments that `make peers` builds."""
    out: Path | None = None
    """Folder for bench.json and bench.html; default: none is written."""
    json: bool = False
    """Print the results as JSON."""


def bench_command(arguments: list[str]) -> bool:
    """Measure where the time of a tick goes and print it; times fail nothing: return true.

    Raises:
        InputError: flags or a folder that cannot be used; nothing has been measured then.
    """
    given = parse(
        Benching,
        arguments,
        prog="qpctrl bench",
        description="Measure a control tick and its parts [µs], larger arms, solvers, limits that "
        "bind, ticks at 1 kHz, simulation – in one run, in turns, on one core.\n\n"
        "Example: qpctrl bench --quick --out runs/bench",
    )
    plan = Plan(
        ticks=given.ticks,
        rounds=given.rounds,
        codes=CODES[given.compiled],
        solvers=given.solvers or solver_names(),
        peers=given.peers,
    )
    plan = quick(plan) if given.quick else plan
    if given.out is not None:
        usable_folder(given.out)
    if given.peers:
        need_peers()
    with _progress() as watch:
        result = measure(plan, required=given.compiled == "yes", watch=watch)
    if given.out is not None:
        write_result(result, render_page(result), given.out)
    if given.json:
        print(json.dumps(result.plain(), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        _print_result(result, given.out)
    return True


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Yield what says, on a terminal, what is being done."""
    screen = Console(stderr=True)
    with Progress(console=screen, transient=True, disable=not interactive()) as progress:
        task = progress.add_task("bench", total=None)
        yield lambda words: progress.update(task, description=words)


def _print_result(result: Result, folder: Path | None) -> None:
    out, machine = console(), result.machine
    core = "not pinned" if machine["pinned_to"] is None else f"core {machine['pinned_to']}"
    out.print(f"[bold]{machine['cpu']}[/], {core} of {machine['cores']}, {machine['system']}\n")
    for sheet in sheets(result):
        out.print(_table(sheet))
        for words in sheet.remarks:
            out.print(f"- {words}", markup=False)
        out.print()
    for words in (*result.notes, WHAT_IS_TIMED, HOW):
        out.print(words, markup=False)
    if folder is not None:
        out.print(f"report: {folder / 'bench.html'}", highlight=False, soft_wrap=True)


def _table(sheet: Sheet) -> Table:
    table = Table(
        title=sheet.title,
        caption=sheet.caption,
        title_justify="left",
        caption_justify="left",
        title_style="bold",
        box=None,
        header_style="bold",
    )
    for i, head in enumerate(sheet.heads):
        table.add_column(head, justify="right" if sheet.is_figure(i) else "left")
    for line in sheet.lines:
        table.add_row(*line)
    return table
