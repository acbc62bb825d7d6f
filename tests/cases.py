"""The tables that the tests multiply: robots, constraints, weights, solvers, states.

Robots are pinocchio chains made here from a seed, so no test depends on a model file.
"""

import functools
import itertools
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from oracles import body_terms

from qpctrl import (
    Command,
    Controller,
    FaceOnPlane,
    Measurement,
    Memory,
    Mode,
    Pfaffian,
    Robot,
    TaskSpace,
    TickReport,
    Weighted,
    from_pinocchio,
)
from qpctrl.compiler import COMPILERS
from qpctrl.memory import remember
from qpctrl.objective import (
    ForceObjective,
    MotionObjective,
    PostureObjective,
    Scene,
    TaskExpressions,
)
from qpctrl.solver import solver_names
from qpctrl.spatial import AXES

UNLIMITED_RATE = 1e9  # Nm/s; random states follow each other faster than any motor

WELL_CONDITIONED = 3e3
"""Largest condition number of Λ among the random states: equality of QP and closed form is
claimed away from singularities, and 1e-8 leaves 1e-16 · cond² · 10 of room."""

LAW_AGREEMENT = 1e-8
"""Promised relative agreement of QP and closed form."""

ROUND_OFF = 1e-10
"""Two double-precision evaluations of one formula, entries of order 1 to 100."""


class Given(dict[str, Any]):
    """A reference: any inputs by name."""

    @property
    def arrays(self) -> Mapping[str, np.ndarray]:
        """Themselves."""
        return self


# Robots ------------------------------------------------------------------------------------


def planar_2r(m1: float = 1.0, m2: float = 1.0, L: float = 1.0, gravity: float = 9.81) -> Robot:
    """Return the textbook's planar arm: point masses at the ends of two links of length L."""
    model = pin.Model()
    model.name = "planar_2r"
    model.gravity.linear = np.array([0.0, -gravity, 0.0])
    elbow = pin.SE3(np.eye(3), np.array([L, 0.0, 0.0]))
    for name, mass, place in (("shoulder", m1, pin.SE3.Identity()), ("elbow", m2, elbow)):
        joint = model.addJoint(model.njoints - 1, pin.JointModelRZ(), place, name)
        model.appendBodyToJoint(
            joint, pin.Inertia(mass, elbow.translation, np.zeros((3, 3))), pin.SE3.Identity()
        )
    return _with_tool(model, elbow, home=np.array([0.4, 0.9]))


