"""What a base does while its arm wipes a board that is longer than the arm's reach."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Matrix, Vector
from qpctrl.objective import Reference
from scenarios.path import Track, glide, lay_out, ramped
from scenarios.plant import PlantState
from scenarios.scenario import Directive
from scenarios.wiping import WipingGuide
from tasks import ForceReference, MotionReference, PostureReference

LOOSEN_TIME = 0.03  # s, in which the force that still counts as contact goes
FADE_TIME = 0.4  # s, in which the reference of lifting leaves the depth of the felt behind
GIVE_UP = 0.005  # m from its reference, beyond which the eraser is left behind
HOLD_TIME = 0.5  # s, from giving up to the end
BRAKE = {"K_p": np.zeros(6), "K_d": np.full(6, 10.0)}  # 1/s² and 1/s, of a tool that stops
INWARD = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])  # along z of the tool, into the board


@dataclass(frozen=True, kw_only=True, eq=False)
class BasePlan:
    """Where the base goes while the eraser wipes: along y of the world, heading as at home.

    It goes at the mean speed of the eraser along the board, so that the arm has the circles
    left to do.
    """

    pose: Callable[[Vector], pin.SE3]
    """Pose of the base in the world at a configuration (nq)."""
    q_home: Vector
    """Configuration of the robot there (nq) [rad or m]."""
    length: float
    """Way of the base [m]."""
    duration: float
    """Time spent wiping [s]."""
    dt: float
    """Control period [s]."""
    along: int | None
    """Coordinate of q along y of the world; none where the base is fixed."""
    lead: float
    """Time [s] by which a damped posture lags: its K_d / K_p."""
    track: Track = field(init=False)
    """Motion of the base."""
    postures: Matrix = field(init=False)
    """Configurations to lean towards (periods×nq) [rad or m]."""

    def __post_init__(self) -> None:
        way = ramped(1.0, self.duration, self.dt)
        p, v, a = (self.length / way.s[-1] * share for share in way)
        p_W, v_W, a_W = (np.outer(share, [0.0, 1.0, 0.0]) for share in (p, v, a))
        X_WE = pin.SE3(np.eye(3), self.pose(self.q_home).translation)
        object.__setattr__(self, "track", lay_out(X_WE, p_W, v_W, a_W, self.dt))
        postures = np.tile(self.q_home, (len(p), 1))
        if self.along is not None:
            postures[:, self.along] += p + self.lead * v
        object.__setattr__(self, "postures", postures)


class LimitReference(NamedTuple):
    """How fast joints may come near their limits."""

    rates: Vector
    """Rates (2) [1/s] at which the distances to a position and to a velocity limit may shrink."""

    @property
    def arrays(self) -> Mapping[str, Array]:
        """Inputs of the limits that this reference sets."""
        return {"rates": self.rates}


GENTLE = LimitReference(np.array([20.0, 20.0]))
"""A base of 60 kg needs 0.1 s to turn its force around."""


class Lift(NamedTuple):
    """How the tool leaves the board: depth and speed at first, none after `FADE_TIME`."""

    since: float
    """Time [s] at which lifting began."""
    depth: float
    """Depth [m] behind the surface then."""
    speed: float
    """Speed [m/s] into the board then."""

    def at(self, time: float) -> tuple[float, float, float]:
        """Return depth [m], speed [m/s] and acceleration [m/s²] at ``time`` [s]."""
        t = time - self.since
        s, s_dot, s_ddot = glide(t, FADE_TIME)
        way = self.depth + self.speed * t
        return (
            way * (1 - s),
            self.speed * (1 - s) - way * s_dot,
            -2 * self.speed * s_dot - way * s_ddot,
        )


class MobileGuide:
    """Walks through the phases of wiping, and takes the base along."""

    def __init__(
        self,
        wiping: WipingGuide,
        plan: BasePlan,
        pose: Callable[[Vector], pin.SE3],
        *,
        lift: Track,
        base_task: bool,
    ) -> None:
        """Start with the base at home.

        Args:
            wiping: what the eraser does.
            plan: what the base does.
            pose: pose of the eraser in the world at a configuration (nq).
            lift: motion of the eraser away from the board.
            base_task: whether the base has a task of its own beside the posture.
        """
        self._wiping, self._plan, self._pose, self._base_task = wiping, plan, pose, base_task
        self._away = lift
        self._wiped: float | None = None  # when wiping began
        self._lifted: Lift | None = None
        self._loose = math.inf  # when the last of the force is let go
        self._stopped: Directive | None = None  # what to do since the eraser is left behind
        self._until = math.inf

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the eraser is lifted off or has stopped."""
        if self._stopped is not None:
            return self._hold(self._stopped, state)
        directive = self._wiping.direct(state)
        if directive is None:
            return None
        if directive.phase == "wipe" and self._wiped is None:
            self._wiped = state.time
        t = 0.0 if self._wiped is None else state.time - self._wiped
        plan, references = self._plan, dict(directive.references)
        row = min(round(t / plan.dt), len(plan.postures) - 1)
        references["posture"] = PostureReference(q_ref=plan.postures[row])
        references["limits"] = GENTLE
        if self._base_task:
            references["base"] = plan.track.at(t)
        motion = references["motion"]
        if isinstance(motion, MotionReference):
            if directive.phase == "lift":
                return self._let_go(directive._replace(references=references), state)
            if directive.phase == "wipe" and self._left_behind(state, motion):
                return self._stop(directive, state)
        return directive._replace(references=references)

    def _left_behind(self, state: PlantState, motion: MotionReference) -> bool:
        """Return whether the eraser is far from its reference in the plane of the board."""
        error = motion.X_WD.actInv(self._pose(state.q).translation)
        return bool(math.hypot(error[0], error[1]) > GIVE_UP)

    def _stop(self, directive: Directive, state: PlantState) -> Directive:
        """Return what to do from now on: stay where the robot is, and press on."""
        references: dict[str, Reference] = {
            "limits": GENTLE,
            "motion": MotionReference(X_WD=self._pose(state.q), gains=BRAKE),
            "posture": PostureReference(q_ref=state.q.copy()),
            "force": directive.references["force"],
        }
        if self._base_task:
            references["base"] = MotionReference(X_WD=self._plan.pose(state.q))
        self._until = state.time + HOLD_TIME
        self._stopped = directive._replace(phase="stop", references=references)
        return self._stopped

    def _hold(self, stopped: Directive, state: PlantState) -> Directive | None:
        if state.time >= self._until:
            return None
        force = stopped.references["force"]
        if isinstance(force, ForceReference):
            force = ForceReference(F_ref=force.F_ref, F_meas=state.wrench_meas)
        return stopped._replace(references={**stopped.references, "force": force})

    def _let_go(self, directive: Directive, state: PlantState) -> Directive:
        """Return what to do instead of lifting at once: the last of the force is ramped down."""
        self._loose = min(self._loose, state.time)
        t, references = state.time - self._loose - LOOSEN_TIME, dict(directive.references)
        motion = self._away.at(t)
        if t < 0:
            references["motion"] = motion
            references["force"] = ForceReference(F_ref=0 * INWARD, F_meas=state.wrench_meas)
            return directive._replace(phase="release", mode="contact", references=references)
        references["motion"] = self._lift(state, motion)
        return directive._replace(references=references)

    def _lift(self, state: PlantState, motion: MotionReference) -> MotionReference:
        """Return the reference of lifting, begun as the tool moves: on felt that comes up."""
        normal, surface = motion.X_WD.rotation[:, 2], motion.X_WD.translation
        if self._lifted is None:
            dt, place = self._plan.dt, self._pose(state.q).translation
            step = self._pose(state.q + dt * state.v).translation - place
            self._lifted = Lift(
                state.time, float(normal @ (place - surface)), float(normal @ step) / dt
            )
        p, v, a = self._lifted.at(state.time)
        return MotionReference(
            X_WD=motion.X_WD * pin.SE3(np.eye(3), p * INWARD[:3]),
            V_des=motion.V_des + v * INWARD,
            V_dot_des=motion.V_dot_des + a * INWARD,
        )
