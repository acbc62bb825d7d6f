"""The job of the humanoid as phases: stand, wipe the wall, be pushed meanwhile, come back."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector, Wrench
from qpctrl.contact import ContactPhase
from qpctrl.objective import Reference
from qpctrl.robot import Robot
from scenarios.path import Glide, glide
from scenarios.plant import PlantState
from scenarios.scenario import Directive
from scenarios.whole_body.humanoid_world import FREE, HAND, SOLES, TORSO, HumanoidWorld
from scenarios.wiping import APPROACH_TIME, LIFT_TIME, WipingGuide, WipingPlan
from tasks import CentreOfMassReference, ForceReference, MotionReference

STAND_TIME = 0.5  # s, before the hand sets off
PUSH_TIME = 0.2  # s
RECOVER_TIME = 2.0  # s of wiping after the push
FARTHEST_LEAN = 0.06  # m, of the centre of mass: from there on the wall must do without
FALLEN = 0.7  # of its height at the start, below which the base has fallen


@dataclass(frozen=True, kw_only=True, eq=False)
class Stance:
    """Where the humanoid stands, and what it is pushed with."""

    world: HumanoidWorld
    wiping: WipingPlan
    """Job of the hand, from the end of `STAND_TIME` on."""
    push: Wrench
    """Push (6) [N, Nm] at the torso, in the axes of the world."""
    push_at: float
    """Time [s] into wiping at which the push begins."""

    @property
    def lean(self) -> float:
        """How far forward [m] the centre of mass must be for the pressure to stay in the middle.

        F h / (m g), with the force F on the wall at the height h; no more than `FARTHEST_LEAN`.
        """
        model = self.world.model
        weight = -float(model.body_mass.sum() * model.opt.gravity[2])
        balanced = float(self.wiping.force * self.world.X_WE.translation[2] / weight)
        return min(balanced, FARTHEST_LEAN)

    @property
    def longest(self) -> float:
        """Time [s] after which the job counts as failed."""
        return STAND_TIME + self.wiping.longest


class HumanoidGuide:
    """Adds to the hand's job what the rest of the body does; pushes it, and sees it fall."""

    def __init__(self, stance: Stance, shove: Callable[[Wrench], None]) -> None:
        """Start standing.

        Args:
            stance: what to do.
            shove: applies a wrench (6) [N, Nm] at the torso from now on.
        """
        robot = stance.world.robot
        self._stance, self._shove = stance, shove
        self._hand = WipingGuide(stance.wiping, lambda q: robot.pose(q, HAND.frame))
        self._forward = stance.lean * np.array([1.0, 0.0, 0.0])
        self._c_home = _centre_of_mass(robot)
        self._height = float(robot.home[2])  # of the floating base
        self._torso = MotionReference(X_WD=robot.pose(robot.home, TORSO.frame))
        self._hold = MotionReference(X_WD=robot.pose(robot.home, HAND.frame))
        self._weight = float(pin.computeTotalMass(robot.model) * -robot.model.gravity.linear[2])
        self._feet = [float(robot.pose(robot.home, name).translation[1]) for name in SOLES]
        self._phase, self._since = "stand", 0.0

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the hand is back or the humanoid fell."""
        if self._fallen(state):
            return None
        if state.time < STAND_TIME:
            hand = Directive("stand", FREE, {"motion": self._hold}, ContactPhase.APPROACH)
        else:
            found = self._hand.direct(state._replace(time=state.time - STAND_TIME))
            if found is None:
                return None
            hand = found
        if hand.phase != self._phase:
            self._phase, self._since = hand.phase, state.time
        phase = self._pushed(state.time - self._since)
        return hand._replace(phase=phase, references={**hand.references, **self._body(state)})

    def _pushed(self, t: float) -> str:
        """Push when it is time, and return the name of the phase, ``t`` [s] after it began."""
        after = t - self._stance.push_at
        if self._phase != "wipe" or after < 0:
            return self._phase
        pushing = after < PUSH_TIME
        self._shove(self._stance.push if pushing else np.zeros(6))
        return "push" if pushing else "recover"

    def _body(self, state: PlantState) -> dict[str, Reference]:
        found: dict[str, Reference] = {
            "centre of mass": self._lean(state.time - self._since),
            "torso": self._torso,
        }
        soles = state.contacts[1:]
        for name, share, F_meas in zip(SOLES, self._shares(soles), soles, strict=True):
            F_ref = np.array([0.0, 0.0, share * self._weight, 0.0, 0.0, 0.0])
            found[f"{name} force"] = ForceReference(F_ref=F_ref, F_meas=F_meas)
        return found

    def _shares(self, soles: Sequence[Wrench]) -> tuple[float, float]:
        """Return the shares of the weight that take the pressure where it is, by no moment.

        Each sole then carries in its middle, far from its edges, also while the body sways.
        """
        left, right = self._feet
        total = sum(float(F[2]) for F in soles)
        if not total > 0.1 * self._weight:
            return 0.5, 0.5
        turning = sum(y * float(F[2]) - float(F[3]) for y, F in zip(self._feet, soles, strict=True))
        share = min(max((turning / total - right) / (left - right), 0.0), 1.0)
        return share, 1 - share

    def _lean(self, t: float) -> CentreOfMassReference:
        """Return the centre of mass, ``t`` [s] into the phase: forward before the hand touches."""
        forward = self._forward
        if self._phase == "approach":
            way = glide(t, APPROACH_TIME)
        elif self._phase == "lift":
            there = glide(t, LIFT_TIME)
            way = Glide(1 - there.s, -there.s_dot, -there.s_ddot)
        else:
            way = Glide(0.0 if self._phase == "stand" else 1.0, 0.0, 0.0)
        return CentreOfMassReference(
            c_des=self._c_home + way.s * forward,
            c_dot_des=way.s_dot * forward,
            c_ddot_des=way.s_ddot * forward,
        )

    def _fallen(self, state: PlantState) -> bool:
        return not float(state.q[2]) > FALLEN * self._height


def _centre_of_mass(robot: Robot) -> Vector:
    return np.array(pin.centerOfMass(robot.model, robot.model.createData(), robot.home))
