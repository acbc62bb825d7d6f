"""The exact rigid plant: M a + h + Jᵀ Aᵀ λ = τ with A V̇ + Ȧ V = v̇_c, integrated.

Dynamics by pinocchio, independent of the controller's expressions; the constraint is the true
one, which need not be what the controller believes.
"""

from collections.abc import Callable, Mapping

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Matrix, Vector, Wrench
from qpctrl.constraint import Constraint, row_function
from qpctrl.evaluator import Evaluator
from qpctrl.robot import Robot
from scenarios.plant import PlantState
from scenarios.runge_kutta import runge_kutta


class RigidPlant:
    """A robot whose tool cannot leave its constraint; the wrench is exact at each state.

    Classical Runge–Kutta with held torque; after each period the velocity is projected onto
    the constraint in the metric M.
    """

    def __init__(
        self,
        robot: Robot,
        constraint: Constraint,
        *,
        environment: Callable[[float], Mapping[str, Array]] | None = None,
        dt: float = 1e-3,
    ) -> None:
        """Prepare the plant.

        Args:
            robot: the true robot.
            constraint: the true constraint.
            environment: inputs of the constraint by name, as a function of time [s]; those that
                it leaves out keep their defaults. It starts at rest, since the robot does.
            dt: period [s].
        """
        self._model, self._data = robot.model, robot.model.createData()
        self._frame, self._index = robot.frame_id(constraint.space.frame), constraint.space.index
        self._rows = Evaluator(row_function(constraint))
        for name, value in constraint.inputs().items():
            self._rows.inputs[name][...] = value
        self._environment = environment
        self._dt = dt
        self._time = 0.0
        self._q, self._v = np.zeros(robot.nv), np.zeros(robot.nv)

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq), with no force on the environment."""
        self._time, self._q, self._v = 0.0, np.array(q), np.zeros_like(q)
        self._move_environment(self._time)
        return self._state(np.zeros(6))

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period.

        The wrench is that of the start of the period, where the torque was computed.
        """
        wrenches: list[Wrench] = []

        def accelerate(time: float, q: Vector, v: Vector) -> Vector:
            self._move_environment(time)
            a, wrench = self.accelerate(q, v, tau)
            wrenches.append(wrench)
            return a

        self._q, v = runge_kutta(accelerate, self._time, self._q, self._v, self._dt)
        self._v = self._project(self._q, v)
        self._time += self._dt
        return self._state(wrenches[0])

    def _move_environment(self, time: float) -> None:
        if self._environment is not None:
            for name, value in self._environment(time).items():
                self._rows.inputs[name][...] = value

    def accelerate(self, q: Vector, v: Vector, tau: Vector) -> tuple[Vector, Vector]:
        """Return acceleration (nv) and wrench on the environment (6) [N, Nm] under ``tau``.

        The environment is where it was last put.
        """
        M, h, J, drift, A, A_dot_V, _, v_c_dot = self._terms(q, v)
        AJ = A @ J
        k = len(A)
        kkt = np.block([[M, AJ.T], [AJ, np.zeros((k, k))]])
        rhs = np.concatenate([tau - h, v_c_dot - A_dot_V - A @ drift])
        found = np.linalg.solve(kkt, rhs)
        wrench = np.zeros(6)
        wrench[self._index] = A.T @ found[len(M) :]
        return found[: len(M)], wrench

    def _project(self, q: Vector, v: Vector) -> Vector:
        M, _, J, _, A, _, v_c, _ = self._terms(q, v)
        AJ = A @ J
        M_inv_rows = np.linalg.solve(M, AJ.T)
        return v - M_inv_rows @ np.linalg.solve(AJ @ M_inv_rows, AJ @ v - v_c)

    def _terms(self, q: Vector, v: Vector) -> tuple[Matrix, ...]:
        model, data, local = self._model, self._data, pin.ReferenceFrame.LOCAL
        upper = np.triu(pin.crba(model, data, q))
        M = upper + np.triu(upper, 1).T
        h = pin.nonLinearEffects(model, data, q, v).copy()
        J = pin.computeFrameJacobian(model, data, q, self._frame, local).reshape(6, -1)
        pin.forwardKinematics(model, data, q, v, np.zeros_like(v))
        drift = pin.getFrameAcceleration(model, data, self._frame, local).vector
        pin.updateFramePlacement(model, data, self._frame)
        X_WF = data.oMf[self._frame]
        rows = self._rows
        rows.inputs["R_WF"][...], rows.inputs["p_WF"][:] = X_WF.rotation, X_WF.translation
        rows.inputs["V"][:] = J @ v
        rows()
        return M, h, J[self._index], drift[self._index], *rows.outputs.values()

    def _state(self, wrench: Vector) -> PlantState:
        return PlantState(self._time, self._q.copy(), self._v.copy(), wrench, wrench, touching=True)
