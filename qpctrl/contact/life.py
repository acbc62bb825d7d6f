"""The life of a contact: approach, touch, press, and what follows when it is lost."""

import math
from dataclasses import dataclass
from typing import NamedTuple, final

from qpctrl.arrays import finite_array, non_negative, positive
from qpctrl.contact.phase import ContactPhase

ROUND_OFF = 1e-9
"""Time [s] by which a sum of periods may fall short of their total."""


class Contact(NamedTuple):
    """Where one contact is in its life, and how it got there."""

    phase: ContactPhase
    since: float
    """Time [s] at which the phase began."""
    time: float
    """Time [s] of the last news."""
    felt_at: float
    """Time [s] at which the environment was felt last; −∞ before the first touch."""
    losses: int = 0
    """How often the contact was lost so far."""

    @property
    def closed(self) -> bool:
        """Whether force can be exchanged."""
        return self.phase.closed

    @property
    def felt(self) -> bool:
        """Whether the environment was felt at the last news."""
        return self.felt_at == self.time

    def explain(self) -> str:
        """Return in words where the contact is."""
        lost = f"; losses so far: {self.losses}" if self.losses else ""
        return f"{self.phase.name} since {self.since:.3f} s: {self.phase.value}{lost}"


@final
@dataclass(frozen=True, kw_only=True)
class ContactLife:
    """How the phases of a contact follow each other.

    APPROACH → TOUCH when told to `feel`; TOUCH → PRESS when felt; PRESS → LOSS when nothing was
    felt for ``loss_time``; LOSS → REGAIN when felt; REGAIN → PRESS after ``regain_time``, or
    → LOSS again; and from each of them → APPROACH when told to `lift`. At most one step at a
    time; nothing is hidden: the same contact and the same news give the same answer.

    A measured force that is not finite counts as nothing felt. News that are older than the
    last, or at no finite time, change nothing.
    """

    touch_force: float = 0.5
    """Force into the environment [N] that counts as felt."""
    loss_time: float = 0.05
    """Time without that force [s] after which the contact counts as lost."""
    regain_time: float = 0.2
    """Time that a regained contact must hold [s] before it counts as pressing again."""

    def __post_init__(self) -> None:
        positive(self.touch_force, (), "touch_force")
        positive(self.loss_time, (), "loss_time")
        non_negative(self.regain_time, (), "regain_time")

    def start(self, time: float, *, closed: bool = False) -> Contact:
        """Return a contact at ``time`` [s] that approaches, or presses already if ``closed``.

        Raises:
            InputError: the time is not finite.
        """
        now = float(finite_array(time, (), "time"))
        if closed:
            return Contact(ContactPhase.PRESS, since=now, time=now, felt_at=now)
        return Contact(ContactPhase.APPROACH, since=now, time=now, felt_at=-math.inf)

    def feel(self, contact: Contact, time: float) -> Contact:
        """Return the contact told to feel for the surface; only one that approaches obeys."""
        if contact.phase is not ContactPhase.APPROACH or not _is_news(contact, time):
            return contact
        return _enter(contact._replace(time=time), ContactPhase.TOUCH)

    def lift(self, contact: Contact, time: float) -> Contact:
        """Return the contact told to let go: it approaches again."""
        if contact.phase is ContactPhase.APPROACH or not _is_news(contact, time):
            return contact
        return _enter(contact._replace(time=time), ContactPhase.APPROACH)

    def advance(self, contact: Contact, time: float, pressing: float) -> Contact:
        """Return the contact after the news of one tick.

        Args:
            contact: what `start`, `feel`, `lift` or the last tick returned.
            time: time of the measurement [s].
            pressing: measured force into the environment [N].
        """
        if not _is_news(contact, time):
            return contact
        felt = math.isfinite(pressing) and pressing >= self.touch_force
        contact = contact._replace(time=time, felt_at=time if felt else contact.felt_at)
        if contact.phase is ContactPhase.TOUCH and felt:
            return _enter(contact, ContactPhase.PRESS)
        if contact.phase is ContactPhase.LOSS and felt:
            return _enter(contact, ContactPhase.REGAIN)
        if contact.closed and _age(time, contact.felt_at) >= self.loss_time:
            return _enter(contact._replace(losses=contact.losses + 1), ContactPhase.LOSS)
        held = felt and _age(time, contact.since) >= self.regain_time
        if contact.phase is ContactPhase.REGAIN and held:
            return _enter(contact, ContactPhase.PRESS)
        return contact


def _is_news(contact: Contact, time: float) -> bool:
    return math.isfinite(time) and time >= contact.time


def _enter(contact: Contact, phase: ContactPhase) -> Contact:
    return contact._replace(phase=phase, since=contact.time)


def _age(time: float, since: float) -> float:
    return time - since + ROUND_OFF
