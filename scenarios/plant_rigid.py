"""The exact rigid plant: M a + h + Jᵀ Aᵀ λ = τ with A V̇ + Ȧ V = v̇_c, integrated.

Dynamics by pinocchio, independent of the controller's expressions; the constraint is the true
one, which need not be what the controller believes.
"""

from collections.abc import Callable, Collection, Mapping

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Vector, Wrench, non_negative, positive
from qpctrl.constraint import Constraint, row_function
from qpctrl.errors import InputError
from qpctrl.evaluator import Evaluator
from qpctrl.robot import Robot
from scenarios.joint_friction import dry_friction
from scenarios.model_error import ModelError, true_model
from scenarios.plant import PlantState
from scenarios.runge_kutta import choose_scheme

LOCAL = pin.ReferenceFrame.LOCAL

SLIP_SPEED = 1e-2
"""Speed [m/s] from which on a point rubs with all of its friction; below, with its share."""


class RigidPlant:
    """A robot whose tool cannot leave its constraint; the wrench is exact at each state.

    Classical Runge–Kutta with held torque, or the midpoint rule for a period of at most 0.2 ms;
    after each period the velocity is projected onto the constraint in the metric M.

    A point contact may rub: the tool drags the environment along its way t with μ λ, so that the
    contact wrench is (Aᵀ + μ t) λ and [M, Jᵀ(Aᵀ + μ t); A J, 0] [a; λ] = rhs. It rubs while it
    pushes and slides: t = v_t / max(‖v_t‖, ε), v_t the velocity of the point along the plane, so
    a point at rest is not held.
    """

    def __init__(
        self,
        robot: Robot,
        constraint: Constraint,
        *,
        environment: Callable[[float], Mapping[str, Array]] | None = None,
        friction: float = 0.0,
        slip_speed: float = SLIP_SPEED,
        joint_friction: Vector | float = 0.0,
        joint_damping: Vector | float = 0.0,
        model_error: ModelError | None = None,
        armature: Vector | None = None,
        dt: float = 1e-3,
    ) -> None:
        """Prepare the plant.

        Args:
            robot: the robot as the controller believes it to be.
            constraint: the true constraint.
            environment: inputs of the constraint by name, as a function of time [s]; those that
                it leaves out keep their defaults. It starts at rest, since the robot does.
            friction: Coulomb friction μ of a point contact [1].
            slip_speed: ε [m/s] of that friction; an explicit step needs more than about
                μ λ dt / (2.5 m) for a contact with mobility 1/m along the plane.
            joint_friction: Coulomb friction of the joints (nv) [Nm or N], which holds them
                exactly while it can; of each joint, or one of all.
            joint_damping: their viscous friction (nv) [Nm s/rad or N s/m], the same.
            model_error: how the true robot differs from the believed one; a payload hangs at the
                origin of the constraint's frame.
            armature: the true inertia of the rotors at their joints (nv) [kg m² or kg]; default:
                the robot's. Zero where the motor is simulated apart, behind an elastic gear.
            dt: period [s].

        Raises:
            InputError: no such frame, a number that cannot be used, or friction of a constraint
                that is not one translation.
        """
        frame = constraint.space.frame
        self._frame = robot.frame_id(frame)
        self._model = true_model(robot, frame, model_error, armature)
        self._data = self._model.createData()
        self._axes = _as_slice(constraint.space.index)
        self._rows = Evaluator(row_function(constraint))
        for name, value in constraint.inputs().items():
            self._rows.inputs[name][...] = value
        self._environment = environment
        self._dt = float(positive(dt, (), "dt"))
        self._scheme = choose_scheme(self._dt)
        unknowns = robot.nv + len(self._rows.outputs["A"])
        self._kkt, self._rhs = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
        self._no_acceleration = np.zeros(robot.nv)
        self._coulomb = non_negative(joint_friction, (robot.nv,), "joint_friction")
        self._viscous = non_negative(joint_damping, (robot.nv,), "joint_damping")
        self._mu = float(non_negative(friction, (), "friction"))
        self._slip_speed = float(positive(slip_speed, (), "slip_speed"))
        self._slip = np.zeros(6)
        if self._mu > 0:
            self.reset(robot.home)
            self._check_point(constraint)
        self.reset(np.zeros(robot.nv))

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq), with no force on the environment."""
        self._time, self._q, self._v = 0.0, np.array(q), np.zeros_like(q)
        self._wrench = np.zeros(6)
        self._moved_to, self._placed_at = np.nan, np.empty(0)
        return self.read()

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period.

        The wrench is that of the start of the period, where the torque was computed.
        """
        self.advance(tau)
        return self.read()

    def advance(self, tau: Vector) -> tuple[Vector, Vector]:
        """Return q (nq) and v (nv) after ``tau`` (nv) [Nm] has acted for one period."""
        wrenches: list[Wrench] = []
        if self._coulomb.any():
            tau = tau + self._dry_friction(tau)

        def accelerate(time: float, q: Vector, v: Vector) -> Vector:
            self._place(time, q)
            a, lam = self._accelerate(q, v, tau)
            if not wrenches:
                wrenches.append(self._wrench_of(lam))
            return a

        self._q, v = self._scheme.step(accelerate, self._time, self._q, self._v, self._dt)
        self._time += self._dt
        self._place(self._time, self._q)
        self._v, self._wrench = self._project(v), wrenches[0]
        return self._q, self._v

    def read(self) -> PlantState:
        """Return the state; the wrench is that of the start of the last period."""
        q, v, wrench = self._q.copy(), self._v.copy(), self._wrench
        return PlantState(self._time, q, v, wrench, wrench, touching=True)

    def _place(self, time: float, q: Vector) -> None:
        """Put the environment where it is at ``time``, and the robot at ``q``; unless they are."""
        if self._environment is not None and time != self._moved_to:
            for name, value in self._environment(time).items():
                self._rows.inputs[name][...] = value
            self._moved_to = time
        if q is not self._placed_at:
            model, data, frame = self._model, self._data, self._frame
            pin.forwardKinematics(model, data, q)
            X_WF = pin.updateFramePlacement(model, data, frame)
            pose = self._rows.inputs
            pose["R_WF"][...], pose["p_WF"][:] = X_WF.rotation, X_WF.translation
            J = pin.computeFrameJacobian(model, data, q, frame, LOCAL)
            self._J = J.reshape(6, -1)  # pinocchio returns a vector for a robot of one joint
            self._M = pin.crba(model, data, q)
            self._placed_at = q

    def _accelerate(self, q: Vector, v: Vector, tau: Vector) -> tuple[Vector, Vector]:
        """Return a (nv) and λ (k) under ``tau`` (nv) from [M (A J)ᵀ; A J 0] [a; λ] = rhs."""
        # below, dot: for matrices as small as these it takes less than half the time of @
        model, data, axes = self._model, self._data, self._axes
        h = pin.nonLinearEffects(model, data, q, v)
        pin.forwardKinematics(model, data, q, v, self._no_acceleration)
        drift = pin.getFrameAcceleration(model, data, self._frame, LOCAL).vector
        A, A_dot_V, _, v_c_dot = self._rows_with(v)
        AJ, n = A.dot(self._J[axes]), len(v)
        kkt, rhs = self._kkt, self._rhs
        kkt[:n, :n], kkt[:n, n:], kkt[n:, :n] = self._M, AJ.T, AJ
        rhs[:n], rhs[n:] = tau - h, v_c_dot - A_dot_V - A.dot(drift[axes])
        if self._viscous.any():
            rhs[:n] -= self._viscous * v
        if self._mu > 0:
            self._slip[:3] = self._mu * self._slip_direction(A[0], self._J[:3].dot(v))
            kkt[:n, n:] += self._J.T.dot(self._slip)[:, np.newaxis]
        found = np.linalg.solve(kkt, rhs)
        if self._mu > 0 and found[n] <= 0:  # it is pulled: no friction
            self._slip[:], kkt[:n, n:] = 0.0, AJ.T
            found = np.linalg.solve(kkt, rhs)
        return found[:n], found[n:]

    def _slip_direction(self, A: Vector, v: Vector) -> Vector:
        """Return t (3) [1] of the contact's only row ``A`` for a point that moves with ``v`` (3).

        It is as long as the row, whose multiplier is the normal force divided by that.
        """
        row = np.zeros(6)
        row[self._axes] = A
        size = float(np.linalg.norm(row))
        normal = row[:3] / size
        v_t = v - normal * normal.dot(v)
        return size / max(float(np.linalg.norm(v_t)), self._slip_speed) * v_t

    def _dry_friction(self, tau: Vector) -> Vector:
        """Return the dry friction of the joints (nv) [Nm or N] in the period to come."""
        self._place(self._time, self._q)
        a, _ = self._accelerate(self._q, self._v, tau)
        mobility = np.linalg.inv(self._kkt)[: len(a), : len(a)]
        return dry_friction(self._dt * mobility, self._v + self._dt * a, self._coulomb)

    def _check_point(self, constraint: Constraint) -> None:
        """Refuse friction, unless the contact's only row is a translation."""
        self._place(self._time, self._q)
        A, *_ = self._rows_with(self._v)
        turning = np.array([axis >= 3 for axis in constraint.space.index])
        if len(A) != 1 or A[:, turning].any():
            raise InputError(
                f"friction: got {self._mu:g} with constraint {constraint.name!r} of {len(A)} "
                f"rows ({', '.join(constraint.row_names)}), need one row that is a translation, "
                "such as PointOnPlane"
            )

    def _project(self, v: Vector) -> Vector:
        """Return the velocity (nv) nearest to ``v`` in the metric M with A J v = v_c."""
        A, _, v_c, _ = self._rows_with(v)
        AJ = A.dot(self._J[self._axes])
        M_inv_rows = np.linalg.solve(self._M, AJ.T)
        return v - M_inv_rows.dot(np.linalg.solve(AJ.dot(M_inv_rows), AJ.dot(v) - v_c))

    def _rows_with(self, v: Vector) -> Collection[Array]:
        """Return A, Ȧ V, v_c, v̇_c where the robot is, moving with ``v`` (nv)."""
        self._rows.inputs["V"][:] = self._J.dot(v)
        self._rows()
        return self._rows.outputs.values()

    def _wrench_of(self, lam: Vector) -> Wrench:
        """Return (Aᵀ + μ t) λ along all six axes."""
        wrench = np.zeros(6)
        wrench[self._axes] = self._rows.outputs["A"].T.dot(lam)
        if self._mu > 0:
            wrench += self._slip * lam[0]
        return wrench


def _as_slice(index: list[int]) -> slice | list[int]:
    """Return neighbouring axes as a slice, which costs less than a list."""
    span = slice(index[0], index[-1] + 1)
    return span if list(range(6))[span] == list(index) else index
