"""Admittance: the frame moves as the sensed wrench asks, by inverse dynamics.

    M_v ẍ_d + B_v ẋ + K_v x = f_ext    →    a_cmd = M_v⁻¹ (f_ext − B_v ẋ − K_v x)

x runs from the reference to the frame; f_ext is the wrench on the robot: minus the low-pass
filtered reading of a force-torque sensor, which is of robot on environment. Simplified: a spring
alone, x_d = K_v⁻¹ f_ext, or a damper alone, ẋ_d = B_v⁻¹ f_ext, followed by a motion loop.
Source: LynchPark2017 §11.7.2.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal, final, get_args

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Twist, Vector, non_negative
from qpctrl.errors import unknown_name
from qpctrl.factor import Factor
from qpctrl.objective import MotionObjective, Scene, TaskExpressions
from qpctrl.space import TaskSpace
from qpctrl.spatial import SX
from tasks.energy import energy_memory, observe_energy
from tasks.pose_error import AT_REST, PoseError, free_directions, motion_signals, pose_error
from tasks.virtual import damping_matrix, mass_matrix, stiffness_matrix

Simulated = Literal["full", "spring", "damper"]


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class AdmittanceReference:
    """Where the spring is at rest, how that place moves, and the sensed wrench."""

    X_WD: pin.SE3
    """Pose of the frame in the world at which the spring is at rest."""
    F_meas: Vector
    """Sensed wrench of robot on environment (n) [N, Nm], in the frame."""
    V_des: Twist = field(default_factory=lambda: np.zeros(6))
    """Body twist of that place (6) [m/s, rad/s], in its own axes."""
    V_dot_des: Twist = field(default_factory=lambda: np.zeros(6))
    """Its derivative (6) [m/s², rad/s²]."""
    gains: Mapping[str, Array] = field(default_factory=dict)
    """Inputs of the task to change from this tick on, by name."""

    @property
    def arrays(self) -> Mapping[str, Array]:
        """Task inputs that this reference sets."""
        return {
            "X_WD": self.X_WD.homogeneous[:3],
            "V_des": self.V_des,
            "V_dot_des": self.V_dot_des,
            "F_meas": self.F_meas,
            **self.gains,
        }


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class AdmittanceTask:
    """Move like a virtual mass, damper and spring under the sensed wrench.

    In free space the filtered wrench is also compensated in the dynamics, so that the arm follows
    a_cmd whatever its own inertia; on a constraint the force task of that space does so. Meant for
    soft environments: on a stiff one the delay of sensor and filter makes the loop unstable. Gains
    are scalars, diagonals (n), or (n×n).
    """

    space: TaskSpace
    M_v: Array | float = 5.0
    """Virtual mass [kg, kg m²], positive definite."""
    B_v: Array | float = 50.0
    """Virtual damping [N s/m, Nm s/rad]; positive definite for a damper alone."""
    K_v: Array | float = 0.0
    """Virtual stiffness [N/m, Nm/rad]; positive definite for a spring alone."""
    simulated: Simulated = "full"
    """Mass, damper and spring, or one of the simplified versions."""
    cutoff: float = 30.0
    """Cut-off [Hz] of the filter on the sensed wrench; 0 is no filter."""
    K_p: Array | float = 400.0
    """Stiffness per unit inertia (n) [1/s²] of the motion loop behind a spring alone."""
    K_d: Array | float = 40.0
    """Damping per unit inertia (n) [1/s] of the motion loop behind a spring or damper alone."""
    name: str = "admittance"

    needs_reference: ClassVar[bool] = True
    """Whether there is no safe reference by default."""

    def __post_init__(self) -> None:
        n = self.space.n
        if self.simulated not in get_args(Simulated):
            raise unknown_name("simulated behaviour", self.simulated, get_args(Simulated))
        spring = mass_matrix if self.simulated == "spring" else stiffness_matrix
        damper = mass_matrix if self.simulated == "damper" else damping_matrix
        object.__setattr__(self, "M_v", mass_matrix(self.M_v, n, f"{self.name}.M_v"))
        object.__setattr__(self, "B_v", damper(self.B_v, n, f"{self.name}.B_v"))
        object.__setattr__(self, "K_v", spring(self.K_v, n, f"{self.name}.K_v"))
        for gain, shape in (("K_p", (n,)), ("K_d", (n,)), ("cutoff", ())):
            value = non_negative(getattr(self, gain), shape, f"{self.name}.{gain}")
            object.__setattr__(self, gain, value)

    def inputs(self) -> dict[str, Array]:
        """Return reference (identity pose, at rest), reading (zero) and the gains in use."""
        used = {"full": ("M_v", "B_v", "K_v"), "spring": ("K_v", "K_p", "K_d")}
        gains = used.get(self.simulated, ("B_v", "K_d"))
        return {
            **AT_REST,
            "F_meas": np.zeros(self.space.n),
            **{key: np.asarray(getattr(self, key)) for key in (*gains, "cutoff")},
        }

    def memory(self) -> dict[str, Array]:
        """Return the filtered wrench (n), zero at first, and the energy observer's."""
        return {"F_ext": np.zeros(self.space.n), **energy_memory(self.space.n)}

    def objective(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> TaskExpressions:
        """Return a_cmd and the wrench to compensate, at the reading ``u``."""
        error = pose_error(self.space, scene.motion, u)
        follow = ca.if_else(u["cutoff"] > 0, 1 - ca.exp(-2 * np.pi * u["cutoff"] * scene.dt), 1.0)
        F_ext = memory["F_ext"] + follow * (u["F_meas"] - memory["F_ext"])
        free = free_directions(scene.A)
        a_cmd = error.feed_forward + free @ self._answer(u, error, F_ext)
        given = observe_energy(u["F_meas"], scene.motion.V, memory, scene.dt)
        return TaskExpressions(
            objective=MotionObjective(a_cmd, None if scene.A.shape[0] else F_ext),
            memory={"F_ext": F_ext, **given.memory},
            signals={
                **motion_signals(error, scene.motion),
                "F_ext": F_ext,
                "energy": given.energy,
            },
        )

    def _answer(self, u: Mapping[str, SX], error: PoseError, F_ext: SX) -> SX:
        """Return what the sensed wrench adds to the acceleration (n) [m/s², rad/s²]."""
        if self.simulated == "spring":
            x_d = -Factor(u["K_v"]).solve(F_ext)
            return u["K_p"] * (error.X_e + x_d) + u["K_d"] * error.V_e
        if self.simulated == "damper":
            return u["K_d"] * (error.V_e - Factor(u["B_v"]).solve(F_ext))
        pull = u["B_v"] @ error.V_e + u["K_v"] @ error.X_e
        return Factor(u["M_v"]).solve(pull - F_ext)
