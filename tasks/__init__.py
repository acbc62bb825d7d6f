"""What to do with the freedom that a constraint leaves: one task per file, all of them here."""

from tasks.admittance import AdmittanceReference, AdmittanceTask
from tasks.centre_of_mass import CentreOfMassReference, CentreOfMassTask
from tasks.energy import EnergyReference, EnergyTask
from tasks.force import ForceReference, ForceTask
from tasks.grasp import GraspForceReference, GraspForceTask
from tasks.impedance import ImpedanceReference, ImpedanceTask
from tasks.momentum import MomentumReference, MomentumTask
from tasks.motion import MotionTask
from tasks.pose_error import MotionReference
from tasks.posture import PostureReference, PostureTask

__all__ = [
    "AdmittanceReference",
    "AdmittanceTask",
    "CentreOfMassReference",
    "CentreOfMassTask",
    "EnergyReference",
    "EnergyTask",
    "ForceReference",
    "ForceTask",
    "GraspForceReference",
    "GraspForceTask",
    "ImpedanceReference",
    "ImpedanceTask",
    "MomentumReference",
    "MomentumTask",
    "MotionReference",
    "MotionTask",
    "PostureReference",
    "PostureTask",
]
