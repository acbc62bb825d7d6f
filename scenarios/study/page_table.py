"""Tables on the page of a study: controllers with their verdicts, published numbers, rows."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import polars as pl

from scenarios import report_page as house
from scenarios.report_style import SERIES, number
from scenarios.study.outcome import FAILURES
from scenarios.study.search import Worst
from scenarios.study.study import Study
from scenarios.study.verdict import is_signed, span, verdicts
from scenarios.study.word import (
    amount,
    digits_of,
    entry,
    factor_title,
    level_text,
    shown,
    title,
    titled,
    unit_text,
)

SAMPLED = (
    "Rates with Wilson intervals, means with bootstrap intervals over the rollouts that have the "
    "number; all of 95 %, and rollouts that share their random numbers or their point count as "
    "one draw. What has a sign is given from its smallest to its largest value. Controllers are "
    "told apart only where the interval of their difference, draw by draw, leaves out zero, and "
    "where that is 1 % or more; one with rollouts that diverged is not compared in the mean of the "
    "others."
)
CHOSEN = (
    "One rollout at each chosen point is no sample, so there are no intervals: numbers are given "
    "from the smallest to the largest over the points. Controllers are told apart only where these "
    "ranges do not overlap; one with rollouts that diverged is not compared in the others."
)
"""What the numbers of controllers are, by whether the rollouts are a sample."""

MOST_ROWS = 200
"""Rows that the page shows; the files hold all of them."""
MOST_WORST = 50
"""Settings that a search found which the page shows."""


def controller_section(study: Study, summary: Mapping[str, Any]) -> str:
    """Return rates and means of each controller, and what they say in words."""
    kinds = [kind for kind, count in summary["outcomes"].items() if count]
    names = [name for name in shown(study) if name in summary["measures"]]
    heads = [f"{kind}<br>% of rollouts" for kind in kinds] if study.search is None else []
    heads += [_head(summary, name) for name in names]
    lines = []
    for i, (controller, one) in enumerate(summary["controllers"].items()):
        cells = [_percent(one["rates"].get(kind)) for kind in kinds] if study.search is None else []
        cells += [mean_cell(summary, name, one["measures"].get(name)) for name in names]
        lines.append(line(f"{dot(i)}{escape(controller)}", cells))
    said = "".join(
        f"<p>{dot(i)}<b>{escape(controller)}</b>: {escape(words)}.</p>"
        for i, (controller, words) in enumerate(verdicts(summary).items())
    )
    words = SAMPLED if summary["sampled"] else CHOSEN
    body = house.table(heads_row("controller", heads), lines)
    caption = f'<p class="caption">{escape(words)}</p>'
    return f"<section><h2>Controllers</h2>{said}{caption}{body}</section>"


def worst_section(study: Study, table: pl.DataFrame) -> str:
    """Return the worst settings that a search found, the worst of all first."""
    if not isinstance(study.search, Worst) or table.is_empty():
        return ""
    names = list(study.measures)
    order = table.sort(
        ~pl.col("outcome").is_in(list(FAILURES)),
        -pl.col(names[0]),
        nulls_last=False,
        maintain_order=True,
    )
    choices = {f"worst_{f.column}": f for f in study.factors}
    lines = []
    for row in order.head(MOST_WORST).iter_rows(named=True):
        place = list(study.controllers).index(row["controller"])
        cells = [row["outcome"]]
        for name in names:
            value, factor = row[name], choices.get(name)
            if value is None or factor is None:
                cells.append(_cell(name, value))
            else:
                cells.append(level_text(study, factor, value))
        lines.append(line(f"{dot(place)}{escape(row['controller'])}", cells))
    heads = ["outcome", *(escape(titled_name(study, name)) for name in names)]
    words = f"Each row is one search. Largest {study.search.measure}, and where it occurs."
    body = house.table(heads_row("controller", heads), lines)
    caption = f'<p class="caption">{escape(words)}</p>'
    return f"<section><h2>Worst settings found</h2>{caption}{body}</section>"


def titled_name(study: Study, name: str) -> str:
    """Return the head of a column of worst settings: a factor's name, or a measure's words."""
    for factor in study.factors:
        if name == f"worst_{factor.column}":
            return factor_title(factor)
    return title(study, name)


def factor_section(study: Study) -> str:
    """Return what varies and how, and what has a value of its own."""
    parameters = study.system.parameters
    lines = []
    for factor in study.factors:
        low, high = (level_text(study, factor, x) for x in (factor.low, factor.high))
        few = [level_text(study, factor, x) for x in factor.values]
        how = "given values" if few else factor.distribution
        cells = [", ".join(few) or f"{low} … {high}", unit_text(factor.unit), how]
        lines.append(_words_line(factor.name, parameters[factor.name].words, cells))
    for name, value in study.fixed.items():
        one = parameters[name]
        text = one.choices[round(value)] if one.choices else number(value, 4)
        lines.append(_words_line(name, one.words, [text, unit_text(one.unit), "fixed"]))
    if not lines:
        return ""
    head = "<tr><th>what</th><th>range</th><th>unit</th><th>how</th></tr>"
    return f"<section><h2>Factors</h2>{house.table(head, lines)}</section>"


def rows_details(study: Study, table: pl.DataFrame) -> str:
    """Return the first rows, which open with a click."""
    names = [f.column for f in study.columns] + ["controller", "outcome", *study.measures]
    head = "".join(f'<th class="n">{escape(name)}</th>' for name in names)
    lines = [
        "<tr>" + "".join(f'<td class="n">{_cell(name, row[name])}</td>' for name in names) + "</tr>"
        for row in table.head(MOST_ROWS).iter_rows(named=True)
    ]
    words = f"The first {MOST_ROWS} of {len(table)} rows" if len(table) > MOST_ROWS else "Rows"
    body = house.table(f"<tr>{head}</tr>", lines)
    return f"<details><summary>{escape(words)}</summary>{body}</details>"


def _head(summary: Mapping[str, Any], name: str) -> str:
    words, unit = (summary["measures"][name][key] for key in ("words", "unit"))
    return escape(titled(words, unit))


def heads_row(first: str, others: Sequence[str]) -> str:
    """Return the heads of a table; all but the first are HTML."""
    cells = "".join(f'<th class="n" style="white-space: normal">{head}</th>' for head in others)
    return f"<tr><th>{escape(first)}</th>{cells}</tr>"


def _words_line(name: str, words: str, cells: Sequence[str]) -> str:
    others = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
    return f"<tr><td>{escape(words)}<br><code>{escape(name)}</code></td>{others}</tr>"


def line(first: str, cells: Sequence[str]) -> str:
    """Return a row of a table from pieces of HTML."""
    return (
        f"<tr><td style='white-space: nowrap'>{first}</td>"
        + "".join(f'<td class="n">{c}</td>' for c in cells)
        + "</tr>"
    )


def _percent(rate: Mapping[str, float] | None) -> str:
    if rate is None:
        return "–"
    value = amount(100 * rate["value"])
    if "low" not in rate:
        return value
    low, high = (amount(100 * rate[key]) for key in ("low", "high"))
    return f"{value}<br><code>{low} … {high}</code>"


def mean_cell(summary: Mapping[str, Any], name: str, one: Mapping[str, float] | None) -> str:
    """Return a mean with its interval, or a range; a dash where there is none."""
    digits = digits_of(name)
    if one is None:
        return "–"
    if one["rollouts"] == 1:
        return amount(one["value"], digits)
    ranged = "low" not in one or "boundary" in summary["configuration"]
    if ranged or is_signed(summary, name):
        return f"<code>from</code> {span(one['min'], one['max'], digits)}"
    interval = span(one["low"], one["high"], digits)
    return f"{amount(one['value'], digits)}<br><code>{interval}</code>"


def dot(place: int) -> str:
    """Return the mark of the controller at a place, in its colour."""
    return f'<span style="color: {SERIES[place % len(SERIES)]}">●</span> '


def _cell(name: str, value: object) -> str:
    if isinstance(value, int | float):
        return entry(name, value, 5)
    return "–" if value is None else escape(str(value))
