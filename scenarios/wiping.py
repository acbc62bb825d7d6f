"""The job of wiping as phases: approach, touch, press, wipe, release, lift."""

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector, Wrench
from qpctrl.objective import Reference
from scenarios.path import PlanarMotion, glide, wiping_loops
from scenarios.plant import PlantState
from scenarios.scenario import Directive
from tasks import ForceReference, MotionReference

APPROACH_TIME = 1.0  # s, from home to just in front of the board
STAND_OFF = 0.006  # m, where the slow touch begins
TOUCH_SPEED = 0.02  # m/s
TOUCH_FORCE = 0.5  # N, measured, that counts as contact
LOST_TIME = 0.05  # s without force after which the tool feels for the board again
PRESS_TIME = 1.2  # s, to ramp the force and settle
RELEASE_TIME = 0.3  # s, to ramp the force down
LIFT_TIME = 0.8  # s
LIFT_DISTANCE = 0.05  # m


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

    def __post_init__(self) -> None:
        loops = wiping_loops(self.speed, self.duration, self.dt)
        if self.start_on_board:
            loops = loops._replace(p=loops.p - loops.p[0])
        object.__setattr__(self, "loops", loops)


class WipingGuide:
    """Walks through the phases; advances on time and on measured force.

    Attributes:
        phases: their names, in order.
    """

    phases = ("approach", "touch", "press", "wipe", "release", "lift")

    def __init__(self, plan: WipingPlan) -> None:
        self._plan = plan
        self._phase = "press" if plan.start_on_board else "approach"
        self._since = 0.0
        self._last_felt = 0.0
        self._lift_from = plan.X_WT_home
        start = plan.X_WT_home if plan.start_on_board else plan.X_WE
        self._origin = start.translation
        self._R_WE = plan.X_WE.rotation
        self._tool_pose = plan.X_WT_home

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the eraser is lifted off."""
        pressing = float(state.wrench_meas[2])
        if pressing > TOUCH_FORCE:
            self._last_felt = state.time
        self._advance(state, pressing)
        t = state.time - self._since
        if self._phase == "done":
            return None
        mode = "contact" if self._phase in ("press", "wipe", "release") else "free"
        references: dict[str, Reference] = {"motion": getattr(self, f"_{self._phase}")(t)}
        if mode == "contact":
            references["force"] = ForceReference(F_ref=self._set_point(), F_meas=state.wrench_meas)
        felt = state.time - self._last_felt < LOST_TIME
        return Directive(self._phase, mode, references, mode == "free" or felt)

    def _advance(self, state: PlantState, pressing: float) -> None:
        t, felt = state.time - self._since, pressing > TOUCH_FORCE
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
            self._enter("touch", state)
        elif self._phase in leave and leave[self._phase]:
            order = (*self.phases, "done")
            self._enter(order[order.index(self._phase) + 1], state)

    def _enter(self, phase: str, state: PlantState) -> None:
        self._phase, self._since = phase, state.time
        if phase == "release":
            self._release_from = state.time

    def _set_point(self) -> Wrench:
        force = TOUCH_FORCE if self._phase == "release" else self._plan.force
        return np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])

    def _approach(self, t: float) -> MotionReference:
        start = self._plan.X_WT_home.translation
        goal = self._on_board(self._plan.loops.p[0], -STAND_OFF)
        s, s_dot, s_ddot = glide(t, APPROACH_TIME)
        way = goal - start
        return self._moving(start + s * way, s_dot * way, s_ddot * way)

    def _touch(self, t: float) -> MotionReference:
        inward = self._R_WE[:, 2]
        start = self._on_board(self._plan.loops.p[0], -STAND_OFF)
        reached = TOUCH_SPEED * glide_in(t)
        return self._moving(start + reached[0] * inward, reached[1] * inward, reached[2] * inward)

    def _press(self, t: float) -> MotionReference:
        return self._moving(self._on_board(self._plan.loops.p[0], 0.0))

    def _wipe(self, t: float) -> MotionReference:
        loops = self._plan.loops
        i = min(round(t / self._plan.dt), len(loops.p) - 1)
        x, y = self._R_WE[:, 0], self._R_WE[:, 1]
        v, a = loops.v[i], loops.a[i]
        return self._moving(
            self._on_board(loops.p[i], 0.0), v[0] * x + v[1] * y, a[0] * x + a[1] * y
        )

    def _release(self, t: float) -> MotionReference:
        return self._moving(self._on_board(self._plan.loops.p[-1], 0.0))

    def _lift(self, t: float) -> MotionReference:
        start, outward = self._on_board(self._plan.loops.p[-1], 0.0), -self._R_WE[:, 2]
        s, s_dot, s_ddot = glide(t, LIFT_TIME)
        way = LIFT_DISTANCE * outward
        return self._moving(start + s * way, s_dot * way, s_ddot * way)

    def _on_board(self, point: Vector, depth: float) -> Vector:
        R = self._R_WE
        return self._origin + point[0] * R[:, 0] + point[1] * R[:, 1] + depth * R[:, 2]

    def _moving(
        self, p: Vector, v: Vector | None = None, a: Vector | None = None
    ) -> MotionReference:
        R = self._R_WE
        zero = np.zeros(3)
        v_D = zero if v is None else R.T @ v
        a_D = zero if a is None else R.T @ a
        return MotionReference(
            X_WD=pin.SE3(R, p), V_des=np.r_[v_D, zero], V_dot_des=np.r_[a_D, zero]
        )


def glide_in(t: float) -> Vector:
    """Return distance, speed and acceleration per unit speed, from rest to steady in 0.1 s."""
    ramp = 0.1
    if t < ramp:
        x = t / ramp
        return np.array([ramp * (x**3 - x**4 / 2), 3 * x**2 - 2 * x**3, (6 * x - 6 * x**2) / ramp])
    return np.array([ramp / 2 + t - ramp, 1.0, 0.0])
