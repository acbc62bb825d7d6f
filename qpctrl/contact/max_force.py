"""The largest force that a contact may carry."""

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
class MaxForce:
    """Press along z of the frame with at most ``limit`` [N], whatever the set-point says.

    Inputs: ``limit``.
    """

    space: TaskSpace
    limit: float
    """Largest force [N]."""
    name: str = "max force"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "largest force")
        positive(self.limit, (), f"{self.name}.limit")

    @property
    def row_names(self) -> tuple[str, ...]:
        """The one direction."""
        return ("fz",)

    @property
    def unit(self) -> str:
        """Unit of its rows."""
        return "N"

    def inputs(self) -> dict[str, Array]:
        """Return the largest force [N]."""
        return {"limit": np.array(float(self.limit))}

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> WrenchRows:
        """Return the one row."""
        W = ca.SX(1, 6)
        W[0, 2] = 1
        return WrenchRows(W, u["limit"])
