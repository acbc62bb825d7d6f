"""Motion of a frame: SE(3) error, transported feed-forward, PID.

    a_cmd = d/dt(Ad_{X⁻¹X_d} V_d) + K_p X_e + K_i ∫X_e + K_d V_e
    [X_e] = log(X⁻¹ X_d),  V_e = Ad_{X⁻¹X_d} V_d − V
    d/dt(Ad_T V_d) = Ad_T V̇_d + ad_{Ad_T V_d} V

Source: LynchPark2017 §11.3.3.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, final

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Twist, non_negative
from qpctrl.factor import Factor
from qpctrl.objective import MotionObjective, Scene, TaskExpressions
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import (
    SX,
    SymbolicPose,
    compose,
    inverse,
    log6,
    motion_cross,
    motion_to_parent,
)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class MotionReference:
    """Where the frame shall be, and how it shall move there."""

    X_WD: pin.SE3
    """Desired pose of the frame in the world."""
    V_des: Twist = field(default_factory=lambda: np.zeros(6))
    """Desired body twist (6) [m/s, rad/s], in the desired frame."""
    V_dot_des: Twist = field(default_factory=lambda: np.zeros(6))
    """Its derivative (6) [m/s², rad/s²]."""

    def arrays(self) -> Mapping[str, Array]:
        """Return the task inputs that this reference sets."""
        return {
            "X_WD": self.X_WD.homogeneous[:3],
            "V_des": self.V_des,
            "V_dot_des": self.V_dot_des,
        }


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
            "X_WD": np.eye(4)[:3],
            "V_des": np.zeros(6),
            "V_dot_des": np.zeros(6),
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
        motion = scene.motion
        X_e, V_e, feed_forward = self._errors(motion, u)
        free = free_directions(scene.A)
        X_free, V_free = free @ X_e, free @ V_e
        grown = memory["integral"] + (1 - scene.freeze) * scene.dt * X_free
        integral = ca.fmin(ca.fmax(grown, -u["integral_max"]), u["integral_max"])
        a_cmd = feed_forward + u["K_p"] * X_free + u["K_i"] * integral + u["K_d"] * V_free
        return TaskExpressions(
            objective=MotionObjective(a_cmd),
            memory={"integral": integral},
            signals={
                "X_e": X_e,
                "V_e": V_e,
                "X_WF": ca.horzcat(motion.X_WF.R, motion.X_WF.p),
                "V": motion.V_full,
            },
        )

    def _errors(self, motion: FrameMotion, u: Mapping[str, SX]) -> tuple[SX, SX, SX]:
        X_WD = SymbolicPose(u["X_WD"][:, :3], u["X_WD"][:, 3])
        turning = ca.vertcat(1, 1, 1, *[float(self.space.turns)] * 3)
        V_des, V_dot_des = turning * u["V_des"], turning * u["V_dot_des"]
        X_FD = compose(inverse(motion.X_WF), X_WD)
        V_transported = motion_to_parent(X_FD, V_des)
        feed_forward = motion_to_parent(X_FD, V_dot_des) + motion_cross(
            V_transported, motion.V_full
        )
        X_e = log6(X_FD) if self.space.turns else ca.vertcat(X_FD.p, ca.SX.zeros(3))
        index = self.space.index
        return X_e[index], (V_transported - motion.V_full)[index], feed_forward[index]


def free_directions(A: SX) -> SX:
    """Return I − A⁺A (n×n), which drops the components along the rows of A."""
    n = A.shape[1]
    if A.shape[0] == 0:
        return ca.SX.eye(n)
    return ca.SX.eye(n) - A.T @ Factor(A @ A.T).solve(A)
