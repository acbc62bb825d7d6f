"""What a rollout of the system `wipe` is judged by: true forces, true motion."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, Vector
from qpctrl.robot import Robot
from scenarios.iso9283 import cycles, path_criteria
from scenarios.metric import column, energy_metrics, rms
from scenarios.study.outcome import (
    CONTACT_MEASURES,
    FORCE_MEASURES,
    TICK_MEASURES,
    contact_measures,
    force_measures,
    tick_measures,
)
from scenarios.study.system import Measures
from scenarios.study.systems.wipe.guide import PRESS, PRESS_TIME, SPEED_RAMP, Job
from scenarios.study.systems.wrong_normal import mobility
from scenarios.world import TOOL

SETTLED = 0.1
"""Force error over the set-point within which the force has settled."""

CONTACT_FROM = PRESS_TIME
"""Time [s] from which a loss of contact counts, whatever errors are judged from: until then the
tool, put down at zero force, may bounce while the set-point ramps up; from then on it rests on the
board with the full force, and nothing that it is asked to do lifts it."""

CONDITION_PERIOD = 0.1
"""Time [s] between the configurations at which Λ⁻¹ is looked at."""

MEASURES: Mapping[str, str] = {
    **FORCE_MEASURES,
    **CONTACT_MEASURES,
    "contact_lost_fraction": "share of the time out of contact, from the end of the first press",
    "reimpact_peak_N": "largest force after a loss of contact; none without a loss",
    "settling_ms": "time until the force stays within 10 %, at rest; none where it does not settle",
    "position_mae_mm": "mean distance from the path, along the believed board",
    "position_rmse_mm": "root mean square distance from the path, along the believed board",
    "position_max_mm": "largest distance from the path, along the believed board",
    "orientation_rmse_deg": "root mean square angle from the believed board's orientation",
    "height_range_mm": "range of the tool's true height over the believed board",
    "path_accuracy_mm": "path accuracy AT_p in the manner of ISO 9283",
    "path_repeatability_mm": "path repeatability RT_p in the manner of ISO 9283",
    **TICK_MEASURES,
    "energy_J": "energy given to the environment",
    "mobility_condition_max": "largest condition number of Λ⁻¹, in m and rad",
}


class Seen(NamedTuple):
    """A rollout as it was, against what it should have been."""

    robot: Robot
    job: Job
    X_WE_true: pin.SE3
    table: pl.DataFrame
    q: Matrix
    """True configuration of each tick (ticks×nq) [rad]."""
    judged_from: float
    """Time [s] from which errors count."""


def wipe_measures(seen: Seen) -> Measures:
    """Return the measures of a rollout."""
    table, job = seen.table, seen.job
    X = poses(seen.robot, seen.q)
    judged = round(seen.judged_from / job.path.dt)
    force = normal_force(table, X[:, :, :3], seen.X_WE_true)
    pressed = round(CONTACT_FROM / job.path.dt)
    touching = table["touching"].to_numpy()[pressed:]
    return {
        **force_measures(force[judged:], job.force),
        **contact_measures(touching, job.path.dt),
        "reimpact_peak_N": reimpact_peak(force[pressed:], touching),
        "settling_ms": settling(force[table["phase"].to_numpy() == PRESS], job),
        **_place(seen, X, judged),
        **tick_measures(table[judged:]),
        "energy_J": energy_metrics(table)["energy_to_environment_J"],
        "mobility_condition_max": _condition(seen),
    }


def poses(robot: Robot, q: Matrix) -> Matrix:
    """Return X_WF (ticks×3×4) of the tool at ``q`` (ticks×nq)."""
    model, data, fid = robot.model, robot.model.createData(), robot.frame_id(TOOL)
    joint, X_JF = model.frames[fid].parentJoint, model.frames[fid].placement
    X = np.empty((len(q), 3, 4))
    for i, at in enumerate(q):
        pin.forwardKinematics(model, data, at)
        X[i] = (data.oMi[joint] * X_JF).homogeneous[:3]
    return X


def normal_force(table: pl.DataFrame, R_WF: Matrix, X_WE_true: pin.SE3) -> Vector:
    """Return the force into the true board (ticks) [N].

    Args:
        table: ticks, with the true wrench.
        R_WF: orientation of the tool (ticks×3×3); the wrench is one period older.
        X_WE_true: the board as it is.
    """
    F = np.stack([column(table, f"wrench.f{axis}") for axis in "xyz"], axis=1)
    normal = X_WE_true.rotation[:, 2] @ R_WF
    return (F * normal).sum(axis=1)


def settling(force: Vector, job: Job) -> float | None:
    """Return when ``force`` (ticks) [N] at rest has settled within `SETTLED` [ms], if it has."""
    off = np.flatnonzero(np.abs(force - job.force) > SETTLED * job.force)
    ticks = int(off[-1]) + 1 if len(off) else 0
    return 1e3 * ticks * job.path.dt if ticks < len(force) else None


def reimpact_peak(force: Vector, touching: Vector) -> float | None:
    """Return the largest force (ticks) [N] since contact was lost for the first time."""
    lost = np.flatnonzero(~touching)
    return float(force[int(lost[0]) :].max()) if len(lost) else None


def _place(seen: Seen, X: Matrix, judged: int) -> dict[str, float | None]:
    """Return how far the tool is from where it should be, by the believed board."""
    job, X_WE = seen.job, seen.job.X_WE
    p_E = (X[:, :, 3] - X_WE.translation) @ X_WE.rotation
    off = np.linalg.norm((p_E - job.path.p)[judged:, :2], axis=1)
    cos = (np.einsum("ij,tij->t", X_WE.rotation, X[judged:, :, :3]) - 1) / 2
    turned = np.degrees(np.arccos(np.clip(cos, -1.0, 1.0)))
    return {
        "position_mae_mm": 1e3 * float(off.mean()),
        "position_rmse_mm": 1e3 * rms(off),
        "position_max_mm": 1e3 * float(off.max()),
        "orientation_rmse_deg": rms(turned),
        "height_range_mm": 1e3 * float(np.ptp(p_E[judged:, 2])),
        **_path(job, p_E, judged),
    }


def _path(job: Job, p_E: Matrix, judged: int) -> dict[str, float | None]:
    """Return path accuracy and repeatability; none where two circles are not there to compare."""
    names = ("path_accuracy_mm", "path_repeatability_mm")
    flat = p_E * [1.0, 1.0, 0.0]
    first = max(judged, round((PRESS_TIME + SPEED_RAMP) / job.path.dt))
    if len(flat) - first < 2 * job.path.cycle:
        return dict.fromkeys(names)
    attained = cycles(flat, job.path.cycle, first)
    found = path_criteria(attained, job.path.p[first : first + job.path.cycle], closed=True)
    values = (1e3 * found.accuracy, 1e3 * found.repeatability)
    return {n: None if math.isnan(x) else x for n, x in zip(names, values, strict=True)}


def _condition(seen: Seen) -> float:
    """Return the largest condition number of Λ⁻¹ of the believed robot, now and then."""
    step = max(round(CONDITION_PERIOD / seen.job.path.dt), 1)
    return max(float(np.linalg.cond(mobility(seen.robot, TOOL, q))) for q in seen.q[::step])
