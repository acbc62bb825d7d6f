"""Posture: what a redundant arm does with the freedom that its tasks leave.

a_post = K_p (q_ref − q) − K_d v, acting through the null space of the task spaces.
Source: Khatib1987.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from qpctrl.arrays import Array, Vector, finite_array, non_negative
from qpctrl.errors import InputError
from qpctrl.objective import PostureObjective, Scene, TaskExpressions
from qpctrl.spatial import SX


@final
class PostureReference:
    """The configuration to lean towards.

    Attributes:
        arrays: the task inputs that this reference sets.
    """

    __slots__ = ("arrays",)

    def __init__(self, *, q_ref: Vector) -> None:
        """Describe the reference.

        Args:
            q_ref: configuration (nq) [rad or m].
        """
        self.arrays = {"q_ref": q_ref}

    @property
    def q_ref(self) -> Vector:
        """Configuration (nq) [rad or m]."""
        return self.arrays["q_ref"]


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PostureTask:
    """Lean towards a configuration without disturbing the task spaces."""

    q_ref: Vector
    """Configuration (nq) [rad or m] until a reference gives another."""
    K_p: Array | float = 20.0
    """Stiffness per unit inertia (nq) [1/s²]; a floating body has none."""
    K_d: Array | float = 9.0
    """Damping per unit inertia (nq) [1/s]."""
    name: str = "posture"
    space: None = None
    """A posture lives in joint space."""

    needs_reference: ClassVar[bool] = False
    """Whether there is a safe reference by default."""

    def __post_init__(self) -> None:
        shape = np.shape(self.q_ref)
        object.__setattr__(self, "q_ref", finite_array(self.q_ref, shape, f"{self.name}.q_ref"))
        for gain in ("K_p", "K_d"):
            value = non_negative(getattr(self, gain), shape, f"{self.name}.{gain}")
            object.__setattr__(self, gain, value)

    def inputs(self) -> dict[str, Array]:
        """Return the configuration and the gains."""
        return {
            "q_ref": self.q_ref,
            "K_p": np.asarray(self.K_p),
            "K_d": np.asarray(self.K_d),
        }

    def memory(self) -> dict[str, Array]:
        """Return nothing: a posture has no memory."""
        return {}

    def objective(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> TaskExpressions:
        """Return a_post at the configuration ``u``.

        Raises:
            InputError: the posture is that of a robot with another number of coordinates.
        """
        if u["q_ref"].shape != scene.q.shape:
            got, need = (q.shape[0] for q in (u["q_ref"], scene.q))
            raise InputError(f"{self.name}.q_ref: got {got} values, need {need}, the size of q")
        pull = scene.coordinates(u["K_p"] * (u["q_ref"] - scene.q))
        a_post = pull - scene.coordinates(u["K_d"]) * scene.v
        return TaskExpressions(objective=PostureObjective(a_post), memory={}, signals={})
