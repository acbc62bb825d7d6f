"""The compliant plant: M a + h + D_q v + Jᵀ F = τ with F from a compliant environment, integrated.

The environment answers the tool's pose and twist with a wrench: springs, a hand, a wall. Dynamics
by pinocchio, independent of the controller's expressions; the plant may carry a payload that
the controller does not know of.
"""

from typing import Protocol

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Matrix, Twist, Vector, Wrench, finite_array, non_negative, positive
from qpctrl.errors import InputError
from qpctrl.robot import Robot
from scenarios.joint_friction import dry_friction
from scenarios.model_error import ModelError, true_model
from scenarios.plant import PlantState
from scenarios.runge_kutta import MIDPOINT, choose_scheme

LOCAL = pin.ReferenceFrame.LOCAL

EXPLICIT_SHARE = 0.5
"""Share of an acceleration that a backward step leaves, below which a step must be implicit."""


class Environment(Protocol):
    """What answers a tool with a wrench."""

    def start(self, X_WF: pin.SE3) -> None:
        """Take note of the pose of the tool at time 0."""

    def wrench(self, time: float, X_WF: pin.SE3, V: Twist) -> Wrench:
        """Return the wrench of robot on environment (6) [N, Nm] in the tool frame.

        Args:
            time: time [s].
            X_WF: pose of the tool.
            V: body twist of the tool (6) [m/s, rad/s].
        """

    def impedance(self) -> tuple[Vector, Vector]:
        """Return stiffness (6) [N/m, Nm/rad] and damping (6) [N s/m, Nm s/rad], tool axes.

        Those where it was last asked for a wrench; they decide how a period is integrated.
        """


