"""A crank with a free-turning handle: four rows (k = 4)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import casadi as ca
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
class Crank:
    """A handle on a circle about z of the frame, free to spin about an axis parallel to it.

    The origin of the tool frame lies on the axis of the handle: v along the radius and along z,
    ω_x and ω_y are zero. Free are the crank's angle and the handle's spin. At zero radius the
    rows lose their rank.

    Inputs: ``X_WE`` (3×4), the believed pose of the environment.
    Source: LynchPark2017 §11.6.1.
    """

    space: TaskSpace
    X_WE: pin.SE3
    """Frame of the crank: origin on its axis, z along it."""
    name: str = "crank"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "crank")

    @property
    def row_names(self) -> tuple[str, ...]:
        """Along the crank, along its axis, and rotations across the axis."""
        return ("radial", "vz", "wx", "wy")

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """Pushed and pulled alike."""
        return (False,) * 4

    def inputs(self) -> dict[str, Array]:
        """Return the believed pose of the environment."""
        return pose_inputs(self.X_WE)

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the four rows at the current pose."""

        def A(X_WF: SymbolicPose) -> SX:
            X_EF = pose_in_environment(X_WF, u)
            axes = axes_of_environment(X_EF)
            length = ca.sqrt(ca.sumsqr(X_EF.p[:2]))
            radial = (X_EF.p[0] * axes[0, :] + X_EF.p[1] * axes[1, :]) / length
            return ca.vertcat(radial, axes[2:5, :])

        return differentiate(A, motion)
