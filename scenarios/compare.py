"""QP against the closed forms over random states: the equivalence table.

For every arm and every number k of constraint rows: random configurations, velocities, turning
and moving constraints (Ȧ V ≠ 0, v̇_c ≠ 0), references, measured wrenches and weights over four
decades. First without limits, where the QP must equal the hybrid law; then with torque limits
that bind, where the certificate and a second solver must agree.
"""

from collections.abc import Callable, Iterator

from qpctrl.compiled import CompileMode
from qpctrl.errors import InputError
from qpctrl.spatial import AXES
from scenarios.comparison import Comparison
from scenarios.equivalence import Case, Row

CASES = (
    Case("planar_2r", ("vx", "vy"), 1),
    *(Case(robot, AXES, k) for robot in ("ur5", "fr3") for k in (0, 1, 3, 5, 6)),
)
"""What `compare` runs."""


def compare(
    *,
    states: int = 1000,
    solver: str = "active-set",
    second: str = "proxsuite",
    form: str = "reduced",
    compiled: CompileMode = "no",
    seed: int = 0,
    cases: tuple[Case, ...] = CASES,
    watch: Callable[[Case, int], None] | None = None,
) -> Iterator[Row]:
    """Yield one row of the table for each case.

    Args:
        states: random states for each case.
        solver: solver under test.
        second: solver to agree with where limits are active.
        form: ``reduced`` or ``full``.
        compiled: whether the ticks under test are compiled; each then runs interpreted as well.
        seed: seed of the states.
        cases: arms and numbers of rows.
        watch: called with the case and the states done, now and then.
    """
    if states < 1:
        raise InputError(f"states: got {states}, need a number >= 1")
    for case in cases:
        yield Comparison(case, solver, second, form, compiled, seed).run(states, watch)
