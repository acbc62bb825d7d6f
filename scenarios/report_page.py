"""A page in the house style: verdict, criteria, tables, and figures with their words."""

import json
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from plotly.offline import get_plotlyjs

from scenarios.panel import Panel
from scenarios.report_style import CSS, number, packed
from scenarios.scenario import Criterion

DRAW = """for (const [key, figure] of Object.entries(figures))
  Plotly.newPlot(key, figure.data, figure.layout, {responsive: true,
    displaylogo: false, showSendToCloud: false, plotlyServerURL: ""});
"""

CRITERIA_HEAD = (
    '<tr><th>what</th><th class="n">value</th><th class="n">limit</th><th>unit</th>'
    "<th>verdict</th></tr>"
)


def page(title: str, body: Sequence[str], panels: Sequence[Panel]) -> str:
    """Return a self-contained page; it needs no network and no other file.

    Args:
        title: of the window.
        body: pieces of HTML; those of `section` name the figures.
        panels: whose figures are drawn.
    """
    figures = {panel.key: panel.figure for panel in panels if panel.figure}
    data = json.dumps(figures, default=packed, ensure_ascii=False).replace("<", "\\u003c")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{CSS}</style></head>\n<body><main>\n"
        + "\n".join(body)
        + f"\n</main>\n<script>{get_plotlyjs()}</script>\n<script>\nconst figures = {data};\n"
        f"{DRAW}</script>\n</body></html>\n"
    )


def header(kicker: str, title: str, words: str, criteria: Sequence[Criterion]) -> str:
    """Return what the page is about, and the verdict of its criteria."""
    held = sum(c.passed for c in criteria)
    passed = held == len(criteria)
    mark, css, verdict = ("✓", "passed", "PASSED") if passed else ("✗", "failed", "FAILED")
    return (
        f'<header><div><div class="kicker">{escape(kicker)}</div><h1>{escape(title)}</h1>'
        f"<p>{escape(words)}</p></div>"
        f'<div class="verdict {css}"><strong>{mark} {verdict}</strong>'
        f"<span>{held} of {len(criteria)} criteria hold</span></div></header>"
    )


def criteria_section(criteria: Sequence[Criterion], words: Mapping[str, str]) -> str:
    """Return the criteria as a table; ``words`` says what the names mean."""
    lines = []
    for c in criteria:
        good = '<td class="good">✓ holds</td>' if c.passed else '<td class="bad">✗ missed</td>'
        lines.append(
            f"<tr><td>{escape(words[c.name])}<br><code>{escape(c.name)}</code></td>"
            f'<td class="n">{number(c.value)}</td><td class="n">≤ {number(c.limit)}</td>'
            f"<td>{escape(c.unit)}</td>{good}</tr>"
        )
    return f"<section><h2>Criteria</h2>{table(CRITERIA_HEAD, lines)}</section>"


def section(panel: Panel) -> str:
    """Return the place of a figure, with its words."""
    return (
        f'<section><h2>{escape(panel.title)}</h2><p class="caption">{escape(panel.caption)}</p>'
        f'<div id="{panel.key}" role="img" aria-label="{escape(panel.title)}"></div></section>'
    )


def details(words: str, parts: Mapping[str, Mapping[str, Any]]) -> str:
    """Return tables of names and values, by title, that open with a click."""
    tables = "".join(
        f"<h3>{escape(title)}</h3>"
        + table("", [f"<tr><td>{escape(k)}</td><td>{_plain(v)}</td></tr>" for k, v in part.items()])
        for title, part in parts.items()
    )
    return f"<details><summary>{escape(words)}</summary>{tables}</details>"


def table(head: str, rows: Sequence[str]) -> str:
    """Return a table of HTML rows under a row of heads, which may be empty."""
    top = f"<thead>{head}</thead>" if head else ""
    return f"<table>{top}<tbody>{''.join(rows)}</tbody></table>"


def _plain(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return "–" if value is None else escape(text)
