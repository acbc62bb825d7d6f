"""A straight edge that stays on a plane: two rows (k = 2)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array
from qpctrl.constraint.environment import (
    need_six_axes,
    pose_in_environment,
    pose_inputs,
)
from qpctrl.constraint.pfaffian import PfaffianRows, differentiate
from qpctrl.errors import InputError
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX, SymbolicPose


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeOnPlane:
    """A scraper on a plane: v_z = 0, and no rotation that lifts one end of the edge.

    With the edge e and the normal n in the tool frame, n·e = 0 stays true iff (e × n)·ω = 0.
    Free are two translations, turning about the normal, and rolling about the edge.

    Inputs: ``X_WE`` (3×4), the believed pose of the environment.
    Source: LynchPark2017 §11.6.1.
    """

    space: TaskSpace
    X_WE: pin.SE3
    """Frame of the plane; its z axis points into it."""
    edge: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """Direction of the edge through the origin of the tool frame, in its axes [1]."""
    name: str = "edge"

    def __post_init__(self) -> None:
        need_six_axes(self.space, "edge on plane")
        length = np.linalg.norm(np.array(self.edge, dtype=np.float64))
        if not (np.isfinite(length) and length > 0):
            raise InputError(f"{self.name}.edge: got {self.edge}, need a direction, not zero")

    @property
    def row_names(self) -> tuple[str, ...]:
        """Translation into the plane, rotation that lifts one end."""
        return ("vz", "lift")

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """The plane is pushed, never pulled."""
        return (True, False)

    def inputs(self) -> dict[str, Array]:
        """Return the believed pose of the environment."""
        return pose_inputs(self.X_WE)

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the two rows at the current pose."""

        def A(X_WF: SymbolicPose) -> SX:
            X_EF = pose_in_environment(X_WF, u)
            normal = X_EF.R[2, :].T
            edge = ca.SX(np.array(self.edge) / np.linalg.norm(self.edge))
            return ca.vertcat(
                ca.horzcat(normal.T, ca.SX(1, 3)),
                ca.horzcat(ca.SX(1, 3), ca.cross(edge, normal).T),
            )

        return differentiate(A, motion)
