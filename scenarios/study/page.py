"""The page of a study: verdict, controllers, figures, tables, and its first rows."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import polars as pl

from scenarios import report_page as house
from scenarios.panel import Panel
from scenarios.report_style import MUTED
from scenarios.scenario import Criterion
from scenarios.study.outcome import counts_text
from scenarios.study.page_published import published_section
from scenarios.study.page_table import (
    controller_section,
    factor_section,
    rows_details,
    worst_section,
)
from scenarios.study.picture import study_panels
from scenarios.study.study import Study
from scenarios.study.word import is_nothing, limit_words, paragraphs, unit_of


def render_study(
    study: Study,
    table: pl.DataFrame,
    criteria: Sequence[Criterion],
    summary: Mapping[str, Any],
) -> str:
    """Return the page; it needs no network and no other file.

    Args:
        study: what was studied.
        table: one row a rollout; some may be missing.
        criteria: its verdict.
        summary: what summary.json holds.
    """
    panels = study_panels(study, table, summary)
    body = [
        _header(study, criteria, summary),
        _notes(study),
        _criteria(study, criteria),
        controller_section(study, summary),
        published_section(study, table, summary),
        worst_section(study, table),
        *(house.section(p) if p.figure else _words(p) for p in panels),
        factor_section(study),
        rows_details(study, table),
        house.details(
            "Configuration and versions",
            {"Configuration": summary["configuration"], "Code": summary["code"]},
        ),
    ]
    return house.page(f"study {study.name}", [piece for piece in body if piece], panels)


def _header(study: Study, criteria: Sequence[Criterion], summary: Mapping[str, Any]) -> str:
    done, rows = summary["rows_done"], summary["rows"]
    counts = counts_text(summary["outcomes"])
    kind = "rollouts" if study.search is None else "searches"
    said = f": {counts}" if counts and study.search is None else ""
    words = f"{study.summary[:1].upper()}{study.summary[1:]}. {done} {kind}{said}. "
    words += _made(summary)
    if done == rows and criteria:
        return house.header("qpctrl · study", study.name, words, criteria)
    mark, more = "NOT JUDGED", "the study has no criteria"
    if done < rows:
        mark, more = "UNFINISHED", f"{done} of {rows} rows"
    return (
        f'<header><div><div class="kicker">qpctrl · study</div><h1>{escape(study.name)}</h1>'
        f'<p>{escape(words)}</p></div><div class="verdict" style="background: {MUTED}">'
        f"<strong>{mark}</strong><span>{more}</span></div></header>"
    )


def _made(summary: Mapping[str, Any]) -> str:
    """Return the seed, and how long the rows took, if that is known."""
    seed, timing = f"Seed {summary['seed']}", summary["timing"]
    if not timing:
        return f"{seed}; how long it took is not known."
    took = f"{timing['rows_made']} rows made in {timing['elapsed_s']:.1f} s"
    return f"{seed}; {took}, {timing['rows_per_s']:.1f} /s."


def _notes(study: Study) -> str:
    """Return what a reader must know, paragraph by paragraph."""
    if not study.notes:
        return ""
    parts = "".join(f"<p>{escape(part)}</p>" for part in paragraphs(study.notes))
    return f"<section><h2>Notes</h2>{parts}</section>"


def _criteria(study: Study, criteria: Sequence[Criterion]) -> str:
    if not criteria:
        return ""
    limits = dict(zip((c.name for c in criteria), study.criteria, strict=True))
    words = {name: limit_words(study, limit) for name, limit in limits.items()}
    units = [unit_of(study, limit.measure) for limit in study.criteria]
    shown = [
        c._replace(unit=unit, value=0.0 if is_nothing(c) else c.value)
        for c, unit in zip(criteria, units, strict=True)
    ]
    return house.criteria_section(shown, words)


def _words(panel: Panel) -> str:
    """Return the place of a panel that has no figure, with its words."""
    return (
        f'<section><h2>{escape(panel.title)}</h2><p class="caption">{escape(panel.caption)}</p>'
        "</section>"
    )
