"""The controllers of the system `wipe`, an open registry: a new one is one entry of `KINDS`."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from qpctrl.arrays import Array, Vector
from qpctrl.constraint import Constraint, FaceOnPlane, PointOnPlane
from qpctrl.contact import Footprint, FrictionCone, MaxForce, WrenchLimit
from qpctrl.controller import Controller
from qpctrl.law import Law
from qpctrl.mode import Mode
from qpctrl.objective import Task, Weighted
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from scenarios.scenario import Options
from scenarios.study.system import Setting
from scenarios.study.systems.law import LAW_WORDS
from scenarios.study.systems.wipe.guide import (
    FORCE_RAMP,
    Follow,
    Job,
    PressWith,
    PushBehind,
    WipeGuide,
    YieldTo,
)
from scenarios.study.systems.wipe.world import PAD_HALF, STEP, believed_world, joint_level
from scenarios.study.systems.wrong_normal import mobility
from scenarios.world import TOOL, Tip
from tasks import ForceTask, ImpedanceTask, MotionTask, PostureTask

SPACE = TaskSpace(TOOL)
MODE = "wipe"

SOLVERS = ("active-set", "proxsuite", "daqp")
"""What solves the QP."""

LARGEST = 1.5
"""Largest force that the contact may carry, over the set-point, where a controller limits it."""

SLACK = 100.0
"""Weight of constraints that can give way."""

Gains = Mapping[str, Mapping[str, Array]]
"""Inputs by name of task or limit, then by name of input."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One way to control the job."""

    words: str
    law: Law = "qp"
    tasks: Callable[[Robot], tuple[Task, ...]]
    """What its one mode has; a task on the tool's pose is called ``motion``."""
    follow: Callable[[Job, Setting], Follow]
    """What these tasks follow."""
    gains: Callable[[Setting], Gains]
    """Inputs that are set at the start."""
    presses: bool = True
    """Whether it knows that the tool is on the board: a constraint in its mode."""
    limits: Callable[[Tip], tuple[WrenchLimit, ...]] = field(default=lambda tip: ())
    """What it knows that the contact of a tip can carry."""
    slack: float | None = None
    """Weight of that constraint, where it can give way."""


def controller(kind: str, tip: Tip, setting: Setting) -> Controller:
    """Return a controller that all rollouts of the same structure share."""
    structure = (int(setting["actuator"]), int(setting["period"]), int(setting["solver"]))
    return _controller(kind, tip, *structure)


def guide(kind: str, job: Job, setting: Setting) -> WipeGuide:
    """Return what leads that controller through the job."""
    chosen = KINDS[kind]
    return WipeGuide(job, MODE, chosen.follow(job, setting), chosen.gains(setting))


@functools.lru_cache(maxsize=24)
def _controller(name: str, tip: Tip, actuator: int, period: int, solver: int) -> Controller:
    kind, robot = KINDS[name], joint_level(actuator, period).robot
    mode = Mode(
        name=MODE,
        tasks=tuple(Weighted(task) for task in kind.tasks(robot)),
        constraints=(_board(tip),) if kind.presses else (),
        contact_limits=kind.limits(tip),
        slack=kind.slack,
    )
    options = Options(law=kind.law, solver=SOLVERS[solver])
    return options.controller(robot, [mode], period * STEP)


def _board(tip: Tip) -> Constraint:
    """Return what the controller believes of the contact."""
    X_WE = believed_world(tip).X_WE
    if tip == "ball":
        return PointOnPlane(space=SPACE, X_WE=X_WE, name="board")
    return FaceOnPlane(space=SPACE, R_WE=X_WE.rotation, name="board")


def _pressing(robot: Robot) -> tuple[Task, ...]:
    return MotionTask(space=SPACE), ForceTask(space=SPACE), PostureTask(q_ref=robot.home)


def _moving(robot: Robot) -> tuple[Task, ...]:
    return MotionTask(space=SPACE), PostureTask(q_ref=robot.home)


def _springy(robot: Robot) -> tuple[Task, ...]:
    spring = ImpedanceTask(space=SPACE, K_v=1.0, B_v=1.0, name="motion")
    return spring, PostureTask(q_ref=robot.home)


