"""Force on the environment: feed-forward, PI, PI with velocity damping.

    F_cmd = F_d + K_fp F_e + K_fi ∫F_e − d Aᵀ S⁻¹ (A V − v_c),   F_e = A⁺A (F_d − F_meas)

What of the set-point lies outside A's rows cannot be pressed, so it is no error that feedback
could remove: integrated, it would leak into the rows through Λ⁻¹. The measured wrench is split
into Aᵀ λ_meas, which the constraint carries, and the rest: friction and whatever else acts
outside A's rows. The rest, low-pass filtered, is fed forward as a known external wrench; left
out, it loads the constrained rotations and tips a wiping tool.
Source: LynchPark2017 §11.5; the damping in the metric S⁻¹ is derived in docs/formulation.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, Vector, non_negative
from qpctrl.factor import Factor
from qpctrl.objective import ForceObjective, Scene, TaskExpressions
from qpctrl.space import TaskSpace
from qpctrl.spatial import SX
from tasks.energy import energy_memory, observe_energy


@final
class ForceReference:
    """The wrench to press with, and the one that is measured.

    Both act on the environment, at the origin and along the axes of the task frame.

    Attributes:
        arrays: the task inputs that this reference sets.
    """

    __slots__ = ("arrays",)

    def __init__(
        self, *, F_ref: Vector, F_meas: Vector, gains: Mapping[str, Array] | None = None
    ) -> None:
        """Describe the reference.

        Args:
            F_ref: set-point (n) [N, Nm] that the ramp runs towards.
            F_meas: measured wrench (n) [N, Nm].
            gains: inputs of the task to change from this tick on, by name; default: none.
        """
        self.arrays = {"F_ref": F_ref, "F_meas": F_meas}
        if gains:
            self.arrays.update(gains)

    @property
    def F_ref(self) -> Vector:
        """Set-point (n) [N, Nm]."""
        return self.arrays["F_ref"]

    @property
    def F_meas(self) -> Vector:
        """Measured wrench (n) [N, Nm]."""
        return self.arrays["F_meas"]


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ForceTask:
    """Press with a wrench along the constrained directions.

    K_fp = K_fi = damping = 0 is feed-forward alone; damping = 0 is PI; all of them the third
    law. With force measured one tick late on a rigid contact K_fp < 1 and
    K_fi · dt < 2 (1 − K_fp) are needed.
    """

    space: TaskSpace
    K_fp: Array | float = 0.0
    """Proportional gain (n) [1]."""
    K_fi: Array | float = 0.0
    """Integral gain (n) [1/s]."""
    damping: Array | float = 0.0
    """Velocity damping d [1/s] along A's rows, relative to the environment; one number serves
    forces and moments."""
    integral_max: Array | float = 50.0
    """Saturation of ∫F_e (n) [N s, Nm s]."""
    ramp: Array | float = 100.0
    """Fastest change of the set-point (n) [N/s, Nm/s]."""
    cutoff: Array | float = 50.0
    """Cut-off [Hz] of the filter on the wrench outside A's rows; 0 ignores that wrench."""
    name: str = "force"

    needs_reference: ClassVar[bool] = False
    """Whether there is a safe reference by default."""

    def __post_init__(self) -> None:
        n = (self.space.n,)
        shapes = {"K_fp": n, "K_fi": n, "integral_max": n, "ramp": n, "damping": (), "cutoff": ()}
        for key, shape in shapes.items():
            value = non_negative(getattr(self, key), shape, f"{self.name}.{key}")
            object.__setattr__(self, key, value)

    def inputs(self) -> dict[str, Array]:
        """Return set-point and measurement (zero) and the gains."""
        n = self.space.n
        gains = ("K_fp", "K_fi", "damping", "integral_max", "ramp", "cutoff")
        return {
            "F_ref": np.zeros(n),
            "F_meas": np.zeros(n),
            **{key: np.asarray(getattr(self, key)) for key in gains},
        }

    def memory(self) -> dict[str, Array]:
        """Return the ramped set-point, ∫F_e, the filtered external wrench, and the observer's."""
        n = self.space.n
        wrenches = {"F_des": np.zeros(n), "integral": np.zeros(n), "F_ext": np.zeros(n)}
        return {**wrenches, **energy_memory(n)}

    def objective(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> TaskExpressions:
        """Return F_cmd and the external wrench at the measurement ``u``."""
        A, V = scene.A, scene.motion.V
        step = u["ramp"] * scene.dt
        F_des = memory["F_des"] + ca.fmin(ca.fmax(u["F_ref"] - memory["F_des"], -step), step)
        carried, F_e = _along_rows(A, u["F_meas"]), _along_rows(A, F_des - u["F_meas"])
        follow = 1 - ca.exp(-2 * np.pi * u["cutoff"] * scene.dt)
        F_ext = memory["F_ext"] + follow * (u["F_meas"] - carried - memory["F_ext"])
        grown = memory["integral"] + (1 - scene.freeze) * scene.dt * F_e
        integral = ca.fmin(ca.fmax(grown, -u["integral_max"]), u["integral_max"])
        brake = A.T @ Factor(scene.S).solve(A @ V - scene.v_c) if A.shape[0] else 0 * V
        F_cmd = F_des + u["K_fp"] * F_e + u["K_fi"] * integral - u["damping"] * brake
        given = observe_energy(u["F_meas"], V, memory, scene.dt)
        return TaskExpressions(
            objective=ForceObjective(F_cmd, F_ext),
            memory={"F_des": F_des, "integral": integral, "F_ext": F_ext, **given.memory},
            signals={"F_des": F_des, "F_cmd": F_cmd, "F_ext": F_ext, "energy": given.energy},
        )


def _along_rows(A: SX, F: SX) -> SX:
    """Return A⁺A F (n) [N, Nm], the part of a wrench that the rows of A can carry."""
    return A.T @ Factor(A @ A.T).solve(A @ F) if A.shape[0] else 0 * F
