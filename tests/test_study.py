"""Studies: factors, designs, outcomes, and the study of a tilted plane against closed forms."""

import json
import math
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import polars as pl
import pytest

from qpctrl import InputError
from scenarios.cli import main
from scenarios.study.design import one_at_a_time, sobol
from scenarios.study.factor import Factor
from scenarios.study.rollout import OutcomeClass, force_measures, roll_out
from scenarios.study.store import chunk_files
from scenarios.study.study import Task, plan_study
from scenarios.study.tilt import Tilt
from scenarios.study.wrong_normal import ForceLaw, held

QPCTRL = Path(sys.executable).parent / "qpctrl"
CLOSED_FORM_GAP = 1e-3  # relative, promised of a one-factor study
ROUND_OFF = 1e-9
TILT = Factor("tilt", "deg", -10.0, 10.0)
OFFSET = Factor("offset", "m", -0.01, 0.03)


class Ran(NamedTuple):
    """What a run of the study left behind."""

    out: Path
    summary: dict[str, Any]


# Factors and designs -------------------------------------------------------------------------


@pytest.mark.parametrize("ends", [(1.0, -1.0), (1.0, 1.0), (math.nan, 1.0), (0.0, math.inf)])
def test_a_factor_refuses_an_empty_or_endless_range(ends: tuple[float, float]) -> None:
    with pytest.raises(InputError, match=r"factor 'tilt'.*need"):
        Factor("tilt", "deg", *ends)


def test_levels_reach_both_ends_of_one_factor_while_the_others_keep_their_centre() -> None:
    points = one_at_a_time((TILT, OFFSET), 5, centre={"offset": 0.0})
    assert points[:5, 0] == pytest.approx([-10, -5, 0, 5, 10])
    assert points[:5, 1] == pytest.approx(np.zeros(5))
    assert points[5:, 0] == pytest.approx(np.zeros(5))
    assert points[5:, 1] == pytest.approx([-0.01, 0, 0.01, 0.02, 0.03])


def test_a_sobol_design_fills_every_cell_once_and_repeats_with_its_seed() -> None:
    points = sobol((TILT, OFFSET), 64, seed=3)
    low, high = np.array([-10, -0.01]), np.array([10, 0.03])
    cells = np.floor((points - low) / (high - low) * 64)
    assert [sorted(column) for column in cells.T.tolist()] == [list(range(64))] * 2
    assert np.array_equal(points, sobol((TILT, OFFSET), 64, seed=3))
    assert not np.array_equal(points, sobol((TILT, OFFSET), 64, seed=4))


@pytest.mark.parametrize(("size", "nearest"), [(12, 8), (13, 16), (100, 128), (1, 2), (-4, 2)])
def test_a_sobol_size_that_is_no_power_of_two_is_refused_with_the_nearest(
    size: int, nearest: int
) -> None:
    with pytest.raises(InputError, match=rf"got {size}, need a power of two; nearest {nearest}$"):
        sobol((TILT,), size, seed=0)


# Outcomes ------------------------------------------------------------------------------------

GOOD = {
    **{"contact_lost_fraction": 0.0, "saturated_fraction": 0.0, "fallback_ticks": 0.0},
    "force_rmse_ratio": 0.02,
}


@dataclass(frozen=True, kw_only=True)
class Scripted:
    """A study whose rollouts do what they are told."""

    name: ClassVar[str] = "scripted"
    summary: ClassVar[str] = "rollouts that do what they are told"
    controllers: ClassVar[tuple[str, ...]] = ("qp",)
    measures: ClassVar[tuple[str, ...]] = tuple(GOOD)
    shown: ClassVar[dict[str, str]] = {}
    factors: ClassVar[tuple[Factor, ...]] = (TILT,)
    found: Any = None

    def run(self, point: dict[str, float], controller: str, seed: int) -> dict[str, float]:
        """Return the measures, or raise them."""
        if isinstance(self.found, Exception):
            raise self.found
        return GOOD | self.found


