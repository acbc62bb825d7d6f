"""Coulomb friction at a point: the cone ``‖f_t‖ ≤ μ f_n``, as a pyramid."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, non_negative
from qpctrl.constraint.environment import need_six_axes
from qpctrl.contact.wrench_limit import WrenchRows
from qpctrl.errors import InputError
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionCone:
    """Keep the force at the tool point inside a pyramid inscribed in the friction cone.

    cos φ_i f_x + sin φ_i f_y ≤ μ cos(π/m) f_z with φ_i = 2π i/m: what the pyramid allows, the
    cone allows, and m sides lose at most 1 − cos(π/m) of the friction: 29 % with 4 sides, 1.9 %
    with 16, 0.12 % with 64. The force is robot on environment, z of the frame into it.

    Inputs: ``mu``.
    Source: LynchPark2017 §12.2.1.
    """

    space: TaskSpace
    mu: float
    """Coefficient of friction μ [1]."""
    sides: int = 16
    """Number m of sides of the pyramid."""
    name: str = "friction"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "friction cone")
        non_negative(self.mu, (), f"{self.name}.mu")
        if self.sides < 3:
            raise InputError(f"{self.name}.sides: got {self.sides}, need 3 or more")

    @property
    def row_names(self) -> tuple[str, ...]:
        """Direction of each side in the tangent plane, in degrees from x."""
        return tuple(f"{360 * i / self.sides:g}deg" for i in range(self.sides))

    @property
    def unit(self) -> str:
        """Unit of its rows."""
        return "N"

    def inputs(self) -> dict[str, Array]:
        """Return the coefficient of friction."""
        return {"mu": np.array(float(self.mu))}

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> WrenchRows:
        """Return one row for each side of the pyramid."""
        angle = 2 * np.pi * np.arange(self.sides) / self.sides
        tangential = ca.SX(np.column_stack([np.cos(angle), np.sin(angle)]))
        normal = -u["mu"] * np.cos(np.pi / self.sides) * ca.SX.ones(self.sides)
        W = ca.horzcat(tangential, normal, ca.SX(self.sides, 3))
        return WrenchRows(W, ca.SX.zeros(self.sides))
