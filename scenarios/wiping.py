"""The job of wiping as phases: approach, touch, press, wipe, release, lift."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Matrix, Vector, Wrench
from qpctrl.contact import ContactLife, ContactPhase
from qpctrl.objective import Reference
from scenarios.path import PlanarMotion, glide, wiping_loops
from scenarios.plant import PlantState
from scenarios.scenario import Directive
from tasks import EnergyReference, ForceReference, MotionReference

APPROACH_TIME = 1.0  # s, from home to just in front of the board
STAND_OFF = 0.006  # m, where the slow touch begins
TOUCH_SPEED = 0.02  # m/s at most; a light touch is slower
SPEED_PER_FORCE = 2e-3  # m/s for each N of set-point: slow enough for the impact to stay below it
TOUCH_FORCE = 0.5  # N at most, measured, that counts as contact
LOSS_TIME = 0.05  # s without force after which the tool feels for the board again
REGAIN_DAMPING = 3.0  # times that of the force task, until a regained contact has settled
SEARCH_SHARE = 0.9  # of the set speed: the reference leaves room for what feedback corrects
SEARCH_DEPTH = 0.05  # m behind the planned surface, where the search for a lost board ends
PRESS_TIME = 1.2  # s, to ramp the force and settle
RELEASE_TIME = 0.3  # s, to ramp the force down
LIFT_TIME = 0.8  # s
LIFT_DISTANCE = 0.05  # m

_REST = np.zeros(3)
_INWARD = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class WipingPlan:
    """Where to wipe, how hard and how fast."""

    X_WE: pin.SE3
    """Board frame, z into the board."""
    X_WT_home: pin.SE3
    """Tool pose at the start."""
    force: float
    """Force on the board [N]."""
    speed: float
    """Wiping speed [m/s]."""
    duration: float
    """Time spent wiping [s]."""
    dt: float
    """Control period [s]."""
    damping: float
    """Velocity damping of the force task [1/s]."""
    start_on_board: bool = False
    """Whether the tool touches the board at time 0 (exact rigid plant)."""
    loss_time: float = LOSS_TIME
    """Time [s] without force after which the board counts as lost."""
    search_speed: float | None = None
    """Speed [m/s] that the tool never exceeds when it feels for a lost board; default: that of
    the touch."""
    loops: PlanarMotion = field(init=False)
    """Path on the board, in the x-y plane of E."""
    p_E: Matrix = field(init=False)
    """Position on the path (samples×3) [m], along the axes of E."""
    v_E: Matrix = field(init=False)
    """Velocity (samples×3) [m/s]."""
    a_E: Matrix = field(init=False)
    """Acceleration (samples×3) [m/s²]."""

    def __post_init__(self) -> None:
        loops = wiping_loops(self.speed, self.duration, self.dt)
        if self.start_on_board:
            loops = loops._replace(p=loops.p - loops.p[0])
        object.__setattr__(self, "loops", loops)
        for name, planar in (("p_E", loops.p), ("v_E", loops.v), ("a_E", loops.a)):
            object.__setattr__(self, name, np.pad(planar, ((0, 0), (0, 1))))

    @property
    def touch_speed(self) -> float:
        """Speed of the touch [m/s], slow enough for the impact to stay below the set-point."""
        return min(TOUCH_SPEED, SPEED_PER_FORCE * self.force)

    @property
    def touch_force(self) -> float:
        """Measured force [N] that counts as contact."""
        return min(TOUCH_FORCE, self.force / 10)

    @property
    def life(self) -> ContactLife:
        """How the phases of the contact with the board follow each other."""
        return ContactLife(touch_force=self.touch_force, loss_time=self.loss_time)

    @property
    def longest(self) -> float:
        """Time [s] after which the job counts as failed."""
        return self.duration + 10.0 + STAND_OFF / self.touch_speed


class Move(NamedTuple):
    """Where the tool shall be, and how it shall move there, along the axes of E."""

    p_E: Vector
    """Position (3) [m]."""
    v_E: Vector = _REST
    """Velocity (3) [m/s]."""
    a_E: Vector = _REST
    """Acceleration (3) [m/s²]."""


class WipingGuide:
    """Walks through the phases; advances on time and on the life of the contact.

    A board that is lost is felt for while the job goes on: the tool moves inward at the speed
    of the search, from wherever it is.

    Attributes:
        phases: their names, in order.
        contact: where the contact with the board is in its life.
    """

    phases = ("approach", "touch", "press", "wipe", "release", "lift")

    def __init__(self, plan: WipingPlan, pose: Callable[[Vector], pin.SE3]) -> None:
        """Start in front of the board, or on it.

        Args:
            plan: where to wipe, how hard and how fast.
            pose: pose of the tool in the world at a configuration (nq).
        """
        self._plan, self._pose, self._life = plan, pose, plan.life
        self._phase = "press" if plan.start_on_board else "approach"
        self.contact = self._life.start(0.0, closed=plan.start_on_board)
        self._since = self._depth = 0.0  # the depth is that of the board behind its plan
        origin = plan.X_WT_home if plan.start_on_board else plan.X_WE
        self._origin, self._R_WE = origin.translation, plan.X_WE.rotation
        self._before_board = plan.p_E[0] - STAND_OFF * _INWARD
        self._moves = {
            "approach": self._approach,
            "touch": self._touch,
            "press": self._press,
            "wipe": self._wipe,
            "release": self._release,
            "lift": self._lift,
        }

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the eraser is lifted off."""
        pressing = float(state.wrench_meas[2])
        self.contact = self._life.advance(self.contact, state.time, pressing)
        self._advance(state.time)
        if self._phase == "done":
            return None
        move = self._moves[self._phase](state.time - self._since)
        if self.contact.phase is ContactPhase.LOSS:
            move = self._search(state, move)
        references: dict[str, Reference] = {"motion": self._reference(move)}
        if not self.contact.closed:
            references["force"] = EnergyReference(F_meas=state.wrench_meas)
            return Directive(self._phase, "free", references, self.contact.phase)
        references["force"] = self._press_with(state.wrench_meas)
        return Directive(self._phase, "contact", references, self.contact.phase)

    def _advance(self, time: float) -> None:
        t = time - self._since
        leave = {
            "approach": t >= APPROACH_TIME,
            "touch": self.contact.closed,
            "press": t >= PRESS_TIME,
            "wipe": t >= self._plan.duration,
            "release": t >= RELEASE_TIME or not self.contact.felt,
            "lift": t >= LIFT_TIME,
        }
        if self._phase == "press" and self.contact.phase is not ContactPhase.PRESS:
            self._since = time  # the force settles anew
        elif leave.get(self._phase, False):
            order = (*self.phases, "done")
            following = order[order.index(self._phase) + 1]
            leaves = following == "lift" and self._plan.start_on_board  # a rigid board holds on
            self._phase, self._since = ("done" if leaves else following), time
        if self._phase == "touch":
            self.contact = self._life.feel(self.contact, time)
        elif self._phase == "lift":
            self.contact = self._life.lift(self.contact, time)

    def _press_with(self, F_meas: Wrench) -> ForceReference:
        plan = self._plan
        force = plan.touch_force if self._phase == "release" else plan.force
        landing = self.contact.phase is ContactPhase.REGAIN
        damping = plan.damping * (REGAIN_DAMPING if landing else 1.0)
        return ForceReference(
            F_ref=np.array([0.0, 0.0, force, 0.0, 0.0, 0.0]),
            F_meas=F_meas,
            gains={"damping": np.array(damping)},
        )

    def _search(self, state: PlantState, move: Move) -> Move:
        """Return the move, but inward from where the tool is instead of along the board."""
        depth = float(self._R_WE[:, 2] @ (self._pose(state.q).translation - self._origin))
        if np.isfinite(depth):
            self._depth = depth
        plan = self._plan
        speed = plan.touch_speed if plan.search_speed is None else plan.search_speed
        inward = SEARCH_SHARE * speed if self._depth < SEARCH_DEPTH else 0.0
        return move._replace(v_E=move.v_E + inward * _INWARD)

    def _approach(self, t: float) -> Move:
        start = self._R_WE.T @ (self._plan.X_WT_home.translation - self._origin)
        s, s_dot, s_ddot = glide(t, APPROACH_TIME)
        way = self._before_board - start
        return Move(start + s * way, s_dot * way, s_ddot * way)

    def _touch(self, t: float) -> Move:
        inward = self._plan.touch_speed * _INWARD
        s, s_dot, s_ddot = _set_off(t)
        return Move(self._before_board + s * inward, s_dot * inward, s_ddot * inward)

    def _press(self, t: float) -> Move:
        return Move(self._plan.p_E[0])

    def _wipe(self, t: float) -> Move:
        plan = self._plan
        i = min(round(t / plan.dt), len(plan.p_E) - 1)
        return Move(plan.p_E[i], plan.v_E[i], plan.a_E[i])

    def _release(self, t: float) -> Move:
        return Move(self._plan.p_E[-1])

    def _lift(self, t: float) -> Move:
        s, s_dot, s_ddot = glide(t, LIFT_TIME)
        way = -LIFT_DISTANCE * _INWARD
        return Move(self._plan.p_E[-1] + s * way, s_dot * way, s_ddot * way)

    def _reference(self, move: Move) -> MotionReference:
        """Return the reference of a tool aligned with the board, as deep as the board is."""
        V_des, V_dot_des = np.zeros(6), np.zeros(6)
        V_des[:3], V_dot_des[:3] = move.v_E, move.a_E
        p_E = move.p_E + self._depth * _INWARD
        X_WD = pin.SE3(self._R_WE, self._origin + self._R_WE @ p_E)
        return MotionReference(X_WD=X_WD, V_des=V_des, V_dot_des=V_dot_des)


def _set_off(t: float, ramp: float = 0.1) -> Vector:
    """Return distance, speed and acceleration per unit of speed, from rest to steady."""
    if t < ramp:
        x = t / ramp
        return np.array([ramp * (x**3 - x**4 / 2), 3 * x**2 - 2 * x**3, (6 * x - 6 * x**2) / ramp])
    return np.array([ramp / 2 + t - ramp, 1.0, 0.0])
