"""How far a peer's answers are from ours, and why."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from qpctrl.arrays import Matrix, Vector
from scenarios.bench.peers.folder import Course, terms
from scenarios.bench.peers.ours import Answer
from scenarios.bench.peers.run import PeerCourse

AT_LIMIT = 1e-4
"""Share of a limit within which a torque is on it."""


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Largest differences from our answer, over all ticks of a variant that the peer solved."""

    peer: str
    variant: str
    torque_Nm: float
    torque_beyond_elbow_Nm: float
    """What is left of it without the part that moves the joints but not the tool."""
    force_N: float
    turn: float
    """Of the tool's angular acceleration [rad/s²]."""
    rest: float
    """Of the acceleration of the point that rests [m/s²]."""
    limited: float
    """Share of the ticks in which a torque is on its limit."""
    ours_limited: float
    """The same of ours."""
    beyond_limit_Nm: float
    """How far a torque goes beyond its limit."""
    dearer_least: float
    """Smallest excess of what its answer costs in our QP over ours [N²/kg]; below zero it would
    be the better one."""
    dearer_most: float
    """The largest excess."""
    unsolved: int
    """Ticks without a solution."""


class _Gap(NamedTuple):
    torque: float
    beyond_elbow: float
    force: float
    turn: float
    rest: float
    dearer: float


def agreement(
    peer: str, variant: str, course: Course, free: Answer, given: PeerCourse
) -> Agreement:
    """Return how far a peer is from us.

    Args:
        peer: its name.
        variant: its name.
        course: the variant, and our answer.
        free: our answer without limits, which gives every task what it asks for.
        given: the peer's, in the order of the course's ticks.
    """
    problem, ours = course.problem, course.answer
    solved = np.flatnonzero(given.solved[: problem.ticks])
    gaps = [_gap(course, free, given.answer, int(i)) for i in solved]
    worst = _Gap(*(np.array(gaps).max(axis=0) if gaps else np.full(6, np.nan)).tolist())
    tau_max = problem.robot.limits.tau_max
    theirs = given.answer.tau[solved]
    return Agreement(
        peer=peer,
        variant=variant,
        torque_Nm=worst.torque,
        torque_beyond_elbow_Nm=worst.beyond_elbow,
        force_N=worst.force,
        turn=worst.turn,
        rest=worst.rest,
        limited=_share_limited(theirs, tau_max),
        ours_limited=_share_limited(ours.tau, tau_max),
        beyond_limit_Nm=float(np.max(np.abs(theirs) - tau_max, initial=0.0)),
        dearer_least=min((gap.dearer for gap in gaps), default=np.nan),
        dearer_most=worst.dearer,
        unsolved=int((~given.solved).sum()),
    )


def _gap(course: Course, free: Answer, theirs: Answer, i: int) -> _Gap:
    """Return the differences at one tick."""
    problem, ours = course.problem, course.answer
    M, _, J = terms(problem, problem.q[i], problem.v[i])
    d_tau, d_force = theirs.tau[i] - ours.tau[i], theirs.force[i] - ours.force[i]
    d_V_dot = J @ np.linalg.solve(M, d_tau - J[:3].T @ d_force)
    free_way = np.linalg.svd(J)[2][len(J) :].T  # joint motion that leaves the tool where it is
    elbow = M @ free_way @ np.linalg.solve(free_way.T @ M @ free_way, free_way.T @ d_tau)
    costs = [
        _cost(M, J, one.tau[i] - free.tau[i], one.force[i] - free.force[i])
        for one in (theirs, ours)
    ]
    return _Gap(
        torque=_largest(d_tau),
        beyond_elbow=_largest(d_tau - elbow),
        force=_largest(d_force),
        turn=_largest(d_V_dot[3:]),
        rest=_largest(d_V_dot[:3]),
        dearer=costs[0] - costs[1],
    )


def _largest(values: Vector) -> float:
    return float(np.abs(values).max())


def _cost(M: Matrix, J: Matrix, d_tau: Vector, d_force: Vector) -> float:
    """Return what our QP pays [N²/kg] for what an answer differs by from the one without limits.

    With all weights 1 its three metrics add up to M: ½ d_aᵀ M d_a + ½ ‖Jᵀ d_f‖²_{M⁻¹}.
    """
    pressed = J[:3].T @ d_force
    moved = d_tau - pressed
    both = np.column_stack((moved, pressed))
    return float(np.sum(both * np.linalg.solve(M, both)) / 2)


def _share_limited(tau: Matrix, tau_max: Vector) -> float:
    return float((np.abs(tau) > (1 - AT_LIMIT) * tau_max).any(axis=1).mean()) if len(tau) else 0.0
