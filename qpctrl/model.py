"""The shared expressions of one mode: dynamics, spaces, constraint splits, objectives."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeVar

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl import limit
from qpctrl.arrays import Array
from qpctrl.constraint import PfaffianRows
from qpctrl.contact import WrenchRows
from qpctrl.dynamics import Dynamics, coordinates
from qpctrl.errors import InputError
from qpctrl.factor import Factor
from qpctrl.law import Split
from qpctrl.layout import Layout
from qpctrl.mode import Mode
from qpctrl.objective import (
    ForceObjective,
    GraspObjective,
    GraspTask,
    MotionObjective,
    Scene,
    Task,
    TaskExpressions,
)
from qpctrl.robot import Robot
from qpctrl.space import (
    FrameMotion,
    SpaceTerms,
    TaskSpace,
    terms_at_home,
    terms_here,
)
from qpctrl.spatial import SX, SymbolicPose

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class WrittenTask:
    """A task with its weight, its priority and its expressions."""

    task: Task
    weight: SX
    priority: int
    written: TaskExpressions


class ModeModel:
    """Everything that the QP and the closed forms of one mode are made from.

    Attributes:
        inputs, memory: layouts of the packed arguments ``u`` and ``x``.
        u_vector, x_vector: those arguments; ``u`` holds the named inputs.
        dynamics: dynamics at (q, v).
        spaces, splits: terms and constraint split of each task space.
        AJ: constraint rows on joint acceleration (k×nv), all spaces stacked.
        tasks: the tasks, written out.
        h: bias with known external wrenches (nv) [Nm].
        M_N: M − JᵀΛJ (nv×nv), the inertia left when all task spaces are taken; undamped it
            is NᵀM = NᵀMN. With the metric of home a constant (`qpctrl.objective`).
    """

    def __init__(self, robot: Robot, mode: Mode) -> None:
        self.robot, self.mode = robot, mode
        self.inputs = Layout(_input_defaults(robot, mode))
        self.memory = Layout(_memory_defaults(mode))
        self.u_vector, self.u = self.inputs.symbols("u")
        self.x_vector, self._x = self.memory.symbols("x")
        self.dynamics = Dynamics(robot)
        self.spaces = self._terms()
        self.splits = {space: self._split(space) for space in self.spaces}
        rows = (split.A @ self.spaces[space].J for space, split in self.splits.items())
        self.AJ = ca.vertcat(ca.SX(0, robot.nv), *rows)
        self.tasks = [
            WrittenTask(
                task=task,
                weight=self.u[f"{task.name}.weight"],
                priority=priority,
                written=self._write(task),
            )
            for task, _, priority in mode.tasks
        ]
        self._check_forces()
        self.h = self.dynamics.h
        for item in self.tasks:
            objective, space = item.written.objective, item.task.space
            if isinstance(objective, ForceObjective) and space is None:
                raise InputError(f"mode {mode.name!r}: a force task needs a task space")
            outside = None
            if isinstance(objective, MotionObjective | ForceObjective):
                outside = objective.F_ext
            if space is not None and outside is not None:
                self.h = self.h + self.spaces[space].J.T @ outside
        self.M_N = self._null_space_inertia()

    @cached_property
    def M_factor(self) -> Factor:
        """Factors of the mass matrix."""
        return Factor(self.dynamics.M)

    def of(self, kind: type[T]) -> list[tuple[T, TaskSpace | None]]:
        """Return the objectives of one kind, each with its task space."""
        return [
            (item.written.objective, item.task.space)
            for item in self.tasks
            if isinstance(item.written.objective, kind)
        ]

    def memory_after(self) -> SX:
        """Return the packed memory after this tick."""
        return self.memory.pack(
            {
                f"{item.task.name}.{key}": value
                for item in self.tasks
                for key, value in item.written.memory.items()
            }
        )

    def contact_rows(self, space: TaskSpace) -> WrenchRows:
        """Return the limits on the multipliers λ of ``space``: rows (m×k) and their bounds."""
        A, motion = self.splits[space].A, self.spaces[space].motion
        rows = [
            limit.rows(motion, _named(self.u, limit.name))
            for limit in self.mode.contact_limits
            if limit.space == space
        ]
        W = ca.vertcat(ca.SX(0, space.n), *(part.W for part in rows))
        return WrenchRows(W @ A.T, ca.vertcat(ca.SX(0, 1), *(part.ub for part in rows)))

    def _terms(self) -> dict[TaskSpace, SpaceTerms]:
        spaces = _spaces(self.mode)
        if self.mode.metric == "inertia":
            return {s: terms_here(s, self.dynamics, self.M_factor, self.u["mu"]) for s in spaces}
        return terms_at_home(spaces, self.dynamics, self.robot.home)

    def _split(self, space: TaskSpace) -> Split:
        terms = self.spaces[space]
        rows = [
            constraint.rows(terms.motion, _named(self.u, constraint.name))
            for constraint in self.mode.constraints
            if constraint.space == space
        ]
        none = ca.SX(0, 1)
        empty = PfaffianRows(ca.SX(0, space.n), none, none, none)
        stacked = (ca.vertcat(*parts) for parts in zip(empty, *rows, strict=True))
        return Split(PfaffianRows(*stacked), terms.Lambda_inv)

    def _write(self, task: Task) -> TaskExpressions:
        split = self.splits[task.space] if task.space else None
        nowhere = FrameMotion(
            TaskSpace("none"), SymbolicPose(ca.SX(3, 3), ca.SX(3, 1)), ca.SX(6, 1)
        )
        scene = Scene(
            q=self.dynamics.q,
            v=self.dynamics.v,
            dt=self.u["dt"],
            freeze=self.u["freeze"],
            mass=ca.SX(pin.computeTotalMass(self.robot.model)),
            coordinates=partial(coordinates, self.robot),
            motion=self.spaces[task.space].motion if task.space else nowhere,
            motions={space: terms.motion for space, terms in self.spaces.items()},
            A=split.A if split else ca.SX(0, 0),
            v_c=split.v_c if split else ca.SX(0, 1),
            S=split.S if split else ca.SX(0, 0),
            Lambda_inv=self.spaces[task.space].Lambda_inv if task.space else ca.SX(0, 0),
        )
        return task.objective(scene, _named(self.u, task.name), _named(self._x, task.name))

    def _check_forces(self) -> None:
        forced = [space for _, space in self.of(ForceObjective)]
        if len(set(forced)) < len(forced):
            raise InputError(f"mode {self.mode.name!r}: two force tasks on one task space")
        forced += [space for grasp, _ in self.of(GraspObjective) for space in grasp.E]
        for constraint in self.mode.constraints:
            if constraint.space not in forced:
                raise InputError(
                    f"constraint {constraint.name!r} has no force task on its task space; "
                    "add one (a zero reference keeps the contact light)"
                )

    def _null_space_inertia(self) -> SX:
        nv = self.robot.nv
        if self.mode.metric == "home":
            return _inertia_of_joints(self.robot, self.dynamics)
        spaces = list(self.spaces.values())
        if len(spaces) == 1:
            return self.dynamics.M - spaces[0].task_inertia
        if sum(terms.space.n for terms in spaces) > nv:
            return ca.SX.zeros(nv, nv)
        J = ca.vertcat(ca.SX(0, nv), *(terms.J for terms in spaces))
        mobility = self.M_factor.congruence(J.T) + self.u["mu"] * ca.SX.eye(J.shape[0])
        return self.dynamics.M - Factor(mobility).congruence(J)


def _inertia_of_joints(robot: Robot, dynamics: Dynamics) -> SX:
    """Return M(home) without the rows and columns of floating bodies (nv×nv)."""
    M = np.array(ca.Function("M", [dynamics.q], [ca.densify(dynamics.M)])(robot.home))
    single = np.array([at is not None for at in robot.coordinates])
    return ca.sparsify(ca.SX(np.where(np.outer(single, single), M, 0.0)))


def _spaces(mode: Mode) -> tuple[TaskSpace, ...]:
    spaces = [task.space for task, _, _ in mode.tasks if task.space is not None]
    for task, _, _ in mode.tasks:
        spaces += task.contacts if isinstance(task, GraspTask) else ()
    spaces += [constraint.space for constraint in mode.constraints]
    return tuple(dict.fromkeys(spaces))


def _input_defaults(robot: Robot, mode: Mode) -> dict[str, Array]:
    defaults = {"dt": np.array(1e-3), "freeze": np.array(0.0), "mu": np.array(0.0)}
    defaults |= {f"limits.{key}": value for key, value in limit.inputs(robot).items()}
    for task, weight, _ in mode.tasks:
        defaults[f"{task.name}.weight"] = np.array(weight)
        defaults |= {f"{task.name}.{key}": value for key, value in task.inputs().items()}
    if mode.slack is not None:
        defaults["slack.weight"] = np.array(mode.slack)
    for constraint in mode.constraints:
        defaults |= {f"{constraint.name}.{key}": v for key, v in constraint.inputs().items()}
    for contact in mode.contact_limits:
        defaults |= {f"{contact.name}.{key}": value for key, value in contact.inputs().items()}
    return defaults


def _memory_defaults(mode: Mode) -> dict[str, Array]:
    return {
        f"{task.name}.{key}": value
        for task, _, _ in mode.tasks
        for key, value in task.memory().items()
    }


def _named(arrays: Mapping[str, SX], name: str) -> dict[str, SX]:
    prefix = f"{name}."
    return {key[len(prefix) :]: value for key, value in arrays.items() if key.startswith(prefix)}
