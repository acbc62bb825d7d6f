"""The page of a comparison of actuators: its table, the reasons, and two figures."""

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from qpctrl.arrays import Vector
from scenarios import report_style as style
from scenarios.actuator_comparison import FASTER, Comparison, torque_errors
from scenarios.actuator_reason import WORDS, Study
from scenarios.force_error import along_set_point
from scenarios.joint_level import Actuator
from scenarios.panel import Panel
from scenarios.report_page import criteria_section, details, header, page, section, table
from scenarios.report_style import Figure, column, line, number

CRITERIA = {
    "fallback_ticks": "Fallback ticks of direct-drive, strain-gauge and series-elastic",
    "strain_gauge_share": "Force error, RMS, of strain-gauge over that of geared",
    "motor_limited_ticks": "Ticks at which a motor of any of them met its own limit",
}
"""Words of each criterion."""

HEADS = {
    "force_mae": ("force, MAE", "N"),
    "force_rmse": ("force, RMSE", "N"),
    "position_rmse": ("position, RMSE", "mm"),
    "torque_error": ("torque error, RMS", "Nm"),
    "saturated": ("saturated", "%"),
    "motor_limited": ("motor limited", "%"),
    "realtime_factor": ("speed", "× real time"),
}
"""Words and unit of each column of the comparison."""

COLOURS: dict[Actuator, str] = {
    "geared": style.SERIES[1],
    "series-elastic": style.SERIES[4],
    "strain-gauge": style.SERIES[3],
    "direct-drive": style.SERIES[2],
    "ideal": style.SERIES[0],
}
"""Line of each actuator; the first is drawn first, below the others."""

WINDOW = 0.1
"""Time over which the RMS of an error is taken [s]."""


LOG = {"type": "log", "dtick": 1}
"""A logarithmic axis with a tick for each decade."""


def render_comparison(comparison: Comparison, summary: Mapping[str, Any]) -> str:
    """Return the page; it needs no network and, but for its links, no other file.

    Args:
        comparison: what was found.
        summary: what summary.json holds.
    """
    name = comparison.scenario.name
    panels = (_force_panel(comparison), _torque_panel(comparison))
    body = [
        header("qpctrl · one job, five actuators", name, _what_ran(summary), comparison.criteria),
        criteria_section(comparison.criteria, CRITERIA),
        _rows(comparison),
        _reasons(comparison) if comparison.studies else "",
        *(section(panel) for panel in panels if panel.figure),
        details(
            "Configuration and versions",
            {"Configuration": summary["config"], "Versions": summary["versions"]},
        ),
    ]
    return page(f"{name}: five actuators", [piece for piece in body if piece], panels)


def shown(key: str, value: float) -> str:
    """Return a number of the comparison's table; a dash where the scenario has none."""
    if np.isnan(value):
        return "–"
    return number(100 * value if HEADS[key][1] == "%" else value)


def row_words(comparison: Comparison) -> str:
    """Return what the columns of the table mean."""
    where = "Force and position as the scenario judges them; torque of the whole run"
    if comparison.phase:
        where = f"Errors of phase {comparison.phase!r}"
    return (
        f"{where}. Torque error: delivered − commanded, over joints and ticks. Shares of all ticks "
        "of the run at which a limit of the controller binds, and at which a motor met its limit "
        "of current or voltage. Speed with another run beside it."
    )


def study_words(comparison: Comparison) -> str:
    """Return which job the reasons come from."""
    duration = getattr(comparison.short, "duration", None)
    same = comparison.short is comparison.scenario
    job = "the same job" if same else f"a shorter job, {number(duration)} s"
    return f"Force error, RMS, of {job}, with one thing taken away from all drives at a time."


def force_figure(comparison: Comparison) -> Figure:
    """Return force along its set-point, and below it the RMS of its error over `WINDOW`."""
    error = comparison.error
    set_point = error.set_point if error else None
    forces = {n: along_set_point(t, set_point) for n, t in comparison.tables.items()}
    time, wanted = column(comparison.tables["ideal"], "time"), forces["ideal"][1]
    traces = [
        line(column(comparison.tables[n], "time"), forces[n][0], n, colour, "N", width=1.2)
        for n, colour in COLOURS.items()
    ]
    dashed = line(time, wanted, "set-point", style.INK, "N", dash="5px,4px")
    figure = style.figure([*traces, dashed], "time [s]", "force [N]", height=640)
    for name, record in comparison.tables.items():
        if error:
            judged = error.judged(record)
            curve = _moving(column(judged, "time"), error.magnitude(judged), name, "N")
            style.add_panel(figure, curve, "RMS of its error [N]", None)
            figure["layout"]["yaxis2"] |= LOG
    return style.shade(figure, style.spans(comparison.tables["ideal"]))


