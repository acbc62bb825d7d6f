"""Metrics of a run, named once for all scenarios. Gaps are relative: max |Δτ| / max |τ|."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, Vector
from qpctrl.contact import ContactPhase
from scenarios.record import WRENCH, fallback_count

SETTLE_TIME = 0.5
"""Time [s] from regaining contact until the force is judged as that of wiping."""


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


class LossEvents(NamedTuple):
    """When contact was lost and regained."""

    gone: float
    """Time [s] of the last tick at which tool and environment touched."""
    lost: float
    """Time [s] at which the contact counted as lost."""
    regained: float
    """Time [s] at which the environment was felt again."""


def loss_events(table: pl.DataFrame) -> LossEvents | None:
    """Return the first loss of contact in a record, or none without loss and regain."""
    time, contact = column(table, "time"), table["contact"].to_numpy()
    lost_at, regained_at = ContactPhase.LOSS.name, ContactPhase.REGAIN.name
    ticks, start = [], 0
    for mark in (~table["touching"].to_numpy(), contact == lost_at, contact == regained_at):
        after = np.flatnonzero(mark[start:])
        if not len(after):
            return None
        start += int(after[0])
        ticks.append(start)
    open_at, lost, regained = ticks
    return LossEvents(*(float(time[i]) for i in (max(open_at - 1, 0), lost, regained)))


def normal_speed(table: pl.DataFrame) -> Vector:
    """Return the speed of the tool (ticks) [m/s] along z of its desired frame."""
    turn = np.stack([column(table, f"motion.X_e.{i}") for i in (3, 4, 5)], axis=1)
    velocity = np.stack([column(table, f"motion.V.{i}") for i in range(3)], axis=1)
    normal = np.array([pin.exp3(rotation)[:, 2] for rotation in turn]).reshape(-1, 3)
    return (normal * velocity).sum(axis=1)


def loss_metrics(table: pl.DataFrame, *, force: float, speed: float) -> dict[str, float]:
    """Return how a tool that wipes lost contact and regained it, by true forces and velocities.

    Args:
        table: the record of wiping.
        force: set-point [N] along tool z.
        speed: set speed of the search [m/s], which the tool shall not exceed from the last touch
            until the regain.
    """
    events = loss_events(table)
    if events is None:
        return dict.fromkeys(_LOSS_NAMES, float("nan"))
    losses = table["contact"] == ContactPhase.LOSS.name
    gap = table.filter(pl.col("time").is_between(events.gone, events.regained))
    landing = table.filter(pl.col("time") >= events.regained)
    error = column(landing.filter(pl.col("time") >= events.regained + SETTLE_TIME), "wrench.fz")
    error -= force
    place = np.stack([column(table, f"motion.X_e.{i}") for i in range(2)], axis=1)
    return {
        "loss_speed_ratio": float(normal_speed(gap).max()) / speed,
        "loss_noticed_ms": 1e3 * (events.lost - events.gone),
        "regain_time_s": events.regained - events.gone,
        "regain_peak_ratio": float(column(landing, "wrench.fz").max()) / force,
        "contact_losses": float((losses & ~losses.shift(1, fill_value=False)).sum()),
        "force_rmse_N": rms(error) if len(error) else float("nan"),
        "force_bias_abs_N": float(abs(error.mean())) if len(error) else float("nan"),
        "position_rmse_mm": 1e3 * rms_norm(place),
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
        **energy_metrics(table),
        "fallback_ticks_total": float(fallback_count(table)),
        "tick_us_median": float(np.median(timing)),
        "tick_us_p99": float(np.quantile(timing, 0.99)),
        "tick_us_p999": float(np.quantile(timing, 0.999)),
    }


def energy_metrics(table: pl.DataFrame) -> dict[str, float]:
    """Return the energy given to the environment in the whole run, by true wrench and twist.

    Unlike the observer of the tasks it does not mind how late a sensor is.
    """
    twists = [name.removesuffix(".V.0") for name in table.columns if name.endswith(".V.0")]
    if not twists or len(table) < 2:
        return {}
    V = np.stack([column(table, f"{twists[0]}.V.{i}") for i in range(6)], axis=1)
    F = np.stack([column(table, f"wrench.{name}") for name in WRENCH], axis=1)
    power = np.nansum(F[1:] * V[:-1], axis=1)  # a wrench is one period old
    return {"energy_to_environment_J": float(np.trapezoid(power, column(table, "time")[:-1]))}


_LOSS_NAMES = (
    *("loss_speed_ratio", "loss_noticed_ms", "regain_time_s", "regain_peak_ratio"),
    *("contact_losses", "force_rmse_N", "force_bias_abs_N", "position_rmse_mm"),
)
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
