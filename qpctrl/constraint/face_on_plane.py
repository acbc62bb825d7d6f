"""A flat face that stays on a plane: three rows (k = 3)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, Rotation
from qpctrl.constraint.environment import need_rotation, need_six_axes
from qpctrl.constraint.pfaffian import PfaffianRows, differentiate
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX, SymbolicPose


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FaceOnPlane:
    """The eraser on the chalkboard: v_z = ω_x = ω_y = 0 along the axes of the plane.

    The rows live in the plane's frame E (z into the plane), so they hold however the tool is
    turned: A = rows (z of v, x of ω, y of ω) of diag(R_EF, R_EF).

    Inputs: ``R_WE`` (3×3), the believed orientation of the plane.
    Source: LynchPark2017 §11.6.1.
    """

    space: TaskSpace
    R_WE: Rotation
    """Orientation of the plane; its z axis points into it."""
    name: str = "plane"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "face on plane")
        need_rotation(self.R_WE, "R_WE")

    @property
    def row_names(self) -> tuple[str, ...]:
        """Translation into the plane, rotations that tip the face."""
        return ("vz", "wx", "wy")

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """The plane is pushed, never pulled."""
        return (True, False, False)

    def inputs(self) -> dict[str, Array]:
        """Return the believed orientation of the plane."""
        return {"R_WE": np.asarray(self.R_WE)}

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the three rows at the current pose."""
        none = ca.SX.zeros(1, 3)

        def A(X_WF: SymbolicPose) -> SX:
            R_EF = u["R_WE"].T @ X_WF.R
            return ca.vertcat(
                ca.horzcat(R_EF[2, :], none),
                ca.horzcat(none, R_EF[0, :]),
                ca.horzcat(none, R_EF[1, :]),
            )

        return differentiate(A, motion)
