"""What the commands ``study`` and ``report`` print: verdicts in words, numbers and criteria."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from scenarios.console import console
from scenarios.scenario import Criterion
from scenarios.study.campaign import Campaign
from scenarios.study.importance import ranking
from scenarios.study.outcome import counts_text
from scenarios.study.page_published import deviating, quoted
from scenarios.study.study import Study
from scenarios.study.verdict import verdicts
from scenarios.study.word import (
    ROUND_OFF,
    entry,
    factor_title,
    is_nothing,
    level_text,
    paragraphs,
    shown,
    words_of,
)

MOST_ROWS = 24
"""Rows of a study that are printed; the files hold all of them."""
MOST_FOUND = 40
"""Rows of a query that are printed."""
MOST_SHOWN = 4
"""Measures of a row that are printed, the most telling ones."""
MOST_FACTORS = 5
"""Factors of a ranking that are printed."""
WIDTH = 100
GAP = 2  # between columns


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
    """Print all that a study found, in short, and where its report is.

    Verdict, notes, rows if they are few, controllers in words, what others publish, the ranking of
    the factors, criteria.

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
    counts = counts_text(summary["outcomes"])
    count = f"{rows} rows" if done == rows else f"{done} of {rows} rows"
    out.print(f"[bold]study {escape(study.name)}[/], {count} ({counts}) {verdict}")
    for part in paragraphs(study.notes):
        out.print("", part, sep="\n", markup=False, highlight=False)
    if len(table) <= MOST_ROWS:
        out.print("", _widest(out, study, table), sep="\n")
    words = Table(box=None, header_style="bold", pad_edge=False)
    words.add_column("controller", no_wrap=True)
    words.add_column("verdict")
    for name, said in verdicts(summary).items():
        words.add_row(escape(name), escape(f"{said}."))
    out.print("", words, sep="\n")
    if study.published:
        out.print("", _published(study, summary), sep="\n")
    if matters := summary.get("sensitivity"):
        out.print("", _ranking(study, matters), sep="\n")
    if criteria:
        out.print("", _criteria(criteria), sep="\n")
    if timing := summary["timing"]:
        out.print(
            f"{timing['rows_made']} rows made in {timing['elapsed_s']:.1f} s, "
            f"{timing['rows_per_s']:.1f} /s"
        )
    out.print(f"report: {folder / 'report.html'}", soft_wrap=True, markup=False)


def print_rows(table: pl.DataFrame) -> None:
    """Print the rows that a query found, and as many of their columns as there is room for."""
    out = console()
    rows = [[_number(value) for value in row] for row in table.head(MOST_FOUND).iter_rows()]
    count = _fitting(table.columns, rows, out.width)
    shown_table = Table(*table.columns[:count], box=None, header_style="bold")
    for row in rows:
        shown_table.add_row(*row[:count])
    out.print(shown_table)
    if len(table) > MOST_FOUND:
        out.print(f"the first {MOST_FOUND} of {len(table)} rows", highlight=False)
    if count < table.width:
        words = f"{count} of {table.width} columns; select some, or --json"
        out.print(words, highlight=False)


