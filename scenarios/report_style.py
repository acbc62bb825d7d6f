"""How the report looks: colours, words for metrics, numbers as people write them."""

import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

INK, MUTED, GRID = "#1f2933", "#66727f", "#e3e7ec"
PASS, FAIL, LIMIT = "#17703d", "#b3261e", "#b3261e"
BOARD, SWEPT, CHALK, MARK = "#24463c", "#3d6155", "#f6f3e8", "#f4c542"
SERIES = ("#1f5fa8", "#d9730d", "#2b8a5b", "#b0307a", "#7a5bc0", "#8a6d1d", "#3596a6", "#5c6670")
"""Line colours, told apart by people with colour-blindness too; used in turn."""

PHASES = {
    "approach": "#eef2f8",
    "touch": "#fbe3b8",
    "press": "#fbdccb",
    "wipe": "#e3f2e6",
    "release": "#ecdcf2",
    "lift": "#eef2f8",
}
"""Background of each phase; a phase that is not listed takes the next of `OTHER_PHASES`."""
OTHER_PHASES = ("#e3f2e6", "#e6eefb", "#fbe3b8", "#ecdcf2", "#fbdccb")

FONT = "system-ui, -apple-system, 'Segoe UI', 'Helvetica Neue', 'Liberation Sans', Arial, sans-serif"

LABELS = {
    "force_rmse_N": ("Force error while wiping, RMS", "N"),
    "force_bias_N": ("Force bias while wiping", "N"),
    "force_bias_abs_N": ("Force bias while wiping, magnitude", "N"),
    "force_peak_N": ("Largest force while wiping", "N"),
    "touch_peak_ratio": ("Largest force at touch and while pressing", "× set-point"),
    "position_rmse_mm": ("Position error while wiping, RMS", "mm"),
    "orientation_rmse_deg": ("Orientation error, RMS", "deg"),
    "tilt_max_deg": ("Largest tilt of the pad while wiping", "deg"),
    "contact_loss_fraction": ("Time without contact while wiping", "%"),
    "qp_law_gap_max": ("QP against hybrid law, largest gap", "× max |τ|"),
    "qp_textbook_gap_max": ("QP against textbook law, largest gap", "× max |τ|"),
    "curvature_term_max": ("Curvature term, largest", "× max |τ|"),
    "kkt_residual_max": ("KKT residual of the QP, largest", ""),
    "saturated_fraction": ("Ticks at a limit while wiping", "%"),
    "fallback_ticks": ("Fallback ticks while wiping", "ticks"),
    "fallback_ticks_total": ("Fallback ticks in the whole run", "ticks"),
    "tick_us_median": ("Tick time, median", "µs"),
    "tick_us_p99": ("Tick time, 99th percentile", "µs"),
    "tick_us_p999": ("Tick time, 99.9th percentile", "µs"),
    "duration_s": ("Simulated time", "s"),
    "realtime_factor": ("Speed of the run", "× real time"),
}
"""Words and unit of each metric."""

KEY_METRICS = (
    *("force_peak_N", "orientation_rmse_deg", "qp_textbook_gap_max", "saturated_fraction"),
    *("tick_us_median", "tick_us_p99", "realtime_factor", "duration_s"),
)

