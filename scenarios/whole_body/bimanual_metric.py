"""How well two arms carried a box: forces, path, slip, what the pads had left, what gave way."""

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, Vector
from qpctrl.robot import Robot
from scenarios.metric import column, largest_norm, rms, rms_norm, tick_metrics, whole_run_metrics
from scenarios.record import fallback_count
from scenarios.report_style import column as column_or_none
from scenarios.torque_step import torque_metrics
from scenarios.whole_body.bimanual_modes import CARRY, SLIDE
from scenarios.whole_body.bimanual_world import PADS, SIDES, BoxWorld
from scenarios.whole_body.contact import face_metrics, solved_pose_errors

PHASES = (
    *("reach", "squeeze", "unload", "lift", "carry", "over", "lower", "land"),
    *("press", "slide", "relax", "raise", "return", "down", "put", "rest", "loose", "retreat"),
)
"""All phases of the job."""
LANDING = ("land", "put")
LIMITS = ("friction", "footprint", "force")
"""What a pad can carry: its limits in the QP."""
SLIPPED = 0.5  # mm along its face, from where a pad counts as slipping
AT_ZERO = 1e-6
"""N or Nm: a margin below it is none."""


def box_metrics(
    table: pl.DataFrame, world: BoxWorld, *, squeeze: float, press: float
) -> dict[str, float]:
    """Return the metrics of a run with set forces ``squeeze`` and ``press`` [N].

    Those of a phase that the run does not reach are NaN.
    """
    solved = table.filter(pl.col("kkt_residual").is_finite())
    ticks = tick_metrics(solved) | whole_run_metrics(table)
    reached = table["phase"].unique()
    return {
        **_of_forces(table, world, squeeze, press),
        **_of_path(table),
        **_of_pads(held(table), world),
        **_of_limits(held(table)),
        **torque_metrics(table, world.robot),
        "phases_left": float(len(set(PHASES) - set(reached))),
        **{name: value for name, value in ticks.items() if np.isfinite(value)},
        "fallback_ticks": float(fallback_count(table)),
    }


def held(table: pl.DataFrame) -> pl.DataFrame:
    """Return the part of a record in which the grasp is meant to hold the box."""
    first, last = PHASES.index("unload"), PHASES.index("rest")
    return table.filter(pl.col("phase").is_in(PHASES[first : last + 1]))


def internal_force(table: pl.DataFrame) -> Vector:
    """Return the true internal force (ticks) [N]: half of the sum of what both pads press with."""
    left, right = (column(table, f"contact.{side}.fz") for side in SIDES)
    return 0.5 * (left + right)


def pad_motion(table: pl.DataFrame, robot: Robot) -> Matrix:
    """Return how far each pad moved along its face (ticks×2) [m], seen from the box, by true q."""
    model, data = robot.model, robot.model.createData()
    box, *pads = (robot.frame_id(name) for name in ("box", *(pad.frame for pad in PADS)))
    q = table.select(f"q.{name}" for name in robot.configuration_names).to_numpy()
    moved, start = np.zeros((len(q), len(pads))), list[pin.SE3]()
    for row, found in zip(q, moved, strict=True):
        pin.framesForwardKinematics(model, data, row)
        poses = [data.oMf[box].inverse() * data.oMf[pad] for pad in pads]
        start = start or poses
        found[:] = [
            np.linalg.norm((a.inverse() * b).translation[:2])
            for a, b in zip(start, poses, strict=True)
        ]
    return moved


def what_gave_way(table: pl.DataFrame, world: BoxWorld) -> tuple[str, ...]:
    """Return in words which margins went to 0 and what slipped, in the order of time."""
    grasped = held(table)
    found = [(time, f"{name} at its limit") for name, time in limit_times(grasped).items()]
    for side, moved in zip(SIDES, 1e3 * pad_motion(grasped, world.robot).T, strict=True):
        if (over := moved > SLIPPED).any():
            time = float(grasped["time"][int(over.argmax())])
            found.append((time, f"{side} pad slipped {SLIPPED:g} mm"))
    torque = pl.col("active").str.contains("(^|, )torque(-speed)? [lr]")
    for words, mark in (("torque at its limit", torque), ("fallback torque", pl.col("fallback"))):
        times = table.filter(mark)["time"]
        found += [(float(times[0]), words)] if len(times) else []
    return tuple(f"{time:.3f} s: {words}" for time, words in sorted(found))


def limit_times(table: pl.DataFrame) -> dict[str, float]:
    """Return when [s] the margin of each limit of the pads was first 0; none if it never was."""
    found = {}
    for name in (f"{side} {limit}" for side in SIDES for limit in LIMITS):
        over = column_or_none(table, f"margin.{name}") < AT_ZERO
        if over.any():
            found[name] = float(table["time"][int(over.argmax())])
    return found


def _of_forces(
    table: pl.DataFrame, world: BoxWorld, squeeze: float, press: float
) -> dict[str, float]:
    carried = table.filter(pl.col("mode") == CARRY)
    slid, unloaded = (table.filter(pl.col("phase") == name) for name in ("slide", "unload"))
    left = float(unloaded["contact.table.fz"][-1]) if len(unloaded) else float("nan")
    return {
        "grasp_force_rmse_share": _rms(internal_force(carried) - squeeze) / squeeze,
        "grasp_force_peak_N": _largest(internal_force(table)),
        "force_rmse_share": _rms(column(slid, "contact.table.fz") - press) / press,
        "unloaded_share": left / world.weight,
    }


PATH = ("object_path_rmse_mm", "object_path_max_mm", "object_turn_rmse_deg")
"""What says how well the box followed its path."""


def _of_path(table: pl.DataFrame) -> dict[str, float]:
    flown = table.filter((pl.col("mode") == CARRY) & ~pl.col("phase").is_in(LANDING))
    slid = table.filter(pl.col("mode") == SLIDE)
    if flown.is_empty():
        return dict.fromkeys(PATH, float("nan"))
    air, ground = solved_pose_errors(flown), solved_pose_errors(slid)
    if not np.isfinite(air).any():
        return dict.fromkeys(PATH, float("nan"))
    ground[:, 2] = 0.0  # the table's business
    place = np.vstack([air[:, :3], ground[:, :3]])
    return {
        "object_path_rmse_mm": 1e3 * rms_norm(place),
        "object_path_max_mm": 1e3 * largest_norm(place),
        "object_turn_rmse_deg": float(np.degrees(rms_norm(air[:, 3:]))),
    }


def _of_pads(table: pl.DataFrame, world: BoxWorld) -> dict[str, float]:
    if table.is_empty():
        names = ("slip_max_mm", "friction_margin_min_N", "cop_margin_min_mm")
        return dict.fromkeys((*names, "friction_used_max", "pressure_used_max"), float("nan"))
    return {
        "slip_max_mm": 1e3 * float(pad_motion(table, world.robot).max()),
        **face_metrics(table, world.contacts[:2]),
    }


def _of_limits(table: pl.DataFrame) -> dict[str, float]:
    """Return for how many ticks the QP had each kind of limit at 0, and when each was first."""
    found = {f"{name.replace(' ', '_')}_zero_s": t for name, t in limit_times(table).items()}
    for limit in LIMITS:
        sides = [column_or_none(table, f"margin.{side} {limit}") < AT_ZERO for side in SIDES]
        found[f"pad_{limit}_limit_ticks"] = float(np.logical_or(*sides).sum())
    return found


def _rms(values: Vector) -> float:
    return rms(values) if len(values) else float("nan")


def _largest(values: Vector) -> float:
    return float(values.max()) if len(values) else float("nan")
