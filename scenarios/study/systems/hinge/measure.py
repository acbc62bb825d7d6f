"""What is measured of a rollout of the system `hinge`."""

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, Wrench
from qpctrl.robot import Robot
from scenarios.metric import column, energy_metrics
from scenarios.record import WRENCH
from scenarios.study.outcome import FORCE_MEASURES, TICK_MEASURES, force_measures, tick_measures
from scenarios.study.system import Measures, Setting
from scenarios.study.systems.compared import compared, compared_words
from scenarios.study.systems.equilibrium import Loop
from scenarios.study.systems.hinge.forms import Door, angle_between, at_rest, outward, turned
from scenarios.study.systems.wrong_normal import mobility

PRESSED = 0.2  # s, from which on the force is judged
SMALL_FORCE = 1e-3  # of the set-point: what errors are compared with where their form is smaller
SMALL_ANGLE = 1e-2  # deg, the same for angles

MEASURES = {
    **compared_words("force_ratio", "force away from the true hinge over the set-point, open"),
    **compared_words("across_N", "force along the believed way of the handle, open"),
    **compared_words("moment_Nm", "moment about the believed axis, open"),
    **compared_words("lag_deg", "angle asked for − angle of the door, open"),
    **compared_words(
        "normal_error_deg",
        "angle between true and believed way of the handle, half-way; a check of the plant",
        "by geometry",
    ),
    "normal_error_share": "largest angle between the two ways, over atan(|offset| / radius)",
    "handle_error_mm": "distance of the handle from where it is asked to be, open",
    "orientation_error_deg": "angle between the handle and what is asked of it, open",
    "constraint_peak_N": "largest force on the handle",
    "constraint_peak_Nm": "largest moment on the handle",
    "energy_J": "energy given to the door, which takes none",
    **FORCE_MEASURES,
    **TICK_MEASURES,
}
"""Words of what `hinge_measures` returns; FORCE_MEASURES are along the set-point."""


def hinge_measures(
    robot: Robot, frame: str, door: Door, loop: Loop, table: pl.DataFrame, setting: Setting
) -> Measures:
    """Return the measures of a rollout, "open" meaning its last tick, at rest."""
    F = np.stack([column(table, f"wrench.{axis}") for axis in WRENCH], axis=1)
    judged = column(table, "time") >= PRESSED
    F_d = np.stack([column(table, f"force.F_des.{i}") for i in range(3)], axis=1)
    along = (F[:, :3] * F_d).sum(axis=1) / setting["force"]
    return {
        **_open(robot, frame, door, loop, table, F[-1], setting),
        **_way(door, table, setting),
        "constraint_peak_N": _largest(F[judged, :3]),
        "constraint_peak_Nm": _largest(F[judged, 3:]),
        "energy_J": energy_metrics(table)["energy_to_environment_J"],
        **force_measures(along[judged], setting["force"]),
        **tick_measures(table),
    }


def _open(
    robot: Robot,
    frame: str,
    door: Door,
    loop: Loop,
    table: pl.DataFrame,
    W: Wrench,
    setting: Setting,
) -> Measures:
    """Return what is left at rest, beside its closed form."""
    q = np.array([table[f"q.{name}"][-1] for name in robot.joint_names])
    X_WF, angle = robot.pose(q, frame), float(np.radians(setting["angle"]))
    closed = at_rest(door, angle, mobility(robot, frame, q), loop)
    found, wanted = (
        _split(door, X_WF, W, setting),
        _split(door, closed.X_WF, closed.wrench, setting),
    )
    floor, X_e = (
        SMALL_FORCE * setting["force"],
        [column(table, f"motion.X_e.{i}")[-1] for i in range(6)],
    )
    lag, lag_closed = (setting["angle"] - np.degrees(turned(X, door)) for X in (X_WF, closed.X_WF))
    return {
        **compared("force_ratio", found[0], wanted[0]),
        **compared("across_N", found[1], wanted[1], floor),
        **compared("moment_Nm", found[2], wanted[2], floor * setting["radius"]),
        **compared("lag_deg", lag, lag_closed, SMALL_ANGLE),
        "handle_error_mm": 1e3 * float(np.linalg.norm(X_e[:3])),
        "orientation_error_deg": float(np.degrees(np.linalg.norm(X_e[3:]))),
    }


def _split(door: Door, X_WF: pin.SE3, W: Wrench, setting: Setting) -> tuple[float, float, float]:
    """Return radial force over set-point, force along the believed way, moment about its axis."""
    f, m = X_WF.rotation @ W[:3], X_WF.rotation @ W[3:]
    return (
        float(outward(door.X_WE_true, X_WF) @ f) / setting["force"],
        float(door.way(door.X_WE, X_WF) @ f),
        float(-door.X_WE.rotation[:, 2] @ m),
    )


def _way(door: Door, table: pl.DataFrame, setting: Setting) -> Measures:
    """Return into which direction the handle moves against what is believed, while it does."""
    moving = table.filter(pl.col("phase") == "open")
    X_WF, V = _poses(moving), np.stack([column(moving, f"motion.V.{i}") for i in range(3)], axis=1)
    speed = np.linalg.norm(V, axis=1)
    fast = np.flatnonzero(speed > speed.max() / 2)
    error = [angle_between(X_WF[i].rotation @ V[i], door.way(door.X_WE, X_WF[i])) for i in fast]
    middle = len(fast) // 2
    at = turned(X_WF[fast[middle]], door)
    offset = float(np.hypot(setting["offset_x"], setting["offset_y"]))
    tilted = setting["tilt_x"] != 0 or setting["tilt_y"] != 0
    found, closed = np.degrees([error[middle], door.normal_error(at)])
    share = None
    if offset > 0 and not tilted:
        share = float(max(error) / np.arctan(offset / setting["radius"]))
    return {
        **compared("normal_error_deg", float(found), float(closed), SMALL_ANGLE),
        "normal_error_share": share,
    }


def _poses(table: pl.DataFrame) -> list[pin.SE3]:
    """Return the pose of the handle at each tick, from the columns of R_WF and p_WF."""
    columns = np.stack([column(table, f"motion.X_WF.{i}") for i in range(12)], axis=1)
    return [pin.SE3(x[:9].reshape(3, 3).T, x[9:]) for x in columns]


def _largest(vectors: Matrix) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())
