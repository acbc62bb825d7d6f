"""Natural constraints of the environment: one class per file, all of them here."""

from qpctrl.constraint.face_on_plane import FaceOnPlane
from qpctrl.constraint.pfaffian import Constraint, Pfaffian, PfaffianRows, row_function
from qpctrl.constraint.selection import Selection

__all__ = ["Constraint", "FaceOnPlane", "Pfaffian", "PfaffianRows", "Selection", "row_function"]