def outcome(found: Any) -> dict[str, Any]:
    """Return the row of a rollout that finds ``found``."""
    return roll_out(Scripted(found=found), Task("x", 0, (2.5,), "qp", 7))


@pytest.mark.parametrize(
    ("found", "kind"),
    [
        ({}, "ok"),
        ({"force_rmse_ratio": 0.2}, "degraded"),
        ({"fallback_ticks": 1.0}, "degraded"),
        ({"saturated_fraction": 0.5, "force_rmse_ratio": 0.2}, "saturated"),
        ({"contact_lost_fraction": 0.001, "saturated_fraction": 0.5}, "lost"),
    ],
)
def test_the_worst_that_happened_is_the_outcome(found: dict[str, float], kind: str) -> None:
    row = outcome(found)
    assert row["outcome"] == kind
    assert row["force_rmse_ratio"] == (GOOD | found)["force_rmse_ratio"]
    assert (row["tilt_deg"], row["reason"]) == (2.5, "")


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (ZeroDivisionError("by\nzero"), "ZeroDivisionError: by zero"),
        ({"force_rmse_ratio": math.nan}, "not finite: force_rmse_ratio"),
        ({"saturated_fraction": math.inf}, "not finite: saturated_fraction"),
    ],
)
def test_what_goes_wrong_is_an_outcome_with_a_reason_and_no_numbers(
    found: Any, reason: str
) -> None:
    row = outcome(found)
    assert (row["outcome"], row["reason"]) == (OutcomeClass.DIVERGED, reason)
    assert [row[name] for name in GOOD] == [None] * len(GOOD)


def test_a_quantity_that_a_rollout_does_not_have_is_no_divergence() -> None:
    row = outcome({"fallback_ticks": None})
    assert (row["outcome"], row["fallback_ticks"]) == ("ok", None)


def test_force_statistics_of_a_known_signal() -> None:
    force = np.r_[np.full(90, 11.0), np.full(10, 4.0)]  # errors +1 and −6
    found = force_measures(force, 10.0)
    assert found["force_mae_N"] == pytest.approx(1.5)
    assert found["force_bias_N"] == pytest.approx(0.3)
    assert found["force_rmse_N"] == pytest.approx(math.sqrt(4.5))
    assert found["force_p95_N"] == pytest.approx(6.0)
    assert found["force_peak_N"] == 11.0


# A wrong normal ------------------------------------------------------------------------------


