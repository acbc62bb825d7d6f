"""Metrics of a mobile arm that wipes: how far it came, and what of its limits it used."""

from collections import Counter

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix, Vector
from qpctrl.robot import Limits
from scenarios.metric import column

HALF_PAD = (0.060, 0.025)
"""Half lengths of the pad [m] along x and y of the tool."""

ACTS = "acts "
"""Begins the name of the metric that says how long a limit acted: ``acts position joint4``."""


def progress(table: pl.DataFrame, near: float) -> dict[str, float]:
    """Return how far along the board the eraser wiped where it shall.

    Args:
        table: ticks spent wiping.
        near: distance [m] from the reference up to which a place counts as wiped.
    """
    wiped = np.where(_follows(table, near) & table["touching"].to_numpy(), 1.0, np.nan)
    y = column(table, "motion.X_WF.10") * wiped
    if np.isnan(y).all():
        return {"wiped_length_m": 0.0, "path_length_m": 0.0}
    p = np.stack([column(table, f"motion.X_WF.{i}") for i in (9, 10, 11)], axis=1)
    steps = np.linalg.norm(np.diff(p, axis=0), axis=1) * wiped[1:]
    return {
        "wiped_length_m": float(np.nanmax(y) - np.nanmin(y)),
        "path_length_m": float(np.nansum(steps)),
    }


def shares(table: pl.DataFrame, limits: Limits) -> dict[str, Vector]:
    """Return the largest share of what joints and motors can do (ticks); 1 is the limit.

    Of positions it is the way from the middle of the range, over half of it.
    """
    q, v, tau = (matrix(table, name) for name in ("q", "v", "tau"))
    middle, half = (limits.q_max + limits.q_min) / 2, (limits.q_max - limits.q_min) / 2
    used = {
        "position": (q - middle) / half,
        "speed": v / limits.v_max,
        "torque": tau / limits.tau_max,
    }
    return {name: np.abs(share).max(axis=1) for name, share in used.items()}


def limit_use(table: pl.DataFrame, limits: Limits) -> dict[str, float]:
    """Return the largest of `shares`."""
    return {f"{name}_use_max_share": float(x.max()) for name, x in shares(table, limits).items()}


def joint_margins(table: pl.DataFrame, limits: Limits) -> dict[str, float]:
    """Return what is left to the position limits: of hinges [deg], of slides [mm]."""
    q = matrix(table, "q")
    left = np.minimum(q - limits.q_min, limits.q_max - q).min(axis=0)
    slide = np.array([name in ("q.base_x", "q.base_y") for name in _columns(table, "q")])
    margins = {"joint_margin_min_deg": float(np.degrees(left[~slide].min()))}
    return margins | ({"base_margin_min_mm": 1e3 * float(left[slide].min())} if slide.any() else {})


def centre_margin(table: pl.DataFrame) -> float:
    """Return how far [mm] the measured centre of pressure stays inside the edges of the pad."""
    force = np.maximum(column(table, "wrench_meas.fz"), 1e-3)
    x, y = (column(table, f"wrench_meas.{m}") / force for m in ("my", "mx"))
    return 1e3 * float(min((HALF_PAD[0] - np.abs(x)).min(), (HALF_PAD[1] - np.abs(y)).min()))


def acting_limits(table: pl.DataFrame, dt: float) -> dict[str, float]:
    """Return for how long [s] each limit acted, by its name; the first to act is the first."""
    names = table["active"].str.split(", ").explode()
    counts = Counter(name for name in names.to_list() if name)
    return {f"{ACTS}{name}": dt * count for name, count in counts.items()}


def matrix(table: pl.DataFrame, quantity: str) -> Matrix:
    """Return all columns of a quantity (ticks×n)."""
    return np.stack([column(table, name) for name in _columns(table, quantity)], axis=1)


def _columns(table: pl.DataFrame, quantity: str) -> list[str]:
    return [name for name in table.columns if name.startswith(f"{quantity}.")]


def _follows(table: pl.DataFrame, near: float) -> Vector:
    """Return whether the eraser is near its reference in the plane of the board (ticks)."""
    error = np.hypot(column(table, "motion.X_e.0"), column(table, "motion.X_e.1"))
    return np.asarray(error <= near)
