"""What is measured of a rollout of the system `rows`."""

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, Vector
from qpctrl.robot import Robot
from scenarios.metric import column
from scenarios.record import WRENCH
from scenarios.study.outcome import FORCE_MEASURES, TICK_MEASURES, force_measures, tick_measures
from scenarios.study.system import Measures, Setting
from scenarios.study.systems.compared import compared, compared_words
from scenarios.study.systems.rows.forms import (
    DT,
    PRESS,
    at_rest,
    drift,
    forgotten_moment,
    groove,
)
from scenarios.study.systems.wrong_normal import mobility

RATED = 20  # ticks, over which a rate is taken and between which mobility is interpolated
NO_MOMENT = 1e-3  # Nm, what a moment is compared with where its closed form is smaller
NO_OFFSET = 1e-3  # mm, the same for an offset

MEASURES = {
    **compared_words("force_ratio", "force into the plane over the set-point, at the end"),
    **compared_words("moment_Nm", "moment that tips the tool about y, at the end"),
    **compared_words("offset_mm", "offset along the plane at the end, at rest"),
    **compared_words(
        "growth_1_s",
        "rate of the moment that tips the tool about y, at the end, over that moment where nothing "
        "is fed forward",
        "closed form, (1 − exp(−2π cutoff dt)) / dt",
    ),
    **compared_words("drift_mm", "way along a free direction that is believed held, at the end"),
    **compared_words(
        "drift_speed_m_s", "speed along a free direction that is believed held, at the end"
    ),
    "pressure_mm": "way of the centre of pressure off the tool's axis, at the end",
    **FORCE_MEASURES,
    **TICK_MEASURES,
}
"""Words of what `rows_measures` returns."""


def rows_measures(
    robot: Robot, frame: str, X_WE: pin.SE3, table: pl.DataFrame, setting: Setting
) -> Measures:
    """Return the measures of a rollout."""
    F = np.stack([column(table, f"wrench.{axis}") for axis in WRENCH], axis=1)
    q = np.array([table[f"q.{name}"][-1] for name in robot.joint_names])
    X_EF = X_WE.actInv(robot.pose(q, frame))
    return {
        **_held(robot, frame, q, X_EF, F, setting),
        **_drifted(robot, frame, X_EF, table, setting),
        "pressure_mm": 1e3 * float(np.linalg.norm(F[-1, 3:5]) / F[-1, 2]),
        **force_measures(F[round(PRESS / DT) :, 2], setting["force"]),
        **tick_measures(table),
    }


def _held(
    robot: Robot, frame: str, q: Vector, X_EF: pin.SE3, F: Matrix, setting: Setting
) -> Measures:
    """Return what is left at rest, or how the moment grows, beside closed forms."""
    Lambda_inv, e = mobility(robot, frame, q), np.radians(setting["turn"])
    rank_error, cutoff = round(setting["rank_error"]), setting["cutoff"]
    closed = at_rest(Lambda_inv, setting)
    ratio = moment = offset = rate = rate_closed = None
    if closed is not None:
        ratio, moment = closed.wrench[2] / setting["force"], closed.wrench[4]
        offset = 1e3 * float(np.linalg.norm(closed.X_WF.translation[:2]))
    elif rank_error > 0 and setting["k_fi"] == 0:
        push = setting["side_force"] * groove(Lambda_inv, X_EF).reaction
        ratio, moment = 1 + push[0] / setting["force"], push[2]
    elif rank_error < 0 and e != 0:
        rate = float(F[-1, 4] - F[-1 - RATED, 4]) / (RATED * DT)
        rate /= forgotten_moment(Lambda_inv, rank_error, e)
        rate_closed = float(-np.expm1(-2 * np.pi * cutoff * DT)) / DT
    found = 1e3 * float(np.linalg.norm(X_EF.translation[:2])) if rank_error <= 0 else None
    return {
        **compared("force_ratio", float(F[-1, 2]) / setting["force"], ratio),
        **compared("moment_Nm", float(F[-1, 4]), moment, NO_MOMENT),
        **compared("offset_mm", found, offset, NO_OFFSET),
        **compared("growth_1_s", rate, rate_closed),
    }


def _drifted(
    robot: Robot, frame: str, X_EF: pin.SE3, table: pl.DataFrame, setting: Setting
) -> Measures:
    """Return how the tool drifts along the groove that is not there, beside its closed form."""
    if setting["rank_error"] <= 0:
        return {**compared("drift_mm", None, None), **compared("drift_speed_m_s", None, None)}
    steps = table.filter(pl.col("phase") == "hold")[:-1]
    seen = np.unique(np.append(np.arange(0, len(steps), RATED), len(steps) - 1))
    wanted = drift(
        np.interp(np.arange(len(steps)), seen, [_S_x(robot, frame, steps, int(i)) for i in seen]),
        setting,
    )
    V = np.array([table[f"motion.V.{i}"][-1] for i in range(3)])
    speed = float((X_EF.rotation @ V)[0])
    return {
        **compared("drift_mm", 1e3 * float(X_EF.translation[0]), 1e3 * wanted.way),
        **compared("drift_speed_m_s", speed, wanted.speed),
    }


def _S_x(robot: Robot, frame: str, table: pl.DataFrame, tick: int) -> float:
    """Return the mobility [1/kg] along the groove at a tick."""
    q = np.array([table[f"q.{name}"][tick] for name in robot.joint_names])
    X_EF = robot.pose(robot.home, frame).actInv(robot.pose(q, frame))
    return groove(mobility(robot, frame, q), X_EF).S_x
