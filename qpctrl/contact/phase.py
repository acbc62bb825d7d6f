"""The life of a contact as a state that a user can read."""

from enum import Enum


class ContactPhase(Enum):
    """Where a contact is in its life."""

    APPROACH = "moving freely towards the surface"
    TOUCH = "feeling for the surface, slowly"
    PRESS = "pressing with the set force"
    LOSS = "nothing felt where the contact was; feeling for it again"
    REGAIN = "felt again; the force ramps up anew"

    closed: bool
    """Whether force can be exchanged, so that integrators may run."""

    def __init__(self, _: str) -> None:
        self.closed = self.name in ("PRESS", "REGAIN")
