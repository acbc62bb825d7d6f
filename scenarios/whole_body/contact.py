"""What a record says of the contacts of a whole body: how near each came to slipping or tipping."""

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
