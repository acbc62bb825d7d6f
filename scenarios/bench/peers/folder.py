"""What a peer is handed: a folder with the robot, the numbers and the ticks of the problem."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Matrix, Vector
from scenarios.bench.peers.ours import Answer, answer, with_limits
from scenarios.bench.peers.problem import (
    FORCE,
    FRICTION,
    LARGEST,
    MOTION_GAINS,
    POSTURE_GAINS,
    SMALLEST,
    Problem,
)
from scenarios.bench.peers.urdf import robot_urdf

UNSATURATED, SATURATED, MET = "unsaturated", "saturated", "met"
"""No limit binds; two joints reach theirs half of the time each; nobody has to give way.

In the last the posture asks for the acceleration that qpctrl finds, so that every task can be met
and weights and metrics don't matter: who states the same problem gives the same answer.
"""

CHECKED = 20
"""States at which a peer's M and h are compared."""


class Course(NamedTuple):
    """One variant of the problem, and qpctrl's answer."""

    problem: Problem
    answer: Answer


def courses(problem: Problem) -> dict[str, Course]:
    """Return the variants by name; of two joints the limits become the medians of their torque."""
    free = answer(problem)
    share = np.abs(free.tau).max(axis=0) / problem.robot.limits.tau_max
    tau_max = np.array(problem.robot.limits.tau_max)
    busy = np.argsort(share)[-2:]
    tau_max[busy] = np.median(np.abs(free.tau), axis=0)[busy]
    limited = with_limits(problem, tau_max)
    return {
        UNSATURATED: Course(problem, free),
        SATURATED: Course(limited, answer(limited)),
        MET: Course(problem, free),
    }


def write(variants: Mapping[str, Course], folder: Path, *, ticks: int, core: int | None) -> None:
    """Write what a peer is handed.

    Args:
        variants: of `courses`.
        folder: where to; it exists.
        ticks: how many of them a peer shall time; the path has no end.
        core: on which it shall run; none leaves that open.
    """
    problem, free = variants[UNSATURATED]
    robot = problem.robot
    facts = {
        "frame": problem.frame,
        "armature": list(robot.model.armature),
        "home": list(robot.home),
        "point": list(problem.X_WE.translation),
        "normal": list(problem.normal),
        "force": FORCE,
        "friction": FRICTION,
        "smallest": SMALLEST,
        "largest": LARGEST,
        "motion_gains": MOTION_GAINS,
        "posture_gains": POSTURE_GAINS,
        "variants": {
            name: list(one.problem.robot.limits.tau_max) for name, one in variants.items()
        },
        "ticks": ticks,
        "core": core,
    }
    (folder / "robot.urdf").write_text(robot_urdf(robot, problem.frame))
    (folder / "problem.json").write_text(json.dumps(facts, indent=2))
    arrays: dict[str, Any] = {
        "q": problem.q,
        "v": problem.v,
        "R_WD": problem.R_WD,
        "omega": problem.omega,
        # Peers follow the reference in the world; qpctrl transports it into the tool, which turns.
        "alpha": problem.alpha + np.cross(problem.omega, _angular_velocity(problem)),
        "met": _leaning(problem, free),
        **_checks(problem),
    }
    np.savez(folder / "arrays.npz", **arrays)


def accelerations(problem: Problem, given: Answer) -> Matrix:
    """Return the joints' accelerations (ticks×nv) [rad/s²] under an answer."""
    found = []
    for q, v, tau, force in zip(problem.q, problem.v, *given, strict=True):
        M, h, J = terms(problem, q, v)
        found.append(np.linalg.solve(M, tau - h - J[:3].T @ force))
    return np.array(found)


def terms(problem: Problem, q: Vector, v: Vector) -> tuple[Matrix, Vector, Matrix]:
    """Return M with armature, h, and the Jacobian (6×nv) of the tool in the axes of the world."""
    model = problem.robot.model
    data, fid = model.createData(), problem.robot.frame_id(problem.frame)
    upper = np.triu(pin.crba(model, data, q))
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    J = np.array(pin.computeFrameJacobian(model, data, q, fid, world))
    h = np.array(pin.nonLinearEffects(model, model.createData(), q, v))
    return upper + np.triu(upper, 1).T, h, J


def _angular_velocity(problem: Problem) -> Matrix:
    """Return the angular velocity (ticks×3) [rad/s] of the tool, in the world."""
    states = zip(problem.q, problem.v, strict=True)
    return np.array([terms(problem, q, v)[2][3:] @ v for q, v in states])


def _leaning(problem: Problem, given: Answer) -> Matrix:
    """Return what to add to the posture's acceleration so that it asks for that of an answer."""
    K_p, K_d = POSTURE_GAINS
    asked = K_p * (problem.robot.home - problem.q) - K_d * problem.v
    leaning: Matrix = accelerations(problem, given) - asked
    return leaning


def _checks(problem: Problem) -> dict[str, Matrix]:
    """Return states, and M and h there."""
    at = np.linspace(0, problem.ticks - 1, CHECKED).astype(int)
    found = [terms(problem, problem.q[i], problem.v[i]) for i in at]
    return {
        "check_q": problem.q[at],
        "check_v": problem.v[at],
        "check_M": np.array([M for M, _, _ in found]),
        "check_h": np.array([h for _, h, _ in found]),
    }
