"""A tool that cannot move at all: six rows (k = 6)."""

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
class Embedded:
    """A tool set in concrete: every wrench can be chosen, and no motion.

    Inputs: ``X_WE`` (3×4), the believed pose of the environment.
    Source: LynchPark2017 §11.6.1.
    """

    space: TaskSpace
    X_WE: pin.SE3
    """Frame of the environment, in whose axes the rows are."""
    name: str = "embedded"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "embedded tool")

    @property
    def row_names(self) -> tuple[str, ...]:
        """All six directions."""
        return ("vx", "vy", "vz", "wx", "wy", "wz")

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """Pushed and pulled alike."""
        return (False,) * 6

    def inputs(self) -> dict[str, Array]:
        """Return the believed pose of the environment."""
        return pose_inputs(self.X_WE)

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the six rows at the current pose."""

        def A(X_WF: SymbolicPose) -> SX:
            X_EF = pose_in_environment(X_WF, u)
            return axes_of_environment(X_EF)

        return differentiate(A, motion)
