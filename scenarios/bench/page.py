"""The page of a measurement: cost against the number of joints, and all tables."""

from html import escape
from typing import Any

import numpy as np

from qpctrl.arrays import Vector
from scenarios import report_page as house
from scenarios import report_style as style
from scenarios.bench.part_trial import WHOLE, WORDS
from scenarios.bench.result import HOW, WHAT_IS_TIMED, Result
from scenarios.bench.sheet import Sheet, sheets
from scenarios.panel import Panel
from scenarios.report_style import Figure, trace

HOVER = "%{y:.4g} µs"

POWERS = (1, 2, 3)
"""Of the lines that guide the eye."""


def render_page(result: Result) -> str:
    """Return the page; it needs no network and no other file."""
    panels = [
        Panel(
            f"growth-{'compiled' if compiled else 'interpreted'}",
            f"Cost against the number of joints, {'compiled' if compiled else 'interpreted'}",
            "Medians of a tick and its parts, k = 3. Dashed: n, n² and n³ from the tick of the "
            "smallest arm. The planar arm (2 joints, k = 1) is another task.",
            growth_figure(result, compiled),
        )
        for compiled in result.plan.codes
        if any(one.compiled is compiled for one in result.growth)
    ]
    machine = result.machine
    words = f"{machine['cpu']}, core {machine['pinned_to']}, {machine['system']}. {WHAT_IS_TIMED}"
    notes = "".join(f"<li>{escape(note)}</li>" for note in result.notes)
    body = [
        '<header><div><div class="kicker">qpctrl · bench</div><h1>Where the time goes</h1>'
        f"<p>{escape(words)}</p></div></header>",
        f"<section><h2>Notes</h2><p>{escape(HOW)}</p><ul>{notes}</ul></section>",
        *(house.section(panel) for panel in panels),
        *(_section(sheet) for sheet in sheets(result)),
        house.details("Versions", {"Versions": machine["versions"]}),
    ]
    return house.page("qpctrl bench", body, panels)


def growth_figure(result: Result, compiled: bool) -> Figure:
    """Return the medians over the number of joints, both axes logarithmic."""
    own = [one for one in result.growth if one.compiled is compiled]
    traces, known = [], tuple(WORDS)
    for one in own:
        place = known.index(one.part) if one.part in known else len(known)
        colour = style.SERIES[place % len(style.SERIES)]
        line = {"color": colour, "width": 3 if one.part == WHOLE else 1.6}
        more: dict[str, Any] = {"mode": "lines+markers", "line": line, "hovertemplate": HOVER}
        traces.append(trace(np.array(one.joints, float), np.array(one.median_us), one.part, **more))
    planar = [r for r in result.of("tick") if r.joints == 2 and r.compiled is compiled]
    if planar:
        at = np.array([2.0]), np.array([planar[0].median_us])
        dot = {"color": style.SERIES[0], "size": 9}
        name = "tick of the planar arm"
        traces.append(trace(*at, name, mode="markers", marker=dot, hovertemplate=HOVER))
    whole = next((one for one in own if one.part == WHOLE), None)
    if whole:
        n = np.geomspace(whole.joints[0], whole.joints[-1], 20)
        traces += [_guide(n, whole.median_us[0] * (n / n[0]) ** power, power) for power in POWERS]
    figure = style.figure(traces, "number of joints n", "median [µs]", height=520)
    joints = sorted({n for one in own for n in one.joints} | ({2} if planar else set()))
    ticks = {"tickvals": joints, "ticktext": [str(n) for n in joints]}
    figure["layout"]["xaxis"] |= {"type": "log", **ticks}
    figure["layout"]["yaxis"] |= {"type": "log", "dtick": "D2"}
    figure["layout"]["margin"]["t"] = 24
    return figure


def _guide(n: Vector, y: Vector, power: int) -> dict[str, Any]:
    """Return a thin line with its power at its end."""
    dashed = {"color": style.MUTED, "width": 1, "dash": "dash"}
    words = {"text": [""] * (len(n) - 1) + [f"n{' ²³'[power - 1].strip()}"], "mode": "lines+text"}
    look = {"textposition": "middle right", "showlegend": False, "hoverinfo": "skip"}
    return trace(n, y, "", line=dashed) | words | look


def _section(sheet: Sheet) -> str:
    cells = [' class="n"' if sheet.is_figure(i) else "" for i in range(len(sheet.heads))]
    head = "".join(f"<th{c}>{escape(h)}</th>" for c, h in zip(cells, sheet.heads, strict=True))
    lines = [
        "<tr>"
        + "".join(f"<td{c}>{escape(x)}</td>" for c, x in zip(cells, line, strict=True))
        + "</tr>"
        for line in sheet.lines
    ]
    remarks = "".join(f"<li>{escape(words)}</li>" for words in sheet.remarks)
    return (
        f'<section><h2>{escape(sheet.title)}</h2><p class="caption">{escape(sheet.caption)}</p>'
        f"{house.table(f'<tr>{head}</tr>', lines)}"
        f"{f'<ul>{remarks}</ul>' if remarks else ''}</section>"
    )
