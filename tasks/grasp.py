"""Squeeze an object between two contacts with a set force.

The wrenches F₁, F₂ of the contacts on the object, each in the object's axes about its own contact,
give a total, which moves the object, and a rest that does not. Asked for is
(F₁ − F₂)/2 = f_cmd (e, 0), with e the direction from contact 1 to contact 2; so hands share forces
and moments alike, and a weight between them is carried by forces through the middle of the pads:

    f_cmd = f_des + K_fp (f_des − f_meas) + K_fi ∫(f_des − f_meas)

Source: Prattichizzo2016.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, final

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, non_negative
from qpctrl.constraint.environment import need_six_axes
from qpctrl.errors import InputError
from qpctrl.objective import GraspObjective, Scene, TaskExpressions
from qpctrl.space import TaskSpace
from qpctrl.spatial import SX, SymbolicPose


@final
class GraspForceReference:
    """The force to squeeze with, and the one that is measured.

    Attributes:
        arrays: the task inputs that this reference sets.
    """

    __slots__ = ("arrays",)

    def __init__(self, *, f_ref: float, f_meas: float) -> None:
        """Describe the reference.

        Args:
            f_ref: set-point [N] that the ramp runs towards.
            f_meas: measured internal force [N]: half of the force of contact 1 less that of
                contact 2, along the line from 1 to 2.
        """
        self.arrays = {"f_ref": np.array(float(f_ref)), "f_meas": np.array(float(f_meas))}


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class GraspForceTask:
    """Squeeze an object between two contacts, each the motion of a hand seen from the object."""

    contacts: tuple[TaskSpace, TaskSpace]
    """Spaces of the hands, ``relative_to`` the object."""
    K_fp: float = 0.0
    """Proportional gain [1]."""
    K_fi: float = 0.0
    """Integral gain [1/s]."""
    integral_max: float = 50.0
    """Saturation of the integral [N s]."""
    ramp: float = 100.0
    """Fastest change of the set-point [N/s]."""
    name: str = "grasp"
    space: None = None
    """It has a space for each contact."""

    needs_reference: ClassVar[bool] = False
    """Whether there is no safe reference by default."""

    def __post_init__(self) -> None:
        one, other = self.contacts
        for space in self.contacts:
            need_six_axes(space, "grasp")
        if one.relative_to is None or one.relative_to != other.relative_to or one == other:
            raise InputError(
                f"{self.name}: need two hands seen from one object, got {one.frame} from "
                f"{one.relative_to} and {other.frame} from {other.relative_to}"
            )
        for gain in ("K_fp", "K_fi", "integral_max", "ramp"):
            non_negative(getattr(self, gain), (), f"{self.name}.{gain}")

    def inputs(self) -> dict[str, Array]:
        """Return set-point and measurement (zero) and the gains."""
        gains = ("K_fp", "K_fi", "integral_max", "ramp")
        given = {key: np.array(float(getattr(self, key))) for key in gains}
        return {**dict.fromkeys(("f_ref", "f_meas"), np.array(0.0)), **given}

    def memory(self) -> dict[str, Array]:
        """Return the ramped set-point and the integral of its error."""
        return {"f_des": np.array(0.0), "integral": np.array(0.0)}

    def objective(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> TaskExpressions:
        """Return the commanded internal wrench at the measurement ``u``."""
        step = u["ramp"] * scene.dt
        f_des = memory["f_des"] + ca.fmin(ca.fmax(u["f_ref"] - memory["f_des"], -step), step)
        f_e = f_des - u["f_meas"]
        grown = memory["integral"] + (1 - scene.freeze) * scene.dt * f_e
        integral = ca.fmin(ca.fmax(grown, -u["integral_max"]), u["integral_max"])
        f_cmd = f_des + u["K_fp"] * f_e + u["K_fi"] * integral
        one, other = (scene.motions[space].X_WF for space in self.contacts)  # seen from the object
        way = other.p - one.p
        along = way / ca.sqrt(ca.sumsqr(way))
        E = {
            space: side / 2 * _turned(X)
            for space, X, side in zip(self.contacts, (one, other), (1.0, -1.0), strict=True)
        }
        F_cmd = ca.vertcat(f_cmd * along, ca.SX.zeros(3))
        return TaskExpressions(
            objective=GraspObjective(E, F_cmd),
            memory={"f_des": f_des, "integral": integral},
            signals={"f_des": f_des, "f_cmd": f_cmd},
        )


def _turned(X_OF: SymbolicPose) -> SX:
    """Return the map (6×6) of a wrench in F to the axes of O, about the same point."""
    return ca.diagcat(X_OF.R, X_OF.R)
