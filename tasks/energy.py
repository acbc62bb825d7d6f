"""A passivity observer: the energy that a robot gives to its environment.

    E = ∫ Fᵀ V dt,   E ← E + dt (P + P_last) / 2,   P = F_measᵀ V_last

A measured wrench is one period old. It is paired with the twist of the same instant, which is
also the one in the same frame: along the rows of a rigid constraint at rest P is then zero to
round-off, and elsewhere the sum is accurate to second order in the period.
A sensor that is late by more than that period makes the sum wrong: the wrench meets another twist.
Source: Hannaford2002.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, final

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, Vector
from qpctrl.objective import ForceObjective, Scene, TaskExpressions
from qpctrl.space import TaskSpace
from qpctrl.spatial import SX


class ObservedEnergy(NamedTuple):
    """The observer after a tick."""

    memory: dict[str, SX]
    """What the next tick needs: a part of the task's memory."""
    energy: SX
    """Energy E [J] given to the environment up to the last measured wrench."""


def energy_memory(n: int) -> dict[str, Array]:
    """Return the observer's memory: energy [J], power [W] and twist (n) of the last tick."""
    return {"energy": np.zeros(()), "power": np.zeros(()), "V_last": np.zeros(n)}


def observe_energy(F: SX, V: SX, memory: Mapping[str, SX], dt: SX) -> ObservedEnergy:
    """Return the energy after one more period.

    Ticks that send the fallback torque are not seen: their measurements cannot be believed.

    Args:
        F: measured wrench on the environment (n) [N, Nm], one period old.
        V: twist of the frame (n) [m/s, rad/s] along the same axes, now.
        memory: what `energy_memory` or the last tick returned.
        dt: period [s].
    """
    power = ca.dot(F, memory["V_last"])
    energy = memory["energy"] + dt * (power + memory["power"]) / 2
    return ObservedEnergy({"energy": energy, "power": power, "V_last": V}, energy)


@final
class EnergyReference(NamedTuple):
    """The wrench that is measured where nothing is asked of it."""

    F_meas: Vector
    """Measured wrench on the environment (n) [N, Nm], along the axes of the task frame."""

    @property
    def arrays(self) -> Mapping[str, Array]:
        """Task inputs that this reference sets."""
        return {"F_meas": self.F_meas}


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class EnergyTask:
    """Ask for nothing and observe the energy, in a mode without a force task.

    Under the name of the force task of other modes it hands the energy on from mode to mode.
    """

    space: TaskSpace
    name: str = "force"

    needs_reference: ClassVar[bool] = False
    """Whether there is no safe reference by default."""

    def inputs(self) -> dict[str, Array]:
        """Return the measurement (zero)."""
        return {"F_meas": np.zeros(self.space.n)}

    def memory(self) -> dict[str, Array]:
        """Return the observer's memory."""
        return energy_memory(self.space.n)

    def objective(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> TaskExpressions:
        """Return no wrench, and the energy at the measurement ``u``."""
        none = ca.SX.zeros(self.space.n)
        given = observe_energy(u["F_meas"], scene.motion.V, memory, scene.dt)
        return TaskExpressions(
            objective=ForceObjective(none, none),
            memory=given.memory,
            signals={"energy": given.energy},
        )
