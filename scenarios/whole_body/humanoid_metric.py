"""How well the humanoid did: the hand while it wipes, the feet throughout, and what gave way."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, Vector
from qpctrl.robot import Robot
from qpctrl.status import Status
from scenarios.metric import column, rms, rms_norm, tick_metrics, whole_run_metrics
from scenarios.record import fallback_count
from scenarios.torque_step import torque_metrics
from scenarios.whole_body.contact import face_metrics, solved_pose_errors
from scenarios.whole_body.humanoid_world import SOLES, TORSO, HumanoidWorld

SLIPPED, TIPPED, DROPPED = 1.0, 1.0, 50.0
"""Way of a sole [mm], its tilt [deg] and way down of the torso [mm] that count as giving way."""
WIPING = (
    *("force_rmse_share", "force_rmse_N", "force_bias_N", "force_peak_N"),
    *("position_rmse_mm", "orientation_rmse_deg"),
)
PUSHED = ("force_error_push_N", "position_error_push_mm", "com_error_push_mm")
BINDING = "^(contact|torque|position|velocity) "
"""Limits that tell of a body near its end; the hand may push the wall no less than nothing."""
WORDS = {"slip": "slipped {:g} mm", "tilt": "tipped {:g}°", "drop": "torso down {:g} mm"}


class BodyMotion(NamedTuple):
    """How feet and torso moved away from where they stood."""

    slip: Matrix
    """Way of each sole along the ground (ticks×2) [mm]."""
    tilt: Matrix
    """Angle of each sole against its start (ticks×2) [deg]."""
    drop: Vector
    """Way of the torso down (ticks) [mm]."""


def humanoid_metrics(table: pl.DataFrame, world: HumanoidWorld, force: float) -> dict[str, float]:
    """Return the metrics of a run that presses on the wall with ``force`` [N]."""
    solved = table.filter(pl.col("kkt_residual").is_finite())
    ticks = tick_metrics(solved) | whole_run_metrics(table)
    return {
        **_of_wiping(table.filter(pl.col("phase") == "wipe"), force),
        **_of_push(table.filter(pl.col("phase").is_in(["push", "recover"])), force),
        **_of_contact(table, force),
        **_of_feet(table, world),
        **torque_metrics(table, world.robot),
        **{name: value for name, value in ticks.items() if np.isfinite(value)},
        "fallback_ticks": float(fallback_count(table)),
    }


def body_motion(table: pl.DataFrame, robot: Robot) -> BodyMotion:
    """Return how feet and torso moved since the start, by forward kinematics of the true state."""
    names = [f"q.{name}" for name in robot.configuration_names]
    model, data = robot.model, robot.model.createData()
    frames = [robot.frame_id(name) for name in (*SOLES, TORSO.frame)]
    slip, tilt, drop = [], [], []
    start: list[pin.SE3] = []
    for q in table.select(names).to_numpy():
        pin.framesForwardKinematics(model, data, q)
        poses = [data.oMf[frame] for frame in frames]
        start = start or [pose.copy() for pose in poses]
        soles = list(zip(start[:2], poses[:2], strict=True))
        slip.append([np.hypot(*(b.translation - a.translation)[:2]) for a, b in soles])
        tilt.append([np.linalg.norm(pin.log3(a.rotation.T @ b.rotation)) for a, b in soles])
        drop.append(start[2].translation[2] - poses[2].translation[2])
    return BodyMotion(1e3 * np.array(slip), np.degrees(np.array(tilt)), 1e3 * np.array(drop))


def what_gave_way(table: pl.DataFrame, world: HumanoidWorld) -> tuple[str, ...]:
    """Return in words what bound, slipped, tipped and fell first, in the order of time."""
    motion, time = body_motion(table, world.robot), column(table, "time")
    found = []
    for name, values, most in zip(WORDS, motion, (SLIPPED, TIPPED, DROPPED), strict=True):
        over = np.flatnonzero((values.reshape(len(time), -1) > most).any(axis=1))
        if len(over):
            i = int(over[0])
            who = "" if name == "drop" else f"{SOLES[int(values[i].argmax())].replace('_', ' ')} "
            found.append((float(time[i]), who + WORDS[name].format(most)))
    found += _first(table, pl.col("active").str.contains(BINDING), "active", "at its limit:")
    found += _first(table, pl.col("status") != Status.OK.name, "status", "fallback torque:")
    return tuple(f"{t:.3f} s: {words}" for t, words in sorted(found))


def _first(table: pl.DataFrame, mark: pl.Expr, name: str, words: str) -> list[tuple[float, str]]:
    """Return time [s] and words of the first tick with a mark; nothing where there is none."""
    rows = table.filter(mark).select("time", name).head(1).rows()
    return [(float(time), f"{words} {said}") for time, said in rows]


def _of_wiping(wipe: pl.DataFrame, force: float) -> dict[str, float]:
    pressed, pose = column(wipe, "wrench.fz"), solved_pose_errors(wipe)
    if not len(pose):
        return dict.fromkeys(WIPING, float("nan"))
    error = pressed - force
    return {
        "force_rmse_share": rms(error) / force,
        "force_rmse_N": rms(error),
        "force_bias_N": float(error.mean()),
        "force_peak_N": float(pressed.max()),
        "position_rmse_mm": 1e3 * rms_norm(pose[:, :2]),
        "orientation_rmse_deg": float(np.degrees(rms_norm(pose[:, 3:]))),
    }


def _of_push(push: pl.DataFrame, force: float) -> dict[str, float]:
    if push.is_empty():
        return dict.fromkeys(PUSHED, float("nan"))
    place = solved_pose_errors(push)[:, :2]
    com = np.stack([column(push, f"centre of mass.c_e.{i}") for i in range(3)], axis=1)
    return {
        "force_error_push_N": _largest(np.abs(column(push, "wrench.fz") - force)),
        "position_error_push_mm": 1e3 * _largest(np.linalg.norm(place, axis=1)),
        "com_error_push_mm": 1e3 * _largest(np.linalg.norm(com, axis=1)),
    }


def _of_contact(table: pl.DataFrame, force: float) -> dict[str, float]:
    on_wall = table.filter(pl.col("phase").is_in(["wipe", "push", "recover"]))
    touched = table.filter(pl.col("phase").is_in(["touch", "press"]))
    peak = column(touched, "wrench.fz").max() if len(touched) else float("nan")
    lost = (~on_wall["touching"].to_numpy()).mean() if len(on_wall) else float("nan")
    return {"touch_peak_ratio": float(peak) / force, "contact_loss_fraction": float(lost)}


def _of_feet(table: pl.DataFrame, world: HumanoidWorld) -> dict[str, float]:
    motion = body_motion(table, world.robot)
    tipped = np.flatnonzero((motion.tilt > TIPPED).any(axis=1))
    flat = table[: int(tipped[0])] if len(tipped) else table  # on an edge a sole has no margins
    return {
        "foot_slip_max_mm": float(motion.slip.max()),
        "foot_tilt_max_deg": float(motion.tilt.max()),
        "torso_drop_max_mm": float(motion.drop.max()),
        **face_metrics(flat[1:], world.soles),  # at the start no torque has acted
    }


def _largest(values: Vector) -> float:
    """Return the largest value; ticks without a solution have none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else float("nan")
