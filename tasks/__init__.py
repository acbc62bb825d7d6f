"""What to do with the freedom that a constraint leaves: one task per file, all of them here."""

from tasks.admittance import AdmittanceReference, AdmittanceTask
from tasks.energy import EnergyReference, EnergyTask
from tasks.force import ForceReference, ForceTask
from tasks.impedance import ImpedanceReference, ImpedanceTask
from tasks.motion import MotionTask
from tasks.pose_error import MotionReference
from tasks.posture import PostureReference, PostureTask

__all__ = [
    "AdmittanceReference",
    "AdmittanceTask",
    "EnergyReference",
    "EnergyTask",
    "ForceReference",
    "ForceTask",
    "ImpedanceReference",
    "ImpedanceTask",
    "MotionReference",
    "MotionTask",
    "PostureReference",
    "PostureTask",
]
