"""The page of a study: verdict, criteria, outcomes, figures, and every row."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import polars as pl

from scenarios import report_page as house
from scenarios.report_style import number
from scenarios.scenario import Criterion
from scenarios.study.study import Study

WORDS = {
    "force_gap": "Force while holding still, against its closed form; worst rollout",
    "offset_gap": "Tangential offset while holding still, against its closed form; worst rollout",
    "speed_gap": "True speed while sliding, against v / cos α; worst rollout",
    "qp_law_gap_max": "QP against the hybrid law, worst tick of all",
    "fallback_ticks": "Ticks that sent the fallback torque, worst rollout",
    "rollouts_diverged": "Rollouts that diverged",
}
"""Words of each criterion."""

MOST_ROWS = 200
"""Rows that the page shows; the files hold all of them."""


def render_study(
    study: Study,
    table: pl.DataFrame,
    criteria: Sequence[Criterion],
    summary: Mapping[str, Any],
) -> str:
    """Return the page; it needs no network and no other file.

    Args:
        study: what was studied.
        table: one row a rollout.
        criteria: its verdict.
        summary: what summary.json holds.
    """
    panels = [panel for panel in study.panels(table) if panel.figure]
    counts = summary["outcomes"]
    said = ", ".join(f"{count} {kind}" for kind, count in counts.items() if count)
    factors = "; ".join(
        f"{f.name} from {number(f.low)} to {number(f.high)} {f.unit}" for f in study.factors
    )
    words = f"{study.summary}. {factors}. {len(table)} rollouts: {said}."
    body = [
        house.header("qpctrl · study", study.name, words, criteria),
        house.criteria_section(criteria, {c.name: WORDS.get(c.name, c.name) for c in criteria}),
        *(house.section(panel) for panel in panels),
        _rows(study, table),
        house.details(
            "Configuration and versions",
            {"Configuration": summary["configuration"], "Code": summary["code"]},
        ),
    ]
    return house.page(f"study {study.name}", body, panels)


def _rows(study: Study, table: pl.DataFrame) -> str:
    names = [f.column for f in study.factors] + ["controller", "outcome", *study.measures]
    head = "".join(f'<th class="n">{escape(name)}</th>' for name in names)
    lines = [
        "<tr>" + "".join(f'<td class="n">{_cell(row[name])}</td>' for name in names) + "</tr>"
        for row in table.head(MOST_ROWS).iter_rows(named=True)
    ]
    words = f"The first {MOST_ROWS} of {len(table)} rollouts" if len(table) > MOST_ROWS else "Rows"
    body = house.table(f"<tr>{head}</tr>", lines)
    return f"<details><summary>{escape(words)}</summary>{body}</details>"


def _cell(value: object) -> str:
    if isinstance(value, str):
        return escape(value)
    return "–" if value is None else number(value, 5)
