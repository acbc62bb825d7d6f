"""The job of wiping as phases: approach, touch, press, wipe, release, lift."""

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Matrix, Vector, Wrench
from qpctrl.objective import Reference
from scenarios.path import PlanarMotion, glide, wiping_loops
from scenarios.plant import PlantState
from scenarios.scenario import Directive
from tasks import ForceReference, MotionReference

APPROACH_TIME = 1.0  # s, from home to just in front of the board
STAND_OFF = 0.006  # m, where the slow touch begins
TOUCH_SPEED = 0.02  # m/s at most; a light touch is slower
TOUCH_FORCE = 0.5  # N at most, measured, that counts as contact
LOST_TIME = 0.05  # s without force after which the tool feels for the board again
PRESS_TIME = 1.2  # s, to ramp the force and settle
RELEASE_TIME = 0.3  # s, to ramp the force down
LIFT_TIME = 0.8  # s
LIFT_DISTANCE = 0.05  # m

_REST = np.zeros(3)


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
    start_on_board: bool = False
    """Whether the tool touches the board at time 0 (exact rigid plant)."""
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
        return min(TOUCH_SPEED, 2e-3 * self.force)

    @property
    def touch_force(self) -> float:
        """Measured force [N] that counts as contact."""
        return min(TOUCH_FORCE, self.force / 10)

    @property
    def longest(self) -> float:
        """Time [s] after which the job counts as failed."""
        return self.duration + 10.0 + STAND_OFF / self.touch_speed


class WipingGuide:
    """Walks through the phases; advances on time and on measured force.

    Attributes:
        phases: their names, in order.
    """

    phases = ("approach", "touch", "press", "wipe", "release", "lift")

    def __init__(self, plan: WipingPlan) -> None:
        self._plan = plan
        self._phase = "press" if plan.start_on_board else "approach"
        self._since = self._last_felt = 0.0
        origin = plan.X_WT_home if plan.start_on_board else plan.X_WE
        self._origin, self._R_WE = origin.translation, plan.X_WE.rotation
        self._before_board = plan.p_E[0] - np.array([0.0, 0.0, STAND_OFF])
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
        if pressing > self._plan.touch_force:
            self._last_felt = state.time
        self._advance(state, felt=pressing > self._plan.touch_force)
        t = state.time - self._since
        if self._phase == "done":
            return None
        mode = "contact" if self._phase in ("press", "wipe", "release") else "free"
        references: dict[str, Reference] = {"motion": self._moves[self._phase](t)}
        if mode == "contact":
            references["force"] = ForceReference(F_ref=self._set_point(), F_meas=state.wrench_meas)
        recent = state.time - self._last_felt < LOST_TIME
        return Directive(self._phase, mode, references, mode == "free" or recent)

    def _advance(self, state: PlantState, *, felt: bool) -> None:
        t = state.time - self._since
        lost = state.time - self._last_felt > LOST_TIME
        leave = {
            "approach": t >= APPROACH_TIME,
            "touch": felt,
            "press": t >= PRESS_TIME,
            "wipe": t >= self._plan.duration,
            "release": t >= RELEASE_TIME or not felt,
            "lift": t >= LIFT_TIME,
        }
        if self._phase == "press" and lost and not self._plan.start_on_board:
            self._phase, self._since = "touch", state.time
        elif leave.get(self._phase, False):
            order = (*self.phases, "done")
            following = order[order.index(self._phase) + 1]
            leaves = following == "lift" and self._plan.start_on_board  # a rigid board holds on
            self._phase, self._since = ("done" if leaves else following), state.time

    def _set_point(self) -> Wrench:
        force = self._plan.touch_force if self._phase == "release" else self._plan.force
        return np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])

    def _approach(self, t: float) -> MotionReference:
        start = self._R_WE.T @ (self._plan.X_WT_home.translation - self._origin)
        s, s_dot, s_ddot = glide(t, APPROACH_TIME)
        way = self._before_board - start
        return self._moving(start + s * way, s_dot * way, s_ddot * way)

    def _touch(self, t: float) -> MotionReference:
        inward = np.array([0.0, 0.0, self._plan.touch_speed])
        s, s_dot, s_ddot = _set_off(t)
        return self._moving(self._before_board + s * inward, s_dot * inward, s_ddot * inward)

    def _press(self, t: float) -> MotionReference:
        return self._moving(self._plan.p_E[0])

    def _wipe(self, t: float) -> MotionReference:
        plan = self._plan
        i = min(round(t / plan.dt), len(plan.p_E) - 1)
        return self._moving(plan.p_E[i], plan.v_E[i], plan.a_E[i])

    def _release(self, t: float) -> MotionReference:
        return self._moving(self._plan.p_E[-1])

    def _lift(self, t: float) -> MotionReference:
        s, s_dot, s_ddot = glide(t, LIFT_TIME)
        way = np.array([0.0, 0.0, -LIFT_DISTANCE])
        return self._moving(self._plan.p_E[-1] + s * way, s_dot * way, s_ddot * way)

    def _moving(self, p_E: Vector, v_E: Vector = _REST, a_E: Vector = _REST) -> MotionReference:
        """Return the reference of a tool aligned with the board, moving along its axes."""
        V_des, V_dot_des = np.zeros(6), np.zeros(6)
        V_des[:3], V_dot_des[:3] = v_E, a_E
        X_WD = pin.SE3(self._R_WE, self._origin + self._R_WE @ p_E)
        return MotionReference(X_WD=X_WD, V_des=V_des, V_dot_des=V_dot_des)


def _set_off(t: float, ramp: float = 0.1) -> Vector:
    """Return distance, speed and acceleration per unit of speed, from rest to steady."""
    if t < ramp:
        x = t / ramp
        return np.array([ramp * (x**3 - x**4 / 2), 3 * x**2 - 2 * x**3, (6 * x - 6 * x**2) / ramp])
    return np.array([ramp / 2 + t - ramp, 1.0, 0.0])
