"""What the momentum about the centre of mass shall be.

ḣ = ḣ_des + K (h_des − h), in the axes of the world. Source: Orin2013.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, final

import numpy as np

from qpctrl.arrays import Array, Vector, non_negative
from qpctrl.objective import MotionObjective, Scene, TaskExpressions
from qpctrl.space import CentroidalSpace
from qpctrl.spatial import SX

ANGULAR = ("wx", "wy", "wz")


@final
class MomentumReference:
    """The momentum to have, and its rate.

    Attributes:
        arrays: the task inputs that this reference sets.
    """

    __slots__ = ("arrays",)

    def __init__(self, *, h_des: Vector, h_dot_des: Vector | None = None) -> None:
        """Describe the reference.

        Args:
            h_des: momentum (n) [kg m/s, kg m²/s] along the axes of the task's space.
            h_dot_des: its rate (n) [N, Nm]; default: 0.
        """
        rate = np.zeros(np.shape(h_des)) if h_dot_des is None else h_dot_des
        self.arrays = {"h_des": h_des, "h_dot_des": rate}


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class MomentumTask:
    """Follow a momentum: without a reference, come to rest."""

    space: CentroidalSpace = field(default_factory=lambda: CentroidalSpace(axes=ANGULAR))
    """Axes to follow along; by default those of the angular momentum."""
    K: Array | float = 10.0
    """Rate at which an error decays (n) [1/s]."""
    name: str = "momentum"

    needs_reference: ClassVar[bool] = False
    """Whether there is no safe reference by default."""

    def __post_init__(self) -> None:
        value = non_negative(self.K, (self.space.n,), f"{self.name}.K")
        object.__setattr__(self, "K", value)

    def inputs(self) -> dict[str, Array]:
        """Return the reference (at rest) and the gain."""
        still = dict.fromkeys(("h_des", "h_dot_des"), np.zeros(self.space.n))
        return {**still, "K": np.asarray(self.K)}

    def memory(self) -> dict[str, Array]:
        """Return nothing: the task has no memory."""
        return {}

    def objective(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> TaskExpressions:
        """Return the commanded rate of the momentum at the reference ``u``."""
        h = scene.motion.V
        h_dot_cmd = u["h_dot_des"] + u["K"] * (u["h_des"] - h)
        return TaskExpressions(objective=MotionObjective(h_dot_cmd), memory={}, signals={"h": h})
