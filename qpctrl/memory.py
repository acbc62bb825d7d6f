"""What a tick reads, and what it hands to the next."""

import math
from typing import NamedTuple

import numpy as np

from qpctrl.arrays import Vector
from qpctrl.contact import ContactPhase


class Measurement(NamedTuple):
    """What the sensors say at one tick."""

    time: float
    """Time of the measurement [s]; each must be later than the one before."""
    q: Vector
    """Configuration (nq) [rad or m]."""
    v: Vector
    """Velocity (nv) [rad/s or m/s]."""
    contact: ContactPhase = ContactPhase.PRESS
    """Phase of the contact; in a mode with constraints integrators hold unless it is closed."""


class Memory(NamedTuple):
    """What one tick hands to the next."""

    mode: str
    packed: Vector
    """``tau``, ``q`` and ``x``, one after the other; what may follow is not remembered."""
    sizes: tuple[int, int, int]
    """Their lengths."""
    time: float
    """Time of the last good measurement [s]."""
    contact: ContactPhase = ContactPhase.PRESS
    """Phase of the contact at the last tick."""
    freeze: bool = False
    """Whether integrators hold at the next tick."""
    fallback_ticks: int = 0
    """Ticks so far that sent the fallback torque."""

    @property
    def tau(self) -> Vector:
        """Torque sent last (nu) [Nm]."""
        return self.packed[: self.sizes[0]]

    @property
    def q(self) -> Vector:
        """Configuration of the last good measurement (nq) [rad or m]."""
        return self.packed[self.sizes[0] : sum(self.sizes[:2])]

    @property
    def x(self) -> Vector:
        """Memory of the mode's tasks, packed as ``Tick.memory`` says."""
        return self.packed[sum(self.sizes[:2]) : sum(self.sizes)]


def remember(mode: str, tau: Vector, q: Vector, x: Vector, time: float = -math.inf) -> Memory:
    """Return the memory of a controller that has sent ``tau`` (nu) [Nm] in ``q`` (nq)."""
    return Memory(mode, np.concatenate((tau, q, x)), (len(tau), len(q), len(x)), time)
