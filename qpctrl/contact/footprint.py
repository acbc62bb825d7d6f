"""The centre of pressure inside a rectangular face."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, positive
from qpctrl.constraint.environment import need_six_axes
from qpctrl.contact.wrench_limit import WrenchRows
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Footprint:
    """Keep the centre of pressure x = −m_y/f_z, y = m_x/f_z inside ±half of the face.

    Four rows, linear in the wrench where f_z ≥ 0: ±m_y ≤ a f_z and ±m_x ≤ b f_z. The face lies
    in the x-y plane of the frame, centred at its origin, z into the environment; beyond its
    edges the tool would tip.

    Inputs: ``half`` (2).
    Source: Caron2015.
    """

    space: TaskSpace
    half: tuple[float, float]
    """Half lengths a along x and b along y [m]."""
    name: str = "footprint"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "footprint")
        positive(np.array(self.half, dtype=np.float64), (2,), f"{self.name}.half")

    @property
    def row_names(self) -> tuple[str, ...]:
        """Edge of the face at which the tool would tip."""
        return ("-x", "+x", "+y", "-y")

    @property
    def unit(self) -> str:
        """Unit of its rows."""
        return "Nm"

    def inputs(self) -> dict[str, Array]:
        """Return the half lengths [m]."""
        return {"half": np.array(self.half, dtype=np.float64)}

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> WrenchRows:
        """Return one row for each edge."""
        W = ca.SX(4, 6)
        for row, (moment, sign, side) in enumerate(((4, 1, 0), (4, -1, 0), (3, 1, 1), (3, -1, 1))):
            W[row, moment] = sign
            W[row, 2] = -u["half"][side]
        return WrenchRows(W, ca.SX.zeros(4))
