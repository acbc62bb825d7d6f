"""Any constraint that can be written as c(pose) = 0: rows by automatic differentiation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import final

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array
from qpctrl.constraint.environment import (
    body_gradient,
    need_six_axes,
    pose_in_environment,
    pose_inputs,
)
from qpctrl.constraint.pfaffian import PfaffianRows, differentiate
from qpctrl.errors import InputError
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX, SymbolicPose

DEPENDENT = 1e-9
"""Smallest singular value of A over its largest below which rows depend on each other."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PoseConstraint:
    """m equations ``c(R, p) = 0`` on the pose X_EF of the tool, written by the user in CasADi.

    ċ = A V along ṗ = R v, Ṙ = R [ω]×, so A = ∂ċ/∂V; A and Ȧ V are exact derivatives.

    Inputs: ``X_WE`` (3×4), the believed pose of the environment.
    Source: LynchPark2017 §2.4.
    """

    space: TaskSpace
    X_WE: pin.SE3
    """Frame of the environment in which ``c`` is written."""
    c: SX
    """The equations (m), 1 ≤ m ≤ 6."""
    R: SX
    """Symbol (3×3) of the rotation of X_EF in ``c``."""
    p: SX
    """Symbol (3) of its translation [m]."""
    contact: pin.SE3
    """A pose X_EF in contact, at which the rows are tried."""
    one_sided: bool = False
    """Whether every row can only push (λ ≥ 0), towards growing c."""
    name: str = "pose"
    _A: ca.Function = field(init=False, repr=False)

    def __post_init__(self) -> None:
        need_six_axes(self.space, "pose constraint")
        c = expression(self.c, {"R": (self.R, (3, 3)), "p": (self.p, (3, 1))}, f"{self.name}.c")
        if not 1 <= c.shape[0] <= 6 or c.shape[1] != 1:
            raise InputError(f"{self.name}.c: got shape {c.shape}, need m×1 with 1 ≤ m ≤ 6")
        A = ca.Function("A", [self.R, self.p], [body_gradient(c, self.R, self.p)])
        try_at(A, self.contact, self.name)
        object.__setattr__(self, "_A", A)

    @property
    def row_names(self) -> tuple[str, ...]:
        """Numbered names: ``c0``, ``c1`` and so on."""
        return tuple(f"c{i}" for i in range(self.c.shape[0]))

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """Same answer for every row."""
        return (self.one_sided,) * int(self.c.shape[0])

    def inputs(self) -> dict[str, Array]:
        """Return the believed pose of the environment."""
        return pose_inputs(self.X_WE)

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the m rows at the current pose."""

        def A(X_WF: SymbolicPose) -> SX:
            return self._A(*pose_in_environment(X_WF, u))

        return differentiate(A, motion)


def expression(given: SX, symbols: Mapping[str, tuple[SX, tuple[int, int]]], name: str) -> SX:
    """Return ``given`` if it is an expression of the symbols alone, each of its own shape.

    Raises:
        InputError: not a CasADi expression, a symbol of the wrong shape, or a free symbol.
    """
    if not isinstance(given, ca.SX):
        raise InputError(f"{name}: got {type(given).__name__}, need a CasADi SX expression")
    for key, (symbol, shape) in symbols.items():
        if not isinstance(symbol, ca.SX) or not symbol.is_valid_input() or symbol.shape != shape:
            raise InputError(f"symbol {key} of {name}: need ca.SX.sym of shape {shape}")
    allowed = ca.vertcat(*(ca.vec(symbol) for symbol, _ in symbols.values()))
    free = [s for s in ca.symvar(given) if not ca.depends_on(allowed, s)]
    if free:
        names = ", ".join(str(s) for s in free)
        raise InputError(f"{name}: got free symbols {names}; allowed: {', '.join(symbols)}")
    return given


def try_at(A: ca.Function, contact: pin.SE3, name: str) -> None:
    """Refuse rows that cannot be used at a pose in contact.

    Raises:
        InputError: A or its derivative is not finite, a row vanishes, or rows depend on others.
    """
    X_EF = [contact.rotation, contact.translation]
    rows, slopes = np.array(A(*X_EF)), [np.array(slope) for slope in _slopes(A, X_EF)]
    if not all(np.isfinite(part).all() for part in (rows, *slopes)):
        raise InputError(f"constraint {name!r}: its derivative at the contact is not finite")
    if (np.abs(rows).max(axis=1) < DEPENDENT).any():
        raise InputError(f"constraint {name!r}: zero gradient at the contact; need a regular one")
    sizes = np.linalg.svd(rows, compute_uv=False)
    if sizes[-1] < DEPENDENT * sizes[0]:
        raise InputError(f"constraint {name!r}: its rows depend on each other at the contact")


def _slopes(A: ca.Function, X_EF: Sequence[Array]) -> tuple[ca.DM, ...]:
    zero = np.zeros(A.size_out(0))
    return tuple(A.jacobian()(*X_EF, zero))
