"""The page of a data sheet: one self-contained HTML file with its numbers and three figures."""

import math
from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from scenarios import report_style as style
from scenarios.actuator.check import no_torque_speed, torque_limit
from scenarios.actuator.sheet import CRITERIA, DataSheet
from scenarios.panel import Panel
from scenarios.report_bode import bode_figure
from scenarios.report_page import criteria_section, details, header, page, section, table
from scenarios.report_style import Figure, line, number, trace

TILES = (
    *("peak_torque_Nm", "continuous_torque_Nm", "no_load_speed_rad_s", "bandwidth_Hz"),
    *("apparent_inertia_kgm2", "stiffness_Nm_rad", "static_Nm", "torque_error_Nm"),
)
"""Facts that are shown large."""

PERIODS_SHOWN = 8
"""Of the bandwidth, after a step."""

THIN_DASH = {"color": style.SERIES[4], "width": 1.4, "dash": "5px,4px"}


def render_page(sheet: DataSheet, summary: Mapping[str, Any]) -> str:
    """Return the page; it needs no network and no other file.

    Args:
        sheet: what was measured.
        summary: what summary.json holds.
    """
    panels, drive = _panels(sheet), sheet.drive
    words = f"{drive.design} · inner loop at {number(sheet.inner_rate)} Hz · {drive.source}"
    config = {key: value for key, value in summary["config"].items() if isinstance(value, dict)}
    return page(
        f"{drive.name} – {'PASSED' if sheet.passed else 'FAILED'}",
        [
            header("qpctrl · data sheet of a joint drive", drive.name, words, sheet.criteria),
            criteria_section(sheet.criteria, CRITERIA),
            _tiles(sheet),
            _facts(sheet),
            *(section(panel) for panel in panels),
            details("Numbers of the drive, versions", {**config, "versions": summary["versions"]}),
        ],
        panels,
    )


def torque_speed_figure(sheet: DataSheet) -> Figure:
    """Return what may be commanded and what arrives over the speed of the joint."""
    drive, measured = sheet.drive, sheet.at_speed
    v = np.linspace(0.0, no_torque_speed(drive), 201)
    limit = np.maximum(torque_limit(drive, v), 0.0)
    continuous = np.where(drive.continuous_torque <= limit, drive.continuous_torque, np.nan)
    hover = "%{y:.4g} Nm"
    dots = {"mode": "markers", "marker": {"color": style.SERIES[1], "size": 9}}
    bars = {"mode": "markers", "marker": {"color": style.INK, "size": 20, "symbol": "line-ew-open"}}
    traces = [
        trace(v, limit, "may be commanded", line=_solid(0), hovertemplate=hover),
        trace(v, continuous, "continuous torque", line=THIN_DASH, hovertemplate=hover),
        trace(measured.v, measured.expected, "arrives, closed form", hovertemplate=hover, **bars),
        trace(measured.v, measured.tau, "arrives, measured", hovertemplate=hover, **dots),
    ]
    figure = style.figure(traces, "speed of the joint [rad/s]", "torque [Nm]", height=440)
    figure["layout"]["yaxis"] |= {"rangemode": "tozero"}
    figure["layout"]["margin"]["t"] = 24
    return figure


def response_figure(sheet: DataSheet) -> Figure:
    """Return the Bode plot: measured points over the transfer function and its second order."""
    swept = sheet.sweep
    f = np.geomspace(swept.frequency[0] / 1.3, swept.frequency[-1] * 1.3, 400)
    figure = bode_figure(swept.frequency, swept.response, f, sheet.model(f), "|τ / τ_cmd| [1]")
    if not sheet.drive.rigid:
        plain = sheet.second_order(f)
        look = {"line": THIN_DASH, "hovertemplate": "%{y:.4g}"}
        figure["data"].insert(1, trace(f, np.abs(plain), "second order alone", **look))
        phase = np.degrees(np.unwrap(np.angle(plain)))
        shown = look | {"hovertemplate": "%{y:.2f}°", "showlegend": False, "yaxis": "y2"}
        figure["data"].append(trace(f, phase, "phase of the second order", **shown))
    style.add_limit(figure, 1 / np.sqrt(2), "−3 dB", anchor="bottom")
    figure["layout"]["annotations"][-1]["x"] = 0.1
    ticks = [m * 10.0**k for k in range(-4, 5) for m in (1, 2, 5)]
    for axis in ("xaxis", "yaxis"):
        figure["layout"][axis] |= {"tickvals": ticks, "ticktext": [f"{t:g}" for t in ticks]}
    figure["layout"]["margin"]["t"] = 24
    return figure


