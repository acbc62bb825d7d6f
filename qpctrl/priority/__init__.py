"""Strict priorities: lexicographic QPs with limits, to round-off."""

from qpctrl.priority.priorities import Attained, Level, Priorities, Ranked

__all__ = ["Attained", "Level", "Priorities", "Ranked"]