def point_mass(m: float = 5.0) -> Robot:
    """Return a point that slides along x and y, as a hand that holds a door handle."""
    model = pin.Model()
    model.name = "point"
    model.gravity.linear = np.zeros(3)
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.addJoint(1, pin.JointModelPY(), pin.SE3.Identity(), "y")
    model.appendBodyToJoint(2, pin.Inertia(m, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    return _with_tool(model, pin.SE3.Identity(), home=np.zeros(2))


def chain(
    joints: int, seed: int, prismatic: tuple[int, ...] = (), parents: tuple[int, ...] = ()
) -> Robot:
    """Return an arm with skew axes, full inertias, armature and a turned tool frame.

    ``parents`` makes it a tree: the joint (from 1; 0 is the world) that carries each joint.
    """
    rng = np.random.default_rng(seed)
    model = pin.Model()
    model.name = f"chain_{joints}"
    for i in range(joints):
        axis = _unit(rng)
        place = pin.SE3(_rotation(rng), 0.3 * _unit(rng))
        kind = (
            pin.JointModelPrismaticUnaligned if i in prismatic else pin.JointModelRevoluteUnaligned
        )
        parent = parents[i] if parents else i
        joint = model.addJoint(parent, kind(axis), place, f"joint{i + 1}")
        mass = 4.0 / (i + 1)
        turned = _rotation(rng)
        moments = turned @ np.diag(mass * np.array([0.012, 0.01, 0.006])) @ turned.T
        inertia = pin.Inertia(mass, 0.1 * rng.normal(size=3), moments)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.armature = rng.uniform(0.05, 0.2, joints)
    home = rng.uniform(-1, 1, joints)
    return _with_tool(model, pin.SE3(_rotation(rng), 0.2 * _unit(rng)), home)


def _with_tool(model: pin.Model, place: pin.SE3, home: np.ndarray) -> Robot:
    last = model.njoints - 1
    model.addFrame(pin.Frame("tool", last, 0, place, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit = np.full(model.nq, -np.inf)
    model.upperPositionLimit = np.full(model.nq, np.inf)
    model.upperEffortLimit = np.zeros(model.nv)  # no limit
    model.upperVelocityLimit = np.zeros(model.nv)
    return from_pinocchio(model, home=home, tau_rate=UNLIMITED_RATE)


def _unit(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis)


def _rotation(rng: np.random.Generator) -> np.ndarray:
    return pin.exp3(rng.uniform(0, 3) * _unit(rng))


PLANE_AXES = ("vx", "vy")

ROBOTS: dict[str, Callable[[], Robot]] = {
    "planar_2r": functools.cache(planar_2r),
    "arm_6": functools.cache(functools.partial(chain, 6, seed=6)),
    "arm_7": functools.cache(functools.partial(chain, 7, seed=7)),
}
SPACES = {
    "planar_2r": TaskSpace("tool", PLANE_AXES),
    "arm_6": TaskSpace("tool"),
    "arm_7": TaskSpace("tool"),
}
DYNAMICS: dict[str, Callable[[], Robot]] = {
    **ROBOTS,
    "tree": functools.cache(functools.partial(chain, 6, seed=26, parents=(0, 1, 2, 1, 4, 4))),
    "with_sliders": functools.cache(functools.partial(chain, 6, seed=16, prismatic=(1, 4))),
}

ROWS = [
    *(("planar_2r", k) for k in (0, 1, 2)),
    *itertools.product(("arm_6", "arm_7"), (0, 1, 3, 5, 6)),
]
"""Robots and their numbers of constraint rows k."""

needs_compiler = pytest.mark.skipif(
    not any(shutil.which(name) for name in COMPILERS), reason="needs a C compiler on PATH"
)

SOLVERS = solver_names()

SOLVER_FORMS = [
    (solver, form)
    for solver, form in itertools.product(SOLVERS, ("reduced", "full"))
    if (solver, form) != ("quadprog", "full")  # needs H ≻ 0, and τ costs nothing
]

WEIGHTS = [
    {"motion": 1.0, "force": 1.0, "posture": 1.0},
    {"motion": 30.0, "force": 0.05, "posture": 1.0},
    {"motion": 0.02, "force": 5.0, "posture": 0.5},
    {"motion": 1.0, "force": 100.0, "posture": 0.01},
]


# States ------------------------------------------------------------------------------------


class State(NamedTuple):
    """A random state, and the generator to draw the rest of the tick from."""

    q: np.ndarray
    v: np.ndarray
    rng: np.random.Generator


def states(robot: Robot, space: TaskSpace, count: int, seed: int = 1) -> Iterator[State]:
    """Yield random states with a well-conditioned Λ."""
    rng = np.random.default_rng(seed)
    while count:
        q, v = rng.uniform(-3, 3, robot.nv), rng.normal(size=robot.nv)
        terms = body_terms(robot.model, q, v, space.frame, space.index)
        if np.linalg.cond(terms.Lambda) < WELL_CONDITIONED:
            count -= 1
            yield State(q, v, rng)


# Tasks whose command is given, so that the law and the QP are tested apart from qpctrl's tasks


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenTask:
    """A task whose objective is what the reference names: a_cmd, or F_cmd and F_ext, or a_post."""

    name: str
    kind: type[MotionObjective] | type[ForceObjective] | type[PostureObjective]
    size: int
    space: TaskSpace | None = None
    needs_reference: bool = False

    def inputs(self) -> dict[str, np.ndarray]:
        """Return zero for each part of the objective."""
        return {part: np.zeros(self.size) for part in self.kind._fields}

    def memory(self) -> dict[str, np.ndarray]:
        """Return nothing."""
        return {}

    def objective(self, scene: Scene, u: Mapping[str, ca.SX], memory: Any) -> TaskExpressions:
        """Return the inputs as they are."""
        return TaskExpressions(self.kind(*(u[part] for part in self.kind._fields)), {}, {})


# Modes and ticks ---------------------------------------------------------------------------


def given_mode(
    robot: Robot, space: TaskSpace, k: int, *, one_sided: bool = False, name: str = "contact"
) -> Mode:
    """Return a mode with given commands and k given Pfaffian rows."""
    tasks = (
        GivenTask(name="motion", kind=MotionObjective, size=space.n, space=space),
        GivenTask(name="force", kind=ForceObjective, size=space.n, space=space),
        GivenTask(name="posture", kind=PostureObjective, size=robot.nv),
    )
    A = np.eye(space.n)[:k]
    rows = (Pfaffian(space=space, A=A, one_sided=one_sided),) if k else ()
    return Mode(name=name, tasks=tuple(Weighted(task) for task in tasks), constraints=rows)


@functools.cache
def given_controller(
    name: str, k: int, form: str = "reduced", solver: str = "proxsuite", one_sided: bool = False
) -> Controller:
    """Return the controller of `given_mode`; shared, as its memory lives outside it."""
    robot, space = ROBOTS[name](), SPACES[name]
    mode = given_mode(robot, space, k, one_sided=one_sided)
    return Controller(robot, [mode], form=form, solver=solver)


class Draw(NamedTuple):
    """Random commands and rows of one tick."""

    A: np.ndarray
    A_dot_V: np.ndarray
    v_c_dot: np.ndarray
    a_cmd: np.ndarray
    F_cmd: np.ndarray
    F_ext: np.ndarray
    a_post: np.ndarray

    def references(self, weights: Mapping[str, float] | None = None) -> dict[str, Given]:
        """Return them as references for the tasks and rows of `given_mode`."""
        found = {
            "motion": Given(a_cmd=self.a_cmd),
            "force": Given(F_cmd=self.F_cmd, F_ext=self.F_ext),
            "posture": Given(a_post=self.a_post),
        }
        for task, weight in (weights or WEIGHTS[0]).items():
            found[task]["weight"] = np.array(weight)
        if len(self.A):
            found["pfaffian"] = Given(A=self.A, A_dot_V=self.A_dot_V, v_c_dot=self.v_c_dot)
        return found


def random_rows(rng: np.random.Generator, k: int, n: int) -> np.ndarray:
    """Return k rows in general position with a condition number of at most 16, as contacts have.

    Rows near to dependent ones ask for multipliers of 1e4, whose residual in double precision
    is above the promised 1e-9.
    """
    left, right = (np.linalg.qr(rng.normal(size=(m, m)))[0] for m in (k, n))
    return left @ (rng.uniform(0.5, 2, (k, 1)) * right[:k])


def draw(rng: np.random.Generator, k: int, n: int, nv: int) -> Draw:
    """Return commands of every kind, none of them zero, and k rows that move and turn."""
    return Draw(
        A=random_rows(rng, k, n),
        A_dot_V=rng.normal(size=k),
        v_c_dot=rng.normal(size=k),
        a_cmd=rng.normal(size=n),
        F_cmd=10 * rng.normal(size=n),
        F_ext=rng.normal(size=n),
        a_post=rng.normal(size=nv),
    )


def tick(
    controller: Controller,
    q: np.ndarray,
    v: np.ndarray,
    references: Mapping[str, Any],
    *,
    tau_last: np.ndarray | None = None,
) -> tuple[Command, TickReport, Memory]:
    """Run one tick of the controller's first mode from a fresh memory."""
    mode = next(iter(controller.engines))
    memory = controller.start(mode, q)
    if tau_last is not None:
        memory = remember(mode, tau_last, memory.q, memory.x)
    return controller.step(mode, Measurement(0.0, q, v), references, memory)


def random_rotation(seed: int) -> np.ndarray:
    """Return a rotation in general position."""
    return _rotation(np.random.default_rng(seed))


def board(space: TaskSpace, seed: int = 3) -> FaceOnPlane:
    """Return a plane in general position."""
    assert space.axes == AXES
    return FaceOnPlane(space=space, R_WE=random_rotation(seed))
