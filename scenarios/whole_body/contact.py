"""What a record says of the contacts of a whole body: how near each came to slipping or tipping."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix, Vector
from scenarios.record import WRENCH
from scenarios.report_style import column

LEAST_FORCE = 1.0
"""Normal force [N] below which a contact has no centre of pressure worth naming."""


class CarryingContact(NamedTuple):
    """A contact, as the plant has it; z of its frame points into the environment."""

    name: str
    """Name under which the record keeps its true wrench, ``contact.NAME.fx`` and so on."""
    friction: float
    """Coulomb friction μ of the plant [1]."""
    half: tuple[float, float] | None = None
    """Half lengths of its face along x and y [m]; none for a point."""


def true_wrench(table: pl.DataFrame, contact: CarryingContact) -> Matrix:
    """Return the true wrench (ticks×6) [N, Nm] of the robot on what it touches."""
    return np.stack([column(table, f"contact.{contact.name}.{part}") for part in WRENCH], axis=1)


def friction_margin(wrench: Matrix, contact: CarryingContact) -> Vector:
    """Return μ f_z − ‖f_t‖ (ticks) [N]: what friction has left before the contact slips."""
    tangential = np.linalg.norm(wrench[:, :2], axis=1)
    return np.asarray(contact.friction * wrench[:, 2] - tangential)


def centre_of_pressure(wrench: Matrix) -> Matrix:
    """Return where the force acts (ticks×2) [m] in the face; NaN where the contact is light."""
    force = np.where(wrench[:, 2] > LEAST_FORCE, wrench[:, 2], np.nan)
    return np.stack([-wrench[:, 4] / force, wrench[:, 3] / force], axis=1)


def pressure_margin(wrench: Matrix, contact: CarryingContact) -> Vector:
    """Return the distance (ticks) [m] of the centre of pressure from the nearest edge.

    NaN where the contact is light, or is a point.
    """
    if contact.half is None:
        return np.full(len(wrench), np.nan)
    left: Vector = (np.array(contact.half) - np.abs(centre_of_pressure(wrench))).min(axis=1)
    return left


def face_metrics(table: pl.DataFrame, faces: Sequence[CarryingContact]) -> dict[str, float]:
    """Return the least that faces had left of friction and footprint, and the most they used.

    A face in the air has no way left to its edge.
    """
    friction, pressure, used, moved = [], [], [], []
    for face in faces:
        wrench, half = true_wrench(table, face), np.array(face.half)
        cone = face.friction * np.maximum(wrench[:, 2], LEAST_FORCE)
        used.append(np.linalg.norm(wrench[:, :2], axis=1) / cone)
        friction.append(friction_margin(wrench, face))
        centre = np.abs(centre_of_pressure(wrench))
        moved.append(np.nan_to_num((centre / half).max(axis=1), nan=1.0))
        pressure.append(np.nan_to_num(pressure_margin(wrench, face), nan=0.0))
    return {
        "friction_margin_min_N": float(np.min(friction)),
        "cop_margin_min_mm": 1e3 * float(np.min(pressure)),
        "friction_used_max": float(np.max(used)),
        "pressure_used_max": float(np.max(moved)),
    }


def solved_pose_errors(table: pl.DataFrame) -> Matrix:
    """Return the pose error of task ``motion`` [m, rad] at ticks with a solution, one a row."""
    pose = np.stack([column(table, f"motion.X_e.{i}") for i in range(6)], axis=1)
    solved: Matrix = pose[np.isfinite(pose).all(axis=1)]
    return solved
