"""What to do with the freedom that a constraint leaves: one task per file, all of them here."""

from tasks.force import ForceReference, ForceTask
from tasks.motion import MotionReference, MotionTask
from tasks.posture import PostureReference, PostureTask

__all__ = [
    "ForceReference",
    "ForceTask",
    "MotionReference",
    "MotionTask",
    "PostureReference",
    "PostureTask",
]
