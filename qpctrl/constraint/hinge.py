"""A firmly grasped hinged body: five rows (k = 5)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import pinocchio as pin

from qpctrl.arrays import Array
from qpctrl.constraint.environment import (
    need_six_axes,
    pose_in_environment,
    pose_inputs,
    twist_at_environment,
)
from qpctrl.constraint.pfaffian import PfaffianRows, differentiate
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX, SymbolicPose


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Hinge:
    """A grasped cabinet door: rotation about the hinge is all that is left.

    The rows are those of the twist at the hinge, in its axes: Ad_{X_EF} V = (0, 0, 0, 0, 0, ω_z).
    Any wrench without moment about the axis is free to choose.

    Inputs: ``X_WE`` (3×4), the believed pose of the environment.
    Source: LynchPark2017 §11.6.1.
    """

    space: TaskSpace
    X_WE: pin.SE3
    """Frame of the hinge: origin on its axis, z along it."""
    name: str = "hinge"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "hinge")

    @property
    def row_names(self) -> tuple[str, ...]:
        """Translations at the axis, and rotations across it."""
        return ("vx", "vy", "vz", "wx", "wy")

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """Pushed and pulled alike."""
        return (False,) * 5

    def inputs(self) -> dict[str, Array]:
        """Return the believed pose of the environment."""
        return pose_inputs(self.X_WE)

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the five rows at the current pose."""

        def A(X_WF: SymbolicPose) -> SX:
            X_EF = pose_in_environment(X_WF, u)
            return twist_at_environment(X_EF)[:5, :]

        return differentiate(A, motion)
