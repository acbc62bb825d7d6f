"""The job of wiping as phases: approach, touch, press, wipe, release, lift."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Matrix, Vector, Wrench
from qpctrl.contact import ContactLife, ContactPhase
from qpctrl.objective import Reference
from scenarios.path import PlanarMotion, Track, glides, lay_out, wiping_loops
from scenarios.plant import PlantState
from scenarios.scenario import Directive
from tasks import EnergyReference, ForceReference, MotionReference

APPROACH_TIME = 1.0  # s, from home to just in front of the board
STAND_OFF = 0.006  # m, where the slow touch begins
SET_OFF_TIME = 0.1  # s, from rest to the speed of the touch
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

# Members of an Enum take 0.1 µs to look up, more than all that is done with them in a tick.
_PRESS, _LOSS, _REGAIN = ContactPhase.PRESS, ContactPhase.LOSS, ContactPhase.REGAIN
_INWARD = np.array([0.0, 0.0, 1.0])
_INWARD_TWIST = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


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
    path: PlanarMotion | None = None
    """Where to wipe, of this speed and duration; default: `wiping_loops`."""
    loops: PlanarMotion = field(init=False)
    """Path on the board, in the x-y plane of E."""
    tracks: dict[str, Track] = field(init=False)
    """Motion of the tool in each phase, aligned with the board."""

    def __post_init__(self) -> None:
        loops = self.path or wiping_loops(self.speed, self.duration, self.dt)
        if self.start_on_board:
            loops = loops._replace(p=loops.p - loops.p[0])
        object.__setattr__(self, "loops", loops)
        object.__setattr__(self, "tracks", self._lay_out())

    def _lay_out(self) -> dict[str, Track]:
        """Return the tracks of all phases."""
        origin = self.X_WT_home if self.start_on_board else self.X_WE
        X_WE = pin.SE3(self.X_WE.rotation, origin.translation)
        home = X_WE.actInv(self.X_WT_home.translation)
        p_E, v_E, a_E = (np.pad(planar, ((0, 0), (0, 1))) for planar in self.loops)
        begin, end = p_E[0], p_E[-1]
        before_board = begin - STAND_OFF * _INWARD

        def along(start: Vector, way: Vector, *shares: Vector) -> Track:
            """Return a track along ``way`` (3) [m], of which shares are done."""
            p, v, a = (np.outer(share, way) for share in shares)
            return lay_out(X_WE, start + p, v, a, self.dt)

        def gliding(start: Vector, way: Vector, duration: float) -> Track:
            return along(start, way, *glides(self._times(duration), duration))

        return {
            "approach": gliding(home, before_board - home, APPROACH_TIME),
            "touch": along(before_board, self.touch_speed * _INWARD, *self._setting_off()),
            "press": along(begin, _INWARD, *np.zeros((3, 1))),
            "wipe": lay_out(X_WE, p_E, v_E, a_E, self.dt),
            "release": along(end, _INWARD, *np.zeros((3, 1))),
            "lift": gliding(end, -LIFT_DISTANCE * _INWARD, LIFT_TIME),
        }

    def _setting_off(self) -> Matrix:
        """Return distance, speed and acceleration (3×periods) per unit of speed, from rest on."""
        t = self._times(SET_OFF_TIME)
        x = t / SET_OFF_TIME
        distance, change = SET_OFF_TIME * (x**3 - x**4 / 2), (6 * x - 6 * x**2) / SET_OFF_TIME
        return np.stack([distance, 3 * x**2 - 2 * x**3, change])

    def _times(self, duration: float) -> Vector:
        """Return the times [s] of the periods of a phase, its end included."""
        return np.arange(round(duration / self.dt) + 1) * self.dt

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
        self._surface = plan.tracks["press"].at(0.0).X_WD
        self._durations = {
            **{"approach": APPROACH_TIME, "press": PRESS_TIME, "wipe": plan.duration},
            **{"release": RELEASE_TIME, "lift": LIFT_TIME},
        }
        self._F_press, self._F_release = (f * _INWARD_TWIST for f in (plan.force, plan.touch_force))
        self._gains, self._landing_gains = (
            {"damping": np.array(plan.damping * factor)} for factor in (1.0, REGAIN_DAMPING)
        )

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the eraser is lifted off."""
        pressing = float(state.wrench_meas[2])
        self.contact = self._life.advance(self.contact, state.time, pressing)
        self._advance(state.time)
        if self._phase == "done":
            return None
        references: dict[str, Reference] = {"motion": self._motion(state)}
        if not self.contact.closed:
            references["force"] = EnergyReference(F_meas=state.wrench_meas)
            return Directive(self._phase, "free", references, self.contact.phase)
        references["force"] = self._press_with(state.wrench_meas)
        return Directive(self._phase, "contact", references, self.contact.phase)

    def _advance(self, time: float) -> None:
        if self._phase == "press" and self.contact.phase is not _PRESS:
            self._since = time  # the force settles anew
        elif self._is_over(time - self._since):
            order = (*self.phases, "done")
            following = order[order.index(self._phase) + 1]
            leaves = following == "lift" and self._plan.start_on_board  # a rigid board holds on
            self._phase, self._since = ("done" if leaves else following), time
        if self._phase == "touch":
            self.contact = self._life.feel(self.contact, time)
        elif self._phase == "lift":
            self.contact = self._life.lift(self.contact, time)

    def _is_over(self, t: float) -> bool:
        """Return whether the phase ends ``t`` [s] after it began."""
        if self._phase == "touch":
            return self.contact.closed
        if self._phase == "release" and not self.contact.felt:
            return True
        return t >= self._durations.get(self._phase, math.inf)

    def _press_with(self, F_meas: Wrench) -> ForceReference:
        landing = self.contact.phase is _REGAIN
        return ForceReference(
            F_ref=self._F_release if self._phase == "release" else self._F_press,
            F_meas=F_meas,
            gains=self._landing_gains if landing else self._gains,
        )

    def _motion(self, state: PlantState) -> MotionReference:
        """Return the reference of a tool aligned with the board, as deep as the board is."""
        motion = self._plan.tracks[self._phase].at(state.time - self._since)
        lost = self.contact.phase is _LOSS
        if not (lost or self._depth):
            return motion
        speed = self._search(state) if lost else 0.0
        return MotionReference(
            X_WD=motion.X_WD * pin.SE3(np.eye(3), self._depth * _INWARD),
            V_des=motion.V_des + speed * _INWARD_TWIST,
            V_dot_des=motion.V_dot_des,
        )

    def _search(self, state: PlantState) -> float:
        """Take the depth of the tool for that of a lost board; return the speed [m/s] inward."""
        normal, surface = self._surface.rotation[:, 2], self._surface.translation
        depth = float(normal @ (self._pose(state.q).translation - surface))
        if math.isfinite(depth):
            self._depth = depth
        plan = self._plan
        speed = plan.touch_speed if plan.search_speed is None else plan.search_speed
        return SEARCH_SHARE * speed if self._depth < SEARCH_DEPTH else 0.0