class CompliantPlant:
    """A robot whose tool meets a compliant environment.

    Classical Runge–Kutta with held torque, or the midpoint rule for a period of at most 0.2 ms.
    Where the environment is too stiff for that, a linearly implicit Euler step: links without
    their rotors are light.

    Attributes:
        energy: energy given to the environment since the start [J], ∫ Fᵀ V dt, integrated with
            the motion.
    """

    def __init__(
        self,
        robot: Robot,
        frame: str,
        environment: Environment,
        *,
        payload: float = 0.0,
        joint_friction: Vector | float = 0.0,
        joint_damping: Vector | float = 0.0,
        model_error: ModelError | None = None,
        armature: Vector | None = None,
        dt: float = 1e-3,
        substeps: int | None = None,
    ) -> None:
        """Bring ``frame`` and the environment together.

        Args:
            robot: the robot as the controller believes it to be.
            frame: name of the frame that meets the environment.
            environment: what answers it.
            payload: point mass [kg] at the frame's origin that the robot's model lacks.
            joint_friction: Coulomb friction of the joints (nv) [Nm or N], which holds them
                exactly while it can; of each joint, or one of all.
            joint_damping: their viscous friction (nv) [Nm s/rad or N s/m], the same.
            model_error: how the true robot differs from the believed one; its payload hangs
                where ``payload`` does.
            armature: the true inertia of the rotors at their joints (nv) [kg m² or kg]; default:
                the robot's. Zero where the motor is simulated apart, behind an elastic gear.
            dt: period [s].
            substeps: integration steps in a period; default: 2, but 1 with the midpoint rule.

        Raises:
            InputError: no such frame, or a number that cannot be used.
        """
        self._frame, self._environment = robot.frame_id(frame), environment
        self._coulomb = non_negative(joint_friction, (robot.nv,), "joint_friction")
        self._joint_damping = non_negative(joint_damping, (robot.nv,), "joint_damping")
        mass = float(non_negative(payload, (), "payload"))
        self._dt = float(positive(dt, (), "dt"))
        self._scheme = choose_scheme(self._dt)
        self._substeps = (1 if self._scheme is MIDPOINT else 2) if substeps is None else substeps
        if self._substeps < 1:
            raise InputError(f"substeps: got {substeps}, need at least 1")
        self._model = true_model(robot, frame, model_error, armature)
        tied = self._model.frames[self._frame]
        if mass > 0:
            load = pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
            self._model.appendBodyToJoint(tied.parentJoint, load, tied.placement)
        self._data = self._model.createData()
        self._time, self._q, self._v = 0.0, np.zeros(robot.nv), np.zeros(robot.nv)
        self._wrench, self.energy, self._implicit = np.zeros(6), 0.0, False
        self._impedance = environment.impedance()

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq); the environment starts there."""
        self._q = finite_array(q, self._v.shape, "q")
        self._time, self._v, self.energy = 0.0, np.zeros_like(self._q), 0.0
        pin.framesForwardKinematics(self._model, self._data, self._q)
        X_WF = self._data.oMf[self._frame].copy()
        self._environment.start(X_WF)
        self._implicit, self._impedance = self._too_stiff(), self._environment.impedance()
        self._wrench = self._environment.wrench(0.0, X_WF, np.zeros(6))
        return self.read()

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period.

        The wrench is that of the start of the period, where the torque was computed.
        """
        self.advance(tau)
        return self.read()

    def advance(self, tau: Vector) -> tuple[Vector, Vector]:
        """Return q (nq) and v (nv) after ``tau`` (nv) [Nm] has acted for one period."""
        h, wrenches, powers = self._dt / self._substeps, [], []
        if self._coulomb.any():
            tau = tau + self._dry_friction(tau)

        def accelerate(time: float, q: Vector, v: Vector) -> Vector:
            a, power, wrench = self._rates(time, q, v, tau)
            wrenches.append(wrench)
            powers.append(power)
            return a

        for i in range(self._substeps):
            t, start = self._time + i * h, (self._q, self._v)
            if not self._implicit:
                self._q, self._v = self._scheme.step(accelerate, t, *start, h)
                if self._is_stiff_now():  # it met a wall that is too stiff for the step just taken
                    (self._q, self._v), powers[:] = start, []
                else:
                    self.energy += self._scheme.integral(powers, h)
            if self._implicit:
                self._v = self._v + h * self._softened(accelerate(t, *start), h)
                self._q = self._q + h * self._v
                self.energy += h * powers[0]
                self._is_stiff_now()
            powers.clear()
        self._time += self._dt
        self._wrench = wrenches[0]
        return self._q, self._v

    def read(self) -> PlantState:
        """Return the state; the wrench is that of the start of the last period."""
        q, v, wrench = self._q.copy(), self._v.copy(), self._wrench
        return PlantState(self._time, q, v, wrench, wrench, touching=bool(wrench.any()))

    def _dry_friction(self, tau: Vector) -> Vector:
        """Return the dry friction of the joints (nv) [Nm or N] in the period to come."""
        a, *_ = self._rates(self._time, self._q, self._v, tau)
        h, mobility = self._dt, pin.computeMinverse(self._model, self._data, self._q)
        if self._implicit:
            a, mobility = self._softened(a, h), self._softened(mobility, h)
        return dry_friction(h * mobility, self._v + h * a, self._coulomb)

    def _is_stiff_now(self) -> bool:
        """Return whether steps are implicit from now on: a wall may have been met or left."""
        if self._scheme is MIDPOINT:
            known, now = self._impedance, self._environment.impedance()
            if any(not np.array_equal(*pair) for pair in zip(known, now, strict=True)):
                self._implicit, self._impedance = self._too_stiff(now), now
        return self._implicit

    def _too_stiff(self, impedance: tuple[Vector, Vector] | None = None) -> bool:
        """Return whether the environment would make an explicit step of the fine scheme grow.

        Args:
            impedance: stiffness and damping (6 each) [N/m, N s/m and so on] of the environment;
                default: those where the tool is.
        """
        h, unit = self._dt / self._substeps, np.eye(len(self._q))
        if self._scheme is not MIDPOINT:
            return False
        self._rates(0.0, self._q, self._v, np.zeros_like(self._q))
        softened = np.array([self._softened(column, h, impedance) for column in unit])
        return bool(np.abs(np.linalg.eigvals(softened)).min() < EXPLICIT_SHARE)

    def _softened(
        self, a: Vector | Matrix, h: float, impedance: tuple[Vector, Vector] | None = None
    ) -> Array:
        """Return (I + h M⁻¹ Jᵀ (D + h K) J)⁻¹ a (nv), where the rates were last taken."""
        K, D = impedance or self._environment.impedance()
        J = pin.getFrameJacobian(self._model, self._data, self._frame, LOCAL).reshape(6, -1)
        M = np.triu(pin.crba(self._model, self._data, self._q))
        M = M + np.triu(M, 1).T
        answer = M + h * (J.T * (D + h * K)).dot(J)
        return np.linalg.solve(answer, M.dot(a))

    def _rates(
        self, time: float, q: Vector, v: Vector, tau: Vector
    ) -> tuple[Vector, float, Wrench]:
        """Return acceleration (nv), power [W] and wrench (6) [N, Nm] on the environment."""
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacement(model, data, self._frame)
        J = pin.getFrameJacobian(model, data, self._frame, LOCAL).reshape(6, -1)
        V = J @ v
        wrench = self._environment.wrench(time, data.oMf[self._frame], V)
        a = pin.aba(model, data, q, v, tau - self._joint_damping * v - J.T @ wrench)
        return a.copy(), float(wrench @ V), wrench
