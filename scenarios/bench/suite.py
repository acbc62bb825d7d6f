"""All trials of a plan, built and ready to take turns."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from qpctrl.arrays import Vector
from qpctrl.controller import Controller
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.robot import Robot
from scenarios.bench.course import LENGTH, Moment, contact_mode, course
from scenarios.bench.humanoid import (
    HUMANOID,
    ROWS,
    humanoid,
    standing_course,
    standing_mode,
)
from scenarios.bench.part_trial import EMPTY, PartTrial, calls_of
from scenarios.bench.plan import Plan
from scenarios.bench.qp_trial import InnerQpTrial, QpTrial, problems
from scenarios.bench.row import Row
from scenarios.bench.serial import TOOL, serial_arm
from scenarios.bench.simulation_trial import EraserTrial, RolloutTrial
from scenarios.bench.tick_trial import CODE, Loop, Pace, TickTrial, torques
from scenarios.bench.timing import Trial, ratio
from scenarios.robot_file import load_robot

LONG = 10
"""Ticks of the headline over those of the other cases: its p99.9 is that of 10⁵ ticks."""

HEADLINE = "fr3"
K = 3
"""Rows of the contact, where nothing else is said."""

PROBLEMS = 250
"""QPs, of ticks in a row, on which solvers are tried by themselves."""

TIGHT = 0.9
"""Torque limit of a joint that shall always be limited, over the least torque that it needs."""

Watch = Callable[[str], None]
"""Called with what is being done."""


@dataclass(eq=False)
class Suite:
    """The trials of a plan.

    Attributes:
        notes: what a reader of the results should know.
    """

    plan: Plan
    watch: Watch
    ticks: list[TickTrial] = field(default_factory=list)
    parts: list[PartTrial] = field(default_factory=list)
    qps: list[QpTrial | InnerQpTrial] = field(default_factory=list)
    eraser: EraserTrial | None = None
    rollouts: RolloutTrial | None = None
    notes: list[str] = field(default_factory=list)
    _courses: dict[tuple[str, int], tuple[Robot, tuple[Moment, ...], Mode]] = field(
        default_factory=dict
    )

    @property
    def trials(self) -> list[Trial]:
        """All of them, in the order of their turns."""
        runs = [trial for trial in (self.eraser, self.rollouts) if trial is not None]
        return [*self.ticks, *self.parts, *self.qps, *runs]

    def rows(self) -> list[Row]:
        """Return the lines of all trials."""
        found = [self._compared(trial) for trial in self.ticks]
        found += [trial.row() for trial in self.qps]
        found += [row for trial in self.parts for row in trial.rows()]
        if self.eraser is not None:
            found += self.eraser.rows()
        if self.rollouts is not None:
            found.append(self.rollouts.row())
        return found

    def _compared(self, trial: TickTrial) -> Row:
        """Return the line of a trial, with its ratio to the first of its section."""
        first = next(one for one in self.ticks if one.section == trial.section)
        row = trial.row()
        return replace(row, facts={**row.facts, "ratio": ratio(trial.blocks, first.blocks)})

    def loop(self, robot: str, k: int, *, compiled: bool, solver: str | None = None) -> Loop:
        """Return a new controller on its course.

        Args:
            robot: ``planar_2r``, ``fr3``, ``humanoid`` or the number of joints of a serial arm.
            k: rows of the contact.
            compiled: whether it runs as generated C.
            solver: of the QP; default: the controller's own.

        Raises:
            InputError: it cannot be compiled.
        """
        self.watch(f"build {robot}, k = {k}{f', {solver}' if solver else ''}")
        arm, moments, mode = self._course(robot, k)
        started = time.perf_counter()
        modes, how = [mode], CODE[compiled]
        if solver is None:
            controller = Controller(arm, modes, compile=how)
        else:
            controller = Controller(arm, modes, compile=how, solver=solver)
        ready = time.perf_counter() - started
        return Loop(controller=controller, moments=moments, k=k, compiled=compiled, ready_s=ready)

    def _course(self, robot: str, k: int) -> tuple[Robot, tuple[Moment, ...], Mode]:
        """Return robot, ticks and mode of a case; the ticks take long to make, once."""
        if (robot, k) not in self._courses:
            if robot == HUMANOID:
                body = humanoid()
                found = body, standing_course(body, LENGTH), standing_mode(body)
            else:
                arm = serial_arm(int(robot)) if robot.isdigit() else load_robot(robot)
                found = arm, course(arm, TOOL, k, LENGTH), contact_mode(arm, TOOL, k)
            self._courses[robot, k] = found
        return self._courses[robot, k]


def build(plan: Plan, watch: Watch, *, required: bool = False) -> Suite:
    """Return the trials of a plan.

    Args:
        plan: what is measured.
        watch: called with what is being built.
        required: whether code that cannot be compiled is an error, and no reason to leave it.

    Raises:
        InputError: it is one.
    """
    suite = Suite(plan=plan, watch=watch)
    for compiled in plan.codes:
        for robot, k in _cases(plan):
            add_case(suite, robot, k, compiled=compiled, required=required)
    first = next(trial.loop for trial in suite.ticks if trial.name == HEADLINE)
    limits = _limits(first)
    _saturated(suite, first, limits)
    _solvers(suite, first, limits["2 joints limited"])
    for pace in ("sleep", "spin"):
        _paced(suite, first, pace)
    suite.eraser = EraserTrial(CODE[first.compiled], plan.wiping, plan.runs)
    suite.rollouts = RolloutTrial(plan.rollout, plan.rollouts)
    return suite


def _cases(plan: Plan) -> list[tuple[str, int]]:
    """Return robots and rows of their contacts, the headline first."""
    fixed = [(HEADLINE, K), (HEADLINE, 1), (HEADLINE, 5), ("planar_2r", 1)]
    return fixed + [(str(joints), K) for joints in plan.joints] + [(HUMANOID, ROWS)] * plan.humanoid


def add_case(suite: Suite, robot: str, k: int, *, compiled: bool, required: bool) -> None:
    """Add ticks, and parts where the contact is that of the headline.

    What cannot be compiled is noted and left out.

    Args:
        suite: what to add to.
        robot: as for `Suite.loop`.
        k: rows of the contact.
        compiled: whether it runs as generated C.
        required: whether code that cannot be compiled is an error.

    Raises:
        InputError: it is one.
    """
    ticks = suite.plan.ticks
    try:
        loop = suite.loop(robot, k, compiled=compiled)
    except InputError as error:
        if required or not compiled:
            raise
        suite.notes.append(f"{robot}, k = {k}, only interpreted: {error}")
        return
    name = f"serial {robot}" if robot.isdigit() else robot
    long = compiled and (robot, k) == (HEADLINE, K)
    suite.ticks.append(TickTrial("tick", name, loop, ticks * (LONG if long else 1)))
    if k == K:
        suite.parts.append(PartTrial(loop, TOOL, ticks))


def _limits(loop: Loop) -> dict[str, Vector]:
    """Return torque limits (nu) [Nm] that bind on none, some or half of the ticks, by name."""
    needed = np.abs(torques(loop, len(loop.moments)))
    own = loop.controller.robot.limits.tau_max
    by_torque = np.argsort(needed.min(axis=0))[::-1]
    found = {"no joint limited": own}
    for count in (1, 2, 3):
        tight, at = own.copy(), by_torque[:count]
        tight[at] = TIGHT * needed.min(axis=0)[at]
        found[f"{count} joint{'s' if count > 1 else ''} limited"] = tight
    at, half = by_torque[:2], own.copy()
    half[at] = np.median(needed, axis=0)[at]
    found["2 joints, each half of the time"] = half
    return found


def _saturated(suite: Suite, loop: Loop, limits: dict[str, Vector]) -> None:
    for name, tau_max in limits.items():
        limited = loop.limited(tau_max)
        suite.ticks.append(TickTrial("saturated", name, limited, suite.plan.ticks))


def _solvers(suite: Suite, first: Loop, tight: Vector) -> None:
    plan = suite.plan
    given = {
        "no limit": problems(first, min(PROBLEMS, plan.ticks)),
        "2 limits": problems(first.limited(tight), min(PROBLEMS, plan.ticks)),
    }
    for solver in plan.solvers:
        loop = suite.loop(HEADLINE, K, compiled=first.compiled, solver=solver)
        for words, limited in (("no limit", loop), ("2 limits", loop.limited(tight))):
            suite.ticks.append(TickTrial("solver", f"{solver}, {words}", limited, plan.ticks))
            name = f"{solver}, {words}, alone"
            inside = EMPTY in calls_of(limited.controller.engines[limited.mode])
            suite.qps.append(
                InnerQpTrial(name, limited, plan.ticks)
                if inside
                else QpTrial(name, solver, limited, given[words], plan.ticks)
            )


def _paced(suite: Suite, loop: Loop, pace: Pace) -> None:
    words = {"sleep": "each ms, asleep between", "spin": "each ms, awake between"}[pace]
    suite.ticks.append(TickTrial("paced", words, loop, suite.plan.paced, pace=pace))