def tilted(degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the believed row (z) and the true one, turned about x."""
    alpha = np.radians(degrees)
    return np.eye(6)[2], np.r_[0, -np.sin(alpha), np.cos(alpha), 0, 0, 0]


@pytest.mark.parametrize(("degrees", "mm"), [(5, 2.196), (10, 4.476), (20, 9.683), (-10, -4.476)])
@pytest.mark.parametrize("gains", [(0.0, 0.0), (0.5, 0.0), (0.5, 20.0)])
def test_a_point_mass_is_pushed_aside_as_published(
    degrees: float, mm: float, gains: tuple[float, float]
) -> None:
    """Along the plane by f sin α / (m K_p cos²α): m = 2, K_p = 400, f = 20."""
    found = held(np.eye(6) / 2, *tilted(degrees), ForceLaw(20.0, *gains, 400.0, outside=False))
    assert found.force_ratio == pytest.approx(1 / np.cos(np.radians(degrees)), abs=ROUND_OFF)
    along = -found.offset[1] / np.cos(np.radians(degrees))  # desired − actual, seen from above
    assert 1e3 * along == pytest.approx(mm, abs=5e-4)


@pytest.mark.parametrize(("K_fp", "K_fi"), [(0.0, 0.0), (0.5, 0.0), (0.5, 20.0)])
def test_the_closed_form_balances_the_law_for_any_inertia(K_fp: float, K_fi: float) -> None:
    """P Λ K_p X_e + (I − P) F_cmd = A_tᵀ λ, solved as it stands."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6))
    Lambda_inv, (A_b, A_t) = root @ root.T + np.eye(6), tilted(12.0)
    Lambda, (f_d, K_p, cos) = np.linalg.inv(Lambda_inv), (20.0, 400.0, A_b @ A_t)
    P = np.eye(6) - np.outer(A_b, A_b @ Lambda_inv) / (A_b @ Lambda_inv @ A_b)
    system = np.zeros((8, 8))  # unknown: X_e (6), λ, f_cmd
    system[:6, :6], system[:6, 6], system[:6, 7] = K_p * P @ Lambda, -A_t, A_b
    system[6, :6] = A_b  # feedback leaves out the error along the believed normal
    system[7, 6:] = [cos, 0.0] if K_fi > 0 else [K_fp * cos, 1.0]
    rhs = np.r_[np.zeros(7), f_d if K_fi > 0 else (1 + K_fp) * f_d]
    *X_e, lam, _ = np.linalg.solve(system, rhs)
    found = held(Lambda_inv, A_b, A_t, ForceLaw(f_d, K_fp, K_fi, K_p, outside=False))
    assert found.force_ratio == pytest.approx(lam / f_d, rel=ROUND_OFF)
    assert found.offset == pytest.approx(np.array(X_e), rel=1e-8)
    if K_fi == 0:
        assert abs(found.force_ratio * cos - 1) > 0.02  # coupled inertia: no longer 1 / cos α


# The study -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    out = tmp_path_factory.mktemp("study") / "tilt"
    flags = ("--levels", "3", "--controllers", "qp", "hybrid", "textbook", "--json")
    done = subprocess.run(
        [QPCTRL, "study", "tilt", *flags, "--out", out], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return Ran(out, json.loads(done.stdout))


def rolled(tilt: float, **changes: Any) -> dict[str, Any]:
    """Return the row of one rollout of the QP."""
    row = roll_out(Tilt(**changes), Task("x", 0, (tilt,), "qp", 0))
    assert row["reason"] == ""
    return row


def test_every_controller_presses_too_hard_and_slides_too_fast_by_the_cosine(ran: Ran) -> None:
    table = ran.summary["table"]
    assert {row["controller"] for row in table} == {"qp", "hybrid", "textbook"}
    assert {row["tilt_deg"] for row in table} == {-10.0, 0.0, 10.0}
    for row in table:
        cos = np.cos(np.radians(row["tilt_deg"]))
        assert row["outcome"] == "ok"
        assert row["force_ratio"] == pytest.approx(1 / cos, rel=CLOSED_FORM_GAP / 10)
        assert row["speed_m_s"] == pytest.approx(0.1 / cos, rel=CLOSED_FORM_GAP)
        assert row["force_bias_N"] == pytest.approx(10 / cos - 10, abs=0.02)
        assert row["offset_gap"] < CLOSED_FORM_GAP
        assert np.sign(round(row["offset_mm"], 3)) == -np.sign(row["tilt_deg"])
        assert row["force_peak_N"] >= 10 / cos * (1 - 1e-4)
        assert 0 < row["qp_law_gap_max"] < 1e-8


def test_without_integral_an_arm_departs_from_one_over_the_cosine_as_its_inertia_says() -> None:
    low, high = (rolled(tilt, k_fp=0.0, k_fi=0.0) for tilt in (-10.0, 10.0))
    for row in (low, high):
        assert abs(row["offset_mm"]) > 0.1
        assert row["force_gap"] < CLOSED_FORM_GAP / 10
        assert row["force_gap_isotropic"] > 5 * CLOSED_FORM_GAP / 10
    assert low["force_ratio"] > high["force_ratio"]  # the sign of a tilt matters


def test_feeding_the_outside_wrench_forward_removes_the_offset_but_not_the_force_error() -> None:
    row = rolled(10.0, k_fp=0.0, k_fi=0.0, cutoff=50.0)
    assert abs(row["offset_mm"]) < 1e-4
    assert row["offset_closed_mm"] == 0.0
    assert row["force_gap"] < 1e-6
    assert row["force_ratio"] == pytest.approx(1 / np.cos(np.radians(10)), rel=1e-6)


def test_an_unstable_force_loop_saturates() -> None:
    assert rolled(5.0, k_fp=3.0, k_fi=0.0)["outcome"] == "saturated"


def test_a_start_that_would_need_the_plane_to_pull_loses_contact() -> None:
    """It accelerates away from the plane: tan α > f / (m a)."""
    away, towards = (rolled(tilt, force=0.3, speed=0.4) for tilt in (30.0, -30.0))
    assert (away["outcome"], towards["contact_lost_fraction"]) == ("lost", 0.0)
    assert away["contact_lost_fraction"] > 0.1


def test_identities_hang_on_all_that_a_result_depends_on(monkeypatch) -> None:
    def identities(seed: int = 0, **changes: Any) -> set[str]:
        return {task.identity for task in plan_study(Tilt(**changes), seed).tasks}

    base = identities()
    assert len(base) == 18
    for other in (identities(seed=1), identities(force=11.0), identities(levels=5)):
        assert not base & other
    monkeypatch.setattr("scenarios.study.study.code_version", lambda: {"source": "other"})
    assert not base & identities()


def test_controllers_share_the_random_numbers_of_a_point() -> None:
    tasks = plan_study(Tilt(levels=2, controllers=("qp", "textbook")), seed=4).tasks
    assert [task.controller for task in tasks] == ["qp", "textbook"] * 2
    assert tasks[0].seed == tasks[1].seed != tasks[2].seed


# The command line ----------------------------------------------------------------------------


def test_the_command_prints_and_writes_what_it_promises(ran: Ran) -> None:
    out, summary = ran
    assert summary == json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["outcomes"] == {"diverged": 0, "lost": 0, "saturated": 0, "degraded": 0, "ok": 9}
    limits = {c["name"]: c["limit"] for c in summary["criteria"]}
    assert [limits[f"{name}_gap"] for name in ("force", "offset", "speed")] == [CLOSED_FORM_GAP] * 3
    assert json.loads((out / "study.json").read_text())["configuration"]["levels"] == 3
    assert len(pl.read_parquet(out / "chunks" / "*.parquet")) == 9
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "signed tilt of the plane [deg]" in page
    assert "PASSED" in page


def test_status_counts_rows_and_says_by_its_exit_code_whether_some_are_missing(
    ran: Ran, tmp_path: Path, capsys
) -> None:
    folder = shutil.copytree(ran.out, tmp_path / "copy")
    for removed, said in ((0, "9 of 9 rows"), (2, "7 of 9 rows")):
        for path in chunk_files(folder)[:removed]:
            path.unlink()
        with pytest.raises(SystemExit) as exited:
            main(["study", "status", str(folder)])
        assert exited.value.code == (removed > 0)
        assert said in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("", "missing NAME; allowed: tilt"),
        ("tlit", "unknown study 'tlit'.*did you mean 'tilt'"),
        ("tilt --low 5 --high -5", "factor 'tilt': got low 5 and high -5 deg, need low < high"),
        ("tilt --low nan", "low: got nan, need finite"),
        ("tilt --high 80", "high: got 80, need -45 to 45 deg"),
        ("tilt --levels 1", "levels: got 1, need at least 2"),
        ("tilt --sobol 12", "nearest 8"),
        ("tilt --controllers pq", "unknown controller 'pq'"),
        ("tilt --controllers qp qp", "controllers: got 'qp qp'"),
        ("tilt --workers 0", "workers: got 0, need at least 1"),
        ("tilt --seed -1", "seed: got -1"),
        ("tilt --force 0", "force: got 0.0"),
        ("tilt --robot planar_2r", "unknown robot 'planar_2r'; allowed: fr3, ur5"),
        ("tilt --friction 1", "unknown flag '--friction'"),
        ("status", "missing DIR"),
        ("status /nowhere", "'/nowhere' holds no study"),
        ("tilt --out /proc/nowhere", "'/proc/nowhere' cannot be written"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments: str, said: str, capsys) -> None:
    with pytest.raises(SystemExit) as exited:
        main(["study", *arguments.split()])
    assert exited.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(said, line), line
