"""The force error that a scenario judges, found in its record by the RMS that it reports.

Scenarios judge their force in a phase of their own: along one direction, where friction acts
across it, or in all three. The one whose RMS is the scenario's own is the one it means; a mean
of magnitudes, and what else is said of that phase, then belongs to the same ticks and directions.
"""

from typing import NamedTuple

import numpy as np
import polars as pl

from qpctrl.arrays import Array, Vector
from scenarios.metric import rms
from scenarios.report_style import column

SAME = 1e-6
"""Relative difference of two RMS values that are one."""

STEADY = 1e-9
"""Relative change of a set-point that is constant."""

AXES = ("fx", "fy", "fz")


class ForceError(NamedTuple):
    """When and along what a scenario judges its force."""

    phase: str
    set_point: Vector | None
    """Constant force (3) [N], in the tool frame, along which the error is taken; none: all of the
    error from a set-point that may change."""

    def judged(self, table: pl.DataFrame) -> pl.DataFrame:
        """Return the ticks of a record that are judged."""
        return table.filter(pl.col("phase") == self.phase)

    def magnitude(self, table: pl.DataFrame) -> Vector:
        """Return the magnitude of the error (ticks) [N] at every tick of ``table``."""
        measured, wanted = forces(table)
        if self.set_point is None:
            return np.asarray(np.linalg.norm(measured - wanted, axis=1))
        size = np.linalg.norm(self.set_point)
        return np.asarray(np.abs(measured @ self.set_point / size - size))


def find_force_error(table: pl.DataFrame, force_rmse: float) -> ForceError | None:
    """Return the error whose RMS a scenario reports as ``force_rmse`` [N]; none: another one."""
    for phase in table["phase"].unique(maintain_order=True):
        _, wanted = forces(table.filter(pl.col("phase") == phase))
        for error in (ForceError(phase, None), ForceError(phase, _constant(wanted))):
            found = rms(error.magnitude(error.judged(table)))
            if abs(found - force_rmse) <= SAME * force_rmse:
                return error
    return None


def along_set_point(table: pl.DataFrame, set_point: Vector | None = None) -> tuple[Vector, Vector]:
    """Return measured force along its set-point, and the size of that (ticks each) [N].

    Args:
        table: the record.
        set_point: constant force (3) [N] that gives the direction; none: that of each tick.
    """
    measured, wanted = forces(table)
    size = np.linalg.norm(wanted, axis=1)
    size = np.where(size > 0, size, np.nan)
    if set_point is not None:
        return measured @ (set_point / np.linalg.norm(set_point)), size
    return (measured * wanted).sum(axis=1) / size, size


def forces(table: pl.DataFrame) -> tuple[Array, Array]:
    """Return measured force and set-point (ticks×3) [N]; NaN where there is none."""
    measured = [column(table, f"wrench_meas.{axis}") for axis in AXES]
    wanted = [column(table, f"force.F_des.{i}") for i in range(3)]
    return np.stack(measured, axis=1), np.stack(wanted, axis=1)


def _constant(wanted: Array) -> Vector | None:
    """Return the set-point (3) that all rows have; none: they differ, or it is nothing."""
    if not len(wanted) or not np.isfinite(wanted).all() or not wanted[0].any():
        return None
    change = np.abs(wanted - wanted[0]).max()
    return wanted[0] if change <= STEADY * np.abs(wanted[0]).max() else None
