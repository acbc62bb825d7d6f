"""What a tick says about itself: how its torque relates to the closed forms, and why."""

import math
from typing import NamedTuple

import numpy as np

from qpctrl.arrays import Array, Vector
from qpctrl.contact import ContactPhase
from qpctrl.contact_report import ContactPlace, ContactReport
from qpctrl.explanation import KINDS
from qpctrl.gives import Give
from qpctrl.layout import Layout
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


ACTIVE_DUAL = 1e-8
"""A row counts as active when its dual is larger than this."""


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


class ReportFormat(NamedTuple):
    """What the numbers of the reports of one mode are."""

    mode: str
    layout: Layout
    """Names and places of the numbers, as `qpctrl.outcome` lists them."""
    owners: tuple[str, ...]
    """What each inequality of the QP belongs to."""
    gives: tuple[Give, ...]
    """Which of the numbers ``give`` belong to which task."""
    has_law: bool
    """Whether closed forms exist."""
    contacts: tuple[ContactPlace, ...] = ()
    """Which of the numbers ``wrench`` and ``margin`` belong to which contact."""


class TickReport(NamedTuple):
    """One tick, explained. Gaps are relative: max |Δτ| / max |τ|.

    All that it says is read out of ``numbers`` when it is asked for.
    """

    format: ReportFormat
    """Names of what the numbers are."""
    numbers: Vector
    """The numbers of the tick in the order of ``format.layout``; NaN where it has no solution."""
    status: Status
    contact: ContactPhase = ContactPhase.PRESS
    """Phase of the contact, as measured."""
    limited: bool = False
    """Whether a limit binds."""
    dependent_rows: tuple[str, ...] = ()
    """Rows of A that depend on others, where that is why there is no solution."""

    @property
    def time(self) -> float:
        """Time of the measurement [s]."""
        return float(self._of("time")[0])

    @property
    def mode(self) -> str:
        """Name of the mode."""
        return self.format.mode

    @property
    def tau_qp(self) -> Vector:
        """Torque of the QP (nu) [Nm]; NaN when there is none."""
        return self._of("tau_qp")

    @property
    def tau_solver(self) -> Vector:
        """Torque of the solver's own answer (nu) [Nm], before the polish.

        Its last bits may differ from run to run, so it is in no record.
        """
        return self._of("tau_solver")

    @property
    def tau_hybrid(self) -> Vector:
        """Torque of the hybrid law (nu) [Nm], or of the equality-constrained QP without one."""
        return self._of("tau_hybrid")

    @property
    def tau_textbook(self) -> Vector:
        """Torque of the law as printed (nu) [Nm]."""
        return self._of("tau_textbook")

    @property
    def lam(self) -> Vector:
        """Contact multipliers (k) [N, Nm], robot on environment."""
        return self._of("lam")

    @property
    def kkt(self) -> Vector:
        """Residuals (4): stationarity, equality, inequality, complementarity."""
        return self._of("kkt")

    @property
    def law_gap(self) -> float:
        """QP against the hybrid law."""
        return float(self._of("gaps")[0])

    @property
    def textbook_gap(self) -> float:
        """QP against the law as printed; NaN where there is none."""
        return self._law_number(1)

    @property
    def unexplained_gap(self) -> float:
        """QP against the law as printed, less the curvature term; NaN where there is none."""
        return self._law_number(2)

    @property
    def curvature(self) -> float:
        """The curvature term Jᵀ Aᵀ S⁻¹ (Ȧ V − v̇_c), relative like the gaps; NaN without a law."""
        return self._law_number(3)

    @property
    def damping(self) -> float:
        """Damping μ of Λ⁻¹ near a singularity [1/kg]; equality is not claimed where it is not 0."""
        return float(self._of("damping")[0])

    @property
    def signals(self) -> Array:
        """Recorded quantities, packed in the order of ``Tick.signals``."""
        return self._of("signals")

    @property
    def active(self) -> tuple[ActiveLimit, ...]:
        """The rows of the QP that bind."""
        if not self.limited:
            return ()
        z, kind = self._of("z"), self._of("kind")
        rows = np.flatnonzero(np.abs(z) > ACTIVE_DUAL).tolist()
        return tuple(
            ActiveLimit(f"{KINDS[int(kind[i])]} {self.format.owners[i]}", float(z[i])) for i in rows
        )

    @property
    def contacts(self) -> tuple[ContactReport, ...]:
        """What each contact carries; empty for a single one without limits, which is ``lam``."""
        wrench, margin = self._of("wrench"), self._of("margin")
        binding = [limit.name.partition(" ")[2] for limit in self.active]
        return tuple(
            ContactReport(
                place.name,
                place.axes,
                wrench[place.wrench],
                dict(zip(place.limits, margin[place.margins].tolist(), strict=True)),
                place.units,
                tuple(row for row in binding if row.rpartition(".")[0] in place.owners),
            )
            for place in self.format.contacts
        )

    @property
    def yields(self) -> tuple[Yield, ...]:
        """What each task lost; empty while no limit is active."""
        if not self.limited:
            return ()
        give = self._of("give")
        return tuple(Yield(of.task, give[of.rows], of.axes, of.units) for of in self.format.gives)

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
        return self.limited

    def explain(self) -> str:
        """Return in words why the torque is what it is."""
        contact = [CONTACT_WORDS[self.contact]] if self.contact in CONTACT_WORDS else []
        if self.status is not Status.OK:
            rows = f": {', '.join(self.dependent_rows)}" if self.dependent_rows else ""
            return "; ".join([f"fallback torque: {self.status.value}{rows}", *contact])
        law = "hybrid law" if self.format.has_law else "KKT solution"
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

    def _of(self, name: str) -> Vector:
        return self.numbers[self.format.layout.place(name)]

    def _law_number(self, i: int) -> float:
        return float(self._of("gaps")[i]) if self.format.has_law else math.nan