CSS = f"""
:root {{ color-scheme: light; }}
* {{ box-sizing: border-box; }}
body {{ margin: 0; background: #f4f5f7; color: {INK}; font: 16px/1.5 {FONT}; }}
main {{ max-width: 1180px; margin: 0 auto; padding: 32px 24px 64px; }}
header {{ display: flex; gap: 24px; justify-content: space-between; align-items: center;
  flex-wrap: wrap; margin-bottom: 24px; }}
header > div:first-child {{ flex: 1 1 480px; }}
.kicker {{ color: {MUTED}; font-size: 14px; letter-spacing: .04em; }}
h1 {{ font-size: 38px; line-height: 1.15; margin: 2px 0 6px; overflow-wrap: anywhere; }}
h2 {{ font-size: 19px; margin: 0 0 4px; }}
h3 {{ font-size: 15px; margin: 20px 0 6px; }}
p {{ margin: 0 0 10px; max-width: 88ch; }}
.verdict {{ padding: 14px 26px; border-radius: 10px; color: white; text-align: center; }}
.verdict strong {{ display: block; font-size: 30px; line-height: 1.15; letter-spacing: .03em; }}
.verdict span {{ font-size: 14px; }}
.passed {{ background: {PASS}; }} .failed {{ background: {FAIL}; }}
.good {{ color: {PASS}; font-weight: 600; }} .bad {{ color: {FAIL}; font-weight: 600; }}
section, details {{ background: white; border: 1px solid {GRID}; border-radius: 10px;
  padding: 20px 22px; margin-bottom: 18px; }}
section.notes {{ border-left: 6px solid {FAIL}; }}
section ul {{ margin: 6px 0 0; padding-left: 22px; }}
.pair {{ display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 18px; }}
.caption {{ color: {MUTED}; font-size: 14px; margin-bottom: 8px; }}
.tiles {{ display: grid; grid-template-columns: repeat(4, minmax(0, 1fr)); gap: 12px;
  margin-bottom: 18px; }}
.tile {{ background: white; border: 1px solid {GRID}; border-radius: 10px; padding: 12px 16px; }}
.tile b {{ display: block; font-size: 23px; line-height: 1.25; font-weight: 600; }}
.tile b small {{ font-size: 14px; font-weight: 400; color: {MUTED}; }}
.tile span {{ color: {MUTED}; font-size: 13px; }}
table {{ border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }}
th, td {{ text-align: left; padding: 7px 12px 7px 0; border-bottom: 1px solid {GRID};
  overflow-wrap: anywhere; vertical-align: top; }}
th {{ color: {MUTED}; font-weight: 500; font-size: 13px; }}
tr:last-child td {{ border-bottom: 0; }}
td.n, th.n {{ text-align: right; padding-right: 20px; white-space: nowrap; }}
code {{ font-family: ui-monospace, 'DejaVu Sans Mono', monospace; font-size: 13px;
  color: {MUTED}; }}
summary {{ cursor: pointer; font-weight: 600; }}
footer {{ color: {MUTED}; font-size: 13px; }}
@media (max-width: 860px) {{ .pair {{ grid-template-columns: minmax(0, 1fr); }}
  .tiles {{ grid-template-columns: repeat(2, minmax(0, 1fr)); }} }}
@media print {{ body {{ background: white; }} section {{ break-inside: avoid; }} }}
"""


def label(name: str) -> str:
    """Return the words for a metric or parameter; an unknown name loses its underscores."""
    return LABELS[name][0] if name in LABELS else name.replace("_", " ")


def unit(name: str, given: str | None = None) -> str:
    """Return the unit of a metric: its own, else the one ``given``, else none."""
    known = LABELS.get(name, ("", ""))[1]
    return known if known == "%" or given is None else given


def number(value: object, digits: int = 3) -> str:
    """Return a number with ``digits`` significant ones: 0.0307, 12 300, 4.21·10⁻¹³, n/a."""
    if value is None or isinstance(value, bool) or not isinstance(value, int | float):
        return "n/a" if value is None else str(value)
    if not math.isfinite(value):
        return "n/a" if math.isnan(value) else ("∞" if value > 0 else "−∞")
    if value == 0:
        return "0"
    if not 1e-3 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        text = f"10{power}" if mantissa == "1" else f"{mantissa}·10{power}"
    elif abs(value) >= 10 ** (digits - 1):
        text = f"{value:,.0f}".replace(",", "\u202f")
    else:
        text = f"{value:.{digits}g}"
    return text.replace("-", "−")


def quantity(name: str, value: Any, given: str | None = None) -> tuple[str, str]:
    """Return a metric as number and unit; fractions become per cent."""
    sign = unit(name, given if given is not None else LABELS.get(name, ("", ""))[1])
    if sign == "%" and isinstance(value, int | float):
        value = 100 * value
    return number(value), sign


def rows(table: Mapping[str, Any]) -> str:
    """Return the body rows of a table of names and values."""
    return "".join(
        f"<tr><td>{escape(str(key))}</td><td>{escape(_plain(value))}</td></tr>"
        for key, value in table.items()
    )


def list_of(items: Sequence[str]) -> str:
    """Return an HTML list of texts, escaped."""
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def _plain(value: Any) -> str:
    if value is None:
        return "–"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
