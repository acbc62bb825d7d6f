"""The job of the system `wipe`: press, then run circles on the believed board.

Everything that does not depend on measurements is laid out before the run starts.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Matrix, Vector, Wrench
from qpctrl.contact import ContactLife
from qpctrl.objective import Reference
from scenarios.plant import PlantState
from scenarios.scenario import Directive

PRESS_TIME = 0.3
"""Time at rest [s], in which the force ramps up and settles."""

FORCE_RAMP = 0.1
"""Time [s] in which the set-point ramps from zero."""

SPEED_RAMP = 0.3
"""Time [s] in which the speed ramps up."""

TOUCH_SHARE = 0.05
"""Measured force over the set-point that counts as contact."""

INWARD = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])

PRESS, WIPE = "press", "wipe"
"""Phases."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Circles:
    """Circles in the x-y plane of the believed board, one row a tick, along the axes of E."""

    p: Matrix
    """Position (ticks×3) [m]."""
    v: Matrix
    """Velocity (ticks×3) [m/s]."""
    a: Matrix
    """Acceleration (ticks×3) [m/s²]."""
    cycle: int
    """Ticks of a whole circle at full speed."""
    dt: float
    """Period [s]."""


def circles(radius: float, speed: float, duration: float, dt: float) -> Circles:
    """Return circles that start at (radius, 0, 0) after `PRESS_TIME`, at rest.

    Args:
        radius: of the circles [m].
        speed: along them [m/s]; rounded so that a circle takes a whole number of ticks.
        duration: of the motion [s].
        dt: period [s].
    """
    cycle = max(round(2 * np.pi * radius / (speed * dt)), 4)
    rate = 2 * np.pi / (cycle * dt)
    t = np.arange(round((PRESS_TIME + duration) / dt)) * dt - PRESS_TIME
    x = np.clip(t / SPEED_RAMP, 0.0, 1.0)
    rise = x**3 * (10 - 15 * x + 6 * x**2)
    turned = SPEED_RAMP * x**4 * (2.5 - 3 * x + x**2) + np.maximum(t - SPEED_RAMP, 0.0)
    phi, w = rate * turned, rate * rise
    w_dot = rate * 30 * x**2 * (1 - x) ** 2 / SPEED_RAMP
    none = np.zeros_like(t)
    out = np.stack([np.cos(phi), np.sin(phi), none], axis=1)
    along = np.stack([-np.sin(phi), np.cos(phi), none], axis=1)
    return Circles(
        p=radius * out,
        v=radius * w[:, None] * along,
        a=radius * (w_dot[:, None] * along - (w**2)[:, None] * out),
        cycle=cycle,
        dt=dt,
    )


class Inputs(NamedTuple):
    """A reference that is laid out already."""

    arrays: Mapping[str, Array]
    """The task inputs that this reference sets."""


class Job(NamedTuple):
    """What there is to do, the same for all controllers."""

    X_WE: pin.SE3
    """Believed board."""
    path: Circles
    force: float
    """Set-point [N]."""

    def poses(self) -> Array:
        """Return X_WD (ticks×3×4) of a tool that is flat on the believed board."""
        R, p = self.X_WE.rotation, self.X_WE.translation
        X_WD = np.empty((len(self.path.p), 3, 4))
        X_WD[:, :, :3] = R
        X_WD[:, :, 3] = p + self.path.p @ R.T
        return X_WD

    def motions(self) -> list[dict[str, Array]]:
        """Return what a task on the tool's pose shall follow, tick by tick."""
        turn = ((0, 0), (0, 3))
        V, V_dot = np.pad(self.path.v, turn), np.pad(self.path.a, turn)
        rows = zip(self.poses(), V, V_dot, strict=True)
        return [{"X_WD": X, "V_des": V, "V_dot_des": V_dot} for X, V, V_dot in rows]

    def ramp(self) -> Vector:
        """Return the set-point (ticks) [N] as it ramps up."""
        t = np.arange(1, len(self.path.p) + 1) * self.path.dt
        return self.force * np.minimum(t / FORCE_RAMP, 1.0)


