"""Where the centre of mass shall be.

ḣ_lin = m (c̈_des + K_p (c_des − c) + K_d (ċ_des − ċ)), the commanded rate of the linear momentum.
Source: Orin2013.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, final

import numpy as np

from qpctrl.arrays import Array, Vector, non_negative
from qpctrl.errors import InputError
from qpctrl.objective import MotionObjective, Scene, TaskExpressions
from qpctrl.space import CentroidalSpace
from qpctrl.spatial import SX

LINEAR = ("vx", "vy", "vz")


@final
class CentreOfMassReference:
    """Where the centre of mass shall be, and how it shall move there, in the axes of the world.

    Attributes:
        arrays: the task inputs that this reference sets.
    """

    __slots__ = ("arrays",)

    def __init__(
        self,
        *,
        c_des: Vector,
        c_dot_des: Vector | None = None,
        c_ddot_des: Vector | None = None,
        gains: Mapping[str, Array] | None = None,
    ) -> None:
        """Describe the reference.

        Args:
            c_des: place (3) [m]; an entry along an axis that the task lacks is not looked at.
            c_dot_des: velocity (3) [m/s]; default: at rest.
            c_ddot_des: acceleration (3) [m/s²]; default: none.
            gains: inputs of the task to change from this tick on, by name; default: none.
        """
        self.arrays = {
            "c_des": c_des,
            "c_dot_des": STILL if c_dot_des is None else c_dot_des,
            "c_ddot_des": STILL if c_ddot_des is None else c_ddot_des,
            **(gains or {}),
        }


STILL: Vector = np.zeros(3)
"""No motion (3) [m/s], [m/s²]."""
STILL.flags.writeable = False  # references share it


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class CentreOfMassTask:
    """Follow a motion of the centre of mass."""

    space: CentroidalSpace = field(default_factory=lambda: CentroidalSpace(axes=LINEAR))
    """Linear axes to follow along, all three by default."""
    K_p: Array | float = 100.0
    """Stiffness per unit mass (n) [1/s²]."""
    K_d: Array | float = 20.0
    """Damping per unit mass (n) [1/s]."""
    name: str = "centre of mass"

    needs_reference: ClassVar[bool] = True
    """Whether there is no safe reference by default."""

    def __post_init__(self) -> None:
        if not set(self.space.axes) <= set(LINEAR):
            raise InputError(f"{self.name}: got axes {self.space.axes}, need some of {LINEAR}")
        for gain in ("K_p", "K_d"):
            value = non_negative(getattr(self, gain), (self.space.n,), f"{self.name}.{gain}")
            object.__setattr__(self, gain, value)

    def inputs(self) -> dict[str, Array]:
        """Return the reference (the origin, at rest) and the gains."""
        still = dict.fromkeys(("c_des", "c_dot_des", "c_ddot_des"), np.zeros(3))
        return {**still, "K_p": np.asarray(self.K_p), "K_d": np.asarray(self.K_d)}

    def memory(self) -> dict[str, Array]:
        """Return nothing: the task has no memory."""
        return {}

    def objective(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> TaskExpressions:
        """Return the commanded rate of the momentum at the reference ``u``."""
        i, m = self.space.index, scene.mass
        c, c_dot = scene.motion.X_WF.p, scene.motion.V_full[:3] / m
        c_e, c_dot_e = (u["c_des"] - c)[i], (u["c_dot_des"] - c_dot)[i]
        a_cmd = m * (u["c_ddot_des"][i] + u["K_p"] * c_e + u["K_d"] * c_dot_e)
        return TaskExpressions(
            objective=MotionObjective(a_cmd), memory={}, signals={"c": c, "c_e": c_e}
        )
