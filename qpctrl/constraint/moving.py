"""A constraint whose environment moves: a board on a conveyor, a door on a ship."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import final

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Twist
from qpctrl.constraint.environment import need_six_axes
from qpctrl.constraint.pfaffian import Constraint, PfaffianRows
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX, SymbolicPose, compose, inverse, motion_cross, motion_to_parent


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class EnvironmentMotion:
    """Where the environment has moved, and how it moves on: the reference of `Moving`.

    Give it under the name of the constraint.
    """

    X_shift: pin.SE3
    """Displacement D: a point of the environment that was at p in the world is at D p."""
    V_env: Twist = field(default_factory=lambda: np.zeros(6))
    """Body twist V_D (6) [m/s, rad/s] of D."""
    V_dot_env: Twist = field(default_factory=lambda: np.zeros(6))
    """Its derivative (6) [m/s², rad/s²]."""

    @property
    def arrays(self) -> Mapping[str, Array]:
        """Inputs of the constraint that this motion sets."""
        return {
            "X_shift": self.X_shift.homogeneous[:3],
            "V_env": self.V_env,
            "V_dot_env": self.V_dot_env,
        }


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Moving:
    """The constraint ``whole``, carried along by an environment that moves as a rigid body.

    The environment has moved by D from where ``whole`` has it, with the body twist V_D. Seen
    from it the tool is at X′ = D⁻¹ X_WF and moves with V − Ad V_D, Ad = Ad_{X_FW D}. So the rows
    of ``whole`` at X′ hold for that twist, and
    v_c = A Ad V_D,  v̇_c = A (Ad V̇_D + ad_{Ad V_D} V).

    Inputs: those of ``whole``; ``X_shift`` (3×4), ``V_env`` (6) and ``V_dot_env`` (6): D, V_D
    and its derivative, at rest by default. `EnvironmentMotion` sets these three.
    """

    whole: Constraint

    def __post_init__(self) -> None:
        need_six_axes(self.whole.space, "moving environment")

    @property
    def name(self) -> str:
        """Name of the constraint that moves."""
        return self.whole.name

    @property
    def space(self) -> TaskSpace:
        """Task space of the constraint that moves."""
        return self.whole.space

    @property
    def row_names(self) -> tuple[str, ...]:
        """Names of its rows."""
        return self.whole.row_names

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """Whether each of its rows can only push."""
        return self.whole.unilateral

    def inputs(self) -> dict[str, Array]:
        """Return the inputs of the constraint, and an environment at rest."""
        rest = EnvironmentMotion(X_shift=pin.SE3.Identity())
        return {**self.whole.inputs(), **rest.arrays}

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the rows of the constraint, seen from the environment."""
        D = SymbolicPose(u["X_shift"][:, :3], u["X_shift"][:, 3])
        X_seen = compose(inverse(D), motion.X_WF)
        V_env = motion_to_parent(inverse(X_seen), u["V_env"])
        V_dot_env = motion_to_parent(inverse(X_seen), u["V_dot_env"]) + motion_cross(
            V_env, motion.V_full
        )
        seen = FrameMotion(motion.space, X_seen, motion.V_full - V_env)
        A, A_dot_V, v_c, v_c_dot = self.whole.rows(seen, u)
        return PfaffianRows(A, A_dot_V, v_c + A @ V_env, v_c_dot + A @ V_dot_env)
