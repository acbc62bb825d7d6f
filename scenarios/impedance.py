"""Impedance control in six directions: a hand pushes the arm, which answers as mass-spring-damper.

Without the mass term the hand feels the arm's own inertia Λ; with it, the virtual one.
Source: LynchPark2017 §11.7.1.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Matrix, positive
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Reference, Weighted
from qpctrl.robot import Robot
from scenarios.guided import DT, FLANGE, arm_at_home
from scenarios.metric import column, tick_metrics, whole_run_metrics
from scenarios.panel import Panel
from scenarios.plant import PlantState
from scenarios.push import (
    Pushes,
    answer_gap,
    displacement,
    inertia_at_home,
    linear_answer,
    push_panels,
    pushed,
    static_gap,
)
from scenarios.robot_file import load_robot
from scenarios.scenario import Criterion, Directive, Experiment, Options, Outcome
from tasks import ImpedanceReference, ImpedanceTask, PostureTask

TASK = "impedance"
HOLD, REST = 1.8, 0.8  # s, of each push and after it


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpedanceGuide:
    """Holds the place where the spring is at rest."""

    X_WD: pin.SE3
    plan: Pushes

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when all pushes are over."""
        if state.time >= self.plan.duration:
            return None
        references: dict[str, Reference] = {TASK: ImpedanceReference(X_WD=self.X_WD)}
        return Directive(self.plan.phase(state.time), TASK, references)


@dataclass(frozen=True, kw_only=True)
class Impedance:
    """Push an arm that answers like a spring and a damper, with its own mass or a virtual one."""

    name: ClassVar[str] = "impedance"
    summary: ClassVar[str] = "push an arm that answers as a mass-spring-damper in six directions"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf) with a frame ``flange``."""
    coordinates: Literal["twist", "minimal"] = "twist"
    """Twist and wrench, or position with roll, pitch and yaw."""
    mass_term: bool = False
    """Whether the hand feels the virtual mass; without it, the arm's own inertia."""
    stiffness: float = 800.0
    """Virtual stiffness [N/m]."""
    stiffness_rot: float = 30.0
    """Virtual stiffness of rotation [Nm/rad]."""
    damping: float = 150.0
    """Virtual damping [N s/m]."""
    damping_rot: float = 5.0
    """Virtual damping of rotation [Nm s/rad]."""
    mass: float = 4.0
    """Virtual mass [kg], with the mass term."""
    inertia: float = 0.1
    """Virtual moment of inertia [kg m²], with the mass term."""
    force: float = 10.0
    """Height of the pushes [N]."""
    moment: float = 1.0
    """Height of the twists [Nm]."""

    def __post_init__(self) -> None:
        for name in (
            *("stiffness", "stiffness_rot", "damping", "damping_rot"),
            *("mass", "inertia", "force", "moment"),
        ):
            positive(getattr(self, name), (), name)

    @property
    def plan(self) -> Pushes:
        """What the hand does."""
        return Pushes(force=self.force, moment=self.moment, hold=HOLD, rest=REST)

    def task(self) -> ImpedanceTask:
        """Return the task of the one mode."""
        return ImpedanceTask(
            space=FLANGE,
            K_v=np.repeat([self.stiffness, self.stiffness_rot], 3),
            B_v=np.repeat([self.damping, self.damping_rot], 3),
            M_v=np.repeat([self.mass, self.inertia], 3) if self.mass_term else None,
            coordinates=self.coordinates,
        )

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        arm, X_WD = arm_at_home(self.robot)
        joints, plan = options.joints(arm, DT), self.plan
        robot = joints.robot
        self._check_mass(robot)
        tasks = (Weighted(self.task()), Weighted(PostureTask(q_ref=robot.home)))
        controller = options.controller(robot, (Mode(name=TASK, tasks=tasks),), DT)
        hand = plan.plant(joints, FLANGE.frame)
        return Experiment(
            robot=robot,
            controller=controller,
            plant=hand,
            guide=ImpedanceGuide(X_WD=X_WD, plan=plan),
            start_mode=TASK,
            q_start=robot.home,
            horizon=plan.duration + 1.0,
            geometry={},
        )

    def _check_mass(self, robot: Robot) -> None:
        """Refuse a virtual mass with which the loop is unstable at home."""
        task = self.task()
        if task.M_v is None:
            return
        alpha = 1 - np.exp(-2 * np.pi * task.cutoff * DT)
        Lambda = inertia_at_home(robot, FLANGE.frame)
        largest = float(np.linalg.eigvals(np.linalg.solve(Lambda, task.M_v)).real.max())
        if alpha * largest >= 2:
            raise InputError(
                f"mass, inertia: got {self.mass} kg and {self.inertia} kg m², need at most "
                f"{2 / (alpha * largest):.3g} times as much: the measured acceleration is one "
                "tick old"
            )

    def model(self, table: pl.DataFrame) -> Matrix:
        """Return x (ticks×6) [m, rad] of the impedance that the hand should feel."""
        task = self.task()
        M = (
            inertia_at_home(load_robot(self.robot), FLANGE.frame)
            if task.M_v is None
            else np.asarray(task.M_v)
        )
        K, B = np.asarray(task.K_v), np.asarray(task.B_v)
        return linear_answer(column(table, "time"), pushed(table), M, B, K).x

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return how far the answer is from the model, over time and at the end of each push."""
        x, task = displacement(table, TASK), self.task()
        heights = np.array([window.wrench for window in self.plan.windows])
        ends = np.linalg.solve(np.asarray(task.K_v), heights.T).T
        return {
            "answer_gap": answer_gap(x, self.model(table)),
            "static_gap_max": static_gap(x, ends, column(table, "time"), self.plan),
            **tick_metrics(table),
            **whole_run_metrics(table),
        }

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = [
            ("answer_gap", 0.05, "× RMS"),
            ("static_gap_max", 0.02, "× push / stiffness"),
            ("fallback_ticks", 0.0, "ticks"),
            ("qp_law_gap_max", 1e-8, "× max |τ|"),
        ]
        return tuple(Criterion(name, metrics[name], limit, unit) for name, limit, unit in limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return displacement and rotation over those of the model, and the pushes."""
        return push_panels(outcome.table, TASK, self.model(outcome.table))
