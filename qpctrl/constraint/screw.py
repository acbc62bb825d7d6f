"""A firmly grasped screw: five rows (k = 5)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import casadi as ca
import pinocchio as pin

from qpctrl.arrays import Array, finite_array
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
class Screw:
    """A grasped valve or bolt: it advances by ``lead`` for each radian that it turns.

    The rows are those of the twist at the screw, in its axes, with v_z − h ω_z among them.

    Inputs: ``X_WE`` (3×4), the believed pose of the environment.
    Source: LynchPark2017 §11.6.1.
    """

    space: TaskSpace
    X_WE: pin.SE3
    """Frame of the screw: origin on its axis, z along it."""
    lead: float
    """Advance h along z [m/rad]."""
    name: str = "screw"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "screw")
        finite_array(self.lead, (), f"{self.name}.lead")

    @property
    def row_names(self) -> tuple[str, ...]:
        """Translations across the axis, advance less lead times turn, rotations across."""
        return ("vx", "vy", "vz - h wz", "wx", "wy")

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
            twist = twist_at_environment(X_EF)
            advance = twist[2, :] - self.lead * twist[5, :]
            return ca.vertcat(twist[:2, :], advance, twist[3:5, :])

        return differentiate(A, motion)
