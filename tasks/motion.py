"""Motion of a frame: PID on the pose error, with transported feed-forward.

    a_cmd = d/dt(Ad_{X⁻¹X_d} V_d) + K_p X_e + K_i ∫X_e + K_d V_e

Source: LynchPark2017 §11.3.3.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, non_negative
from qpctrl.objective import MotionObjective, Scene, TaskExpressions
from qpctrl.space import TaskSpace
from qpctrl.spatial import SX
from tasks.pose_error import AT_REST, free_directions, motion_signals, pose_error


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class MotionTask:
    """Follow a pose with PID feedback on SE(3) and transported feed-forward.

    A space without angular axes controls the position alone. Feedback acts in the directions
    that A leaves free: errors along its rows belong to the force task.
    """

    space: TaskSpace
    K_p: Array | float = 400.0
    """Stiffness per unit inertia (n) [1/s²]."""
    K_i: Array | float = 0.0
    """Integral gain (n) [1/s³]."""
    K_d: Array | float = 40.0
    """Damping per unit inertia (n) [1/s]."""
    integral_max: Array | float = 0.05
    """Saturation of ∫X_e (n) [m s, rad s]."""
    name: str = "motion"

    needs_reference: ClassVar[bool] = True
    """Whether there is no safe reference by default."""

    def __post_init__(self) -> None:
        for gain in ("K_p", "K_i", "K_d", "integral_max"):
            value = non_negative(getattr(self, gain), (self.space.n,), f"{self.name}.{gain}")
            object.__setattr__(self, gain, value)

    def inputs(self) -> dict[str, Array]:
        """Return the reference (identity pose, at rest) and the gains."""
        return {
            **AT_REST,
            "K_p": np.asarray(self.K_p),
            "K_i": np.asarray(self.K_i),
            "K_d": np.asarray(self.K_d),
            "integral_max": np.asarray(self.integral_max),
        }

    def memory(self) -> dict[str, Array]:
        """Return ∫X_e (n) [m s, rad s]."""
        return {"integral": np.zeros(self.space.n)}

    def objective(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> TaskExpressions:
        """Return a_cmd at the reference ``u``."""
        error = pose_error(self.space, scene.motion, u)
        free = free_directions(scene.A)
        X_free, V_free = free @ error.X_e, free @ error.V_e
        grown = memory["integral"] + (1 - scene.freeze) * scene.dt * X_free
        integral = ca.fmin(ca.fmax(grown, -u["integral_max"]), u["integral_max"])
        feedback = u["K_p"] * X_free + u["K_i"] * integral + u["K_d"] * V_free
        return TaskExpressions(
            objective=MotionObjective(error.feed_forward + feedback),
            memory={"integral": integral},
            signals=motion_signals(error, scene.motion),
        )
