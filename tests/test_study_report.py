"""The report of a study: its numbers, its verdicts in words, what is drawn, and the command."""

import json
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import polars as pl
import pytest
from plotly.offline import get_plotlyjs
from scipy.stats import binomtest, t, ttest_rel

from qpctrl import InputError
from scenarios.cli import main
from scenarios.cli_study_print import print_conclusion, print_rows
from scenarios.panel import Panel
from scenarios.study.design import Design
from scenarios.study.factor import Factor
from scenarios.study.importance import share
from scenarios.study.outcome import CONTACT_MEASURES, FORCE_MEASURES, TICK_MEASURES
from scenarios.study.page import render_study
from scenarios.study.parameter import Parameter, choice
from scenarios.study.picture import study_panels
from scenarios.study.picture.cloud import thinned
from scenarios.study.plan import Plan
from scenarios.study.rollout import row_schema
from scenarios.study.search import Boundary, Worst
from scenarios.study.store import chunk_files
from scenarios.study.study import Along, Limit, Published, Study
from scenarios.study.study_file import study_of
from scenarios.study.summary import conclude
from scenarios.study.system import Rollout, Setting
from scenarios.study.systems import SYSTEMS
from scenarios.study.verdict import standing, verdicts
from scenarios.study.word import amount, entry, limit_words, title, unit_of

MAX_BYTES = 6_000_000
NBSP = "\u00a0"


@dataclass(frozen=True)
class Pushing:
    """A system that is never run: its rows are made up."""

    name: ClassVar[str] = "pushing"
    summary: ClassVar[str] = "rows that are made up"
    parameters: ClassVar[Mapping[str, Parameter]] = {
        "tilt": Parameter("deg", 0.0, -45.0, 45.0, "tilt of the plane"),
        "stiffness": Parameter("N_m", 1e4, 1.0, 1e8, "stiffness of the wall"),
        "delay": Parameter("ticks", 1.0, 0.0, 99.0, "delay of the reading", whole=True),
        "k_fp": Parameter("1", 0.5, 0.0, 100.0, "proportional force gain"),
        "robot": choice("the arm", "fr3", "ur5"),
    }
    controllers: ClassVar[Mapping[str, str]] = {n: n for n in ("qp", "law", "spring", "slow")}
    measures: ClassVar[Mapping[str, str]] = {
        "offset_mm": "tangential offset",
        "offset_mm_closed": "its closed form",
        "offset_mm_gap": "relative distance of the two",
        **FORCE_MEASURES,
        "position_mae_mm": "mean absolute position error",
        **CONTACT_MEASURES,
        **TICK_MEASURES,
    }

    def run(self, setting: Setting, controller: str, seed: int, *, full: bool = False) -> Rollout:
        """Refuse to run."""
        raise NotImplementedError

    def limit(self, setting: Setting, controller: str, parameter: str) -> float | None:
        """Return none."""
        return None


TILT = Factor("tilt", "deg", -10.0, 10.0)
STIFFNESS = Factor("stiffness", "N_m", 1e3, 1e6, "log-uniform")
DELAY = Factor("delay", "ticks", 1.0, 5.0, whole=True, values=(1.0, 2.0, 5.0))
ROBOT = Factor("robot", "choice", 0.0, 1.0, whole=True, values=(0.0, 1.0))

GAIN = Factor("k_fp", "1", 0.1, 0.7, values=(0.1, 0.3, 0.7))

Answer = Callable[[Mapping[str, float], str, int], Mapping[str, Any]]
"""Outcome, reason and measures of a row from its point, controller and repeat."""


def a_study(**of: Any) -> Study:
    """Return a study of the made-up system."""
    usual: dict[str, Any] = {"controllers": ("qp",), "factors": (TILT,), "show": ("force_mae_N",)}
    return Study(name="made-up", summary="made up", system=Pushing(), **{**usual, **of})


def rows_of(study: Study, answer: Answer) -> pl.DataFrame:
    """Return the table of a study whose rows are answers."""
    rows = []
    for task in Plan(study, 0):
        point = dict(zip((f.name for f in study.columns), task.point, strict=True))
        rows.append(
            {
                **dict.fromkeys(row_schema(study)),
                **{f.column: point[f.name] for f in study.columns},
                **{"identity": task.identity, "row": task.row, "repeat": task.repeat},
                **{"controller": task.controller, "seed": task.seed, "elapsed_s": 0.1},
                **{"outcome": "ok", "reason": "", **answer(point, task.controller, task.repeat)},
            }
        )
    return pl.DataFrame(rows, schema=row_schema(study), orient="row")


def concluded(study: Study, table: pl.DataFrame) -> dict[str, Any]:
    """Return the summary, as its file would say it."""
    summary = conclude(study, Plan(study, 0).manifest(), table, None).summary
    return json.loads(json.dumps(summary, allow_nan=False))


def drawn(study: Study, table: pl.DataFrame) -> dict[str, Panel]:
    """Return the pictures by key."""
    return {p.key: p for p in study_panels(study, table, concluded(study, table))}


def page_of(study: Study, table: pl.DataFrame) -> str:
    """Return the page."""
    found = conclude(study, Plan(study, 0).manifest(), table, None)
    return render_study(study, table, *found)


def printed(study: Study, table: pl.DataFrame, capsys: pytest.CaptureFixture[str]) -> str:
    """Return what is printed of a study."""
    criteria, summary = conclude(study, Plan(study, 0).manifest(), table, None)
    print_conclusion(study, table, criteria, summary, Path("out"))
    return capsys.readouterr().out


def traces(panel: Panel, name: str) -> list[dict[str, Any]]:
    """Return the traces of a picture with this name."""
    assert panel.figure is not None
    return [t for t in panel.figure["data"] if t.get("name") == name]


def diverged(**of: Any) -> dict[str, Any]:
    """Return a row that diverged, with no measures."""
    return {"outcome": "diverged", "reason": "left all bounds at 0.1 s", **of}


# Levels --------------------------------------------------------------------------------------


