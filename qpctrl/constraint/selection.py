"""Some of the rows of another constraint."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

from qpctrl.arrays import Array
from qpctrl.constraint.pfaffian import Constraint, PfaffianRows
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Selection:
    """The rows ``keep`` of ``whole``; used to drop rows that depend on others."""

    whole: Constraint
    keep: tuple[int, ...]

    @property
    def name(self) -> str:
        """Name of the whole constraint."""
        return self.whole.name

    @property
    def space(self) -> TaskSpace:
        """Task space of the whole constraint."""
        return self.whole.space

    @property
    def row_names(self) -> tuple[str, ...]:
        """Names of the rows kept."""
        return tuple(self.whole.row_names[i] for i in self.keep)

    @property
    def unilateral(self) -> tuple[bool, ...]:
        """Whether each row kept can only push."""
        return tuple(self.whole.unilateral[i] for i in self.keep)

    def inputs(self) -> dict[str, Array]:
        """Return the inputs of the whole constraint."""
        return self.whole.inputs()

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> PfaffianRows:
        """Return the rows kept."""
        keep = list(self.keep)
        A, *rates = self.whole.rows(motion, u)
        return PfaffianRows(A[keep, :], *(rate[keep] for rate in rates))
