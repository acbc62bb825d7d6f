"""The compliant plant: M a + h + D_q v + Jᵀ F = τ with F from a compliant environment, integrated.

The environment answers the tool's pose and twist with a wrench: springs, a hand, a wall. Dynamics
by pinocchio, independent of the controller's expressions; the plant may carry a payload that
the controller does not know of.
"""

from typing import Protocol

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Twist, Vector, Wrench, finite_array, non_negative, positive
from qpctrl.errors import InputError
from qpctrl.robot import Robot
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
        """Return stiffness (6) [N/m, Nm/rad] and damping (6) [N s/m, Nm s/rad], tool axes."""


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
        joint_damping: float = 0.0,
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
            joint_damping: viscous friction of every joint [Nm s/rad or N s/m] that it lacks too.
            armature: the true inertia of the rotors at their joints (nv) [kg m² or kg]; default:
                the robot's. Zero where the motor is simulated apart, behind an elastic gear.
            dt: period [s].
            substeps: integration steps in a period; default: 2, but 1 with the midpoint rule.

        Raises:
            InputError: no such frame, or a number that cannot be used.
        """
        self._frame, self._environment = robot.frame_id(frame), environment
        self._joint_damping = float(non_negative(joint_damping, (), "joint_damping"))
        mass = float(non_negative(payload, (), "payload"))
        self._dt = float(positive(dt, (), "dt"))
        self._scheme = choose_scheme(self._dt)
        self._substeps = (1 if self._scheme is MIDPOINT else 2) if substeps is None else substeps
        if self._substeps < 1:
            raise InputError(f"substeps: got {substeps}, need at least 1")
        self._model = robot.model.copy()
        if armature is not None:
            self._model.armature = non_negative(armature, (robot.nv,), "armature")
        tied = self._model.frames[self._frame]
        if mass > 0:
            load = pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
            self._model.appendBodyToJoint(tied.parentJoint, load, tied.placement)
        self._data = self._model.createData()
        self._time, self._q, self._v = 0.0, np.zeros(robot.nv), np.zeros(robot.nv)
        self._wrench, self.energy, self._implicit = np.zeros(6), 0.0, False

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq); the environment starts there."""
        self._q = finite_array(q, self._v.shape, "q")
        self._time, self._v, self.energy = 0.0, np.zeros_like(self._q), 0.0
        pin.framesForwardKinematics(self._model, self._data, self._q)
        X_WF = self._data.oMf[self._frame].copy()
        self._environment.start(X_WF)
        self._implicit = self._too_stiff()
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

        def accelerate(time: float, q: Vector, v: Vector) -> Vector:
            a, power, wrench = self._rates(time, q, v, tau)
            wrenches.append(wrench)
            powers.append(power)
            return a

        for i in range(self._substeps):
            t = self._time + i * h
            if self._implicit:
                self._v = self._v + h * self._softened(accelerate(t, self._q, self._v), h)
                self._q = self._q + h * self._v
                self.energy += h * powers[0]
            else:
                self._q, self._v = self._scheme.step(accelerate, t, self._q, self._v, h)
                self.energy += self._scheme.integral(powers, h)
            powers.clear()
        self._time += self._dt
        self._wrench = wrenches[0]
        return self._q, self._v

    def read(self) -> PlantState:
        """Return the state; the wrench is that of the start of the last period."""
        q, v, wrench = self._q.copy(), self._v.copy(), self._wrench
        return PlantState(self._time, q, v, wrench, wrench, touching=bool(wrench.any()))

    def _too_stiff(self) -> bool:
        """Return whether the environment would make an explicit step of the fine scheme grow."""
        h, unit = self._dt / self._substeps, np.eye(len(self._q))
        if self._scheme is not MIDPOINT:
            return False
        self._rates(0.0, self._q, self._v, np.zeros_like(self._q))
        softened = np.array([self._softened(column, h) for column in unit])
        return bool(np.abs(np.linalg.eigvals(softened)).min() < EXPLICIT_SHARE)

    def _softened(self, a: Vector, h: float) -> Vector:
        """Return (I + h M⁻¹ Jᵀ (D + h K) J)⁻¹ a (nv), where the rates were last taken."""
        K, D = self._environment.impedance()
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
