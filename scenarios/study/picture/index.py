"""What matters: bars of Sobol indices, and Morris's effects with their plane of μ* and σ."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qpctrl.arrays import Vector
from scenarios import report_style as style
from scenarios.panel import Panel
from scenarios.report_style import trace
from scenarios.study.importance import FAILED
from scenarios.study.picture.grid import Cell, bars, grid
from scenarios.study.study import Study
from scenarios.study.word import title, unit_of, words_of

ROW = 30  # px, of a factor
COLOURS = {"first": style.SERIES[0], "total": style.SERIES[1], "mu_star": style.SERIES[0]}
NAMES = {"first": "first order", "total": "total", "mu_star": "μ*"}


def index_panels(study: Study, found: Mapping[str, Any]) -> list[Panel]:
    """Return a figure for each measure.

    Args:
        study: what was studied.
        found: what `importance` returns.
    """
    names = dict.fromkeys(name for one in found["controllers"].values() for name in one)
    return [_panel(study, found, name) for name in names]


def _panel(study: Study, found: Mapping[str, Any], name: str) -> Panel:
    by = {c: one[name] for c, one in found["controllers"].items() if name in one}
    known = {c: one for c, one in by.items() if "note" not in one}
    words = "whether a rollout fails" if name == FAILED else words_of(study, name)
    morris = study.design.kind == "morris"
    heading = f"{'Effects on' if morris else 'What decides on'} {words}"
    caption = " ".join([_meaning(study, name), *_used(by)])
    if not known:
        return Panel(f"index-{name}", heading, caption, None)
    cells = _morris(study, found["factors"], name, known) if morris else _sobol(found, known)
    height = max(ROW * len(found["factors"]), 150)
    figure = grid(cells, 2, height=height)
    figure["layout"]["hovermode"] = "closest"
    return Panel(f"index-{name}", heading, caption, figure)


def _sobol(found: Mapping[str, Any], known: Mapping[str, Any]) -> list[Cell]:
    factors, order = found["factors"], _order(next(iter(known.values()))["total"])
    cells = []
    for controller, one in known.items():
        traces = [_bars(factors, one[key], order, key) for key in ("total", "first")]
        axis = style.axis("share of the variance", rangemode="tozero")
        label = controller if len(found["controllers"]) > 1 else ""
        cells.append(Cell(traces=traces, x=axis, y=_names_axis(), title=label))
    return cells


def _morris(
    study: Study, factors: Sequence[str], name: str, known: Mapping[str, Any]
) -> list[Cell]:
    order = _order(next(iter(known.values()))["mu_star"])
    unit = "" if name == FAILED else unit_of(study, name)
    size = f" [{unit}]" if unit else ""
    cells = []
    for controller, one in known.items():
        label = controller if len(study.controllers) > 1 else ""
        bar = _bars(factors, one["mu_star"], order, "mu_star")
        across = style.axis(f"μ*{size}", rangemode="tozero")
        cells.append(Cell(traces=[bar], x=across, y=_names_axis(), title=label))
        star = _column(one["mu_star"], "value")
        sigma, reach = np.array(one["sigma"]), 1.1 * float(star.max())
        line = {"color": style.MUTED, "width": 1, "dash": "dash"}
        ends = np.array([0.0, reach])
        guide = trace(ends, ends, "σ = μ*", line=line, hoverinfo="skip")
        names = [n if x > 0.02 * star.max() else "" for n, x in zip(factors, star, strict=True)]
        dots = trace(star, sigma, "", mode="markers+text", text=names)
        dots |= {"textposition": _positions(star), "textfont": {"size": 11}}
        dots |= {"hovertext": list(factors)}
        dots |= {"marker": {"size": 9, "color": COLOURS["mu_star"]}}
        dots |= {"hovertemplate": "%{hovertext}: μ* %{x:.3g}, σ %{y:.3g}<extra></extra>"}
        x, y = (style.axis(f"{letter}{size}", rangemode="tozero") for letter in ("μ*", "σ"))
        cells.append(Cell(traces=[guide, dots], x=x, y=y, title=label))
    return cells


def _bars(
    factors: Sequence[str], rates: Sequence[Mapping[str, float]], order: Sequence[int], key: str
) -> dict[str, Any]:
    value, low, high = (_column([rates[i] for i in order], k) for k in ("value", "low", "high"))
    return {
        "type": "bar",
        "orientation": "h",
        "name": NAMES[key],
        **{"x": value, "y": [factors[i] for i in order]},
        "marker": {"color": COLOURS[key], "opacity": 0.85},
        "error_x": bars(value, low, high, color=style.INK),
        "hovertemplate": "%{y}: %{x:.3g}<extra></extra>",
    }


def _order(rates: Sequence[Mapping[str, float]]) -> list[int]:
    """Return the factors from the least to the most telling, as bars are stacked upwards."""
    return sorted(range(len(rates)), key=lambda i: rates[i]["value"])


def _positions(x: Vector) -> list[str]:
    """Return where the names of neighbours stand, so that they do not cover each other."""
    around = ("top center", "bottom center", "middle right", "middle left")
    rank = np.argsort(np.argsort(x))
    return [around[i % len(around)] for i in rank]


def _column(rates: Sequence[Mapping[str, float | None]], key: str) -> Vector:
    return np.array([np.nan if one[key] is None else one[key] for one in rates], dtype=np.float64)


def _names_axis() -> dict[str, Any]:
    return style.axis("", type="category", showgrid=False, ticks="")


def _meaning(study: Study, name: str) -> str:
    of = "the indicator, 1 where a rollout diverged, lost contact or chattered"
    of = of if name == FAILED else title(study, name)
    if study.design.kind == "morris":
        return (
            f"Change of {of} while one factor crosses its range. μ*: mean size of the effect, with "
            "its 95 % interval; σ: how much it depends on the other factors."
        )
    return (
        f"Shares of the variance of {of}: by a factor alone (first order), and with all that it "
        "takes part in (total). Whiskers: 95 % intervals."
    )


def _used(by: Mapping[str, Any]) -> list[str]:
    """Return in words what is left out, controller by controller."""
    said = []
    for controller, one in by.items():
        if "note" in one:
            said.append(f"{controller}: none, {one['note']}.")
        for kind in ("blocks", "trajectories"):
            if kind in one and (gone := one[kind] - one[f"{kind}_used"]):
                why = "with a rollout that has no number"
                said.append(f"{controller}: {gone} of {one[kind]} {kind}, {why}, are left out.")
    return said