def _motion_gains(setting: Setting) -> dict[str, Array]:
    return {
        **{key: np.full(6, setting[key.lower()]) for key in ("K_p", "K_i", "K_d")},
        "weight": np.array(setting["motion_weight"]),
    }


def _force_gains(setting: Setting) -> dict[str, Array]:
    one = {"damping": setting["damping"], "cutoff": setting["cutoff"]}
    return {
        "K_fp": np.full(6, setting["k_fp"]),
        "K_fi": np.repeat([setting["k_fi"], setting["k_mi"]], 3),
        "ramp": np.full(6, setting["force"] / FORCE_RAMP),
        **{key: np.array(value) for key, value in one.items()},
        "weight": np.array(setting["force_weight"]),
    }


def _pressing_gains(setting: Setting) -> Gains:
    return {"motion": _motion_gains(setting), "force": _force_gains(setting)}


def _open_loop_gains(setting: Setting) -> Gains:
    return _pressing_gains({**setting, "k_fp": 0.0, "k_fi": 0.0, "k_mi": 0.0})


def _cone_gains(setting: Setting) -> Gains:
    return {
        **_pressing_gains(setting),
        "friction": {"mu": np.array(setting["friction_model"])},
        "max force": {"limit": np.array(LARGEST * setting["force"])},
    }


def _spring_gains(setting: Setting) -> Gains:
    """Return stiffness and critical damping of each direction alone, at home."""
    K = np.repeat([setting["spring"], setting["spring_rot"]], 3)
    K[2] = setting["spring_normal"]
    B = 2 * np.sqrt(K * _inertia())
    weight = np.array(setting["motion_weight"])
    return {"motion": {"K_v": np.diag(K), "B_v": np.diag(B), "weight": weight}}


@functools.cache
def _inertia() -> Vector:
    """Return the diagonal of Λ (6) [kg, kg m²] at home."""
    robot = believed_world("pad").robot
    Lambda: Vector = np.linalg.inv(mobility(robot, TOOL, robot.home)).diagonal()
    return Lambda


def _contact_limits(tip: Tip) -> tuple[WrenchLimit, ...]:
    cone, largest = FrictionCone(space=SPACE, mu=0.3), MaxForce(space=SPACE, limit=1.0)
    if tip == "ball":
        return cone, largest
    half = (float(PAD_HALF[0]), float(PAD_HALF[1]))
    return cone, largest, Footprint(space=SPACE, half=half)


def _pressing_kind(
    words: str,
    *,
    law: Law = "qp",
    gains: Callable[[Setting], Gains] = _pressing_gains,
    limits: Callable[[Tip], tuple[WrenchLimit, ...]] = lambda tip: (),
    slack: float | None = None,
) -> Kind:
    """Return one that moves along the board and presses on it, with a task for each."""
    return Kind(
        words=words,
        law=law,
        tasks=_pressing,
        follow=lambda job, setting: PressWith(job),
        gains=gains,
        limits=limits,
        slack=slack,
    )


KINDS: dict[str, Kind] = {
    "qp": _pressing_kind("the QP: motion along the board, PI force with damping on it"),
    "hybrid": _pressing_kind(LAW_WORDS["hybrid"], law="hybrid"),
    "textbook": _pressing_kind(LAW_WORDS["textbook"], law="textbook"),
    "feed-forward": _pressing_kind("the QP without force feedback", gains=_open_loop_gains),
    "qp-cone": _pressing_kind(
        "the QP with limits on what the contact carries", gains=_cone_gains, limits=_contact_limits
    ),
    "qp-slack": _pressing_kind("the QP whose constraint can give way", slack=SLACK),
    "impedance": Kind(
        words="a spring to a place behind the believed board, where it gives the set force",
        tasks=_springy,
        follow=lambda job, setting: PushBehind(job, setting["spring_normal"]),
        gains=_spring_gains,
        presses=False,
    ),
    "admittance": Kind(
        words="a position loop whose depth yields to the force error as a damper",
        tasks=_moving,
        follow=lambda job, s: YieldTo(job, s["yield_damping"], s["yield_cutoff"]),
        gains=lambda setting: {"motion": _motion_gains(setting)},
        presses=False,
    ),
}
"""Controllers by name; all do the same job."""