def torque_figure(comparison: Comparison) -> Figure:
    """Return the RMS over joints and `WINDOW` of delivered − commanded torque."""
    curves = []
    for name in COLOURS:
        record = comparison.tables[name]
        size = np.sqrt((torque_errors(record) ** 2).mean(axis=1))
        curves.append(_moving(column(record, "time"), size, name, "Nm"))
    figure = style.figure(curves, "time [s]", "torque error, RMS [Nm]", height=440)
    for trace in figure["data"]:
        trace["showlegend"] = True
    figure["layout"]["yaxis"] |= LOG
    return style.shade(figure, style.spans(comparison.tables["ideal"]))


def _moving(time: Vector, error: Vector, name: Actuator, unit: str) -> dict[str, Any]:
    """Return the curve of a moving RMS; what is nothing is not drawn."""
    step = float(np.median(np.diff(time))) if len(time) > 1 else WINDOW
    kernel = np.ones(min(max(round(WINDOW / step), 1), len(time)))
    squares = np.convolve(error**2, kernel, "same") / np.convolve(
        np.ones(len(error)), kernel, "same"
    )
    size = np.where(squares > 0, np.sqrt(squares), np.nan)
    return line(time, size, name, COLOURS[name], unit, width=1.6, showlegend=False)


def _force_panel(comparison: Comparison) -> Panel:
    below = (
        f"Below: RMS of the error over {number(WINDOW)} s in phase {comparison.phase!r}, on a "
        "logarithmic scale. "
    )
    words = (
        f"Measured, along its set-point. {below if comparison.phase else ''}Phases are those of "
        "ideal joints."
    )
    return Panel("force", "Force and set-point", words, force_figure(comparison))


def _torque_panel(comparison: Comparison) -> Panel:
    words = (
        f"Delivered − commanded, RMS over the joints and {number(WINDOW)} s. Ideal joints deliver "
        "what is commanded, which a logarithmic scale cannot show."
    )
    return Panel("torque", "Error of delivered torque", words, torque_figure(comparison))


def _what_ran(summary: Mapping[str, Any]) -> str:
    config = summary["config"]
    units = {"robot": "robot {}", "plant": "{} plant", "duration": "{} s"}
    said = [words.format(number(config[k])) for k, words in units.items() if config.get(k)]
    return " · ".join([*said, f"inner loops at {number(config['inner_rate'])} Hz"])


def _rows(comparison: Comparison) -> str:
    head = "".join(f'<th class="n">{words}<br>{unit}</th>' for words, unit in HEADS.values())
    lines = [
        f"<tr><td style='white-space: nowrap'>{_dot(name)}"
        f"<a href='{name}/report.html'>{name}</a></td>"
        + "".join(f'<td class="n">{shown(key, getattr(row, key))}</td>' for key in HEADS)
        + "</tr>"
        for name, row in comparison.rows.items()
    ]
    return (
        f'<section><h2>Side by side</h2><p class="caption">{escape(row_words(comparison))}</p>'
        f"{table(f'<tr><th>actuator</th>{head}</tr>', lines)}</section>"
    )


def _reasons(comparison: Comparison) -> str:
    said = "".join(
        f"<p>{_dot(name)}<b>{name}</b>: {escape(study.sentence())}</p>"
        for name, study in comparison.studies.items()
    )
    faster = (
        "–: the drives have nothing of it, or met no limit. Shorter steps are those of an inner "
        f"rate {FASTER} times as high; stiffer drives run there too, with loops √10 times as fast."
    )
    return (
        f'<section><h2>Why they differ</h2><p class="caption">{escape(study_words(comparison))}</p>'
        f'{said}{_matrix(comparison.studies)}<p class="caption">{escape(faster)}</p></section>'
    )


def _matrix(studies: Mapping[Actuator, Study]) -> str:
    """Return the force errors behind the reasons, one column for each actuator."""
    head = "".join(f'<th class="n">{name}<br>N</th>' for name in studies)
    cells: dict[str, Callable[[Study], float | None]] = {
        "with everything in place": lambda study: study.whole,
        **{
            words.changed: lambda study, key=key: study.without.get(key)  # type: ignore[misc]
            for key, words in WORDS.items()
        },
        "without all of these but the torque loop": lambda study: study.together,
        "ideal joints": lambda study: study.ideal,
    }
    causes = [WORDS[study.cause].changed if study.cause else "" for study in studies.values()]
    lines = []
    for words, of in cells.items():
        values = [of(study) for study in studies.values()]
        if any(value is not None for value in values):
            marks = [words == cause for cause in causes]
            lines.append(f"<tr><td>{escape(words)}</td>{_cells(values, marks)}</tr>")
    return table(f"<tr><th>drives</th>{head}</tr>", lines)


def _cells(values: Sequence[float | None], marks: Sequence[bool]) -> str:
    return "".join(
        f'<td class="n{" good" if marked else ""}">{_force(value)}</td>'
        for value, marked in zip(values, marks, strict=True)
    )


def _force(value: float | None) -> str:
    if value is None:
        return "–"
    return "fails" if np.isnan(value) else number(value)


def _dot(name: Actuator) -> str:
    return f'<span style="color: {COLOURS[name]}">●</span> '
