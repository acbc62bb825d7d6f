"""What a tick says about itself: how its torque relates to the closed forms, and why."""

from typing import NamedTuple

import numpy as np

from qpctrl.arrays import Array, Vector
from qpctrl.contact import ContactPhase
from qpctrl.status import Status

TINY_TORQUE = 1e-9
"""Torque [Nm] below which gaps are not relative to the torque any more."""

NEGLIGIBLE = 1e-9
"""What a task gave way, in its own unit, below which `explain` is silent."""

CONTACT_WORDS = {
    ContactPhase.LOSS: f"contact lost: {ContactPhase.LOSS.value}",
    ContactPhase.REGAIN: f"contact regained: {ContactPhase.REGAIN.value}",
}
"""What `explain` says of a contact; of the other phases nothing."""


class ActiveLimit(NamedTuple):
    """A row of the QP that binds."""

    name: str
    """``torque JOINT``, ``torque-speed JOINT``, ``torque rate JOINT``, ``position JOINT``,
    ``velocity JOINT``, ``unilateral ROW`` or ``contact LIMIT.ROW``."""
    dual: float
    """Its multiplier; positive on an upper bound, negative on a lower one. The unit is that of
    the cost [N²/kg] over that of the row."""


class Yield(NamedTuple):
    """How far one task gave way, against what the closed form would have given it."""

    task: str
    """Its name; ``slack`` for the constraints of a mode with slack, whose axes are their rows."""
    amount: Vector
    """Difference for each axis or joint of the task."""
    axes: tuple[str, ...]
    """Name of each axis or joint."""
    units: tuple[str, ...]
    """Unit of each."""

    def largest(self) -> tuple[str, float, str]:
        """Return axis, amount and unit of the largest difference."""
        i = int(np.abs(self.amount).argmax())
        return self.axes[i], float(self.amount[i]), self.units[i]


class Command(NamedTuple):
    """What to send to the joints."""

    tau: Vector
    """Torque (nu) [Nm]."""
    fallback: bool
    """Whether this is the fallback torque."""


class TickReport(NamedTuple):
    """One tick, explained. Gaps are relative: max |Δτ| / max |τ|."""

    time: float
    """Time of the measurement [s]."""
    mode: str
    status: Status
    tau_qp: Vector
    """Torque of the QP (nu) [Nm]; NaN when there is none."""
    tau_solver: Vector
    """Torque of the solver's own answer (nu) [Nm], before the polish. Its last bits may differ
    from run to run, so it is in no record."""
    tau_hybrid: Vector
    """Torque of the hybrid law (nu) [Nm], or of the equality-constrained QP without one."""
    tau_textbook: Vector
    """Torque of the law as printed (nu) [Nm]."""
    lam: Vector
    """Contact multipliers (k) [N, Nm], robot on environment."""
    kkt: Vector
    """Residuals (4): stationarity, equality, inequality, complementarity."""
    law_gap: float
    """QP against the hybrid law."""
    textbook_gap: float
    """QP against the law as printed."""
    unexplained_gap: float
    """QP against the law as printed, less the curvature term."""
    curvature: float
    """The curvature term Jᵀ Aᵀ S⁻¹ (Ȧ V − v̇_c), relative like the gaps."""
    active: tuple[ActiveLimit, ...]
    yields: tuple[Yield, ...]
    """What each task lost; empty while no limit is active."""
    damping: float
    """Damping μ of Λ⁻¹ near a singularity [1/kg]; equality is not claimed where it is not 0."""
    dependent_rows: tuple[str, ...]
    signals: Array
    """Recorded quantities, packed in the order of ``Tick.signals``."""
    contact: ContactPhase = ContactPhase.PRESS
    """Phase of the contact, as measured."""

    @property
    def kkt_residual(self) -> float:
        """Largest of the four residuals."""
        return float(max(self.kkt.tolist()))

    @property
    def solver_gap(self) -> float:
        """The solver's own torque against that of the polished solution."""
        largest = max(float(np.abs(self.tau_qp).max()), TINY_TORQUE)
        return float(np.abs(self.tau_solver - self.tau_qp).max()) / largest

    @property
    def saturated(self) -> bool:
        """Whether a limit binds."""
        return bool(self.active)

    def explain(self) -> str:
        """Return in words why the torque is what it is."""
        contact = [CONTACT_WORDS[self.contact]] if self.contact in CONTACT_WORDS else []
        if self.status is not Status.OK:
            rows = f": {', '.join(self.dependent_rows)}" if self.dependent_rows else ""
            return "; ".join([f"fallback torque: {self.status.value}{rows}", *contact])
        law = "KKT solution" if np.isnan(self.curvature) else "hybrid law"
        said = [f"QP = {law} to {self.law_gap:.1e}"] if not self.active else []
        for limit in self.active:
            side = "upper" if limit.dual > 0 else "lower"
            said.append(f"{limit.name} at its {side} limit (dual {abs(limit.dual):.3g})")
        for lost in self.yields:
            axis, amount, unit = lost.largest()
            if abs(amount) > NEGLIGIBLE:
                who = lost.task if lost.task == "slack" else f"task {lost.task}"
                said.append(f"{who} gave way by {amount:+.3g} {unit} along {axis}")
        if self.curvature > 1e-12:
            said.append(
                f"textbook law differs by its curvature term, {self.curvature:.1e} of max |τ|"
            )
        if self.damping:
            said.append(
                f"near a singularity: Λ damped by μ = {self.damping:.2g}, no equality claimed"
            )
        return "; ".join([*said, *contact])
