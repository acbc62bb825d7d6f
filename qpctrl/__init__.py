"""Optimization-based whole-body control for robots that move along a surface and push on it."""

from qpctrl.constraint import Constraint, FaceOnPlane, Pfaffian, PfaffianRows
from qpctrl.contact import Contact, ContactLife, ContactPhase
from qpctrl.controller import Controller
from qpctrl.errors import InputError, ModelMismatchError, QpctrlError
from qpctrl.memory import Measurement, Memory
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.report import ActiveLimit, Command, TickReport, Yield
from qpctrl.robot import Limits, Robot, from_pinocchio
from qpctrl.space import CentroidalSpace, TaskSpace
from qpctrl.status import Status
from qpctrl.urdf import from_urdf

__all__ = [
    "ActiveLimit",
    "CentroidalSpace",
    "Command",
    "Constraint",
    "Contact",
    "ContactLife",
    "ContactPhase",
    "Controller",
    "FaceOnPlane",
    "InputError",
    "Limits",
    "Measurement",
    "Memory",
    "Mode",
    "ModelMismatchError",
    "Pfaffian",
    "PfaffianRows",
    "QpctrlError",
    "Robot",
    "Status",
    "TaskSpace",
    "TickReport",
    "Weighted",
    "Yield",
    "from_pinocchio",
    "from_urdf",
]
