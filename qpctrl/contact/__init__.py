"""Limits on what a contact can carry: one class per file, all of them here."""

from qpctrl.contact.footprint import Footprint
from qpctrl.contact.friction_cone import FrictionCone
from qpctrl.contact.max_force import MaxForce
from qpctrl.contact.wrench_limit import WrenchLimit, WrenchRows

__all__ = ["Footprint", "FrictionCone", "MaxForce", "WrenchLimit", "WrenchRows"]
