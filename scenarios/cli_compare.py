"""The command ``qpctrl compare``."""

import dataclasses
import json
from typing import Literal

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from qpctrl.compiled import CompileMode
from scenarios.command import interactive, parse
from scenarios.compare import CASES, compare
from scenarios.console import console
from scenarios.equivalence import Row
from scenarios.eraser import Eraser
from scenarios.run import run_scenario
from scenarios.scenario import Options


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparing:
    """Flags of ``compare``."""

    states: int = 1000
    """Random states for each arm and number of constraint rows."""
    solver: str = "active-set"
    """Solver under test."""
    second: str = "proxsuite"
    """Solver to agree with where limits are active."""
    form: Literal["reduced", "full"] = "reduced"
    """Variables of the QP: (a, λ) or (a, τ, λ)."""
    compiled: CompileMode = "auto"
    """Whether the ticks under test run as generated C; each is then compared with itself
    interpreted."""
    seed: int = 0
    """Seed of the random states."""
    json: bool = False
    """Print JSON."""


def compare_command(arguments: list[str]) -> bool:
    """Compare QP and closed forms, print the table; return whether its criteria hold.

    Raises:
        InputError: flags that cannot be used.
    """
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
                compiled=given.compiled,
                seed=given.seed,
                watch=lambda case, done: progress.update(task, advance=50),
            )
        )
        progress.update(task, description="eraser")
        how = Options(solver=given.solver, form=given.form, compiled=given.compiled)
        eraser = run_scenario(Eraser(duration=2.0), how)
    failed = [c for row in rows for c in row.criteria() if not c.passed]
    gap = eraser.summary["metrics"]["qp_law_gap_max"]
    passed = not failed and eraser.passed
    if given.json:
        table = [dataclasses.asdict(row) for row in rows]
        print(json.dumps({"passed": passed, "table": table, "eraser_law_gap": gap}, indent=2))
        return passed
    out = console()
    out.print(_equivalence_table(rows))
    out.print(
        f"eraser, wiping 2 s: QP − hybrid {gap:.1e} of max |τ|, "
        f"criteria {'all hold' if eraser.passed else 'missed'}"
    )
    for criterion in failed:
        out.print(f"[red]missed[/] {criterion.name}: {criterion.value:.2e} > {criterion.limit:g}")
    out.print("[green]PASSED[/]" if passed else "[red]FAILED[/]")
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
            "compiled",
        ),
        *("limited", "two solvers", "singular", "unsolved"),
        box=None,
        header_style="bold",
        caption="largest over the states, relative to max |τ|; polish: what it changes in the "
        "solver's own answer; compiled: against interpreted; limited: states with active torque "
        "limits; singular: Λ damped, no equality claimed",
    )
    for row in rows:
        gaps = (
            *(row.law_gap, row.own_gap, row.textbook_gap, row.curvature_gap),
            row.kkt,
        )
        compiled = "–" if row.compiled_gap is None else f"{row.compiled_gap:.1e}"
        table.add_row(
            *(row.robot, str(row.k), str(row.states), *(f"{gap:.1e}" for gap in gaps), compiled),
            *(str(row.limited), f"{row.solver_gap:.1e}", str(row.damped), str(row.unsolved)),
        )
    return table
