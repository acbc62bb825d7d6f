"""Impedance: the frame answers a push like a mass, a damper and a spring.

    M_v ẍ + B_v ẋ + K_v x = f_ext,   x from the reference to the frame, f_ext on the robot
    F = Λ ẍ_meas + η − (M_v ẍ_meas + B_v ẋ + K_v x)      with the mass term
    F = η − (B_v ẋ + K_v x)                              without: the arm's own Λ is felt

``twist`` takes the exponential coordinates of the pose error for x and the body twist for ẋ.
``minimal`` takes x = (p, roll, pitch, yaw) of the frame in the reference, ẋ = E(x) V and
f = E⁻ᵀ F. Source: LynchPark2017 §11.7.1.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal, final, get_args

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Twist, Vector, positive
from qpctrl.constraint.environment import body_gradient, need_six_axes
from qpctrl.constraint.pfaffian import differentiate
from qpctrl.errors import unknown_name
from qpctrl.objective import MotionObjective, Scene, TaskExpressions
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX, SymbolicPose, compose, inverse
from tasks.pose_error import AT_REST, PoseError, free_directions, motion_signals, pose_error
from tasks.virtual import damping_matrix, mass_matrix, stiffness_matrix

Coordinates = Literal["twist", "minimal"]


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ImpedanceReference:
    """Where the spring is at rest, how that place moves, and the measured acceleration."""

    X_WD: pin.SE3
    """Pose of the frame in the world at which the spring is at rest."""
    V_des: Twist = field(default_factory=lambda: np.zeros(6))
    """Its body twist (6) [m/s, rad/s], in its own axes."""
    V_dot_des: Twist = field(default_factory=lambda: np.zeros(6))
    """Its derivative (6) [m/s², rad/s²]."""
    V_dot_meas: Vector | None = None
    """Measured derivative of the twist (n) [m/s², rad/s²] along the axes of the space; none:
    the difference of the last two twists."""
    gains: Mapping[str, Array] = field(default_factory=dict)
    """Inputs of the task to change from this tick on, by name: ``K_v`` (n×n) for instance."""

    @property
    def arrays(self) -> Mapping[str, Array]:
        """Task inputs that this reference sets."""
        given = {} if self.V_dot_meas is None else {"V_dot_meas": self.V_dot_meas}
        return {
            "X_WD": self.X_WD.homogeneous[:3],
            "V_des": self.V_des,
            "V_dot_des": self.V_dot_des,
            "accelerometer": np.array(float(self.V_dot_meas is not None)),
            **given,
            **self.gains,
        }


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ImpedanceTask:
    """Answer pushes with a virtual spring and damper, and on request a virtual mass.

    Gains are scalars, diagonals (n), or matrices (n×n). With the mass term and an acceleration
    that is one tick old, the loop is stable iff the eigenvalues of α Λ⁻¹ M_v are below 2, with
    α = 1 − exp(−2π cutoff dt): 4.3 Λ at 100 Hz and 1 kHz.
    """

    space: TaskSpace
    K_v: Array | float
    """Virtual stiffness [N/m, Nm/rad], positive semidefinite."""
    B_v: Array | float
    """Virtual damping [N s/m, Nm s/rad], positive semidefinite."""
    M_v: Array | float | None = None
    """Virtual mass [kg, kg m²], positive definite; none leaves the arm's own inertia."""
    coordinates: Coordinates = "twist"
    """Exponential coordinates with twist and wrench, or minimal coordinates."""
    cutoff: float = 100.0
    """Cut-off [Hz] of the filter on the measured acceleration, with a mass term."""
    name: str = "impedance"

    needs_reference: ClassVar[bool] = True
    """Whether there is no safe reference by default."""

    def __post_init__(self) -> None:
        n = self.space.n
        object.__setattr__(self, "K_v", stiffness_matrix(self.K_v, n, f"{self.name}.K_v"))
        object.__setattr__(self, "B_v", damping_matrix(self.B_v, n, f"{self.name}.B_v"))
        if self.M_v is not None:
            object.__setattr__(self, "M_v", mass_matrix(self.M_v, n, f"{self.name}.M_v"))
        positive(self.cutoff, (), f"{self.name}.cutoff")
        if self.coordinates not in get_args(Coordinates):
            raise unknown_name("coordinates", self.coordinates, get_args(Coordinates))
        if self.coordinates == "minimal":
            need_six_axes(self.space, "impedance in minimal coordinates")

    def inputs(self) -> dict[str, Array]:
        """Return the reference (identity pose, at rest) and the gains."""
        gains: dict[str, Array] = {"K_v": np.asarray(self.K_v), "B_v": np.asarray(self.B_v)}
        if self.M_v is not None:
            gains |= {"M_v": np.asarray(self.M_v), "cutoff": np.array(float(self.cutoff))}
        unused = {"V_dot_meas": np.zeros(self.space.n), "accelerometer": np.array(0.0)}
        return {**AT_REST, **unused, **gains}

    def memory(self) -> dict[str, Array]:
        """Return twist and filtered acceleration (n each), and whether there has been a tick."""
        if self.M_v is None:
            return {}
        n = self.space.n
        return {"V_last": np.zeros(n), "V_dot": np.zeros(n), "begun": np.array(0.0)}

    def objective(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> TaskExpressions:
        """Return a_cmd = V̇_meas − Λ⁻¹ (M_v (V̇_meas − ff) − B_v V_e − K_v X_e) at ``u``.

        Without the mass term V̇_meas is replaced by the feed-forward ff.
        """
        error = pose_error(self.space, scene.motion, u)
        after: dict[str, SX] = {}
        V_dot = error.feed_forward
        if self.M_v is not None:
            after = self._accelerate(scene, u, memory)
            V_dot = after["V_dot"]
        free = free_directions(scene.A)
        wrench = free @ self._restoring_wrench(scene, u, error, V_dot)
        V_dot = error.feed_forward + free @ (V_dot - error.feed_forward)
        return TaskExpressions(
            objective=MotionObjective(V_dot + scene.Lambda_inv @ wrench),
            memory=after,
            signals={**motion_signals(error, scene.motion), "wrench": wrench},
        )

    def _accelerate(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> dict[str, SX]:
        """Return the memory after this tick, with the filtered acceleration (n) in it."""
        V = scene.motion.V
        difference = memory["begun"] * (V - memory["V_last"]) / scene.dt
        given = ca.if_else(u["accelerometer"] > 0.5, u["V_dot_meas"], difference)
        follow = 1 - ca.exp(-2 * np.pi * u["cutoff"] * scene.dt)
        V_dot = memory["V_dot"] + follow * (given - memory["V_dot"])
        return {"V_last": V, "V_dot": V_dot, "begun": ca.SX(1.0)}

    def _restoring_wrench(
        self, scene: Scene, u: Mapping[str, SX], error: PoseError, V_dot: SX
    ) -> SX:
        """Return −(M_v ẍ + B_v ẋ + K_v x) as a wrench (n) [N, Nm] in the frame."""
        M_v = u["M_v"] if self.M_v is not None else ca.SX(self.space.n, self.space.n)
        beyond = V_dot - error.feed_forward
        if self.coordinates == "twist":
            return u["K_v"] @ error.X_e + u["B_v"] @ error.V_e - M_v @ beyond
        X_WD = SymbolicPose(u["X_WD"][:, :3], u["X_WD"][:, 3])
        seen = FrameMotion(self.space, compose(inverse(X_WD), scene.motion.X_WF), -error.V_e)
        E, E_dot_V, _, _ = differentiate(coordinate_rates, seen)
        x, x_dot, x_ddot = minimal_coordinates(*seen.X_WF), E @ seen.V, E @ beyond + E_dot_V
        return -E.T @ (M_v @ x_ddot + u["B_v"] @ x_dot + u["K_v"] @ x)


def minimal_coordinates(R: SX, p: SX) -> SX:
    """Return x = (p, roll, pitch, yaw) (6) [m, rad], with R = R_z(yaw) R_y(pitch) R_x(roll)."""
    pitch = ca.atan2(-R[2, 0], ca.sqrt(R[0, 0] ** 2 + R[1, 0] ** 2))
    return ca.vertcat(p, ca.atan2(R[2, 1], R[2, 2]), pitch, ca.atan2(R[1, 0], R[0, 0]))


def coordinate_rates(X_DF: SymbolicPose) -> SX:
    """Return E (6×6) with ẋ = E V for the body twist V; singular at a pitch of ±90°."""
    return body_gradient(minimal_coordinates(*X_DF), X_DF.R, X_DF.p)
