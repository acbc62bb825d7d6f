"""Outcomes of a tick; the text of each is the advice."""

from enum import Enum


class Status(Enum):
    """What happened at a tick. Every outcome but OK sends the fallback torque."""

    OK = "solved to the demanded accuracy"
    INACCURATE = "the solver missed the demanded accuracy; try another solver or lower gains"
    INFEASIBLE = "no torque within the limits satisfies the constraint; relax a limit or slow down"
    NOT_FINITE = "a measurement or reference is not finite; check the sensors"
    STALE = "the measurement is not newer than the last one; check the communication"
    DEPENDENT_ROWS = "rows of A depend on each other; drop the named rows or refuse the mode"


LIMITED = 1
"""Code of a tick that is solved with a limit active; below it none is, above there is no answer."""

BY_CODE = (
    Status.OK,
    Status.OK,
    Status.INACCURATE,
    Status.INFEASIBLE,
    Status.NOT_FINITE,
    Status.STALE,
    Status.DEPENDENT_ROWS,
)
"""What the codes of ``native/tick.h`` mean."""
