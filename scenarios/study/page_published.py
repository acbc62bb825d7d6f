"""Numbers that others publish, beside ours: tables on the page of a study."""

from collections.abc import Mapping
from html import escape
from typing import Any, NamedTuple

import polars as pl

from scenarios import report_page as house
from scenarios.study.page_table import dot, heads_row, line
from scenarios.study.study import Along, Published, Study
from scenarios.study.verdict import span
from scenarios.study.word import digits_of, entry, factor_title, level_text, title


class Quoted(NamedTuple):
    """One column: a measure, as a mean or as the largest over the rollouts."""

    measure: str
    largest: bool

    def ours(self, one: Mapping[str, float]) -> float:
        """Return our number."""
        return one["max" if self.largest else "value"]

    def theirs(self, other: Published) -> float | None:
        """Return their number, if it is of this kind."""
        same = (self.measure in other.largest) == self.largest
        return other.measures.get(self.measure) if same else None

    def head(self, words: str) -> str:
        """Return the head of the column."""
        return f"{words}, largest over the rollouts" if self.largest else words


def quoted(study: Study) -> tuple[Quoted, ...]:
    """Return what others publish, each once."""
    found = (Quoted(n, n in one.largest) for one in study.published for n in one.measures)
    return tuple(dict.fromkeys(found))


def deviating(study: Study) -> frozenset[str]:
    """Return the measures of which others give the standard deviation."""
    return frozenset(name for one in study.published for name in one.deviations)


def published_section(study: Study, table: pl.DataFrame, summary: Mapping[str, Any]) -> str:
    """Return what others report beside ours; nothing where the study has none of it."""
    if not study.published:
        return ""
    columns, spread, lines = quoted(study), deviating(study), []
    for i, (controller, one) in enumerate(summary["controllers"].items()):
        cells = [_ours(q, one["measures"].get(q.measure), spread) for q in columns]
        lines.append(line(f"{dot(i)}{escape(controller)}<br><code>ours</code>", cells))
    lines += [
        line(_source(other), [_theirs(q, other) for q in columns]) for other in study.published
    ]
    small = "their 95 % intervals" if summary["sampled"] else "the smallest and largest"
    words = f"Means over the rollouts of this study, in small {small}, and what others report."
    if any(q.largest for q in columns):
        words += " Where the head says so, both are the largest over the rollouts."
    if spread:
        words += " ±: standard deviation over the rollouts."
    heads = [escape(q.head(title(study, q.measure))) for q in columns]
    body = house.table(heads_row("controller", heads), lines) if columns else ""
    caption = f'<p class="caption">{escape(words)}</p>'
    along = "".join(_along(study, table, *key) for key in _followed(study))
    return f"<section><h2>Beside published numbers</h2>{caption}{body}{along}</section>"


def mean_at(table: pl.DataFrame, controller: str, along: Along, column: str, x: float) -> Any:
    """Return our mean of a measure at a value of a factor; None where there is none."""
    here = (pl.col("controller") == controller) & ((pl.col(column) - x).abs() < 1e-9)
    return table.filter(here)[along.measure].mean()


def _followed(study: Study) -> dict[tuple[str, str], None]:
    """Return each factor and measure along which others give numbers."""
    return dict.fromkeys((a.factor, a.measure) for o in study.published for a in o.along)


def _along(study: Study, table: pl.DataFrame, factor_name: str, measure: str) -> str:
    """Return our means and their numbers at the values of a factor."""
    factor = next(f for f in study.columns if f.name == factor_name)
    theirs = {
        other.name: one
        for other in study.published
        for one in other.along
        if (one.factor, one.measure) == (factor_name, measure)
    }
    places = sorted({x for one in theirs.values() for x in one.at})
    lines = []
    for i, controller in enumerate(study.controllers):
        one = next(iter(theirs.values()))
        means = [mean_at(table, controller, one, factor.column, x) for x in places]
        cells = ["–" if y is None else entry(measure, y) for y in means]
        lines.append(line(f"{dot(i)}{escape(controller)} <code>ours</code>", cells))
    for name, one in theirs.items():
        known = dict(zip(one.at, one.values, strict=True))
        cells = [entry(measure, known[x]) if x in known else "–" for x in places]
        lines.append(line(escape(name), cells))
    heads = [level_text(study, factor, x) for x in places]
    words = f"{title(study, measure)} by {factor_title(factor)}"
    return f"<h3>{escape(words[:1].upper() + words[1:])}</h3>" + house.table(
        heads_row("controller", heads), lines
    )


def _ours(
    column: Quoted,
    one: Mapping[str, float] | None,
    spread: frozenset[str],
) -> str:
    if one is not None and column.largest:
        return entry(column.measure, one["max"])
    if one is None:
        return "–"
    cell = entry(column.measure, one["value"])
    if column.measure in spread:
        cell += f" ± {entry(column.measure, one['deviation'])}"
    low, high = (one[key] for key in (("low", "high") if "low" in one else ("min", "max")))
    return f"{cell}<br><code>{span(low, high, digits_of(column.measure))}</code>"


def _theirs(column: Quoted, other: Published) -> str:
    value = column.theirs(other)
    if value is None:
        return "–"
    deviation = None if column.largest else other.deviations.get(column.measure)
    more = "" if deviation is None else f" ± {entry(column.measure, deviation)}"
    return f"{entry(column.measure, value)}{more}"


def _source(other: Published) -> str:
    note = f"; {escape(other.note)}" if other.note else ""
    words = f"<span style='white-space: normal'>{note}</span>"
    return f"{escape(other.name)}<br><code>{escape(other.source)}</code>{words}"
