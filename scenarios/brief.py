"""A brief record: of each tick the numbers that a rollout is judged by, and few words.

Its columns have the names of the full record (`scenarios.record`) and the same values.
"""

from qpctrl.controller import Controller
from scenarios.record import Record

QUANTITIES = (
    *("phase", "contact", "status", "fallback", "touching", "saturated"),
    *("time", "law_gap", "textbook_gap", "curvature", "kkt_residual"),
    *("q", "v", "wrench_meas", "wrench", "signals"),
)


class BriefRecord(Record):
    """Collects the state, the wrenches and the tasks' signals of every tick."""

    def __init__(self, controller: Controller) -> None:
        """Prepare the columns for the modes of ``controller``."""
        super().__init__(controller, only=QUANTITIES)
