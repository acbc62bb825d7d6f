"""Linear limits ``W F ≤ ub`` on the wrench ``F = Aᵀ λ`` that a contact carries."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol, runtime_checkable

from qpctrl.arrays import Array
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX


class WrenchRows(NamedTuple):
    """Rows of a limit on the wrench of robot on environment, in the axes of its space."""

    W: SX
    """One row for each side of the limit (rows×n)."""
    ub: SX
    """Upper bounds (rows) [N, Nm]."""


@runtime_checkable
class WrenchLimit(Protocol):
    """What a contact can carry, as inequalities of the QP on its multipliers."""

    @property
    def name(self) -> str:
        """Name under which inputs and reports refer to the limit."""

    @property
    def space(self) -> TaskSpace:
        """Task space of the constraint whose wrench is limited."""

    @property
    def row_names(self) -> tuple[str, ...]:
        """Name of each row."""

    @property
    def unit(self) -> str:
        """Unit of every row: N or Nm."""

    def inputs(self) -> dict[str, Array]:
        """Return the values that may change every tick, with their defaults."""

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> WrenchRows:
        """Return the rows as expressions of the pose and the inputs ``u``."""