def _fitting(names: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> int:
    """Return how many of the first columns fit side by side; at least one."""
    columns = zip(names, *rows, strict=True)
    ends = itertools.accumulate(max(map(len, column)) + GAP for column in columns)
    return max(sum(end <= width for end in ends), 1)


def _published(study: Study, summary: Mapping[str, Any]) -> Table:
    """Return what others report beside ours: means, or the largest where theirs is."""
    out = Table(box=None, header_style="bold", pad_edge=False)
    out.add_column("beside published", no_wrap=True)
    columns, spread = quoted(study), deviating(study)
    for q in columns:
        out.add_column(f"{q.measure}\n({'largest' if q.largest else 'mean'})", justify="right")
    for name, one in summary["controllers"].items():
        cells = []
        for q in columns:
            found = one["measures"].get(q.measure)
            more = not q.largest and q.measure in spread and found is not None
            deviation = found["deviation"] if more and found else None
            cells.append(_deviating(q.measure, found and q.ours(found), deviation))
        out.add_row(f"{escape(name)}, ours", *cells)
    for other in study.published:
        cells = [
            _deviating(
                q.measure, q.theirs(other), None if q.largest else other.deviations.get(q.measure)
            )
            for q in columns
        ]
        out.add_row(escape(other.name), *cells)
    return out


def _ranking(study: Study, matters: Mapping[str, Any]) -> Table:
    """Return the factors that matter most to the first measure that is shown."""
    name, morris = shown(study)[0], study.design.kind == "morris"
    kind = "mean size of effect μ*" if morris else "total index"
    out = Table(box=None, header_style="bold", pad_edge=False)
    out.add_column("controller", no_wrap=True)
    out.add_column(f"{kind} for {words_of(study, name)}, with its 95 % interval")
    for controller, found in matters["controllers"].items():
        ranked = ranking(found[name], matters["factors"])
        told = [f"{factor} {_rate(rate)}" for factor, rate in ranked[:MOST_FACTORS]]
        said = ", ".join(told) or f"none, {found[name].get('note', 'no number')}"
        more = len(ranked) - MOST_FACTORS
        said += f"; {more} more are smaller" if more > 0 else ""
        out.add_row(escape(controller), escape(said))
    return out


def _rate(rate: Mapping[str, float | None]) -> str:
    value, low, high = (_short("", rate[key], 3) for key in ("value", "low", "high"))
    return f"{value} ({low} … {high})"


def _deviating(name: str, value: float | None, deviation: float | None) -> str:
    more = "" if deviation is None else f" ± {entry(name, deviation)}"
    return f"{_short(name, value, 3)}{more}"


def _widest(out: Console, study: Study, table: pl.DataFrame) -> Table:
    """Return the rows with as many of the measures that are shown as fit; at least one."""
    unbound = out.options.update(max_width=10 * WIDTH)
    for count in range(MOST_SHOWN, 1, -1):
        rows = _rows(study, table, shown(study)[:count])
        if Measurement.get(out, unbound, rows).maximum <= out.width:
            return rows
    return _rows(study, table, shown(study)[:1])


def _rows(study: Study, table: pl.DataFrame, names: Sequence[str]) -> Table:
    """Return the rows: factors, and measures with their closed forms."""
    out = Table(box=None, header_style="bold", pad_edge=False)
    for factor in study.columns:
        out.add_column(escape(factor_title(factor)), justify="right")
    out.add_column("controller", no_wrap=True)
    for name in names:
        closed = f"{name}_closed" in study.measures
        out.add_column(f"{name}\n(closed form)" if closed else name, justify="right")
    out.add_column("outcome", no_wrap=True)
    for row in table.iter_rows(named=True):
        point = [level_text(study, f, row[f.column]) for f in study.columns]
        numbers = []
        for name in names:
            form = row.get(f"{name}_closed")
            more = "" if form is None else f" ({entry(name, form, 4)})"
            numbers.append(f"{_short(name, row[name])}{more}")
        out.add_row(*point, row["controller"], *numbers, row["outcome"])
    return out


def _criteria(criteria: Sequence[Criterion]) -> Table:
    table = Table("criterion", "value", "limit", "", box=None, header_style="bold", pad_edge=False)
    for c in criteria:
        mark = "[green]ok[/]" if c.passed else "[red]missed[/]"
        value = f"{c.value:.3g}" if c.value == c.value else "none"
        value = "0" if is_nothing(c) else value
        table.add_row(c.name, value, f"≤ {c.limit:g}", mark)
    return table


def _short(name: str, value: float | None, digits: int = 4) -> str:
    return "–" if value is None else entry(name, value, digits)


def _number(value: object) -> str:
    if value is None:
        return "–"
    if not isinstance(value, float):
        return str(value)
    return "0" if abs(value) < ROUND_OFF else f"{value:.5g}"
