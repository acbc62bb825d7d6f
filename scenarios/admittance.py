"""Admittance control in six directions: the arm senses the hand and moves as a virtual mass would.

The sensor in the wrist has noise, bias and delay, and its reading is low-pass filtered.
Source: LynchPark2017 §11.7.2.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import finite_array, non_negative, positive
from qpctrl.mode import Mode
from qpctrl.objective import Reference, Weighted
from scenarios.force_sensor import ForceSensor, SensedPlant
from scenarios.guided import DT, FLANGE, arm_at_home
from scenarios.metric import column, tick_metrics, whole_run_metrics
from scenarios.panel import Panel
from scenarios.plant import PlantState
from scenarios.push import (
    Answer,
    Pushes,
    answer_gap,
    displacement,
    inertia_at_home,
    linear_answer,
    push_panels,
    pushed,
)
from scenarios.robot_file import load_robot
from scenarios.scenario import Criterion, Directive, Experiment, Options, Outcome
from tasks import AdmittanceReference, AdmittanceTask, PostureTask

TASK = "admittance"
HOLD, REST = 1.0, 0.5  # s, of each push and after it


@dataclass(frozen=True, kw_only=True, eq=False)
class AdmittanceGuide:
    """Holds the place where the spring is at rest, and hands on the sensor's reading."""

    X_WD: pin.SE3
    plan: Pushes

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when all pushes are over."""
        if state.time >= self.plan.duration:
            return None
        reading = AdmittanceReference(X_WD=self.X_WD, F_meas=state.wrench_meas)
        references: dict[str, Reference] = {TASK: reading}
        return Directive(self.plan.phase(state.time), TASK, references)


@dataclass(frozen=True, kw_only=True)
class Admittance:
    """Push an arm that senses the hand and moves as a virtual mass, damper and spring."""

    name: ClassVar[str] = "admittance"
    summary: ClassVar[str] = "push an arm that senses the hand and moves as a virtual mass would"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf) with a frame ``flange``."""
    simulated: Literal["full", "spring", "damper"] = "full"
    """Mass, damper and spring, or one of them alone with a motion loop behind it."""
    mass: float = 4.0
    """Virtual mass [kg]."""
    inertia: float = 0.1
    """Virtual moment of inertia [kg m²]."""
    damping: float = 100.0
    """Virtual damping [N s/m]."""
    damping_rot: float = 2.5
    """Virtual damping of rotation [Nm s/rad]."""
    stiffness: float = 600.0
    """Virtual stiffness [N/m]."""
    stiffness_rot: float = 15.0
    """Virtual stiffness of rotation [Nm/rad]."""
    force: float = 10.0
    """Height of the pushes [N]."""
    moment: float = 1.0
    """Height of the twists [Nm]."""
    cutoff: float = 50.0
    """Cut-off of the filter on the reading [Hz]; 0 is no filter."""
    noise: float = 0.1
    """Standard deviation of the sensor's force [N]; moments get a tenth of the number [Nm]."""
    bias: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Constant error of the reading (6) [N, Nm]."""
    delay: int = 1
    """Age of the reading [ticks], beyond the one period of the loop."""

    def __post_init__(self) -> None:
        for name in (
            *("mass", "inertia", "damping", "damping_rot", "stiffness", "stiffness_rot"),
            *("force", "moment"),
        ):
            positive(getattr(self, name), (), name)
        non_negative(self.cutoff, (), "cutoff")
        self._sensor()

    @property
    def plan(self) -> Pushes:
        """What the hand does."""
        return Pushes(force=self.force, moment=self.moment, hold=HOLD, rest=REST)

    def task(self) -> AdmittanceTask:
        """Return the task of the one mode."""
        return AdmittanceTask(
            space=FLANGE,
            M_v=np.repeat([self.mass, self.inertia], 3),
            B_v=np.repeat([self.damping, self.damping_rot], 3),
            K_v=np.repeat([self.stiffness, self.stiffness_rot], 3),
            simulated=self.simulated,
            cutoff=self.cutoff,
        )

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        arm, X_WD = arm_at_home(self.robot)
        joints, plan = options.joints(arm, DT), self.plan
        robot = joints.robot
        tasks = (Weighted(self.task()), Weighted(PostureTask(q_ref=robot.home)))
        controller = options.controller(robot, (Mode(name=TASK, tasks=tasks),), DT)
        hand = plan.plant(joints, FLANGE.frame)
        return Experiment(
            robot=robot,
            controller=controller,
            plant=SensedPlant(hand, self._sensor(), options.seed),
            guide=AdmittanceGuide(X_WD=X_WD, plan=plan),
            start_mode=TASK,
            q_start=robot.home,
            horizon=plan.duration + 1.0,
            geometry={},
        )

    def model(self, table: pl.DataFrame) -> Answer:
        """Return the motion (ticks×6) of what is simulated, under the true push and the bias.

        A spring alone is followed by the motion loop, x = K_p K_v⁻¹ f / (s² + K_d s + K_p), and a
        damper alone by x = K_d B_v⁻¹ f / (s (s + K_d)): masses of K_v / K_p and B_v / K_d. A bias b
        acts as (I − M_v Λ⁻¹) b, since the reading is compensated in the dynamics too.
        """
        task = self.task()
        M, B, K = (np.asarray(matrix) for matrix in (task.M_v, task.B_v, task.K_v))
        if self.simulated == "spring":
            M, B = K / np.asarray(task.K_p), K * (np.asarray(task.K_d) / np.asarray(task.K_p))
        elif self.simulated == "damper":
            M, K = B / np.asarray(task.K_d), np.zeros_like(K)
        Lambda = inertia_at_home(load_robot(self.robot), FLANGE.frame)
        acting = (np.eye(6) - M @ np.linalg.inv(Lambda)) @ np.array(self.bias)
        return linear_answer(column(table, "time"), pushed(table) - acting, M, B, K)

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return how far the answer is from the model, and the usual.

        What a damper alone answers is a velocity: where it ends up is not the model's business.
        """
        x, model = displacement(table, TASK), self.model(table)
        V = np.stack([column(table, f"{TASK}.V.{i}") for i in range(6)], axis=1)
        damper = self.simulated == "damper"
        gap = answer_gap(V, model.x_dot) if damper else answer_gap(x, model.x)
        return {"answer_gap": gap, **tick_metrics(table), **whole_run_metrics(table)}

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = [
            ("answer_gap", 0.05, "× RMS"),
            ("fallback_ticks", 0.0, "ticks"),
            ("qp_law_gap_max", 1e-8, "× max |τ|"),
        ]
        return tuple(Criterion(name, metrics[name], limit, unit) for name, limit, unit in limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return displacement and rotation over those of the model, and the pushes."""
        return push_panels(outcome.table, TASK, self.model(outcome.table).x)

    def _sensor(self) -> ForceSensor:
        bias = finite_array(np.array(self.bias), (6,), "bias")
        return ForceSensor(noise=self.noise, bias=bias, delay=self.delay)
