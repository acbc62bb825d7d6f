"""A wrong normal: its closed forms, and the study that measures it against them."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.study.plan import Task
from scenarios.study.rollout import roll_out
from scenarios.study.study_file import find_study, read_study, study_of
from scenarios.study.systems.wrong_normal import ForceLaw, held

QPCTRL = Path(sys.executable).parent / "qpctrl"
CLOSED_FORM_GAP = 1e-3  # relative, promised of a one-factor study
ROUND_OFF = 1e-9


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


def rolled(tilt: float, controller: str = "qp", **fixed: Any) -> dict[str, Any]:
    """Return the row of one rollout."""
    said = read_study(find_study("tilt"))
    study = study_of({**said, "fixed": fixed, "controllers": [controller]})
    row = roll_out(study, Task("x", 0, 0, (tilt,), controller, 0)).row
    assert row["reason"] == ""
    return row


@pytest.mark.parametrize("controller", ["qp", "hybrid", "textbook"])
@pytest.mark.parametrize("tilt", [-10.0, 0.0, 10.0])
def test_every_controller_presses_too_hard_and_slides_too_fast_by_the_cosine(
    tilt: float, controller: str
) -> None:
    row, cos = rolled(tilt, controller), np.cos(np.radians(tilt))
    assert row["outcome"] == "ok"
    assert row["force_ratio"] == pytest.approx(1 / cos, rel=CLOSED_FORM_GAP / 10)
    assert row["speed_m_s"] == pytest.approx(0.1 / cos, rel=CLOSED_FORM_GAP)
    assert row["force_bias_N"] == pytest.approx(10 / cos - 10, abs=0.02)
    assert row["offset_mm_gap"] < CLOSED_FORM_GAP
    assert np.sign(round(row["offset_mm"], 3)) == -np.sign(tilt)
    assert row["force_peak_N"] >= 10 / cos * (1 - 1e-4)
    assert 0 < row["qp_law_gap_max"] < 1e-8


def test_without_integral_an_arm_departs_from_one_over_the_cosine_as_its_inertia_says() -> None:
    low, high = (rolled(tilt, k_fp=0.0, k_fi=0.0) for tilt in (-10.0, 10.0))
    for row in (low, high):
        assert abs(row["offset_mm"]) > 0.1
        assert row["force_ratio_gap"] < CLOSED_FORM_GAP / 10
        isotropic = row["force_ratio"] * np.cos(np.radians(10))
        assert abs(isotropic - 1) > CLOSED_FORM_GAP / 2
    assert low["force_ratio"] > high["force_ratio"]  # the sign of a tilt matters


def test_feeding_the_outside_wrench_forward_removes_the_offset_but_not_the_force_error() -> None:
    row = rolled(10.0, k_fp=0.0, k_fi=0.0, cutoff=50.0)
    assert abs(row["offset_mm"]) < 1e-4
    assert row["offset_mm_closed"] == 0.0
    assert row["force_ratio_gap"] < 1e-6
    assert row["force_ratio"] == pytest.approx(1 / np.cos(np.radians(10)), rel=1e-6)


def test_a_start_that_would_need_the_plane_to_pull_loses_contact() -> None:
    """It accelerates away from the plane: tan α > f / (m a)."""
    away, towards = (rolled(tilt, force=0.3, speed=0.4) for tilt in (30.0, -30.0))
    assert (away["outcome"], towards["contact_lost_fraction"]) == ("lost", 0.0)
    assert away["longest_loss_ms"] > 100


def test_the_study_passes_and_is_the_same_on_any_number_of_processes(tmp_path: Path) -> None:
    found = []
    for workers in ("1", "2"):
        flags = ("--size", "2", "--workers", workers, "--json", "--out", tmp_path / workers)
        command = [QPCTRL, "study", "tilt", *flags]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout))
    one, two = found
    assert one["passed"]
    assert all(c["value"] is not None for c in one["criteria"])
    assert one["controllers"]["qp"]["rows"] == 2
    for summary in (one, two):
        del summary["timing"]
    assert one == two
