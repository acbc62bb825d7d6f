"""Friction against turning about the normal of a contact."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, non_negative
from qpctrl.constraint.environment import need_six_axes
from qpctrl.contact.wrench_limit import WrenchRows
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class TorsionalFriction:
    """Keep the moment about the normal inside |m_z| ≤ r f_z, z of the frame into the environment.

    r is the coefficient of friction times the mean distance of the pressure from the origin: for a
    disc of radius R pressed evenly 2/3 μ R.

    Inputs: ``r``.
    Source: LynchPark2017 §12.2.1.
    """

    space: TaskSpace
    r: float
    """Moment per normal force [m]."""
    name: str = "torsion"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "torsional friction")
        non_negative(self.r, (), f"{self.name}.r")

    @property
    def row_names(self) -> tuple[str, ...]:
        """The two senses."""
        return ("+z", "-z")

    @property
    def unit(self) -> str:
        """Unit of its rows."""
        return "Nm"

    def inputs(self) -> dict[str, Array]:
        """Return moment per normal force [m]."""
        return {"r": np.array(float(self.r))}

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> WrenchRows:
        """Return one row for each sense."""
        W = ca.SX(2, 6)
        W[0, 5], W[1, 5] = 1, -1
        W[:, 2] = -u["r"]
        return WrenchRows(W, ca.SX.zeros(2))
