"""One line of the equivalence table, and what it promises."""

from dataclasses import dataclass
from typing import NamedTuple

from qpctrl.certificate import KKT_TOLERANCE
from scenarios.scenario import Criterion

EQUALITY = 1e-8
"""Largest relative difference between QP and closed form."""

AGREEMENT = 1e-7
"""Largest relative difference between two solvers with limits active."""

POLISH = 1e-6
"""Largest relative change that the polish may make: in the full form, whose Hessian is singular
in τ, proxsuite's own answer is off by up to 4e-7."""

SAME_CODE = 1e-10
"""Largest relative difference between compiled and interpreted ticks."""

OVERSHOOT = 1e-9
"""Farthest that a torque may pass its limit [Nm]."""


class Case(NamedTuple):
    """One arm with one number of constraint rows."""

    robot: str
    axes: tuple[str, ...]
    k: int


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the equivalence table; all differences are the largest over the states."""

    robot: str
    k: int
    states: int
    law_gap: float
    """QP − hybrid, relative."""
    curvature_gap: float
    """QP − textbook + curvature term, relative; the term computed apart from the controller."""
    own_gap: float
    """The solver's own answer − QP, relative: what the polish changes."""
    textbook_gap: float
    """QP − textbook, relative: what the curvature term makes of it."""
    kkt: float
    """KKT residual, with and without active limits."""
    limited: int
    """States with at least one torque limit active."""
    damped: int
    """States near a singularity, where Λ is damped and equality is not claimed."""
    overshoot: float
    """Torque beyond its limit [Nm]."""
    solver_gap: float
    """QP against a second solver's answer with limits active, relative; as that solver left
    it in the reduced form."""
    unsolved: int
    """States that the solver left without a solution of the demanded accuracy."""
    compiled_gap: float | None = None
    """Compiled tick − interpreted tick, relative, with and without limits; none if interpreted."""

    def criteria(self) -> tuple[Criterion, ...]:
        """Return what this line promises."""
        where = f"{self.robot} k={self.k}"
        gap = self.compiled_gap
        same = () if gap is None else (Criterion(f"{where} compiled", gap, SAME_CODE, "× max |τ|"),)
        return (
            *same,
            Criterion(f"{where} QP = hybrid", self.law_gap, EQUALITY, "× max |τ|"),
            Criterion(
                f"{where} QP − textbook = curvature", self.curvature_gap, EQUALITY, "× max |τ|"
            ),
            Criterion(f"{where} solver's own answer", self.own_gap, POLISH, "× max |τ|"),
            Criterion(f"{where} KKT", self.kkt, KKT_TOLERANCE, ""),
            Criterion(f"{where} torque beyond limit", self.overshoot, OVERSHOOT, "Nm"),
            Criterion(f"{where} two solvers", self.solver_gap, AGREEMENT, "× max |τ|"),
            Criterion(f"{where} unsolved", self.unsolved, 0, "states"),
        )
