"""The report of a run: what the page says, what survives the thinning, and bad records."""

import copy
import json
import re
import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping
from html.parser import HTMLParser
from typing import Any

import numpy as np
import plotly.graph_objects as go
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from qpctrl import InputError, Status
from scenarios import report_figure, report_style, report_torque
from scenarios.catalogue import SCENARIOS
from scenarios.panel import board_panels
from scenarios.picture import png, render_scene
from scenarios.report import LABELS, label, quantity, render_report
from scenarios.video import screen as video_screen
from scenarios.world import build_world

TICKS = 5000
PHASES = ("approach", "touch", "press", "wipe", "release", "lift")
MAX_BYTES = 8_000_000
KINDS = ("tau_delivered", "tau_meas")
SINGLE = 1e-6
"""Relative: the page holds numbers in single precision."""

X_WE = np.array([[0, 0, 1, 0.3], [0, -1, 0, 0.1], [1, 0, 0, 0.8], [0, 0, 0, 1.0]])
"""z of the board along x of the world, x of the board up."""


def a_table(n: int = TICKS, joints: tuple[str, ...] = ("joint1", "joint2")) -> pl.DataFrame:
    """Return a record with everything in it, of a run that went well."""
    time = 1e-3 * np.arange(n)
    phase = np.array(PHASES)[np.minimum(np.arange(n) * len(PHASES) // max(n, 1), 5)]
    contact = np.isin(phase, ("press", "wipe", "release"))
    p_E = np.stack([0.08 * np.cos(time), 0.08 * np.sin(time), 0 * time], axis=1)
    p_W = p_E @ X_WE[:3, :3].T + X_WE[:3, 3]
    columns: dict[str, Any] = {
        "time": time,
        "phase": phase.astype(str).tolist(),
        "status": ["OK"] * n,
        "touching": contact,
        "saturated": np.zeros(n, dtype=bool),
        "active": [""] * n,
        "wrench_meas.fx": np.sin(time),
        "wrench_meas.fy": np.cos(time),
        "wrench_meas.fz": np.where(contact, 10.0, 0.0),
        "force.F_des.2": np.where(contact, 10.0, np.nan),
        "law_gap": np.full(n, 2e-13),
        "textbook_gap": np.full(n, 3e-4),
        "unexplained_gap": np.full(n, 4e-13),
        "curvature": np.where(contact, 3e-4, 0.0),
        "damping": np.zeros(n),
        "kkt_residual": np.full(n, 1e-12),
        "tick_us": 100.0 + np.arange(n) % 50,
    }
    columns |= {f"motion.X_e.{i}": 1e-5 * np.sin(time + i) for i in range(6)}
    columns |= {f"motion.X_WF.{9 + i}": p_W[:, i] for i in range(3)}
    for i, joint in enumerate(joints):
        columns |= {f"{kind}.{joint}": i + np.sin(time) for kind in ("tau", "tau_delivered")}
    return pl.DataFrame(columns)


def a_summary(**changes: Any) -> dict[str, Any]:
    """Return what summary.json holds of a run that passed."""
    criteria = [("force_rmse_N", 0.03, 0.1, "N"), ("qp_law_gap_max", 2e-13, 1e-8, "× max |τ|")]
    keys = ("name", "value", "limit", "unit")
    summary = {
        "scenario": "eraser",
        "passed": True,
        "criteria": [{**dict(zip(keys, row, strict=True)), "passed": True} for row in criteria],
        "metrics": {"force_rmse_N": 0.03, "tick_us_median": 123.0, "contact_loss_fraction": 0.25},
        "config": {"robot": "fr3", "force": 10.0, "home": None, "law": "qp", "solver": "proxsuite"},
        "versions": {"qpctrl": "0.1.0"},
    }
    return summary | changes


def geometry() -> dict[str, np.ndarray]:
    """Return the board and a circle on it."""
    angle = np.linspace(0, 2 * np.pi, 500)
    return {"X_WE": X_WE, "loops": 0.08 * np.stack([np.cos(angle), np.sin(angle)], axis=1)}


def without_plotly(page: str) -> str:
    """Return the page without the library embedded in it."""
    return re.sub(r"<script>/\*\*.*?</script>", "", page, flags=re.S)


def figures_in(page: str) -> dict[str, Any]:
    """Return the figures of a page; their JSON must be strict."""
    text = re.search(r"const figures = (.*);\n", page)
    assert text

    def refuse(constant: str) -> None:
        raise ValueError(constant)

    return json.loads(text[1], parse_constant=refuse)


def board_report(summary: dict[str, Any], table: pl.DataFrame, where: dict[str, Any]) -> str:
    """Return the page of a run on a board."""
    return render_report(summary, table, board_panels(summary, table, where))


def all_figures(table: pl.DataFrame) -> list[report_figure.Figure | None]:
    """Return every figure of a record."""
    return [
        report_figure.path_figure(table, geometry()),
        report_figure.force_figure(table, {"force_rmse_N": 0.1}),
        report_figure.error_figure(table, {"tilt_max_deg": 0.05}),
        report_torque.torque_figure(table),
        report_figure.equality_figure(table),
        report_figure.timing_figure(table),
    ]


def trace(figure: report_figure.Figure | None, name: str) -> dict[str, Any]:
    """Return the one trace of that name."""
    assert figure
    (found,) = [t for t in figure["data"] if t["name"] == name]
    return found


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_judged_metric_has_a_label(name: str) -> None:
    metrics: Mapping[str, float] = defaultdict(float)
    unnamed = {c.name for c in SCENARIOS[name]().judge(metrics)} - set(LABELS)
    assert not unnamed


def test_page_of_a_good_run_says_so_in_words() -> None:
    page = without_plotly(board_report(a_summary(), a_table(), geometry()))
    assert "✓ PASSED" in page
    assert "FAILED" not in page
    assert "What went wrong" not in page
    assert "2 of 2 criteria hold" in page
    for name in ("force_rmse_N", "qp_law_gap_max"):
        assert name in page
        assert label(name) in page
    assert "2·10⁻¹³" in page
    assert "robot fr3 · 10 N ·" in page


def test_page_of_a_bad_run_has_a_sentence_for_each_missed_criterion() -> None:
    summary = a_summary(passed=False)
    summary["criteria"][0] |= {"value": 0.35, "passed": False}
    summary["criteria"][1] |= {"value": None, "passed": False}
    page = without_plotly(board_report(summary, a_table(), geometry()))
    assert "✗ FAILED" in page
    assert "PASSED" not in page
    assert "0 of 2 criteria hold" in page
    assert "Force error, RMS: 0.35 N, the limit is 0.1 N, 3.5 times as much." in page
    assert "QP against hybrid law, largest gap: no value; the run&#x27;s phases were: app" in page


def test_fallback_ticks_are_listed_with_time_and_advice() -> None:
    status = ["OK"] * TICKS
    status[40:43], status[100] = ["INFEASIBLE"] * 3, "STALE"
    table = a_table().with_columns(status=pl.Series(status))
    page = without_plotly(board_report(a_summary(), table, geometry()))
    assert "4 of 5000 ticks sent the fallback torque" in page
    assert (
        f"0.040 s to 0.042 s (ticks: 3, approach): INFEASIBLE – {Status.INFEASIBLE.value}" in page
    )
    assert "(ticks: 1, approach): STALE" in page


def test_every_text_is_escaped() -> None:
    evil = "<img src=x onerror=alert(1)>"
    summary = a_summary(scenario=evil, config={"robot": evil, evil: [evil]})
    summary["criteria"][0] |= {"name": evil, "unit": evil}
    table = a_table(joints=(evil,)).with_columns(
        active=pl.lit(f"torque {evil}"), phase=pl.lit(evil), status=pl.lit(evil)
    )
    page = without_plotly(board_report(summary, table, geometry()))
    assert evil not in page
    assert "&lt;img src=x onerror=alert(1)&gt;" in page
    drawn = figures_in(page)
    assert evil not in json.dumps(drawn)
    names = [t["name"] for t in drawn["torque"]["data"]]
    assert names == ["&lt;img src=x onerror=alert(1)&gt;", "limit binds"]


class Loads(HTMLParser):
    """Collects whatever a page would load, and its element ids."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, str | None]] = []
        self.ids: list[str | None] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect what one tag refers to."""
        self.found += [(tag, value) for name, value in attrs if name in ("src", "href", "data")]
        self.ids += [value for name, value in attrs if name == "id"]


def test_page_loads_nothing_and_sends_nothing() -> None:
    page = board_report(a_summary(), a_table(), geometry())
    loads = Loads()
    loads.feed(page)
    assert not loads.found
    assert set(loads.ids) == {"path", "error", "force", "torque", "equality", "timing"}
    assert "url(" not in without_plotly(page)
    assert not re.search(r"https?://", without_plotly(page))
    assert "showSendToCloud: false" in page


def test_page_is_deterministic_and_small() -> None:
    table = a_table(60_000, joints=tuple(f"joint{i}" for i in range(30)))
    page = board_report(a_summary(), table, geometry())
    assert page == board_report(copy.deepcopy(a_summary()), table.clone(), geometry())
    assert len(page.encode()) <= MAX_BYTES
    lags = pl.selectors.starts_with("tau.") * 0.9
    table = table.with_columns(lags.name.replace("tau", kind) for kind in KINDS)
    page = board_report(a_summary(), table.with_columns(motor_limited=pl.lit(True)), geometry())
    assert page.count("joint29, ") == len(KINDS)
    assert len(page.encode()) <= MAX_BYTES


def test_every_figure_is_one_that_plotly_knows() -> None:
    active = [""] * (TICKS - 3) + ["torque joint2", "unilateral board.vz", "torque joint1"]
    table = a_table().with_columns(active=pl.Series(active), tau_delivered=pl.lit(0.0))
    for figure in all_figures(table):
        go.Figure(figure)  # raises on a property or value that plotly does not know


DAMAGES = {
    "no rows": lambda t: t.head(0),
    "one row": lambda t: t.head(1),
    "never in contact": lambda t: t.filter(pl.col("phase") == "approach"),
    "no wiping": lambda t: t.filter(pl.col("phase") != "wipe"),
    "no force columns": lambda t: t.select(pl.exclude("^force.*$")),
    "no signals at all": lambda t: t.select("time", "phase", "status"),
    "nothing finite": lambda t: t.with_columns(pl.selectors.float().exclude("time") * np.nan),
    "infinite": lambda t: t.with_columns(pl.selectors.float().exclude("time") + np.inf),
    "nulls": lambda t: t.with_columns(
        pl.lit(None, pl.Float64).alias("wrench_meas.fz"),
        pl.lit(None, pl.String).alias("active"),
        pl.lit(None, pl.Boolean).alias("touching"),
    ),
    "always at a limit": lambda t: t.with_columns(
        saturated=pl.lit(True), active=pl.lit("torque joint2, unilateral board.vz")
    ),
    "chattering": lambda t: t.with_columns(
        phase=pl.when(pl.col("time") * 1000 % 2 < 1).then(pl.lit("touch")).otherwise("phase")
    ),
    "drives": lambda t: driven(t),
    "drives that say nothing": lambda t: t.with_columns(motor_limited=pl.lit(None, pl.Boolean)),
    "other phases": lambda t: t.with_columns(phase=pl.col("phase") + " it"),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("where", [geometry(), {"X_WE": X_WE}, {}], ids=["all", "board", "none"])
def test_any_record_gives_a_page(
    damage: str, where: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("scenarios.report_page.get_plotlyjs", lambda: "/** five megabytes */")
    summary = a_summary(passed=False)
    for c in summary["criteria"]:
        c |= {"value": None, "passed": False}
    summary["metrics"] = dict.fromkeys(summary["metrics"])
    page = board_report(summary, DAMAGES[damage](a_table()), where)
    figures_in(page)
    assert "✗ FAILED" in without_plotly(page)
    assert "nan" not in re.sub(r"<script>.*?</script>", "", page, flags=re.S)


@given(
    arrays(np.float64, st.integers(1, 300), elements=st.floats(-1e6, 1e6) | st.just(np.nan)),
    st.integers(1, 40),
)
@settings(derandomize=True, deadline=None, max_examples=200)
def test_thinning_keeps_extremes_ends_and_order(y: np.ndarray, buckets: int) -> None:
    at = report_style.thin(y, buckets)
    assert (np.diff(at) > 0).all()
    assert at[0] == 0
    assert at[-1] == len(y) - 1
    assert len(at) <= 2 * buckets + 2
    if not np.isnan(y).all():
        assert np.nanmax(y[at]) == np.nanmax(y)
        assert np.nanmin(y[at]) == np.nanmin(y)


def test_a_peak_of_one_tick_survives() -> None:
    n, tick = 50_000, 31_234
    peaks = {"wrench_meas.fz": 77.0, "law_gap": 0.5, "tau.joint2": -88.0, "motion.X_e.0": 0.0009}
    table = a_table(n).with_columns(
        pl.when(pl.int_range(n) == tick).then(value).otherwise(pl.col(name)).alias(name)
        for name, value in peaks.items()
    )
    drawn = {
        "wrench_meas.fz": trace(report_figure.force_figure(table, {}), "normal, measured"),
        "law_gap": trace(report_figure.equality_figure(table), "QP − hybrid law"),
        "tau.joint2": trace(report_torque.torque_figure(table), "joint2"),
        "motion.X_e.0": trace(report_figure.error_figure(table, {}), "error along x"),
    }
    for name, value in peaks.items():
        y, scale = drawn[name]["y"], 1e6 if name.startswith("motion") else 1.0
        at = int(np.abs(y).argmax())
        assert y[at] == pytest.approx(scale * value, rel=SINGLE), name
        assert drawn[name]["x"][at] == pytest.approx(1e-3 * tick)
        assert len(y) < n / 10


def test_path_is_drawn_on_the_board_in_mm_while_touching() -> None:
    figure = report_figure.path_figure(a_table(), geometry())
    actual, pad = trace(figure, "actual path"), trace(figure, "wiped area")
    t = 1e-3 * np.arange(TICKS)
    touching = a_table()["touching"].to_numpy()
    assert np.nanmax(actual["y"]) == pytest.approx(80 * np.cos(t[touching]).max())
    assert np.nanmax(actual["x"]) == pytest.approx(80 * np.sin(t[touching]).max())
    assert np.nanmin(pad["y"]) == pytest.approx(80 * np.cos(t[touching]).min() - 60, abs=2.0)
    assert np.nanmax(pad["x"]) == pytest.approx(80 * np.sin(t[touching]).max() + 25, abs=2.0)


def test_marks_of_a_binding_limit_sit_on_the_joint_and_name_it() -> None:
    active = [""] * TICKS
    active[1000] = "torque rate joint2"
    table = a_table().with_columns(active=pl.Series(active))
    marks = trace(report_torque.torque_figure(table), "limit binds")
    assert marks["x"] == pytest.approx([1.0])
    assert marks["y"] == pytest.approx([1 + np.sin(1.0)])
    assert marks["text"] == ["torque rate joint2"]


def test_delivered_torque_is_drawn_only_where_it_differs() -> None:
    names = [t["name"] for t in report_torque.torque_figure(a_table())["data"]]
    assert names == ["joint1", "joint2"]
    lagging = a_table().with_columns((pl.col("tau.joint1") * 0.99).alias("tau_delivered.joint1"))
    names = [t["name"] for t in report_torque.torque_figure(lagging)["data"]]
    assert names == ["joint1", "joint1, delivered", "joint2"]


def driven(table: pl.DataFrame) -> pl.DataFrame:
    """Return the record as of joints with drives: the second lags and is measured wrongly."""
    tau1, tau2 = pl.col("tau.joint1"), pl.col("tau.joint2")
    return table.with_columns(
        tau1.alias("tau_delivered.joint1"),
        tau1.alias("tau_meas.joint1"),
        (tau2 - 0.5).alias("tau_delivered.joint2"),
        (tau2 + 0.25).alias("tau_meas.joint2"),
        motor_limited=pl.int_range(pl.len()).is_in([100, 101, 2500]),
    )


def test_commanded_delivered_and_measured_torque_are_three_curves_where_they_differ() -> None:
    figure = report_torque.torque_figure(driven(a_table()))
    names = [t["name"] for t in figure["data"]]
    curves = ["joint1", "joint2", "joint2, delivered", "joint2, measured"]
    assert names == [*curves, "motor at its limit"]
    lines = [trace(figure, name)["line"] for name in curves[1:]]
    assert len({one["color"] for one in lines}) == 1
    assert len({one["dash"] for one in lines}) == 3
    groups = [t.get("legendgroup") for t in figure["data"]]
    assert groups == ["joint1", "joint2", "joint2", "joint2", None]
    for name, offset in (("delivered", -0.5), ("measured", 0.25)):
        curve = trace(figure, f"joint2, {name}")
        assert curve["y"] == pytest.approx(1 + np.sin(curve["x"]) + offset)
    marks = trace(figure, "motor at its limit")
    assert marks["x"] == pytest.approx([0.1, 0.101, 2.5])
    go.Figure(figure)


def test_words_on_torque_say_what_drives_do_with_a_command() -> None:
    words = report_torque.torque_words(driven(a_table()))
    assert "differs most at joint2: by up to 0.5 Nm, RMS 0.5 Nm." in words
    assert "No limit bound on any tick." in words
    assert "limit of current or voltage on 3 of 5\u202f000 ticks" in words
    calm = driven(a_table()).with_columns(motor_limited=pl.lit(False))
    assert "No motor met its limit" in report_torque.torque_words(calm)
    assert "motor" not in report_torque.torque_words(a_table())


def test_words_on_equality_leave_out_ticks_at_a_limit() -> None:
    limited = pl.int_range(TICKS) == 7
    table = a_table().with_columns(
        saturated=limited, law_gap=pl.when(limited).then(0.1).otherwise(pl.col("law_gap"))
    )
    words = report_figure.equal_words(table)
    assert "4 999 of 5 000 ticks" in words.replace("\u202f", " ")
    assert "at most 2·10⁻¹³ of max |τ|: they are one law, to round-off" in words
    worse = report_figure.equal_words(table.with_columns(saturated=pl.lit(False)))
    assert "at most 0.1 of max |τ|: they are not one law" in worse


def test_gaps_are_not_drawn_where_there_was_no_solution() -> None:
    status = ["OK"] * 100
    status[10:20] = ["INFEASIBLE"] * 10
    table = a_table(100).with_columns(status=pl.Series(status), law_gap=pl.lit(0.0))
    drawn = trace(report_figure.equality_figure(table), "QP − hybrid law")["y"]
    assert np.isnan(drawn[10:20]).all()
    assert (np.r_[drawn[:10], drawn[20:]] == report_figure.FLOOR).all()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0306605, "0.0307"),
        (4.2e-13, "4.2·10⁻¹³"),
        (1e-8, "10⁻⁸"),
        (-3.5, "−3.5"),
        (12345.6, "12\u202f346"),
        (999.7, "1\u202f000"),
        (0, "0"),
        (None, "n/a"),
        (float("nan"), "n/a"),
        (float("-inf"), "−∞"),
        (True, "True"),
    ],
)
def test_numbers_read_as_people_write_them(value: object, text: str) -> None:
    assert report_style.number(value) == text


def test_fractions_are_shown_per_cent() -> None:
    assert quantity("contact_loss_fraction", 0.25, "") == ("25", "%")
    assert quantity("force_rmse_N", 0.25) == ("0.25", "N")
    assert quantity("my_metric", 2.0, "m") == ("2", "m")


def test_pixels_come_back_from_the_png() -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    data = png(pixels)
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", data[16:24]) == (7, 5)
    start = data.index(b"IDAT")
    (length,) = struct.unpack(">I", data[start - 4 : start])
    lines = np.frombuffer(zlib.decompress(data[start + 4 : start + 4 + length]), np.uint8)
    assert (lines.reshape(5, 22)[:, 1:].reshape(5, 7, 3) == pixels).all()


def test_a_machine_without_opengl_is_told_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("no display")

    monkeypatch.setattr(video_screen, "_context", fail)
    world = build_world("fr3")
    with pytest.raises(InputError, match="no display; set MUJOCO_GL=egl"):
        render_scene(world, world.robot.home)
    with pytest.raises(InputError, match="q: got shape"):
        render_scene(world, np.zeros(3))
