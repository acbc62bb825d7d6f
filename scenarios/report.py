"""The report of a run: one self-contained HTML page, opened by a person."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import polars as pl

from qpctrl.status import Status
from scenarios.panel import Panel, common_panels
from scenarios.report_page import CRITERIA_HEAD, details, page, section
from scenarios.report_page import table as html_table
from scenarios.report_style import number

FEW = 5  # fallback ticks that are listed one by one

LABELS = {
    "force_rmse_N": ("Force error, RMS", "N"),
    "force_bias_N": ("Force bias", "N"),
    "force_bias_abs_N": ("Force bias, magnitude", "N"),
    "force_peak_N": ("Largest force", "N"),
    "touch_peak_ratio": ("Largest force at touch and while pressing", "× set-point"),
    "position_rmse_mm": ("Position error, RMS", "mm"),
    "orientation_rmse_deg": ("Orientation error, RMS", "deg"),
    "tilt_max_deg": ("Largest tilt of the pad", "deg"),
    "contact_loss_fraction": ("Time without contact", "%"),
    "qp_law_gap_max": ("QP against hybrid law, largest gap", "× max |τ|"),
    "qp_textbook_gap_max": ("QP against textbook law, largest gap", "× max |τ|"),
    "curvature_term_max": ("Curvature term, largest", "× max |τ|"),
    "kkt_residual_max": ("KKT residual of the QP, largest", ""),
    "saturated_fraction": ("Ticks at a limit", "%"),
    "fallback_ticks": ("Fallback ticks", "ticks"),
    "fallback_ticks_total": ("Fallback ticks in the whole run", "ticks"),
    "tick_us_median": ("Tick time, median", "µs"),
    "tick_us_p99": ("Tick time, 99th percentile", "µs"),
    "tick_us_p999": ("Tick time, 99.9th percentile", "µs"),
    "force_rmse_share": ("Force error, RMS", "× set-point"),
    "grasp_force_rmse_share": ("Squeezing force error, RMS", "× set-point"),
    "object_path_rmse_mm": ("Path of the box, RMS error", "mm"),
    "object_turn_rmse_deg": ("Turn of the box, RMS error", "deg"),
    "slip_max_mm": ("Slip of box and pads, largest", "mm"),
    "foot_slip_max_mm": ("Slip of a foot, largest", "mm"),
    "foot_tilt_max_deg": ("Tilt of a foot, largest", "deg"),
    "torso_drop_max_mm": ("Way down of the torso, largest", "mm"),
    "friction_used_max": ("Friction used, largest", "× what there is"),
    "pressure_used_max": ("Centre of pressure, largest way to an edge", "× half of the face"),
    "torque_used_max": ("Torque, largest", "× limit"),
    "pad_friction_limit_ticks": ("Ticks with a pad at its friction limit", "ticks"),
    "pad_footprint_limit_ticks": ("Ticks with a pad about to tip", "ticks"),
    "pad_force_limit_ticks": ("Ticks with a pad at its largest force", "ticks"),
    "unloaded_share": ("Time without load on a contact", "× time"),
    "phases_left": ("Phases that were not reached", ""),
    "wiped_length_missing_m": ("Wiped length that is missing", "m"),
    "torque_step_max_share": ("Largest step of a torque in a tick", "× limit of its rate"),
    "position_use_max_share": ("Range of a joint used, largest", "× limit"),
    "speed_use_max_share": ("Speed of a joint used, largest", "× limit"),
    "duration_s": ("Simulated time", "s"),
    "force_error_share": ("Force error, RMS, over the set-point", ""),
    "moment_rmse_Nm": ("Moment error, RMS", "Nm"),
    "hinge_angle_rmse_deg": ("Error of the hinge's angle, RMS", "deg"),
    "steady_error_gap": ("Steady force error against its closed form", "× set-point"),
    "decay_rate_gap": ("Decay rate against its closed form", "relative"),
    "critical_gain_gap_max": ("Critical gains against their closed forms, largest", "relative"),
    "final_error_share": ("Force error at the end", "× set-point"),
    "impedance_gap_max": ("Measured impedance against m s² + b s + k, largest", "× |Z|"),
    "admittance_gap_max": ("Measured admittance against its model, largest", "× |Y|"),
    "answer_gap": ("Answer to the pushes against the model, RMS", "× RMS"),
    "static_gap_max": ("End of each push against push over stiffness, largest", ""),
    "stiffness_limit_gap": ("Limit of the wall's stiffness, found against computed", "relative"),
    "growth_gap": ("Growth of the bounces, found against computed", "relative"),
    "passivity_limit_gap": ("Passivity limit, found against K T / 2", "relative"),
    "loss_speed_ratio": ("Largest speed into the board without contact", "× set speed"),
    "regain_peak_ratio": ("Largest force after contact is regained", "× set-point"),
    "regain_time_s": ("Time until contact is regained", "s"),
    "contact_losses": ("Losses of contact", ""),
    "tip_angle_error_deg": ("Error of the tip angle, largest", "deg"),
    "torque_step_max": ("Step of torque from tick to tick, largest", "× limit"),
    "torque_step_switch_max": ("Largest step of a torque where the mode changes", "× limit"),
    "edge_shift_mm": ("Way of the edge on the board, largest", "mm"),
    "pressure_to_edge_mm": ("Pressure to edge where the face becomes an edge", "mm"),
    "pressure_to_middle_mm": ("Pressure to middle at the end", "mm"),
    "board_gap_um": ("Gap between tool and board, largest", "µm"),
    "board_tilt_deg": ("Tilt of the tool against the board, largest", "deg"),
    "valve_angle_rmse_deg": ("Error of the valve's angle, RMS", "deg"),
    "energy_to_hand_J": ("Energy given to the hand", "J"),
    "energy_to_environment_J": ("Energy given to the environment", "J"),
    "realtime_factor": ("Speed of the run", "× real time"),
}
"""Words and unit of each metric."""

KEY_METRICS = (
    *("force_peak_N", "orientation_rmse_deg", "qp_textbook_gap_max", "saturated_fraction"),
    *("tick_us_median", "tick_us_p99", "realtime_factor", "duration_s"),
)


def label(name: str) -> str:
    """Return the words for a metric or parameter; an unknown name loses its underscores."""
    return LABELS[name][0] if name in LABELS else name.replace("_", " ")


def unit(name: str, given: str | None = None) -> str:
    """Return the unit of a metric: its own, else the one ``given``, else none."""
    known = LABELS.get(name, ("", ""))[1]
    return known if known == "%" or given is None else given


def quantity(name: str, value: Any, given: str | None = None) -> tuple[str, str]:
    """Return a metric as number and unit; fractions become per cent."""
    sign = unit(name, given if given is not None else LABELS.get(name, ("", ""))[1])
    if sign == "%" and isinstance(value, int | float):
        value = 100 * value
    return number(value), sign


def _list_of(items: Sequence[str]) -> str:
    """Return an HTML list of texts, escaped."""
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def render_report(summary: Mapping[str, Any], table: pl.DataFrame, own: Sequence[Panel]) -> str:
    """Return the page; it needs no network and no other file.

    Args:
        summary: what summary.json holds; a metric may be null.
        table: the record, one row a tick; a column may be missing.
        own: the scenario's own pictures, which come first.
    """
    panels = [*own, *common_panels(table)]
    body = (
        _header(summary),
        _notes(summary, table),
        _criteria(summary["criteria"]),
        _tiles(summary["metrics"]),
        _sections([panel for panel in panels if panel.figure]),
        _details(summary),
    )
    return page(f"{summary['scenario']} – {_verdict(summary)}", body, panels)


def _header(summary: Mapping[str, Any]) -> str:
    criteria, passed = summary["criteria"], summary["passed"]
    held = sum(bool(c["passed"]) for c in criteria)
    mark, css = ("✓", "passed") if passed else ("✗", "failed")
    return (
        '<header><div><div class="kicker">qpctrl · report of a run</div>'
        f"<h1>{escape(str(summary['scenario']))}</h1>"
        f"<p>{escape(_what_ran(summary['config']))}</p></div>"
        f'<div class="verdict {css}"><strong>{mark} {_verdict(summary)}</strong>'
        f"<span>{held} of {len(criteria)} criteria hold</span></div></header>"
    )


def _verdict(summary: Mapping[str, Any]) -> str:
    return "PASSED" if summary["passed"] else "FAILED"


def _what_ran(config: Mapping[str, Any]) -> str:
    """Return one line on what ran, of the parameters that the scenario has."""
    law = f"sends the torque of the {'QP' if config.get('law') == 'qp' else config.get('law')}"
    solver = f"{config.get('form')} QP solved by {config.get('solver')}"
    words = {
        "robot": "robot {}",
        "actuator": "{} joints, judged like ideal ones",
        "plant": "{} plant",
        "force": "{} N",
        "speed": "{} m/s",
        "rate": "{} deg/s",
        "duration": "{} s",
        "friction": "friction {}",
        "force_noise": "force noise {} N",
    }
    if config.get("plant") == "rigid":
        del words["friction"]  # that plant has none
    if not config.get("force_noise"):
        del words["force_noise"]
    if config.get("actuator") == "ideal":
        del words["actuator"]
    said = [
        form.format(number(config[name]))
        for name, form in words.items()
        if config.get(name) is not None
    ]
    return " · ".join([*said, law, solver])


def _criteria(criteria: Sequence[Mapping[str, Any]]) -> str:
    lines = []
    for c in criteria:
        name, passed = str(c["name"]), c["passed"]
        value, sign = quantity(name, c["value"], c["unit"])
        limit, _ = quantity(name, c["limit"], c["unit"])
        verdict = '<td class="good">✓ holds</td>' if passed else '<td class="bad">✗ missed</td>'
        lines.append(
            f"<tr><td>{escape(label(name))}<br><code>{escape(name)}</code></td>"
            f'<td class="n">{escape(value)}</td><td class="n">≤ {escape(limit)}</td>'
            f"<td>{escape(sign)}</td>{verdict}</tr>"
        )
    return f"<section><h2>Criteria</h2>{html_table(CRITERIA_HEAD, lines)}</section>"


def _tiles(metrics: Mapping[str, Any]) -> str:
    tiles = []
    for name in KEY_METRICS:
        if name in metrics:
            value, sign = quantity(name, metrics[name])
            shown = f"<b>{value} <small>{sign}</small></b><span>{label(name)}</span>"
            tiles.append(f'<div class="tile">{shown}</div>')
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _notes(summary: Mapping[str, Any], table: pl.DataFrame) -> str:
    """Return what went wrong: a sentence for each missed criterion, and the fallback ticks."""
    said = [_missed(c, table) for c in summary["criteria"] if not c["passed"]]
    said += _fallbacks(table)
    if not said:
        return ""
    return f'<section class="notes"><h2>What went wrong</h2>{_list_of(said)}</section>'


def _missed(c: Mapping[str, Any], table: pl.DataFrame) -> str:
    name = str(c["name"])
    value, sign = quantity(name, c["value"], c["unit"])
    limit, _ = quantity(name, c["limit"], c["unit"])
    if c["value"] is None:
        phases = ", ".join(table["phase"].unique(maintain_order=True)) or "none"
        return f"{label(name)}: no value; the run's phases were: {phases}."
    times = f", {number(c['value'] / c['limit'], 2)} times as much" if c["limit"] else ""
    return f"{label(name)}: {value} {sign}, the limit is {limit} {sign}{times}.".replace(" ,", ",")


def _fallbacks(table: pl.DataFrame) -> list[str]:
    """Return the stretches of ticks that sent the fallback torque, the first few."""
    brief = table.select("time", "status", "phase")
    runs = brief.with_columns(run=pl.struct("status", "phase").rle_id()).filter(
        pl.col("status") != Status.OK.name
    )
    if runs.is_empty():
        return []
    said = [f"{len(runs)} of {len(table)} ticks sent the fallback torque. When it began:"]
    for _, run in list(runs.group_by("run", maintain_order=True))[:FEW]:
        name, phase = run["status"][0], run["phase"][0]
        first, last = run["time"][0], run["time"][-1]
        advice = Status[name].value if name in Status.__members__ else "unknown status"
        said.append(
            f"{first:.3f} s to {last:.3f} s (ticks: {len(run)}, {phase}): {name} – {advice}"
        )
    return said


def _sections(panels: Sequence[Panel]) -> str:
    """Return the figures, half ones side by side."""
    sections, pending = [], ""
    for panel in panels:
        place = section(panel)
        if panel.half and pending:
            place, pending = f'<div class="pair">{pending}{place}</div>', ""
        elif panel.half:
            pending = place
            continue
        sections += [pending, place]
        pending = ""
    sections.append(pending)
    return "\n".join(sections).strip() or "<section><p>Nothing was recorded.</p></section>"


def _details(summary: Mapping[str, Any]) -> str:
    parts = {"Configuration": "config", "Metrics": "metrics", "Versions": "versions"}
    shown = {title: summary[key] for title, key in parts.items()}
    return details("Configuration, all metrics, versions", shown)
