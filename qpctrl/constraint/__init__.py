"""Natural constraints of the environment: one class per file, all of them here."""

from qpctrl.constraint.crank import Crank
from qpctrl.constraint.drawer import Drawer
from qpctrl.constraint.edge_on_plane import EdgeOnPlane
from qpctrl.constraint.embedded import Embedded
from qpctrl.constraint.face_on_plane import FaceOnPlane
from qpctrl.constraint.hinge import Hinge
from qpctrl.constraint.moving import EnvironmentMotion, Moving
from qpctrl.constraint.pfaffian import Constraint, Pfaffian, PfaffianRows, row_function
from qpctrl.constraint.point_on_plane import PointOnPlane
from qpctrl.constraint.pose_constraint import PoseConstraint
from qpctrl.constraint.screw import Screw
from qpctrl.constraint.selection import Selection
from qpctrl.constraint.surface import Surface, cylinder, saddle, sphere

__all__ = [
    "Constraint",
    "Crank",
    "Drawer",
    "EdgeOnPlane",
    "Embedded",
    "EnvironmentMotion",
    "FaceOnPlane",
    "Hinge",
    "Moving",
    "Pfaffian",
    "PfaffianRows",
    "PointOnPlane",
    "PoseConstraint",
    "Screw",
    "Selection",
    "Surface",
    "cylinder",
    "row_function",
    "saddle",
    "sphere",
]
