"""What the commands ``study`` and ``report`` print: verdicts in words, numbers and criteria."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl
from rich.markup import escape
from rich.table import Table

from scenarios.console import console
from scenarios.report_style import number
from scenarios.scenario import Criterion
from scenarios.study.campaign import Campaign
from scenarios.study.study import Study
from scenarios.study.verdict import verdicts
from scenarios.study.word import factor_title, level_text, shown

MOST_ROWS = 24
"""Rows of a study that are printed; the files hold all of them."""
MOST_FOUND = 40
"""Rows of a query that are printed."""
MOST_SHOWN = 4
"""Measures of a row that are printed, the most telling ones."""
WIDTH = 100


def print_campaign(campaign: Campaign, folder: Path) -> None:
    """Print the verdict on a study that has just been made, and where its report is."""
    study = campaign.plan.study
    print_conclusion(study, campaign.table, campaign.criteria, campaign.summary, folder)


def print_conclusion(
    study: Study,
    table: pl.DataFrame,
    criteria: Sequence[Criterion],
    summary: Mapping[str, Any],
    folder: Path,
) -> None:
    """Print verdict, rows if they are few, each controller in words, criteria, and the report.

    Args:
        study: what was studied.
        table: its rows; some may be missing.
        criteria: its verdict.
        summary: what summary.json holds.
        folder: where the report is.
    """
    out = console()
    out.width = min(out.width, WIDTH)
    done, rows = summary["rows_done"], summary["rows"]
    verdict = "[green]PASSED[/]" if summary["passed"] else "[red]FAILED[/]"
    verdict = verdict if done == rows else "[yellow]UNFINISHED[/]"
    counts = ", ".join(f"{count} {kind}" for kind, count in summary["outcomes"].items() if count)
    count = f"{rows} rows" if done == rows else f"{done} of {rows} rows"
    out.print(f"[bold]study {escape(study.name)}[/], {count} ({counts}) {verdict}")
    if len(table) <= MOST_ROWS:
        out.print("", _rows(study, table), sep="\n")
    words = Table(box=None, header_style="bold", pad_edge=False)
    words.add_column("controller", no_wrap=True)
    words.add_column("verdict")
    for name, said in verdicts(summary).items():
        words.add_row(escape(name), escape(f"{said}."))
    out.print("", words, sep="\n")
    if criteria:
        out.print("", _criteria(criteria), sep="\n")
    if timing := summary["timing"]:
        out.print(
            f"{timing['rows_made']} rows made in {timing['elapsed_s']:.1f} s, "
            f"{timing['rows_per_s']:.1f} /s"
        )
    out.print(f"report: {folder / 'report.html'}", soft_wrap=True, markup=False)


def print_rows(table: pl.DataFrame) -> None:
    """Print the rows that a query found."""
    out = Table(*table.columns, box=None, header_style="bold")
    for row in table.head(MOST_FOUND).iter_rows():
        out.add_row(*(_number(value) for value in row))
    if len(table) > MOST_FOUND:
        out.caption = f"the first {MOST_FOUND} of {len(table)} rows"
    console().print(out)


def _rows(study: Study, table: pl.DataFrame) -> Table:
    """Return the rows: factors, and what is shown with its closed form."""
    out = Table(box=None, header_style="bold", pad_edge=False)
    for factor in study.columns:
        out.add_column(escape(factor_title(factor)), justify="right")
    out.add_column("controller", no_wrap=True)
    names = shown(study)[:MOST_SHOWN]
    for name in names:
        closed = f"{name}_closed" in study.measures
        out.add_column(f"{name}\n(closed form)" if closed else name, justify="right")
    out.add_column("outcome", no_wrap=True)
    for row in table.iter_rows(named=True):
        point = [level_text(study, f, row[f.column]) for f in study.columns]
        numbers = []
        for name in names:
            form = row.get(f"{name}_closed")
            more = "" if form is None else f" ({number(form, 4)})"
            numbers.append(f"{_short(row[name])}{more}")
        out.add_row(*point, row["controller"], *numbers, row["outcome"])
    return out


def _criteria(criteria: Sequence[Criterion]) -> Table:
    table = Table("criterion", "value", "limit", "", box=None, header_style="bold", pad_edge=False)
    for c in criteria:
        mark = "[green]ok[/]" if c.passed else "[red]missed[/]"
        value = f"{c.value:.3g}" if c.value == c.value else "none"
        table.add_row(c.name, value, f"≤ {c.limit:g}", mark)
    return table


def _short(value: float | None) -> str:
    return "–" if value is None else number(value, 4)


def _number(value: object) -> str:
    if value is None:
        return "–"
    return f"{value:.5g}" if isinstance(value, float) else str(value)
