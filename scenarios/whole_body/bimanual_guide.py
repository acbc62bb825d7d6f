"""The job of two arms with a box: squeeze, lift, carry, press, slide, bring back, let go."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector
from qpctrl.objective import Reference
from qpctrl.robot import Robot
from scenarios.guided import ThereAndBack
from scenarios.path import glide
from scenarios.plant import PlantState
from scenarios.scenario import Directive
from scenarios.whole_body.bimanual_modes import CARRY, REACH, SLIDE, STAND
from scenarios.whole_body.bimanual_path import Path, Place, eight, ring, sink, stay, straight
from scenarios.whole_body.bimanual_world import GAP, HALF, HANDS, SIDES
from tasks import ForceReference, GraspForceReference, MotionReference

TOUCH = ThereAndBack(far=3 * GAP, speed=0.005)  # m, m/s, of the pads until they feel the box
TOUCH_FORCE = 0.5  # N, measured, that counts as contact
LIGHT_FORCE = 0.5  # N, at which a contact is left
LAND_SPEED = 0.005  # m/s, at which the box comes down on the table
ABOVE = 0.002  # m above the table, from where it comes down slowly
RAMP, SETTLE = 0.4, 0.2  # s
MOVE = 0.8  # s, of a straight leg
ASIDE = -0.06  # m along x, from where the box starts to where it is pressed on the table
RETREAT = 0.03  # m
STUCK = 0.2  # share of the weight that may be left on the table before it is lifted
LOST = 0.03  # m off its path, from where the box counts as lost

Force = Callable[[float], float]
Ends = Literal["time", "pads", "table"]


class Step(NamedTuple):
    """One phase of the job."""

    name: str
    mode: str
    duration: float
    """Longest time [s]."""
    path: Path
    """Of the box; of the pads, away from it, in the mode without a grasp."""
    squeeze: Force
    """Set-point of the internal force [N]."""
    press: Force
    """Set-point of the force on the table [N]."""
    ends: Ends = "time"
    """What ends it: its time, or that both pads, or the table, are felt."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxPlan:
    """How hard to squeeze and to press, and how far to carry."""

    robot: Robot
    X_WT: pin.SE3
    """Table, z down."""
    weight: float
    """Of the box [N]."""
    squeeze: float
    """Internal force [N]."""
    press: float
    """Force on the table while the box slides [N]."""
    height: float
    """How high the box is lifted [m]."""
    size: tuple[float, float, float]
    """Half width, half depth and height of the eight [m]."""
    turn: float
    """Largest angle by which it is turned [rad]."""
    radius: float
    """Of the ring on the table [m]."""
    duration: float
    """Time for the eight [s], and for the ring."""
    steps: tuple[Step, ...] = field(init=False)
    """The phases, in order."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", (*self._up(), *self._over(), *self._back()))

    def _up(self) -> tuple[Step, ...]:
        ground, f, w = np.zeros(3), self.squeeze, self.weight
        rest, high = stay(ground), np.array([0.0, 0.0, self.height])
        return (
            Step("reach", REACH, TOUCH.half, rest, _hold(0.0), _hold(w), "pads"),
            Step("squeeze", STAND, RAMP + SETTLE, rest, _ramp(TOUCH_FORCE, f), _hold(w)),
            Step("unload", STAND, RAMP + SETTLE, rest, _hold(f), _ramp(w, LIGHT_FORCE)),
            self._carry("lift", straight(ground, high, MOVE), MOVE),
        )

    def _over(self) -> tuple[Step, ...]:
        high, aside = np.array([0.0, 0.0, self.height]), np.array([ASIDE, 0.0, self.height])
        low, ground = np.array([ASIDE, 0.0, ABOVE]), np.array([ASIDE, 0.0, 0.0])
        slide, hold, f = partial(Step, squeeze=_hold(self.squeeze)), stay(ground), self.press
        return (
            self._carry("carry", eight(high, self.size, self.turn, self.duration), self.duration),
            self._carry("over", straight(high, aside, MOVE), MOVE),
            self._carry("lower", straight(aside, low, MOVE), MOVE),
            self._land("land", low),
            slide("press", STAND, RAMP + SETTLE, hold, press=_ramp(TOUCH_FORCE, f)),
            slide(
                "slide",
                SLIDE,
                self.duration,
                ring(ground, self.radius, self.duration),
                press=_hold(f),
            ),
            slide("relax", STAND, RAMP + SETTLE, hold, press=_ramp(f, LIGHT_FORCE)),
        )

    def _back(self) -> tuple[Step, ...]:
        rise = np.array([0.0, 0.0, self.height / 2])
        ground, low = np.zeros(3), np.array([0.0, 0.0, ABOVE])
        side, f, w = np.array([ASIDE, 0.0, 0.0]), self.squeeze, self.weight
        rest, time = stay(ground), RAMP + SETTLE
        return (
            self._carry("raise", straight(side, side + rise, MOVE), MOVE),
            self._carry("return", straight(side + rise, rise, MOVE), MOVE),
            self._carry("down", straight(rise, low, MOVE), MOVE),
            self._land("put", low),
            Step("rest", STAND, time, rest, _hold(f), _ramp(TOUCH_FORCE, w)),
            Step("loose", STAND, time, rest, _ramp(f, LIGHT_FORCE), _hold(w)),
            Step("retreat", REACH, MOVE, rest, _hold(0.0), _hold(w)),
        )

    def _carry(self, name: str, path: Path, duration: float) -> Step:
        return Step(name, CARRY, duration, path, _hold(self.squeeze), _hold(0.0))

    def _land(self, name: str, start: Vector) -> Step:
        path, squeeze = sink(start, LAND_SPEED), _hold(self.squeeze)
        return Step(name, CARRY, 3 * ABOVE / LAND_SPEED, path, squeeze, _hold(0.0), "table")


class BoxGuide:
    """Walks through the steps of a plan; advances on time and on what pads and box feel.

    It stops early where the box cannot be lifted, or is lost.
    """

    def __init__(self, plan: BoxPlan) -> None:
        self._plan, self._steps, self._since = plan, list(plan.steps), 0.0
        robot = plan.robot
        self._box = int(robot.model.joints[robot.model.getJointId("box")].idx_q)
        self._hands = [robot.pose(robot.home, hand.frame) for hand in HANDS]
        self._sunk = np.zeros(3)  # m, from the path's start to where the box was then

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none at the end of the job."""
        if self._over(state):
            done = self._steps.pop(0)
            self._since = state.time
            self._sunk = np.zeros(3)
            if self._steps and done.mode == STAND:
                self._sunk = self._bottom(state) - self._steps[0].path(0.0).p
            if done.name == "unload" and state.contacts[2][2] > STUCK * self._plan.weight:
                return None
            if done.name == "loose":
                self._hands = [self._plan.robot.pose(state.q, hand.frame) for hand in HANDS]
        if not self._steps:
            return None
        step, t = self._steps[0], state.time - self._since
        if step.mode == REACH:
            return Directive(step.name, step.mode, self._free(step, t, state))
        place = _from(self._sunk, step.path(t), t)
        if not np.linalg.norm(self._bottom(state) - place.p) <= LOST:  # nor where it is no number
            return None
        force = 0.5 * float(state.contacts[0][2] + state.contacts[1][2])
        references: dict[str, Reference] = {
            "grasp": GraspForceReference(f_ref=step.squeeze(t), f_meas=force)
        }
        if step.mode != STAND:
            references["motion"] = place.reference(self._plan.X_WT)
        if step.mode in (STAND, SLIDE):
            references["press"] = _pressing(step, t, state)
        return Directive(step.name, step.mode, references)

    def _over(self, state: PlantState) -> bool:
        step = self._steps[0]
        forces = [float(contact[2]) for contact in state.contacts]
        felt = {"pads": min(forces[:2]), "table": forces[2], "time": 0.0}[step.ends] > TOUCH_FORCE
        return felt or state.time - self._since >= step.duration

    def _free(self, step: Step, t: float, state: PlantState) -> dict[str, Reference]:
        """Return references of free hands: towards the box, or away from it."""
        if step.name == "retreat":
            s, s_dot, s_ddot = (-RETREAT * part for part in glide(t, step.duration))
        else:
            s, s_dot, s_ddot = TOUCH.at(t)
        z = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        found: dict[str, Reference] = {"press": _pressing(step, t, state)}
        for side, X_WH in zip(SIDES, self._hands, strict=True):
            X_WD = X_WH * pin.SE3(np.eye(3), s * z[:3])
            found[f"{side} hand"] = MotionReference(
                X_WD=X_WD, V_des=s_dot * z, V_dot_des=s_ddot * z
            )
        return found

    def _bottom(self, state: PlantState) -> Vector:
        """Return where the box's lowest face is (3) [m], against the middle of the table."""
        X_WO = pin.XYZQUATToSE3(state.q[self._box : self._box + 7])
        return np.asarray(X_WO.act(np.array([0.0, 0.0, -HALF])) - self._plan.X_WT.translation)


def _from(sunk: Vector, place: Place, t: float) -> Place:
    """Return a place on a path that begins ``sunk`` (3) [m] beside it, and joins it smoothly."""
    s, s_dot, s_ddot = glide(t, RAMP)
    return place._replace(
        p=place.p + (1 - s) * sunk,
        p_dot=place.p_dot - s_dot * sunk,
        p_ddot=place.p_ddot - s_ddot * sunk,
    )


def _pressing(step: Step, t: float, state: PlantState) -> ForceReference:
    F_ref = np.array([0.0, 0.0, step.press(t), 0.0, 0.0, 0.0])
    return ForceReference(F_ref=F_ref, F_meas=state.contacts[2])


def _hold(force: float) -> Force:
    return lambda t: force


def _ramp(start: float, end: float) -> Force:
    return lambda t: start + (end - start) * glide(t, RAMP).s
