"""What a scenario is: frozen parameters that set up an experiment and judge its record."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import polars as pl

from qpctrl.arrays import Array
from qpctrl.compiled import CompileMode
from qpctrl.contact import ContactPhase
from qpctrl.controller import Controller
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Reference
from qpctrl.robot import Robot
from scenarios.actuator.ablation import Ablation
from scenarios.actuator.inner import INNER_RATE
from scenarios.joint_level import Actuator, JointLevel, joint_level
from scenarios.panel import Panel
from scenarios.plant import Plant, PlantState


class Directive(NamedTuple):
    """What a guide asks of the controller at one tick."""

    phase: str
    mode: str
    references: Mapping[str, Reference]
    contact: ContactPhase = ContactPhase.PRESS


class Guide(Protocol):
    """Decides, tick by tick, what the robot shall do; its state is its own, explicit and small."""

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the job is done."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Experiment:
    """A controller, a plant, and what to do with them."""

    robot: Robot
    controller: Controller
    plant: Plant
    guide: Guide
    start_mode: str
    q_start: Array
    """Configuration (nq) [rad or m] at time 0."""
    horizon: float
    """Longest time the run can take [s]."""
    geometry: Mapping[str, Array]
    """Poses (4×4) that a picture of the run needs, by name."""
    contacts: tuple[str, ...] = ()
    """Names of the contacts whose wrenches the plant tells one by one."""


class Criterion(NamedTuple):
    """One condition of success: ``value ≤ limit``."""

    name: str
    value: float
    limit: float
    unit: str

    @property
    def passed(self) -> bool:
        """Whether it holds; a NaN does not."""
        return bool(self.value <= self.limit)


def criteria(
    metrics: Mapping[str, float], limits: Mapping[str, tuple[float, str]]
) -> tuple[Criterion, ...]:
    """Return a condition for each of ``limits`` (value and unit by metric); a missing one fails."""
    return tuple(
        Criterion(name, metrics.get(name, float("nan")), limit, unit)
        for name, (limit, unit) in limits.items()
    )


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to run any scenario."""

    law: Literal["qp", "hybrid", "textbook"] = "qp"
    """Whose torque is sent; the others are computed and compared."""
    solver: str = "active-set"
    """active-set, proxsuite, or an installed back-end of qpsolvers; bisections keep the default."""
    form: Literal["reduced", "full"] = "reduced"
    """Variables of the QP: (a, λ) or (a, τ, λ)."""
    seed: int = 0
    """Seed of every random number of the run."""
    actuator: Actuator = "ideal"
    """Design of the joints: what becomes of a commanded torque."""
    drives: tuple[str, ...] = ()
    """Joint drives, names of `qpctrl actuator` or TOML files: one for all joints or one for each;
    default: by the joint's torque limit. They move sliding joints by a capstan of 20 mm radius."""
    without: tuple[Ablation, ...] = ()
    """What is taken away from the drives, to see what it costs."""
    inner_rate: float = INNER_RATE
    """Rate of the drives' current and torque loops [Hz]."""
    compiled: CompileMode = "auto"
    """Whether ticks and inner loop run as generated C, which takes seconds the first time."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed: got {self.seed}, need a number >= 0")

    def joints(self, robot: Robot, dt: float) -> JointLevel:
        """Return what moves the joints of ``robot`` under a controller of period ``dt`` [s].

        Its ``robot`` is the one to build the controller for.
        """
        return joint_level(
            robot,
            actuator=self.actuator,
            drives=self.drives,
            inner_rate=self.inner_rate,
            dt=dt,
            seed=self.seed,
            compile=self.compiled,
            ablations=self.without,
        )

    def controller(self, robot: Robot, modes: Sequence[Mode], dt: float) -> Controller:
        """Return a controller of period ``dt`` [s] that is run as these options say."""
        solver, form, law = self.solver, self.form, self.law
        return Controller(
            robot, modes, dt=dt, solver=solver, form=form, law=law, compile=self.compiled
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """A finished run."""

    experiment: Experiment
    table: pl.DataFrame
    """One row a tick."""
    summary: dict[str, Any]
    """What summary.json holds."""

    @property
    def passed(self) -> bool:
        """Whether every criterion of the scenario holds."""
        return bool(self.summary["passed"])


@runtime_checkable
class Eventful(Protocol):
    """A scenario that says in words what happened in a run."""

    def events(self, table: pl.DataFrame) -> tuple[str, ...]:
        """Return what gave way, in the order of time."""


class Scenario(Protocol):
    """Frozen parameters of one experiment."""

    @property
    def name(self) -> str:
        """Name on the command line."""

    @property
    def summary(self) -> str:
        """One line for the list of scenarios."""

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the scenario's metrics of a record."""

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the pictures of a run that a person would look at first."""
