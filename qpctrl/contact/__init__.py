"""Contacts: their life from touch to loss, and limits on what they can carry."""

from qpctrl.contact.footprint import Footprint
from qpctrl.contact.friction_cone import FrictionCone
from qpctrl.contact.life import Contact, ContactLife
from qpctrl.contact.max_force import MaxForce
from qpctrl.contact.phase import ContactPhase
from qpctrl.contact.torsional_friction import TorsionalFriction
from qpctrl.contact.wrench_limit import WrenchLimit, WrenchRows

__all__ = [
    "Contact",
    "ContactLife",
    "ContactPhase",
    "Footprint",
    "FrictionCone",
    "MaxForce",
    "TorsionalFriction",
    "WrenchLimit",
    "WrenchRows",
]
