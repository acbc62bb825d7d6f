"""Metrics of a run, named once for all scenarios. Gaps are relative: max |Δτ| / max |τ|."""

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix, Vector
from scenarios.record import fallback_count


def wiping_metrics(table: pl.DataFrame, force: float) -> dict[str, float]:
    """Return the metrics of a run that presses along tool z with ``force`` [N] while wiping.

    All are taken while wiping, but for the peak at touch and the timing.
    """
    wipe = table.filter(pl.col("phase") == "wipe")
    if wipe.is_empty():
        return dict.fromkeys(_NAMES, float("nan")) | whole_run_metrics(table)
    pressed = table.filter(pl.col("phase").is_in(["touch", "press"]))
    error = column(wipe, "wrench_meas.fz") - force
    pose = np.stack([column(wipe, f"motion.X_e.{i}") for i in range(6)], axis=1)
    return {
        "force_rmse_N": rms(error),
        "force_bias_N": float(error.mean()),
        "force_bias_abs_N": float(abs(error.mean())),
        "force_peak_N": float(column(wipe, "wrench_meas.fz").max()),
        "touch_peak_ratio": float(column(pressed, "wrench_meas.fz").max()) / force,
        "position_rmse_mm": 1e3 * rms(np.linalg.norm(pose[:, :2], axis=1)),
        "orientation_rmse_deg": float(np.degrees(rms(np.linalg.norm(pose[:, 3:], axis=1)))),
        "tilt_max_deg": float(np.degrees(np.linalg.norm(pose[:, 3:5], axis=1).max())),
        "contact_loss_fraction": _share(~wipe["touching"]),
        **tick_metrics(wipe),
        **whole_run_metrics(table),
    }


def tick_metrics(table: pl.DataFrame) -> dict[str, float]:
    """Return gaps on unsaturated ticks, and how many ticks saturated or fell back."""
    free = table.filter(~pl.col("saturated") & (pl.col("status") == "OK"))
    return {
        "qp_law_gap_max": _largest(free, "law_gap"),
        "qp_textbook_gap_max": _largest(free, "textbook_gap"),
        "curvature_term_max": _largest(free, "curvature"),
        "kkt_residual_max": _largest(table, "kkt_residual"),
        "saturated_fraction": _share(table["saturated"]),
        "fallback_ticks": float(fallback_count(table)),
    }


def whole_run_metrics(table: pl.DataFrame) -> dict[str, float]:
    """Return counts and timing of the whole run."""
    timing = column(table, "tick_us")
    return {
        "fallback_ticks_total": float(fallback_count(table)),
        "tick_us_median": float(np.median(timing)),
        "tick_us_p99": float(np.quantile(timing, 0.99)),
        "tick_us_p999": float(np.quantile(timing, 0.999)),
    }


_NAMES = (
    *("force_rmse_N", "force_bias_N", "force_bias_abs_N", "force_peak_N", "touch_peak_ratio"),
    *("position_rmse_mm", "orientation_rmse_deg", "tilt_max_deg", "contact_loss_fraction"),
    *("qp_law_gap_max", "qp_textbook_gap_max", "curvature_term_max", "kkt_residual_max"),
    *("saturated_fraction", "fallback_ticks"),
)


def column(table: pl.DataFrame, name: str) -> Vector:
    """Return a column of the record as numbers."""
    return table[name].to_numpy().astype(np.float64)


def _share(marks: pl.Series) -> float:
    return float(marks.to_numpy().mean()) if len(marks) else 0.0


def _largest(table: pl.DataFrame, name: str) -> float:
    return float(column(table, name).max()) if len(table) else float("nan")


def rms(values: Vector | Matrix) -> float:
    """Return the root of the mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def rms_norm(vectors: Matrix) -> float:
    """Return the root mean square of the length of each row."""
    return rms(np.linalg.norm(vectors, axis=1))


def largest_norm(vectors: Matrix) -> float:
    """Return the length of the longest row."""
    return float(np.linalg.norm(vectors, axis=1).max())
