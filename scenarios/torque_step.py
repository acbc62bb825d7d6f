"""How far torques of a run step from tick to tick, and how much of their limits they use."""

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix, Vector
from qpctrl.robot import Robot


def torque_steps(table: pl.DataFrame, robot: Robot) -> Vector:
    """Return the largest change of torque (ticks − 1) from tick to tick, over its limit."""
    allowed = robot.limits.tau_rate * np.diff(table["time"].to_numpy())[:, None]
    steps = np.abs(np.diff(_torques(table, robot), axis=0)) / allowed
    return np.asarray(steps.max(axis=1, initial=0.0))


def torque_metrics(table: pl.DataFrame, robot: Robot) -> dict[str, float]:
    """Return steps of torque and the largest torque, over what limits allow."""
    step, mode = torque_steps(table, robot), table["mode"].to_numpy()
    return {
        "torque_step_max_share": float(step.max(initial=0.0)),
        "torque_step_switch_max": float(step[mode[1:] != mode[:-1]].max(initial=0.0)),
        "torque_used_max": float((np.abs(_torques(table, robot)) / robot.limits.tau_max).max()),
    }


def _torques(table: pl.DataFrame, robot: Robot) -> Matrix:
    return table.select(f"tau.{name}" for name in robot.actuator_names).to_numpy()
