"""The random states of one line of the equivalence table."""

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Matrix, Vector
from qpctrl.certificate import KKT_TOLERANCE
from qpctrl.compiled import CompileMode
from qpctrl.constraint import Pfaffian
from qpctrl.engine import Engine
from qpctrl.limit import UNBOUNDED
from qpctrl.memory import Measurement, remember
from qpctrl.mode import Mode
from qpctrl.native_tick import NativeTick
from qpctrl.objective import Weighted
from qpctrl.polish import Polish
from qpctrl.report import TickReport
from qpctrl.robot import Robot
from qpctrl.solver import make_solver
from qpctrl.space import TaskSpace
from qpctrl.status import Status
from qpctrl.tick import build_tick
from scenarios.equivalence import Case, Row
from scenarios.robot_file import load_robot
from tasks import ForceReference, ForceTask, MotionReference, MotionTask, PostureTask

WORST = (
    *("law_gap", "own_gap", "curvature_gap", "textbook_gap"),
    *("kkt", "overshoot", "solver_gap", "compiled_gap"),
)
"""Figures of a row that are the largest over its states."""


class Comparison:
    """The engine of one case, and what has been seen so far."""

    def __init__(
        self,
        case: Case,
        solver: str,
        second: str,
        form: str,
        compiled: CompileMode,
        seed: int,
    ) -> None:
        self._case, self._rng = case, np.random.default_rng([seed, case.k, len(case.robot)])
        self._robot = load_robot(case.robot)
        self._space = TaskSpace("flange", case.axes)
        tick = build_tick(self._robot, _mode(self._robot, self._space, case.k), form)

        def engine(compile: CompileMode) -> Engine:
            return Engine(
                self._robot,
                tick,
                solver=make_solver(solver),
                dt=1e-3,
                law="qp",
                tolerance=KKT_TOLERANCE,
                compile=compile,
            )

        self._engine = engine(compiled)
        compiled_tick = isinstance(self._engine.runner, NativeTick)
        self._interpreted = engine("no") if compiled_tick else None
        self._second, self._form = make_solver(second), form
        self._polish = Polish(*(len(self._engine.terms[name]) for name in ("g", "b", "lb")))
        self._worst = dict.fromkeys(WORST, 0.0)
        if not compiled_tick:
            del self._worst["compiled_gap"]
        self._limited = self._damped = self._unsolved = 0

    def run(self, states: int, watch: Callable[[Case, int], None] | None) -> Row:
        """Return the row of that many random states."""
        for i in range(states):
            self._state()
            if watch is not None and i % 50 == 49:
                watch(self._case, i + 1)
        return Row(
            robot=self._case.robot,
            k=self._case.k,
            states=states,
            limited=self._limited,
            damped=self._damped,
            unsolved=self._unsolved,
            **self._worst,
        )

    def _state(self) -> None:
        q, v = self._draw(self._engine)
        free = self._solve(q, v)
        if free is None:
            return
        if free.damping:
            self._damped += 1
            return
        self._note("law_gap", free.law_gap)
        self._note("own_gap", free.solver_gap)
        self._note("textbook_gap", free.textbook_gap)
        self._note("kkt", free.kkt_residual)
        apart = free.tau_textbook - free.tau_qp - self._curvature(q)
        self._note("curvature_gap", np.abs(apart).max() / np.abs(free.tau_qp).max())
        limit = np.abs(self._feasible_torque()) * 1.02 + 0.01
        self._engine.inputs["limits.tau_max"][:] = limit
        ours = self._solve(q, v)
        if ours is None:
            return
        self._note("kkt", ours.kkt_residual)
        self._note("overshoot", float((np.abs(ours.tau_qp) - limit).max()))
        terms = self._engine.terms
        T = terms["C"][: self._robot.nu]
        found = self._second.solve(self._engine.qp)
        if self._form == "full":  # no cost on τ: a solver's own regularisation shows there
            found = self._polish.on_active_set(self._engine.qp, found)
        theirs = T @ found.x + terms["t"]
        self._note("solver_gap", np.abs(ours.tau_qp - theirs).max() / np.abs(theirs).max())
        self._limited += ours.saturated

    def _solve(self, q: Vector, v: Vector) -> TickReport | None:
        engine = self._engine
        x = engine.tick.memory.vector()
        rest = remember("compare", np.zeros(self._robot.nu), q, x)
        seen = Measurement(0.0, q, v)
        found = engine.quick(seen, {}, rest._replace(time=-1.0)) if engine.quick else 0
        _, report, _ = engine.step(seen, {}, rest) if isinstance(found, int) else found
        if report.status is not Status.OK:
            self._unsolved += 1
            return None
        if self._interpreted is not None and not report.damping:
            for name, value in engine.inputs.items():
                self._interpreted.inputs[name][...] = value
            _, again, _ = self._interpreted.step(Measurement(0.0, q, v), {}, rest)
            gap = np.abs(report.tau_qp - again.tau_qp).max() / np.abs(report.tau_qp).max()
            self._note("compiled_gap", gap)
        return report

    def _note(self, name: str, value: float) -> None:
        value = float(value)
        worst = self._worst[name]
        self._worst[name] = value if not value <= worst else worst  # a NaN stays

    def _draw(self, engine: Engine) -> tuple[Vector, Vector]:
        rng, u, n, k = self._rng, engine.inputs, self._space.n, self._case.k
        limits = self._robot.limits
        q = rng.uniform(np.maximum(limits.q_min, -np.pi), np.minimum(limits.q_max, np.pi))
        v = rng.normal(size=self._robot.nv) * 0.5
        for name in ("tau_max", "tau_rate", "tau_stall", "q_max", "v_max"):
            u[f"limits.{name}"][:] = UNBOUNDED
        u["limits.q_min"][:] = -UNBOUNDED
        X_WD = self._robot.pose(q, "flange") * pin.exp6(pin.Motion(rng.normal(size=6) * 0.05))
        motion = MotionReference(
            X_WD=X_WD, V_des=rng.normal(size=6) * 0.3, V_dot_des=rng.normal(size=6)
        )
        force = ForceReference(F_ref=rng.normal(size=n) * 10, F_meas=rng.normal(size=n) * 10)
        values = {f"motion.{key}": value for key, value in motion.arrays.items()}
        values |= {f"force.{key}": value for key, value in force.arrays.items()}
        values |= {
            f"{task}.weight": 10.0 ** rng.uniform(-2, 2) for task in ("motion", "force", "posture")
        }
        if k:
            values |= {"environment.A": _rows(rng, k, n)}
            values |= {"environment.A_dot_V": rng.normal(size=k)}
            values |= {"environment.v_c_dot": rng.normal(size=k)}
        for name, value in values.items():
            u[name][...] = value
        return q, v

    def _curvature(self, q: Vector) -> Vector:
        """Return Jᵀ Aᵀ S⁻¹ (Ȧ V − v̇_c) (nv) [Nm] from pinocchio and numpy alone."""
        u, model = self._engine.inputs, self._robot.model
        if not self._case.k:
            return np.zeros(self._robot.nv)
        data = model.createData()
        upper = np.triu(pin.crba(model, data, q))
        frame = self._robot.frame_id("flange")
        J = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL)
        AJ = u["environment.A"] @ J[self._space.index]
        S = AJ @ np.linalg.solve(upper + np.triu(upper, 1).T, AJ.T)
        return AJ.T @ np.linalg.solve(S, u["environment.A_dot_V"] - u["environment.v_c_dot"])

    def _feasible_torque(self) -> Vector:
        """Return a torque (nu) [Nm] that satisfies the constraints but is not the best one."""
        terms, rng = self._engine.terms, self._rng
        x = terms["x_law"]
        rows = terms["A"]
        step = rng.normal(size=len(x)) * (0.3 * np.abs(x) + 0.1)
        if len(rows):
            step -= np.linalg.pinv(rows) @ (rows @ step)
        return terms["C"][: self._robot.nu] @ (x + step) + terms["t"]


def _rows(rng: np.random.Generator, k: int, n: int) -> Matrix:
    """Return random rows (k×n) with singular values between 0.5 and 2."""
    left, _, right = np.linalg.svd(rng.normal(size=(k, n)), full_matrices=False)
    return left @ np.diag(rng.uniform(0.5, 2.0, size=k)) @ right


def _mode(robot: Robot, space: TaskSpace, k: int) -> Mode:
    tasks = (
        Weighted(MotionTask(space=space, K_p=100.0, K_i=5.0, K_d=20.0)),
        Weighted(ForceTask(space=space, K_fp=0.3, K_fi=5.0, damping=3.0, ramp=1e6)),
        Weighted(PostureTask(q_ref=robot.home)),
    )
    if not k:
        return Mode(name="compare", tasks=(tasks[0], tasks[2], tasks[1]))
    rows = Pfaffian(space=space, A=np.eye(space.n)[:k], name="environment")
    return Mode(name="compare", tasks=tasks, constraints=(rows,))