class Follow(Protocol):
    """Turns what is to do, and the measured force, into the references of one controller."""

    def references(self, tick: int, F_meas: Wrench) -> dict[str, Reference]:
        """Return the references of a tick at the measured wrench (6) [N, Nm]."""


class PressWith:
    """A motion and a force task: the pose, the set-point and the measured wrench."""

    def __init__(self, job: Job) -> None:
        self._motions = [Inputs(values) for values in job.motions()]
        self._F_ref = job.force * INWARD

    def references(self, tick: int, F_meas: Wrench) -> dict[str, Reference]:
        """Return the references of a tick."""
        reading = Inputs({"F_ref": self._F_ref, "F_meas": F_meas})
        return {"motion": self._motions[tick], "force": reading}


class PushBehind:
    """A spring towards a place so far behind the believed board that it gives the set force."""

    def __init__(self, job: Job, stiffness: float) -> None:
        """Lay out the poses of a spring of normal ``stiffness`` [N/m]."""
        motions = job.motions()
        for values, force in zip(motions, job.ramp(), strict=True):
            values["X_WD"][:, 3] += force / stiffness * values["X_WD"][:, 2]
        self._motions = [Inputs(values) for values in motions]

    def references(self, tick: int, F_meas: Wrench) -> dict[str, Reference]:
        """Return the references of a tick; the measured wrench is not used."""
        return {"motion": self._motions[tick]}


class YieldTo:
    """Admittance: a position loop whose depth moves as a damper would under the force error.

    ẋ_d = (f_d − f_meas) / B_v, with the reading low-pass filtered.
    """

    def __init__(self, job: Job, damping: float, cutoff: float) -> None:
        """Start on the board.

        Args:
            job: what there is to do.
            damping: B_v [N s/m].
            cutoff: of the filter on the reading [Hz].
        """
        self._motions, self._ramp = job.motions(), job.ramp()
        self._dt, self._B_v = job.path.dt, damping
        self._follow = 1 - math.exp(-2 * math.pi * cutoff * self._dt)
        self._depth = self._f = 0.0

    def references(self, tick: int, F_meas: Wrench) -> dict[str, Reference]:
        """Return the references of a tick."""
        self._f += self._follow * (float(F_meas[2]) - self._f)
        speed = (float(self._ramp[tick]) - self._f) / self._B_v
        self._depth += speed * self._dt
        values = self._motions[tick]
        values["X_WD"][:, 3] += self._depth * values["X_WD"][:, 2]
        values["V_des"][2] += speed
        return {"motion": Inputs(values)}


class WipeGuide:
    """Leads a controller along the job, tick by tick.

    A contact that is lost is no reason to stop: the controller keeps pressing, its integrators
    hold until the board is felt again.
    """

    def __init__(
        self, job: Job, mode: str, follow: Follow, gains: Mapping[str, Mapping[str, Array]]
    ) -> None:
        """Start at the first tick.

        Args:
            job: what there is to do.
            mode: of the controller.
            follow: what its tasks follow.
            gains: inputs of tasks and limits, by name, that hold throughout.
        """
        self._follow, self._mode, self._gains = follow, mode, gains
        self._tick, self._ticks = 0, len(job.path.p)
        self._press = round(PRESS_TIME / job.path.dt)
        self._life = ContactLife(touch_force=TOUCH_SHARE * job.force)
        self._contact = self._life.start(0.0, closed=True)

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the path is at its end."""
        tick = self._tick
        if tick == self._ticks:
            return None
        F_meas = state.wrench_meas
        self._contact = self._life.advance(self._contact, state.time, float(F_meas[2]))
        references = self._follow.references(tick, F_meas)
        if tick == 0:
            references = _merged(references, self._gains)
        self._tick = tick + 1
        phase = PRESS if tick < self._press else WIPE
        return Directive(phase, self._mode, references, self._contact.phase)


def _merged(
    references: Mapping[str, Reference], gains: Mapping[str, Mapping[str, Array]]
) -> dict[str, Reference]:
    """Return references that set gains too."""
    given = {name: reference.arrays for name, reference in references.items()}
    names = dict.fromkeys((*given, *gains))
    return {name: Inputs({**gains.get(name, {}), **given.get(name, {})}) for name in names}
