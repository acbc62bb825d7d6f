"""A point that stays on a plane: one row (k = 1)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import pinocchio as pin

from qpctrl.arrays import Array
from qpctrl.constraint.environment import (
    axes_of_environment,
    need_six_axes,
    pose_in_environment,
    pose_inputs,
)
from qpctrl.constraint.pfaffian import PfaffianRows, differentiate
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX, SymbolicPose


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PointOnPlane:
    """A fingertip or stylus on a plane: the velocity of the frame's origin into it is zero.

    Inputs: ``X_WE`` (3×4), the believed pose of the environment.
    Source: LynchPark2017 §11.6.1.
    """

    space: TaskSpace
    X_WE: pin.SE3
    """Frame of the plane; its z axis points into it."""
    name: str = "plane"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "point on plane")

    @property
    def row_names(self) -> tuple[str, ...]:
        """Translation into the plane."""
        return ("vz",)

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """The plane is pushed, never pulled."""
        return (True,)

    def inputs(self) -> dict[str, Array]:
        """Return the believed pose of the environment."""
        return pose_inputs(self.X_WE)

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the row at the current pose."""

        def A(X_WF: SymbolicPose) -> SX:
            X_EF = pose_in_environment(X_WF, u)
            return axes_of_environment(X_EF)[2, :]

        return differentiate(A, motion)
