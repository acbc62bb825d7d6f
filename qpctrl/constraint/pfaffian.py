"""Pfaffian constraints ``A V = v_c`` and their derivative ``A V̇ + Ȧ V = v̇_c``.

Source: LynchPark2017 §11.6.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol, final, runtime_checkable

import casadi as ca
import numpy as np

from qpctrl.arrays import Array
from qpctrl.errors import InputError
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX, SymbolicPose, skew


class PfaffianRows(NamedTuple):
    """Rows of a constraint on the twist ``V`` (n) of its task space."""

    A: SX
    """Constraint matrix (k×n)."""
    A_dot_V: SX
    """Ȧ V (k) [m/s², rad/s²]."""
    v_c: SX
    """Velocity v_c (k) [m/s, rad/s] of the environment along the rows; 0 where it rests."""
    v_c_dot: SX
    """Acceleration v̇_c (k) [m/s², rad/s²] of the environment along the rows."""


@runtime_checkable
class Constraint(Protocol):
    """What the environment forbids: k rows on the twist of one task space."""

    @property
    def name(self) -> str:
        """Name under which reports refer to the rows."""

    @property
    def space(self) -> TaskSpace:
        """Task space whose twist the rows act on."""

    @property
    def row_names(self) -> tuple[str, ...]:
        """Name of each of the k rows."""

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """For each row, whether the robot can only push (λ ≥ 0)."""

    def inputs(self) -> dict[str, Array]:
        """Return the values that may change every tick, with their defaults."""

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the rows as expressions of the pose, the twist and the inputs ``u``."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Pfaffian:
    """Any constraint whose ``A``, ``Ȧ V``, ``v_c`` and ``v̇_c`` are computed elsewhere, every tick.

    Inputs: ``A`` (k×n), ``A_dot_V`` (k), ``v_c`` (k), ``v_c_dot`` (k).
    """

    space: TaskSpace
    A: Array
    """Constraint matrix (k×n) until another is given."""
    name: str = "pfaffian"
    one_sided: bool = False
    """Whether every row can only push (λ ≥ 0)."""

    def __post_init__(self) -> None:
        shape = np.shape(self.A)
        if len(shape) != 2 or shape[1] != self.space.n or not 1 <= shape[0] <= self.space.n:
            raise InputError(
                f"A of constraint {self.name!r}: got shape {shape}, need k×{self.space.n} for the "
                f"axes {' '.join(self.space.axes)}, with 1 ≤ k ≤ {self.space.n}"
            )
        if not np.isfinite(self.A).all():
            raise InputError(f"A of constraint {self.name!r}: got a value that is not finite")

    @property
    def row_names(self) -> tuple[str, ...]:
        """Numbered names: ``row0``, ``row1`` and so on."""
        return tuple(f"row{i}" for i in range(len(self.A)))

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """Same answer for every row."""
        return (self.one_sided,) * len(self.A)

    def inputs(self) -> dict[str, Array]:
        """Return ``A`` (k×n) and resting values of ``A_dot_V``, ``v_c`` and ``v_c_dot`` (k)."""
        still = dict.fromkeys(("A_dot_V", "v_c", "v_c_dot"), np.zeros(len(self.A)))
        return {"A": np.asarray(self.A), **still}

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the inputs as they are."""
        return PfaffianRows(u["A"], u["A_dot_V"], u["v_c"], u["v_c_dot"])


def differentiate(A_of: Callable[[SymbolicPose], SX], motion: FrameMotion) -> PfaffianRows:
    """Return the rows of a resting environment from ``A`` (k×n) as a function of the pose X_WF.

    Ȧ V is exact: the derivative of A along Ṙ = R [ω]×, ṗ = R v, by automatic differentiation.
    """
    R, p, V = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3), ca.SX.sym("V", motion.space.n)
    A = A_of(SymbolicPose(R, p))
    pose = ca.vertcat(ca.vec(R), p)
    R_WF, p_WF = motion.X_WF
    rate = ca.vertcat(ca.vec(R_WF @ skew(motion.V_full[3:])), R_WF @ motion.V_full[:3])
    symbols = ca.vertcat(pose, V)
    values = ca.vertcat(ca.vec(R_WF), p_WF, motion.V)
    A_here, A_dot_V = ca.substitute([A, ca.jtimes(A @ V, pose, rate)], [symbols], [values])
    still = ca.SX.zeros(A.shape[0])
    return PfaffianRows(A_here, A_dot_V, still, still)


def row_function(constraint: Constraint) -> ca.Function:
    """Return (R_WF, p_WF, V_full, *inputs) → (A, Ȧ V, v_c, v̇_c) of one constraint, for plants."""
    R, p, V = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3), ca.SX.sym("V", 6)
    u = {name: ca.SX.sym(name, *np.shape(value)) for name, value in constraint.inputs().items()}
    rows = constraint.rows(FrameMotion(constraint.space, SymbolicPose(R, p), V), u)
    names = ["R_WF", "p_WF", "V", *u]
    return ca.Function(
        "rows",
        [R, p, V, *u.values()],
        [ca.densify(part) for part in rows],
        names,
        ["A", "A_dot_V", "v_c", "v_c_dot"],
        {"allow_duplicate_io_names": True},  # the inputs of a `Pfaffian` are its rows
    )