def tilted(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
    """Return offsets of −2 mm a degree around a closed form, and forces that differ."""
    if point["tilt"] == 10.0 and controller == "law":
        return diverged()
    closed = -2.0 * point["tilt"]
    force = {"qp": 1.0, "law": 3.0}[controller] + 0.1 * repeat
    return {
        **{"offset_mm": closed + 0.5 * (repeat - 1), "offset_mm_closed": closed},
        **{"offset_mm_gap": 0.01, "force_mae_N": force},
    }


@pytest.fixture(scope="module")
def leveled() -> tuple[Study, pl.DataFrame]:
    study = a_study(
        controllers=("qp", "law"),
        factors=(TILT, DELAY),
        design=Design(size=5),
        repeats=3,
        show=("offset_mm", "force_mae_N"),
    )
    return study, rows_of(study, tilted)


def test_levels_are_drawn_with_means_and_intervals_over_the_closed_form(leveled) -> None:
    panel = drawn(*leveled)["level-offset_mm"]
    over_tilt, over_delay = traces(panel, "qp")
    np.testing.assert_array_equal(over_tilt["x"], [-10, -5, 0, 5, 10])
    np.testing.assert_allclose(over_tilt["y"], [20, 10, 0, -10, -20], atol=1e-12)
    np.testing.assert_array_equal(over_delay["x"], [1, 2, 5])
    for side in ("array", "arrayminus"):
        assert (over_tilt["error_y"][side] > 0.1).all()
        assert (over_tilt["error_y"][side] <= 0.5 + 1e-12).all()
    form = traces(panel, "closed form")[0]
    np.testing.assert_allclose(form["y"], [20, 10, 0, -10, -20])
    assert form["mode"] == "lines"
    assert over_tilt["mode"] == "markers"


def test_what_diverged_is_not_drawn_but_told(leveled) -> None:
    panel = drawn(*leveled)["level-force_mae_N"]
    (law, _) = traces(panel, "law")
    np.testing.assert_array_equal(law["x"], [-10, -5, 0, 5])
    np.testing.assert_allclose(law["y"], 3.1)
    assert law["mode"] == "markers"  # no line over the hole
    assert "3 of 48 have no number (3 diverged)" in panel.caption
    (tick,) = panel.figure["layout"]["shapes"]
    assert (tick["x0"], tick["xref"], tick["yref"]) == (10.0, "x", "y domain")


def test_a_closed_form_of_each_controller_is_drawn_where_they_differ(leveled) -> None:
    study, table = leveled
    other = table.with_columns(
        pl.when(pl.col("controller") == "law").then(7.0).otherwise("offset_mm_closed")
        .alias("offset_mm_closed")
    )  # fmt: skip
    panel = drawn(study, other)["level-offset_mm"]
    assert traces(panel, "closed form") == []
    np.testing.assert_array_equal(traces(panel, "closed form, law")[0]["y"], [7.0] * 5)


def every_number(value: Any) -> list[float]:
    """Return all numbers of the data of a figure, missing ones as NaN."""
    if isinstance(value, Mapping):
        return [x for v in value.values() for x in every_number(v)]
    if isinstance(value, np.ndarray):
        return value.astype(float).ravel().tolist()
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [x for v in value for x in every_number(v)]
    return [float("nan")] if value is None else [value] if isinstance(value, int | float) else []


def test_no_figure_holds_what_is_no_number() -> None:
    count = 0
    for study, table in every_design():
        for panel in drawn(study, table).values():
            if panel.figure:
                data = panel.figure["data"]
                maps = [t for t in data if t["type"] == "heatmap"]  # these say None, no NaN
                numbers = every_number([t for t in data if t not in maps])
                numbers += [z for t in maps for z in t["z"] if z is not None]
                assert np.isfinite(numbers).all(), panel.key
                count += len(numbers)
    assert count > 1000


# Boundaries ----------------------------------------------------------------------------------


def gave_way(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
    """Return a limit of 1e4 / (delay · stiffness), searched up to 5."""
    closed = 1e4 / point["delay"] / point["stiffness"]
    if closed > 5:
        return {"reason": "holds up to the end", "k_fp_limit_closed": closed, "rollouts": 2.0}
    return {
        **{"k_fp_limit": 1.001 * closed, "k_fp_limit_closed": closed},
        **{"k_fp_limit_gap": 1e-3, "rollouts": 12.0},
    }


def a_limit_study() -> Study:
    search = Boundary(
        parameter="k_fp", low=1e-3, high=5.0, measure="force_mae_N", limit=1.0, scale="log"
    )
    design = Design(kind="map", size=4)
    return a_study(factors=(STIFFNESS, DELAY), design=design, search=search, show=())


def test_limits_are_drawn_log_log_a_curve_a_delay_with_the_closed_form_dashed() -> None:
    study = a_limit_study()
    panel = drawn(study, rows_of(study, gave_way))["limit-k_fp_limit"]
    (found,), (closed,) = (
        traces(panel, name) for name in ("delay 2 ticks", "delay 2 ticks, closed form")
    )
    np.testing.assert_allclose(found["x"], [1e3, 1e4, 1e5, 1e6], rtol=1e-12)
    np.testing.assert_allclose(found["y"], 1.001 * 1e4 / 2 / found["x"])
    np.testing.assert_allclose(closed["y"], 1e4 / 2 / np.array([1e3, 1e4, 1e5, 1e6]))
    assert closed["line"]["dash"] == "dash"
    layout = panel.figure["layout"]
    assert (layout["xaxis"]["type"], layout["yaxis"]["type"]) == ("log", "log")
    assert len(traces(panel, "delay 1 ticks")[0]["x"]) == 3
    assert "No mark at 1 of 12 points, searched from 0.001 to 5: 1 holds up to the end" in (
        panel.caption
    )


def test_a_limit_that_was_found_nowhere_is_told_in_words() -> None:
    study = a_limit_study()
    table = rows_of(study, lambda *_: {"reason": "does not hold at the start", "rollouts": 2.0})
    panel = drawn(study, table)["limit-k_fp_limit"]
    assert panel.figure is None
    assert "12 does not hold at the start" in panel.caption
    assert panel.caption in page_of(study, table)
    said = verdicts(concluded(study, table))["qp"]
    assert said.startswith("found at 0 of 12 points, it does not hold at the start at 12")


def test_a_verdict_on_limits_says_where_they_were_found_and_how_near_they_are() -> None:
    study = a_limit_study()
    said = verdicts(concluded(study, rows_of(study, gave_way)))["qp"]
    assert said == (
        "found at 11 of 12 points, nothing gives way up to the end at 1; value of k_fp up to which "
        "force_mae_N ≤ 1: 0.002 … 5, within 0.001 of its closed form"
    )


# Maps ----------------------------------------------------------------------------------------


def lost_beyond(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
    """Lose contact in one of four repeats at delay 5; diverge in all at a tilt of 10."""
    if point["tilt"] == 10.0 and controller == "law":
        return diverged()
    lost = point["delay"] == 5.0 and repeat == 0
    return {"force_mae_N": abs(point["tilt"]) + point["delay"], "outcome": "lost" if lost else "ok"}


def a_map_study() -> Study:
    design = Design(kind="map", size=5)
    return a_study(controllers=("qp", "law"), factors=(TILT, DELAY), design=design, repeats=4)


def tile(trace: Mapping[str, Any], x: str, y: str) -> float | None:
    """Return the number of a cell of a heat map; none where it has none."""
    found = [
        z for a, b, z in zip(trace["x"], trace["y"], trace["z"], strict=True) if (a, b) == (x, y)
    ]
    return found[0] if found else None


def test_a_map_shows_the_share_of_failures_and_means_of_what_did_not_diverge() -> None:
    study = a_map_study()
    panels = drawn(study, rows_of(study, lost_beyond))
    qp, law = panels["map-failed"].figure["data"]
    assert panels["map-failed"].title == "Share of rollouts diverged or lost"
    assert [tile(qp, "−5", "5"), tile(qp, "−5", "1")] == [25.0, 0.0]
    assert [tile(law, "10", "1"), tile(law, "−10", "5")] == [100.0, 25.0]
    assert "1 of 4, 95 %: 4.56 … 69.9 %" in qp["text"]
    qp, law = panels["map-force_mae_N"].figure["data"]
    assert [tile(qp, "10", "2"), tile(law, "5", "2")] == [12.0, 7.0]
    assert tile(law, "10", "2") is None
    assert "12 of 120 rollouts have no number" in panels["map-force_mae_N"].caption


def test_levels_without_a_number_stay_on_the_map() -> None:
    study = a_map_study()
    table = rows_of(study, lost_beyond)
    law = drawn(study, table)["map-force_mae_N"].figure["data"][1]
    assert len(law["z"]) == 15
    at = [i for i, x in enumerate(law["x"]) if x == "10"]
    assert [(law["y"][i], law["z"][i], law["text"][i]) for i in at] == [
        (y, None, "no number") for y in ("1", "2", "5")
    ]
    cut = table.filter(pl.col("tilt_deg") < 10)
    failed = drawn(study, cut)["map-failed"].figure["data"][0]
    assert [failed["text"][i] for i in at] == ["no rollouts yet"] * 3
    assert '"z":' in page_of(study, table)


# Indices -------------------------------------------------------------------------------------


def additive(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
    """Return x + 2 y of the shares x, y of tilt and (logarithmic) stiffness; the robot is idle."""
    x = (point["tilt"] + 10) / 20
    y = np.log10(point["stiffness"] / 1e3) / 3
    return {"force_mae_N": 1 + x + 2 * y, "outcome": "lost" if y > 0.9 else "ok"}


def test_indices_are_those_of_the_additive_function_and_are_drawn() -> None:
    study = a_study(factors=(TILT, STIFFNESS, ROBOT), design=Design(kind="indices", size=256))
    table = rows_of(study, additive)
    found = concluded(study, table)["sensitivity"]
    assert found["factors"] == ["tilt", "stiffness", "robot"]
    one = found["controllers"]["qp"]["force_mae_N"]
    for kind in ("first", "total"):
        values = [rate["value"] for rate in one[kind]]
        assert values == pytest.approx([0.2, 0.8, 0.0], abs=0.02)
        assert all(r["low"] <= r["value"] <= r["high"] for r in one[kind])
    failed = found["controllers"]["qp"]["failed"]["total"]
    assert [r["value"] for r in failed] == pytest.approx([0, 1, 0], abs=0.1)
    panel = drawn(study, table)["index-force_mae_N"]
    (bar,) = traces(panel, "total")
    assert bar["y"] == ["robot", "tilt", "stiffness"]
    np.testing.assert_allclose(bar["x"], sorted(r["value"] for r in one["total"]))
    assert (bar["error_x"]["array"][1:] > 0).all()


def test_blocks_that_diverged_or_are_not_there_yet_are_left_out_and_counted() -> None:
    study = a_study(factors=(TILT, STIFFNESS), design=Design(kind="indices", size=32))
    table = rows_of(study, additive)
    gone = pl.when(pl.col("row") == 5).then(None).otherwise("force_mae_N").alias("force_mae_N")
    cut = table.with_columns(gone).filter(pl.col("row") != 127)
    one = concluded(study, cut)["sensitivity"]["controllers"]["qp"]["force_mae_N"]
    assert (one["blocks"], one["blocks_used"]) == (32, 30)
    caption = drawn(study, cut)["index-force_mae_N"].caption
    assert "qp: 2 of 32 blocks, with a rollout that has no number, are left out." in caption


def test_indices_that_cannot_be_had_are_told_in_words() -> None:
    study = a_study(factors=(TILT, STIFFNESS), design=Design(kind="indices", size=8))
    same = rows_of(study, lambda *_: {"force_mae_N": 1.0})
    panel = drawn(study, same)["index-force_mae_N"]
    assert panel.figure is None
    assert "qp: none, the same in all rollouts." in panel.caption
    few = rows_of(study, lambda p, *_: diverged() if p["tilt"] > 0 else {"force_mae_N": 1.0})
    assert "blocks: " in drawn(study, few)["index-force_mae_N"].caption


def test_morris_effects_are_the_slopes_over_the_whole_range_of_each_factor() -> None:
    study = a_study(
        factors=(TILT, STIFFNESS, GAIN), design=Design(kind="morris", size=8), repeats=3
    )
    table = rows_of(study, additive)
    one = concluded(study, table)["sensitivity"]["controllers"]["qp"]["force_mae_N"]
    assert [r["value"] for r in one["mu_star"]] == pytest.approx([1.0, 2.0, 0.0], abs=1e-9)
    assert one["sigma"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    partial = concluded(study, table.filter(pl.col("row") != 0))["sensitivity"]
    used = partial["controllers"]["qp"]["force_mae_N"]
    assert (used["trajectories"], used["trajectories_used"]) == (8, 7)
    plane = drawn(study, table)["index-force_mae_N"].figure["data"][2]
    np.testing.assert_allclose(plane["x"], [1.0, 2.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    "factor",
    [TILT, STIFFNESS, Factor("tilt", "deg", -3.0, 9.0, "normal")],
    ids=["uniform", "log-uniform", "normal"],
)
def test_shares_are_what_the_factor_makes_its_values_of(factor: Factor) -> None:
    shares = np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(share(factor, factor.at(shares)), shares, atol=1e-12)


# Random points, and the front ----------------------------------------------------------------


def traded(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
    """Return force and path errors that controllers trade for each other."""
    force, path = {"qp": (1.0, 8.0), "law": (2.0, 4.0), "spring": (5.0, 5.0)}[controller]
    wave = np.sin(7 * point["tilt"])
    return {"force_mae_N": force + 0.2 * wave, "position_mae_mm": path + 0.5 * wave}


def a_cloud_study(size: int = 64) -> Study:
    return a_study(
        controllers=("qp", "law", "spring"),
        factors=(TILT, STIFFNESS),
        design=Design(kind="sobol", size=size),
        published=(
            Published(
                name="theirs",
                source="Someone2020",
                note="another arm",
                measures={"force_mae_N": 2.05, "position_mae_mm": 3.07},
            ),
        ),
    )


def test_the_front_is_that_of_the_means_beside_published_numbers() -> None:
    study = a_cloud_study()
    table = rows_of(study, traded)
    panel = drawn(study, table)["front"]
    (front,), (theirs,) = traces(panel, "front"), traces(panel, "published")
    mean = table.group_by("controller").agg(pl.col("force_mae_N", "position_mae_mm").mean())
    expected = mean.filter(pl.col("controller") != "spring").sort("position_mae_mm")
    np.testing.assert_allclose(front["x"], expected["position_mae_mm"])
    np.testing.assert_allclose(front["y"], expected["force_mae_N"])
    assert (theirs["x"][0], theirs["y"][0]) == (3.07, 2.05)
    (qp,) = traces(panel, "qp")
    assert qp["error_x"]["array"][0] > 0
    page = page_of(study, table)
    row = re.search(r"<td[^>]*>theirs.*?</tr>", page)
    assert row
    assert all(said in row[0] for said in ("Someone2020", "another arm", "2.05", "3.07"))


def test_one_controller_alone_has_no_front() -> None:
    study = a_study(design=Design(size=3))
    assert "front" not in drawn(study, rows_of(study, lambda *_: {"force_mae_N": 1.0}))


def test_a_cloud_is_thinned_the_same_way_each_time_and_keeps_its_extremes() -> None:
    y = np.sin(np.arange(5000.0))
    y[1234], y[4321] = 9.0, -9.0
    at = thinned(y, 100)
    assert 90 <= len(at) <= 100
    assert {1234, 4321} <= set(at.tolist())
    np.testing.assert_array_equal(at, thinned(y, 100))
    np.testing.assert_array_equal(thinned(y[:50], 100), np.arange(50))
    study = a_cloud_study(1024)
    panel = drawn(study, rows_of(study, traded))["cloud-force_mae_N"]
    assert "900 of 3072 rollouts are drawn" in panel.caption
    assert all(len(t["x"]) <= 300 for t in panel.figure["data"])


# Published numbers ---------------------------------------------------------------------------


def a_published_study(**of: Any) -> Study:
    """Return levels of tilt beside a controller that gives mean, spread, peak, and a curve."""
    along = Along(factor="tilt", measure="force_mae_N", at=(-10.0, 10.0), values=(1.48, 6.1))
    theirs = Published(
        name="theirs",
        source="Someone2020",
        measures={"force_mae_N": 2.05, "force_peak_N": 62.0},
        largest=("force_peak_N",),
        deviations={"force_mae_N": 1.67},
        along=(along,),
    )
    return a_study(**{"design": Design(size=3), "repeats": 4, "published": (theirs,)} | of)


def peaked(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
    """Return a force error of tilt / 10 + 3 + repeat, and peaks of 50, 51, 52 and 53 N."""
    return {"force_mae_N": point["tilt"] / 10 + 3 + repeat, "force_peak_N": 50.0 + repeat}


def cells_of(line: str) -> list[str]:
    """Return the texts of the cells of a row of a table."""
    return [re.sub("<[^>]*>", " ", c).strip() for c in re.findall("<t[dh].*?</t[dh]>", line)]


def published_lines(page: str) -> list[list[str]]:
    """Return the rows of the tables of published numbers."""
    start = page.index("Beside published numbers")
    return [cells_of(x) for x in page[start : page.index("</section>", start)].split("<tr>")[1:]]


def test_the_largest_stands_beside_the_largest_and_a_deviation_beside_a_deviation() -> None:
    study = a_published_study()
    page = page_of(study, rows_of(study, peaked))
    heads, ours, theirs, *_ = published_lines(page)
    assert heads[1:] == [
        "mean absolute force error [N]",
        f"{title(study, 'force_peak_N')}, largest over the rollouts",
    ]
    errors = np.add.outer([2.0, 3.0, 4.0], np.arange(4.0))
    assert ours[1].startswith(f"4.5 ± {errors.std(ddof=1):.3g}  ")
    assert (ours[2], theirs[1:]) == ("53", ["2.05 ± 1.67", "62"])


def test_numbers_along_a_factor_are_stars_and_a_table() -> None:
    study = a_published_study()
    table = rows_of(study, peaked)
    panel = drawn(study, table)["level-force_mae_N"]
    (star,) = traces(panel, "theirs, published")
    np.testing.assert_array_equal(star["x"], [-10, 10])
    np.testing.assert_array_equal(star["y"], [1.48, 6.1])
    assert "Stars: published." in panel.caption
    heads, ours, theirs = published_lines(page_of(study, table))[-3:]
    assert (heads[1:], ours[1:], theirs[1:]) == (["−10", "10"], ["3.5", "5.5"], ["1.48", "6.1"])


def test_what_is_published_must_name_what_the_study_has() -> None:
    along = Along(factor="delay", measure="force_mae_N", at=(1.0,), values=(2.0,))
    with pytest.raises(InputError, match="unknown factor 'delay'"):
        a_published_study(published=(Published(name="a", source="b", along=(along,)),))
    with pytest.raises(InputError, match="unknown measure published by 'a' 'force_peak_N'"):
        Published(name="a", source="b", largest=("force_peak_N",))
    with pytest.raises(InputError, match="got 1 values at 2 places, need one at each"):
        Along(factor="tilt", measure="force_mae_N", at=(1.0, 2.0), values=(2.0,))


def test_a_file_says_notes_and_all_of_what_is_published(monkeypatch) -> None:
    monkeypatch.setitem(SYSTEMS, "pushing", Pushing())
    study = a_published_study(notes="one\n\ntwo")
    again = study_of(study.configuration())
    assert (again.published, again.notes) == (study.published, "one\n\ntwo")
    assert "notes" not in study.inputs()


# What is no sample ---------------------------------------------------------------------------


def test_without_a_sample_there_are_ranges_and_no_intervals() -> None:
    study = a_study(controllers=("qp", "law"), design=Design(size=5))
    table = rows_of(study, lambda p, c, r: {"force_mae_N": 20 + p["tilt"] * (1 + (c == "law"))})
    summary = concluded(study, table)
    found = summary["controllers"]["qp"]["measures"]["force_mae_N"]
    assert (found["value"], found["min"], found["max"]) == (20, 10, 30)
    assert not {"low", "high"} & found.keys()
    assert verdicts(summary)["qp"] == (
        "keeps contact in all 5 rollouts; mean absolute force error: 10 … 30 N"
    )
    page = without_plotly(page_of(study, table))
    assert "95 %" not in page
    assert "One rollout at each chosen point is no sample" in page
    assert "<code>from</code> 10 … 30" in page


@pytest.mark.parametrize(("step", "said"), [(21.0, "best of 2"), (19.0, "")])
def test_without_a_sample_ranges_that_do_not_overlap_are_told_apart(step: float, said: str) -> None:
    study = a_study(controllers=("qp", "law"), design=Design(size=5))

    def answer(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
        return {"force_mae_N": 20 + point["tilt"] + step * (controller == "law")}

    assert standing(concluded(study, rows_of(study, answer)), "force_mae_N", "qp") == said


def test_without_a_sample_failures_are_counted_and_not_ranked() -> None:
    study = a_study(controllers=("qp", "law"), factors=(TILT, DELAY), design=Design(kind="map"))
    said = verdicts(concluded(study, rows_of(study, lost_beyond)))
    assert said["qp"].startswith(f"lost contact in 9 of 27 rollouts (33.3{NBSP}%); ")
    assert "failures" not in "".join(said.values())


def test_repeats_and_random_points_are_a_sample(leveled) -> None:
    assert concluded(*leveled)["sampled"]
    study = a_cloud_study(4)
    assert concluded(study, rows_of(study, traded))["sampled"]
    assert concluded(*a_worst_study())["sampled"]
    assert not concluded(limits := a_limit_study(), rows_of(limits, gave_way))["sampled"]


# Worst settings ------------------------------------------------------------------------------


def a_worst_study() -> tuple[Study, pl.DataFrame]:
    search = Worst(measure="force_mae_N", trials=8)
    study = a_study(factors=(TILT, ROBOT), search=search, repeats=4, show=())

    def found(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
        at = {"worst_tilt_deg": 2.5 * repeat, "worst_robot_choice": float(repeat % 2)}
        if repeat == 1:
            return {"outcome": "lost", **at, "worst_force_mae_N": 1.5, "rollouts": 3.0}
        outcome = "degraded" if repeat == 0 else "ok"
        return {"outcome": outcome, **at, "worst_force_mae_N": float(repeat), "rollouts": 8.0}

    return study, rows_of(study, found)


def test_the_worst_settings_are_listed_with_failures_first() -> None:
    study, table = a_worst_study()
    page = page_of(study, table)
    body = page[
        page.index("Worst settings found") : page.index("</section>", page.index("Worst s"))
    ]
    lines = [
        [re.sub(r"<[^>]*>", "", cell).strip() for cell in re.findall(r"<td.*?</td>", line)]
        for line in body.split("<tr>")[2:]
    ]
    assert [line[1:] for line in lines] == [
        ["lost", "1.5", "2.5", "ur5", "3"],
        ["ok", "3", "7.5", "ur5", "8"],
        ["ok", "2", "5", "fr3", "8"],
        ["degraded", "0", "0", "fr3", "8"],
    ]
    said = verdicts(concluded(study, table))["qp"]
    assert said.startswith(f"lost contact in 1 of 4 searches (25{NBSP}%, 95{NBSP}%: 4.56 … 69.9")


# Verdicts ------------------------------------------------------------------------------------


def around(means: Mapping[str, float], spread: float = 0.2, common: float = 0.0) -> Answer:
    """Return a force error that spreads around a mean for each controller, and no failures.

    ``common`` is what a draw does to all controllers alike; in the mean of 5 draws, nothing.
    """

    def answer(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
        own = spread * np.sin(5.0 * repeat + list(means).index(controller))
        return {"force_mae_N": means[controller] + own + common * (repeat % 5 - 2)}

    return answer


def compared(means: Mapping[str, float], repeats: int = 70, **of: Any) -> dict[str, Any]:
    """Return the summary of controllers with these mean force errors."""
    study = a_study(controllers=tuple(means), factors=(), repeats=repeats, **of)
    return concluded(study, rows_of(study, around(means)))


def test_the_best_is_named_where_its_interval_overlaps_no_other() -> None:
    summary = compared({"qp": 1.4, "law": 2.0, "spring": 3.0, "slow": 9.0})
    said = verdicts(summary)
    one = summary["controllers"]["qp"]["measures"]["force_mae_N"]
    assert one["low"] < one["value"] < one["high"]
    assert said["qp"] == (
        "keeps contact in all 70 rollouts; mean absolute force error "
        f"{one['value']:.3g} N (95{NBSP}%: {one['low']:.3g} … {one['high']:.3g}), best of 4"
    )
    ends = [said[name].rsplit(", ", 1)[1] for name in ("law", "spring", "slow")]
    assert ends == ["second of 4", "third of 4", "worst of 4"]


def test_no_verdict_where_the_interval_of_the_difference_holds_zero() -> None:
    said = verdicts(compared({"qp": 1.4, "law": 1.41, "spring": 3.0, "slow": 3.01}))
    assert said["qp"].endswith("), not distinguishable from law")
    assert said["slow"].endswith("), not distinguishable from spring, more than qp and law")
    assert "best" not in "".join(said.values())


def test_a_measure_that_goes_below_zero_is_not_ranked() -> None:
    summary = compared({"qp": 1.0, "law": 9.0})
    assert standing(summary, "force_mae_N", "qp") == "best of 2"
    summary["controllers"]["law"]["measures"]["force_mae_N"]["min"] = -1.0
    assert standing(summary, "force_mae_N", "qp") == ""


def test_few_rollouts_and_one_controller_are_not_ranked() -> None:
    few = verdicts(compared({"qp": 1.0, "law": 9.0}, repeats=9))
    assert few["qp"].endswith("); 9 rollouts are too few to rank it")
    assert "best of 2" in verdicts(compared({"qp": 1.0, "law": 9.0}, repeats=10))["qp"]
    alone = verdicts(compared({"qp": 1.0}))["qp"]
    assert alone.endswith(")")
    assert "rank" not in alone


def at_levels(answer: Answer, repeats: int, **of: Any) -> dict[str, Any]:
    """Return the summary of two controllers at five tilts that share their draws."""
    study = a_study(**{"controllers": ("qp", "law"), "design": Design(size=5)} | of)
    study = replace(study, repeats=repeats)
    return concluded(study, rows_of(study, answer))


def test_rows_of_one_draw_do_not_count_as_many() -> None:
    summary = at_levels(around({"qp": 1.0, "law": 9.0}), 9)
    one = summary["controllers"]["qp"]
    assert (one["rows"], one["draws"]) == (45, 9)
    assert verdicts(summary)["qp"].endswith("); 9 draws are too few to rank it")
    assert "best of 2" in verdicts(at_levels(around({"qp": 1.0, "law": 9.0}), 10))["qp"]


def test_what_a_draw_does_to_both_does_not_hide_their_difference() -> None:
    summary = at_levels(around({"qp": 10.0, "law": 10.5}, common=3.0), 20)
    qp, law = (summary["controllers"][n]["measures"]["force_mae_N"] for n in ("qp", "law"))
    assert qp["high"] > law["low"] + 2.0
    assert verdicts(summary)["qp"].endswith("best of 2")
    assert verdicts(summary)["law"].endswith("worst of 2")


def test_the_difference_of_two_controllers_is_that_of_a_paired_t_test_over_draws() -> None:
    rng = np.random.default_rng(0)
    draw, own = 5 * rng.normal(size=25), rng.normal(size=(2, 5, 25))

    def answer(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
        tilt, which = round(point["tilt"] / 5) + 2, int(controller == "law")
        return {"force_mae_N": 50 + tilt + which + draw[repeat] + own[which, tilt, repeat]}

    summary = at_levels(answer, 25)
    found = summary["controllers"]["qp"]["differences"]["force_mae_N"]["law"]
    means = own.mean(axis=1) + np.array([[0.0], [1.0]])
    test = ttest_rel(*means).confidence_interval()
    assert found["value"] == pytest.approx(means[0].mean() - means[1].mean())
    width = test.high - test.low
    assert [found["low"], found["high"]] == pytest.approx([test.low, test.high], abs=0.1 * width)
    assert found["draws"] == 25
    back = summary["controllers"]["law"]["differences"]["force_mae_N"]["qp"]
    assert [back["low"], back["high"]] == pytest.approx([-found["high"], -found["low"]])


@pytest.mark.parametrize(("kind", "draws"), [("sobol", 8), ("morris", 8), ("indices", 8)])
def test_points_that_are_drawn_are_draws_with_all_their_repeats(kind: Any, draws: int) -> None:
    study = a_study(factors=(TILT, STIFFNESS, GAIN), design=Design(kind=kind, size=8), repeats=3)
    table = rows_of(study, additive)
    one = concluded(study, table)["controllers"]["qp"]
    assert one["draws"] == draws
    first = table.filter(pl.col("row") < len(table) // 3 // 8)
    alone = concluded(study, first)["controllers"]["qp"]["measures"]["force_mae_N"]
    assert not {"low", "high"} & alone.keys()  # how far a single draw is off is open


@pytest.mark.parametrize(
    ("law", "said"), [(1.011, "best of 2"), (1.009, "not distinguishable from law")]
)
def test_a_difference_that_does_not_matter_is_not_told(law: float, said: str) -> None:
    study = a_study(controllers=("qp", "law"), factors=(), repeats=40)
    summary = concluded(study, rows_of(study, around({"qp": 1.0, "law": law}, spread=0.001)))
    apart = summary["controllers"]["qp"]["differences"]["force_mae_N"]["law"]
    assert apart["high"] < 0
    assert verdicts(summary)["qp"].endswith(f"), {said}")


@pytest.mark.parametrize(("bad", "said"), [(5, ""), (6, "most failures of 2")])
@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_what_differs_in_a_few_draws_alone_is_chance(bad: int, said: str, noise: float) -> None:
    def answer(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
        off = controller == "law" and repeat < bad
        force = 2.0 if off else 1.0 + noise * (controller == "law")
        return {"force_mae_N": force, "outcome": "lost" if off else "ok"}

    summary = at_levels(answer, 40)
    apart = summary["controllers"]["law"]["differences"]
    assert all(apart[m]["qp"]["low"] > 0 for m in ("force_mae_N", "failed"))
    assert standing(summary, "force_mae_N", "law") == (
        "worst of 2" if said else "not distinguishable from qp"
    )
    words = verdicts(summary)["law"]
    assert words.startswith(f"lost contact in {5 * bad} of 200 rollouts ({2.5 * bad:.3g}{NBSP}%, ")
    assert (f"), {said};" in words) == bool(said)


def test_the_interval_of_a_rate_counts_draws_where_all_of_a_draw_fails() -> None:
    def answer(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
        return {"force_mae_N": 1.0, "outcome": "lost" if repeat < 6 else "ok"}

    one = at_levels(answer, 20)["controllers"]["qp"]["failed"]
    score = binomtest(6, 20).proportion_ci(0.95, method="wilson")
    assert one["value"] == 0.3
    assert [one["low"], one["high"]] == pytest.approx([score.low, score.high])


def test_a_controller_that_diverged_is_not_compared_by_what_it_survived() -> None:
    study = a_study(controllers=("qp", "law", "spring"), factors=(), repeats=40)
    calm = around({"qp": 2.0, "law": 1.0, "spring": 3.0})

    def answer(point: Mapping[str, float], controller: str, repeat: int) -> Mapping[str, Any]:
        bad = controller == "law" and repeat < 20
        return diverged() if bad else calm(point, controller, repeat)

    summary = concluded(study, rows_of(study, answer))
    said = verdicts(summary)
    assert said["law"].startswith(
        f"diverged in 20 of 40 rollouts (50{NBSP}%, 95{NBSP}%: 35.2 … 64.8{NBSP}%), most failures"
        " of 3;"
    )
    assert "more than" not in said["qp"]
    assert said["law"].endswith("its numbers are of the other 20, so it is not ranked")
    assert said["qp"].endswith("best of 2")
    assert summary["controllers"]["law"]["measures"]["force_mae_N"]["rollouts"] == 20


def test_failures_are_compared_by_their_rates() -> None:
    study = a_study(controllers=("qp", "law"), factors=(), repeats=40)

    def answer(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
        outcome = (
            "lost" if controller == "law" and repeat % 2 else "chatter" if repeat == 3 else "ok"
        )
        return {"force_mae_N": 1.0, "outcome": outcome}

    said = verdicts(concluded(study, rows_of(study, answer)))
    assert said["qp"].startswith("chattered in 1 of 40 rollouts (2.5")
    assert "), fewest failures of 2;" in said["qp"]
    assert "lost contact in 20 of 40 rollouts" in said["law"]
    assert "), most failures of 2;" in said["law"]


def test_what_has_a_sign_is_told_as_a_range_and_never_ranked(leveled) -> None:
    summary = concluded(*leveled)
    said = verdicts(summary)["qp"]
    assert "tangential offset: −20.5 … 20.5 mm, within 0.01 of its closed form" in said
    assert standing(summary, "offset_mm", "qp") == ""
    assert "<code>from</code> −20.5 … 20.5" in page_of(*leveled)


def test_units_and_words_of_measures_and_criteria() -> None:
    study = a_limit_study()
    assert unit_of(study, "k_fp_limit") == ""
    study = a_study()
    units = [unit_of(study, n) for n in ("offset_mm_closed", "force_rmse_ratio", "longest_loss_ms")]
    assert units == ["mm", "", "ms"]
    assert unit_of(study, "offset_mm_gap") == ""
    limit = Limit(measure="offset_mm_gap", limit=1e-3, controllers=("qp",))
    assert limit_words(study, limit) == (
        "tangential offset: relative distance from its closed form, largest of qp"
    )


def test_the_interval_of_independent_points_is_the_standard_error_of_their_mean() -> None:
    study = a_cloud_study(128)
    table = rows_of(study, traded)
    values = table.filter(pl.col("controller") == "qp")["force_mae_N"].to_numpy()
    found = concluded(study, table)["controllers"]["qp"]["measures"]["force_mae_N"]
    width = 2 * t.ppf(0.975, 127) * values.std(ddof=1) / np.sqrt(128)
    assert found["high"] - found["low"] == pytest.approx(width, rel=0.1)


def test_means_and_rates_are_those_of_the_rows(leveled) -> None:
    study, table = leveled
    one = concluded(study, table)["controllers"]["law"]
    values = table.filter(pl.col("controller") == "law")["force_mae_N"].drop_nulls().to_numpy()
    found = one["measures"]["force_mae_N"]
    assert (found["value"], found["max"]) == pytest.approx((values.mean(), values.max()))
    by_draw = values.reshape(-1, 3).mean(axis=0)  # of three, the interval holds all
    assert (found["low"], found["high"]) == pytest.approx((by_draw.min(), by_draw.max()))
    assert one["outcomes"]["diverged"] == 3
    assert one["rates"]["diverged"]["value"] == pytest.approx(3 / 24)
    assert found["rollouts"] == 21


# The page ------------------------------------------------------------------------------------


def every_design() -> list[tuple[Study, pl.DataFrame]]:
    """Return a study of each kind with its rows."""
    factors = (TILT, STIFFNESS, ROBOT)
    shapes = {"indices": 16, "morris": 6}
    made = [a_study(factors=factors, design=Design(kind=k, size=n)) for k, n in shapes.items()]  # type: ignore[arg-type]
    found = [(study, rows_of(study, additive)) for study in made]
    for study, answer in (
        (a_limit_study(), gave_way),
        (a_map_study(), lost_beyond),
        (a_cloud_study(), traded),
    ):
        found.append((study, rows_of(study, answer)))
    return [*found, a_worst_study()]


def without_plotly(page: str) -> str:
    """Return the page without the library that draws."""
    return page.replace(get_plotlyjs(), "")


def test_a_page_of_any_design_loads_nothing_and_names_no_nan() -> None:
    for study, table in every_design():
        page = without_plotly(page_of(study, table))
        assert not re.search(r"https?://|<link|src=", page)
        assert not re.search(r"\bNaN\b|\bnan\b|undefined", page)
        assert "Factors" in page
        assert "NOT JUDGED" in page


def test_a_page_of_ten_thousand_rows_is_small() -> None:
    factors = (TILT, STIFFNESS, ROBOT, DELAY, Factor("k_fp", "1", 0.0, 1.0))
    show = ("force_mae_N", "force_rmse_N", "position_mae_mm")
    study = a_study(
        controllers=("qp", "law", "spring"),
        factors=factors,
        design=Design(kind="indices", size=512),
        show=show,
    )

    def answer(point: Mapping[str, float], controller: str, repeat: int) -> dict[str, Any]:
        found = traded(point, controller, repeat)
        return {**found, "force_rmse_N": found["force_mae_N"] * (1 + point["k_fp"])}

    table = rows_of(study, answer)
    assert len(table) == 10_752
    page = page_of(study, table)
    assert len(page.encode()) <= MAX_BYTES
    assert "of 10752 rollouts are drawn" in page


def test_criteria_are_told_in_words_with_their_units(leveled) -> None:
    study, table = leveled
    limit = Limit(measure="force_mae_N", limit=2.05, statistic="mean", controllers=("qp",))
    judged = a_study(
        controllers=("qp", "law"), factors=(TILT, DELAY), design=study.design, repeats=3,
        criteria=(limit,),
    )  # fmt: skip
    page = page_of(judged, table)
    assert "mean absolute force error, mean over the rollouts of qp" in page
    assert "PASSED" in page
    assert re.search(r"1\.1</td><td class=\"n\">≤ 2\.05</td><td>N</td>", page)


def test_notes_stand_on_the_page_and_are_printed_in_lines_that_fit(capsys) -> None:
    study = a_study(notes="Contact is <soft> here [N].\n\n" + 40 * "why so ", repeats=2)
    table = rows_of(study, lambda *_: {"force_mae_N": 1.0})
    page = page_of(study, table)
    assert "<h2>Notes</h2><p>Contact is &lt;soft&gt; here [N].</p><p>why so" in page
    assert page.index("<h2>Notes") < page.index("<h2>Controllers")
    assert "<h2>Notes" not in page_of(a_study(repeats=2), table)
    out = printed(study, table, capsys)
    assert "Contact is <soft> here [N]." in out
    assert out.count("why so") == 40
    assert max(map(len, out.splitlines())) <= 100


def test_round_off_is_told_as_zero_and_ratios_with_five_digits() -> None:
    assert [amount(x) for x in (9e-13, -9e-13, 2e-12)] == ["0", "0", "2·10⁻¹²"]
    assert entry("force_ratio", 1.0154321) == entry("force_ratio_closed", 1.0154321) == "1.0154"
    assert entry("force_ratio_gap", 1.0154321) == "1.02"
    study = a_study(show=("force_rmse_ratio",), repeats=2)
    table = rows_of(study, lambda *_: {"force_rmse_ratio": 1.0154321, "force_bias_N": 3e-17})
    page = page_of(study, table)
    assert ">1.0154<br>" in page
    assert "10⁻¹⁷" not in page


# The commands --------------------------------------------------------------------------------


def exit_code(*arguments: str) -> int:
    """Return what the command line ends with."""
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("study") / "tilt"
    assert exit_code("study", "tilt", "--size", "2", "--workers", "1", "--out", str(out)) == 0
    return out


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "copy"))


def test_the_report_is_written_again_from_the_rows(folder: Path, made: Path, capsys) -> None:
    for name in ("report.html", "summary.json"):
        (folder / name).unlink()
    assert exit_code("report", str(folder)) == 0
    out = capsys.readouterr().out
    assert "4 rows (4 ok) PASSED" in out
    assert "keeps contact in all 2 rollouts" in out
    assert max(map(len, out.splitlines()[:-1])) <= 100
    theirs, ours = (
        json.loads((at / "summary.json").read_text(encoding="utf-8")) for at in (made, folder)
    )
    assert theirs["timing"]
    assert ours == {**theirs, "timing": None}
    page = (folder / "report.html").read_text(encoding="utf-8")
    before = (made / "report.html").read_text(encoding="utf-8")
    assert "Seed 0; how long it took is not known." in page
    took = re.search(r"Seed 0; (4 rows made in [\d.]+ s, [\d.]+ /s)\.", before)
    assert took
    assert before.replace(took[1], "how long it took is not known") == page
    assert '0</td><td class="n">≤ 10⁻⁸' in page  # what is but round-off
    assert "keeps contact in all 2 rollouts" in page
    ratio = theirs["controllers"]["qp"]["measures"]["force_ratio"]
    assert ratio["value"] == pytest.approx(1 / np.cos(np.radians(10)), rel=1e-4)


def test_an_unfinished_study_says_how_many_rows_are_there(folder: Path, capsys) -> None:
    chunk_files(folder)[0].unlink()
    assert exit_code("report", str(folder), "--json") == 1
    summary = json.loads(capsys.readouterr().out)
    assert (summary["rows_done"], summary["rows"], summary["passed"]) == (3, 4, False)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert re.search(r"UNFINISHED</strong><span>3 of 4 rows", page)
    assert exit_code("report", str(folder)) == 1
    assert "3 of 4 rows (3 ok) UNFINISHED" in capsys.readouterr().out


def test_other_folders_are_refused_in_one_line(folder: Path, tmp_path: Path, capsys) -> None:
    run = tmp_path / "run"
    run.mkdir()
    for name in ("ticks.parquet", "report.html", "summary.json"):
        (run / name).touch()
    shutil.rmtree(folder / "chunks")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "study.json").write_text("{}", encoding="utf-8")
    cases = {
        str(run): rf"is that of a run, whose report is there already: {run}/report.html",
        str(tmp_path): "holds no study: no study.json",
        str(tmp_path / "none"): "which is no folder; need that of a study",
        str(folder): "holds no rows yet",
        str(tmp_path / "broken"): "is not that of a study",
        "--jsn": "missing DIR",
    }
    for argument, said in cases.items():
        assert exit_code("report", argument) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert re.search(said, line), line
    assert exit_code("report", str(folder), "--jsn") == 2
    assert "did you mean '--json'" in capsys.readouterr().err
    assert exit_code("report", "--help") == 0
    assert "qpctrl report runs/study-tilt" in capsys.readouterr().out


def test_rows_of_another_version_are_refused_in_one_line(folder: Path, capsys) -> None:
    for path in chunk_files(folder):
        pl.read_parquet(path).drop("offset_mm").write_parquet(path)
    assert exit_code("report", str(folder)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "offset_mm" in line


def test_a_large_study_is_printed_short(capsys) -> None:
    study = a_cloud_study()
    table = rows_of(study, traded)
    criteria, summary = conclude(study, Plan(study, 0).manifest(), table, None)
    print_conclusion(study, table, criteria, summary, Path("out"))
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 20
    assert max(map(len, lines)) <= 100
    said = " ".join(" ".join(lines).split())
    assert "qp keeps contact in all 64 rollouts; mean absolute force error" in said


def line_of(out: str, start: str) -> str:
    """Return the line that starts so, with single spaces."""
    (line,) = [line for line in out.splitlines() if line.startswith(start)]
    return " ".join(line.split())


def test_published_numbers_are_printed_beside_ours(capsys) -> None:
    study = a_published_study()
    out = printed(study, rows_of(study, peaked), capsys)
    errors = np.add.outer([2.0, 3.0, 4.0], np.arange(4.0))
    assert line_of(out, "qp, ours") == f"qp, ours 4.5 ± {errors.std(ddof=1):.3g} 53"
    assert line_of(out, "theirs") == "theirs 2.05 ± 1.67 62"
    assert "(largest)" in out


@pytest.mark.parametrize(
    ("kind", "size", "said"),
    [("indices", 64, r"qp stiffness 0\.[78]\d* \(0\.\d+ … \d\.\d+\), tilt 0\.[12]\d* \("),
     ("morris", 8, r"qp stiffness 2 \(2 … 2\), tilt 1 \(1 … 1\), robot 0 \(0 … 0\)$")],
)  # fmt: skip
def test_the_ranking_of_the_factors_is_printed(kind: Any, size: int, said: str, capsys) -> None:
    study = a_study(factors=(TILT, STIFFNESS, ROBOT), design=Design(kind=kind, size=size))
    out = printed(study, rows_of(study, additive), capsys)
    ranked = out[out.index("total index" if kind == "indices" else "mean size of effect") :]
    assert re.search(said, line_of(ranked, "qp"))


def test_a_query_prints_the_columns_that_fit_and_says_how_many_there_are(capsys) -> None:
    table = pl.DataFrame({f"a_column_{i:02}": [0.1234567, 3e-17] for i in range(40)})
    print_rows(table)
    head, first, second, *_, last = capsys.readouterr().out.splitlines()
    count = len(head.split())
    assert 3 < count < 40
    assert first.split() == ["0.12346"] * count
    assert second.split() == ["0"] * count
    assert last == f"{count} of 40 columns; select some, or --json"
    print_rows(table.select("a_column_00"))
    assert "columns" not in capsys.readouterr().out


def test_rows_are_printed_with_the_measures_that_fit(capsys) -> None:
    show = ("force_mae_N", "force_rmse_N", "position_mae_mm", "contact_lost_fraction")
    for factors, count in (((TILT,), 4), ((TILT, STIFFNESS, DELAY, GAIN), 2)):
        study = a_study(factors=factors, show=show, design=Design(kind="levels", size=2))
        table = rows_of(study, lambda *_: dict.fromkeys(show, 1.0))
        head = next(x for x in printed(study, table, capsys).splitlines() if "outcome" in x)
        assert [name for name in show if name in head] == list(show[:count])
        assert "…" not in head
