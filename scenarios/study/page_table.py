"""Tables on the page of a study: controllers with their verdicts, published numbers, rows."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import polars as pl

from scenarios import report_page as house
from scenarios.report_style import SERIES, number
from scenarios.study.outcome import FAILURES
from scenarios.study.search import Worst
from scenarios.study.study import Published, Study
from scenarios.study.verdict import is_signed, span, verdicts
from scenarios.study.word import factor_title, level_text, shown, title, titled, unit_text

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
        cells += [_mean(summary, name, one["measures"].get(name)) for name in names]
        lines.append(_line(f"{_dot(i)}{escape(controller)}", cells))
    said = "".join(
        f"<p>{_dot(i)}<b>{escape(controller)}</b>: {escape(words)}.</p>"
        for i, (controller, words) in enumerate(verdicts(summary).items())
    )
    words = (
        "Rates with Wilson intervals, means with bootstrap intervals over the rollouts that have "
        "the number; all of 95 %. What has a sign is given from its smallest to its largest value. "
        "Controllers are told apart only where their intervals do not overlap; one with rollouts "
        "that diverged is not compared in the mean of the others."
    )
    body = house.table(_heads("controller", heads), lines)
    caption = f'<p class="caption">{escape(words)}</p>'
    return f"<section><h2>Controllers</h2>{said}{caption}{body}</section>"


def published_section(study: Study, summary: Mapping[str, Any]) -> str:
    """Return what others report beside our means; nothing where the study has none of it."""
    if not study.published:
        return ""
    names = list(dict.fromkeys(name for one in study.published for name in one.measures))
    lines = []
    for i, (controller, one) in enumerate(summary["controllers"].items()):
        cells = [_mean(summary, name, one["measures"].get(name)) for name in names]
        lines.append(_line(f"{_dot(i)}{escape(controller)}<br><code>ours</code>", cells))
    for other in study.published:
        cells = [number(other.measures[n]) if n in other.measures else "–" for n in names]
        lines.append(_line(_source(other), cells))
    words = "Means over the rollouts of this study, and what others report of the same job."
    table = house.table(_heads("controller", [escape(title(study, n)) for n in names]), lines)
    caption = f'<p class="caption">{escape(words)}</p>'
    return f"<section><h2>Beside published numbers</h2>{caption}{table}</section>"


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
                cells.append(_cell(value))
            else:
                cells.append(level_text(study, factor, value))
        lines.append(_line(f"{_dot(place)}{escape(row['controller'])}", cells))
    heads = ["outcome", *(escape(titled_name(study, name)) for name in names)]
    words = f"Each row is one search. Largest {study.search.measure}, and where it occurs."
    body = house.table(_heads("controller", heads), lines)
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
        "<tr>" + "".join(f'<td class="n">{_cell(row[name])}</td>' for name in names) + "</tr>"
        for row in table.head(MOST_ROWS).iter_rows(named=True)
    ]
    words = f"The first {MOST_ROWS} of {len(table)} rows" if len(table) > MOST_ROWS else "Rows"
    body = house.table(f"<tr>{head}</tr>", lines)
    return f"<details><summary>{escape(words)}</summary>{body}</details>"


def _source(other: Published) -> str:
    note = f"; {escape(other.note)}" if other.note else ""
    words = f"<span style='white-space: normal'>{note}</span>"
    return f"{escape(other.name)}<br><code>{escape(other.source)}</code>{words}"


def _head(summary: Mapping[str, Any], name: str) -> str:
    words, unit = (summary["measures"][name][key] for key in ("words", "unit"))
    return escape(titled(words, unit))


def _heads(first: str, others: Sequence[str]) -> str:
    cells = "".join(f'<th class="n" style="white-space: normal">{head}</th>' for head in others)
    return f"<tr><th>{escape(first)}</th>{cells}</tr>"


def _words_line(name: str, words: str, cells: Sequence[str]) -> str:
    others = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
    return f"<tr><td>{escape(words)}<br><code>{escape(name)}</code></td>{others}</tr>"


def _line(first: str, cells: Sequence[str]) -> str:
    return (
        f"<tr><td style='white-space: nowrap'>{first}</td>"
        + "".join(f'<td class="n">{c}</td>' for c in cells)
        + "</tr>"
    )


def _percent(rate: Mapping[str, float] | None) -> str:
    if rate is None:
        return "–"
    value, low, high = (number(100 * rate[key]) for key in ("value", "low", "high"))
    return f"{value}<br><code>{low} … {high}</code>"


def _mean(summary: Mapping[str, Any], name: str, one: Mapping[str, float] | None) -> str:
    if one is None:
        return "–"
    if one["rollouts"] == 1:
        return number(one["value"])
    if is_signed(summary, name) or "boundary" in summary["configuration"]:
        return f"<code>from</code> {span(one['min'], one['max'])}"
    return f"{number(one['value'])}<br><code>{span(one['low'], one['high'])}</code>"


def _dot(place: int) -> str:
    return f'<span style="color: {SERIES[place % len(SERIES)]}">●</span> '


def _cell(value: object) -> str:
    if isinstance(value, str):
        return escape(value)
    return "–" if value is None else number(value, 5)
