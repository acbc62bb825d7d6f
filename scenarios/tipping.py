"""The job of tipping over an edge as phases: from touch to edge and back to the whole face."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector, Wrench
from qpctrl.contact import ContactLife
from qpctrl.objective import Reference
from qpctrl.robot import Robot
from scenarios.guided import Stroke, ThereAndBack
from scenarios.path import glide
from scenarios.plant import PlantState
from scenarios.scenario import Directive
from scenarios.world import EDGE
from tasks import ForceReference, MotionReference

CLEARANCE = 0.006  # m, between pad and board at the start
TOUCH = ThereAndBack(far=0.02, speed=0.01)  # m, m/s, towards the board until it is felt
TOUCH_FORCE = 0.5  # N at most, measured, that counts as contact
HALF_WIDTH = 0.025  # m, from the middle of the pad to its edge
NEAR_EDGE = 0.0025  # m from the edge, where the pressure is when the face becomes an edge
FEEL_ANGLE = np.radians(1.5)  # below it the tool comes back slowly, until the face is felt
FEEL = ThereAndBack(far=2 * FEEL_ANGLE, speed=np.radians(1.0))  # rad, rad/s
PRESS_TIME = 0.4  # s, to ramp the force
SHIFT_TIME = 0.8  # s, to move the centre of pressure
SETTLE_TIME = 0.4  # s, after each of these and before the tool comes back

FREE, FACE, LINE = "free", "face", "line"
"""Modes: no contact, the whole face (k = 3), the edge alone (k = 2)."""

_ABOUT_EDGE, _INWARD = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
_STILL = Stroke(0.0, 0.0, 0.0)


class Step(NamedTuple):
    """One phase of the job."""

    name: str
    mode: str
    duration: float
    """Longest time [s]; ``touch`` and ``feel`` end when they feel what they look for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TippingPlan:
    """How hard to press, and how far and fast to tip."""

    X_WE: pin.SE3
    """Board frame, z into the board."""
    force: float
    """Force on the board [N]."""
    angle: float
    """Angle to tip to [rad]."""
    rate: float
    """Mean rate of tipping [rad/s]."""

    @property
    def steps(self) -> tuple[Step, ...]:
        """The phases, in order."""
        tipping = self.angle / self.rate
        return (
            Step("touch", FREE, TOUCH.half),
            Step("press", FACE, PRESS_TIME + SETTLE_TIME),
            Step("lean", FACE, SHIFT_TIME + SETTLE_TIME),
            Step("tip", LINE, tipping),
            Step("hold", LINE, SETTLE_TIME),
            Step("return", LINE, tipping),
            Step("feel", LINE, FEEL.half),
            Step("spread", FACE, SHIFT_TIME + 3 * SETTLE_TIME),
        )

    @property
    def touch_force(self) -> float:
        """Measured force [N] that counts as contact."""
        return min(TOUCH_FORCE, self.force / 10)


class TippingGuide:
    """Walks through the steps of a plan; advances on time and on what the sensor feels.

    Attributes:
        contact: where the contact with the board is in its life.
    """

    def __init__(self, plan: TippingPlan, robot: Robot) -> None:
        self._plan, self._robot = plan, robot
        self._steps = list(plan.steps)
        self._life = ContactLife(touch_force=plan.touch_force)
        self.contact = self._life.feel(self._life.start(0.0), 0.0)
        self._since = self._tilt = 0.0  # s, rad: when and at what angle the step began

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the pressure is back in the middle."""
        tilt = self._measured_tilt(state)
        pressing = float(state.wrench_meas[:3] @ _normal(tilt))
        self.contact = self._life.advance(self.contact, state.time, pressing)
        if self._over(state):
            self._steps.pop(0)
            self._since, self._tilt = state.time, tilt
        if not self._steps:
            return None
        step, t = self._steps[0], state.time - self._since
        angle = self._angle(step, t)
        references: dict[str, Reference] = {"motion": self._motion(step, t, angle)}
        if step.mode != FREE:
            F_ref = self._set_point(step, t, angle)
            references["force"] = ForceReference(F_ref=F_ref, F_meas=state.wrench_meas)
        return Directive(step.name, step.mode, references, self.contact.phase)

    def _over(self, state: PlantState) -> bool:
        name = self._steps[0].name
        moment = float(state.wrench_meas[3])  # of a force beside the edge
        felt = {"touch": self.contact.closed, "feel": moment < -NEAR_EDGE * self._plan.force}
        return felt.get(name, False) or state.time - self._since >= self._steps[0].duration

    def _measured_tilt(self, state: PlantState) -> float:
        R_EF = self._plan.X_WE.rotation.T @ self._robot.pose(state.q, EDGE).rotation
        return float(np.arctan2(R_EF[2, 1], R_EF[2, 2]))

    def _angle(self, step: Step, t: float) -> Stroke:
        """Return the angle of tipping [rad] and its derivatives.

        A mode that holds the angle starts from the measured one: the felt has given way.
        """
        if step.mode != LINE:
            return _STILL
        if step.name == "hold":
            return Stroke(self._plan.angle, 0.0, 0.0)
        if step.name == "feel":
            slow = FEEL.at(t)
            return Stroke(FEEL_ANGLE - slow.s, -slow.s_dot, -slow.s_ddot)
        way = (self._plan.angle if step.name == "tip" else FEEL_ANGLE) - self._tilt
        s, s_dot, s_ddot = glide(t, step.duration)
        return Stroke(self._tilt + way * s, way * s_dot, way * s_ddot)

    def _motion(self, step: Step, t: float, angle: Stroke) -> MotionReference:
        """Return the reference of a tool whose edge stays where it is, at that angle."""
        depth = TOUCH.at(t) if step.mode == FREE else Stroke(CLEARANCE, 0.0, 0.0)
        p_E = np.array([0.0, HALF_WIDTH, depth.s - CLEARANCE])
        X_ED = pin.SE3(pin.exp3(angle.s * _ABOUT_EDGE), p_E)
        return MotionReference(
            X_WD=self._plan.X_WE * X_ED,
            V_des=np.concatenate([depth.s_dot * _INWARD, angle.s_dot * _ABOUT_EDGE]),
            V_dot_des=np.concatenate([depth.s_ddot * _INWARD, angle.s_ddot * _ABOUT_EDGE]),
        )

    def _set_point(self, step: Step, t: float, angle: Stroke) -> Wrench:
        """Return the set-point (6) [N, Nm]: a force along the normal, and where it acts."""
        plan = self._plan
        force, middle, lever = plan.force, -HALF_WIDTH, 0.0
        if step.name == "press":
            force = plan.touch_force + (plan.force - plan.touch_force) * glide(t, PRESS_TIME).s
            lever = middle
        elif step.mode == FACE:
            moved = glide(t, SHIFT_TIME).s
            share = moved if step.name == "lean" else 1 - moved
            lever = middle + share * (HALF_WIDTH - NEAR_EDGE)
        return np.concatenate([force * _normal(angle.s), [force * lever, 0.0, 0.0]])


def _normal(tilt: float) -> Vector:
    """Return the normal of the board (3), into it, in the axes of a tool tipped by ``tilt``."""
    return np.array([0.0, np.sin(tilt), np.cos(tilt)])