def step_figure(sheet: DataSheet) -> Figure:
    """Return the answer to a step, with all imperfections, over that of the closed form."""
    answer = sheet.answer
    time = 1e3 * answer.time
    middle = time + 500 / sheet.inner_rate if sheet.drive.rigid else time  # current: a mean
    traces = [
        line(time, answer.tau_meas, "as the drive reads it", style.SERIES[2], "Nm", width=1.0),
        line(middle, answer.tau, "delivered", style.SERIES[1], "Nm", width=2),
    ]
    if sheet.model.decay_rate > 0:
        model = answer.height * sheet.model.step(answer.time)
        traces.append(line(time, model, "closed form, linear part", style.SERIES[0], "Nm"))
    wanted = line(time, answer.tau_cmd, "commanded", style.INK, "Nm", dash="5px,4px")
    wanted["line"]["shape"] = "hv"
    figure = style.figure([*traces, wanted], "time since the step [ms]", "torque [Nm]", height=440)
    edge = sheet.sweep.bandwidth
    shown = min(time[-1], PERIODS_SHOWN * 1e3 / edge) if math.isfinite(edge) else time[-1]
    figure["layout"]["xaxis"]["range"] = [max(float(time[0]), -0.1 * float(shown)), float(shown)]
    figure["layout"]["margin"]["t"] = 24
    return figure


def _panels(sheet: DataSheet) -> tuple[Panel, ...]:
    loses = bool(np.any(sheet.at_speed.expected < 0.999 * sheet.at_speed.limit))
    lost = " What is missing is friction, which this drive does not measure." if loses else ""
    words = (
        "Steady torque at constant speed, commanded as high as a controller may: current, gear "
        f"and spring limit it from above, back-EMF at speed.{lost}"
    )
    locked = "Output locked, linear part: friction, play, noise and steps of the readings are off."
    answer = (
        f"A step to {number(sheet.answer.height)} Nm, a quarter of the peak torque, output locked, "
        "with friction, play and noise. Drag to zoom, double-click to see all of it."
    )
    return (
        Panel("speed", "Torque and speed", words, torque_speed_figure(sheet)),
        Panel("bode", "From commanded to delivered torque", locked, response_figure(sheet)),
        Panel("step", "Step of torque", answer, step_figure(sheet)),
    )


def _solid(i: int) -> dict[str, Any]:
    return {"color": style.SERIES[i], "width": 2}


def _tiles(sheet: DataSheet) -> str:
    shown = {fact.key: (fact, value) for group in sheet.facts().values() for fact, value in group}
    tiles = [
        f'<div class="tile"><b>{number(value)} <small>{escape(fact.unit)}</small></b>'
        f"<span>{escape(fact.words)}</span></div>"
        for fact, value in (shown[key] for key in TILES if key in shown)
    ]
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _facts(sheet: DataSheet) -> str:
    """Return the data sheet itself, two groups side by side."""
    cards = [
        f"<section><h2>{escape(title.capitalize())}</h2>"
        + table("", [_row(fact.words, number(value, 4), fact.unit) for fact, value in group])
        + "</section>"
        for title, group in sheet.facts().items()
    ]
    pairs = zip(cards[::2], cards[1::2], strict=True)
    return "\n".join(f'<div class="pair">{left}{right}</div>' for left, right in pairs)


def _row(words: str, value: str, unit: str) -> str:
    cells = f'<td class="n">{escape(value)}</td><td>{escape(unit)}</td>'
    return f"<tr><td>{escape(words)}</td>{cells}</tr>"
