"""The problem as qpctrl states it, and its answer."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl import Controller, Measurement, Mode, TaskSpace, Weighted
from qpctrl.arrays import Array, Matrix, Vector
from qpctrl.constraint import PoseConstraint
from qpctrl.contact.wrench_limit import WrenchRows
from qpctrl.errors import InputError
from qpctrl.objective import Reference
from qpctrl.space import FrameMotion
from qpctrl.spatial import SX
from qpctrl.status import Status
from scenarios.bench.course import Given, Moment
from scenarios.bench.peers.problem import (
    DT,
    FORCE,
    FRICTION,
    LARGEST,
    MOTION_GAINS,
    POSTURE_GAINS,
    SMALLEST,
    Problem,
)
from tasks import ForceReference, ForceTask, MotionReference, MotionTask, PostureTask

WARM = 100
"""Ticks before the first that counts: the torque may not jump, and starts from that at rest."""

CONTACT = "contact"
"""Name of the only mode."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PointFriction:
    """The force of a point on a plane: a pyramid of four sides along its axes, and its size.

    |f_x| ≤ μ f_z, |f_y| ≤ μ f_z, least ≤ f_z ≤ most, in the axes of the plane.
    """

    space: TaskSpace
    X_WE: pin.SE3
    """Frame of the plane; its z axis points into it."""
    name: str = "friction"

    @property
    def row_names(self) -> tuple[str, ...]:
        """Sides of the pyramid, and both ends of the normal force."""
        return ("+x", "-x", "+y", "-y", "most", "least")

    @property
    def unit(self) -> str:
        """Unit of its rows."""
        return "N"

    def inputs(self) -> dict[str, Array]:
        """Return coefficient μ and the bounds on the normal force [N]."""
        sizes = {"mu": FRICTION, "most": LARGEST, "least": SMALLEST}
        return {name: np.array(value) for name, value in sizes.items()}

    def rows(self, motion: FrameMotion, u: Mapping[str, SX]) -> WrenchRows:
        """Return the rows on the wrench in the axes of the tool."""
        force = ca.SX(np.array(self.X_WE.rotation.T)) @ motion.X_WF.R
        x, y, z = (force[i, :] for i in range(3))
        mu = u["mu"]
        sides = ca.vertcat(x - mu * z, -x - mu * z, y - mu * z, -y - mu * z, z, -z)
        ub = ca.vertcat(ca.SX.zeros(4), u["most"], -u["least"])
        return WrenchRows(ca.horzcat(sides, ca.SX(6, 3)), ub)


def contact_mode(problem: Problem) -> Mode:
    """Return motion, force with the third law, and posture on a point that rests."""
    space = TaskSpace(problem.frame)
    R, p = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3)
    point = PoseConstraint(
        space=space, X_WE=problem.X_WE, c=p, R=R, p=p, contact=pin.SE3.Identity(), name="point"
    )
    tasks = (
        MotionTask(space=space, K_p=MOTION_GAINS[0], K_d=MOTION_GAINS[1]),
        ForceTask(space=space, K_fp=0.5, K_fi=20.0, damping=20.0, ramp=1e6),
        PostureTask(q_ref=problem.robot.home, K_p=POSTURE_GAINS[0], K_d=POSTURE_GAINS[1]),
    )
    return Mode(
        name=CONTACT,
        tasks=tuple(Weighted(task) for task in tasks),
        constraints=(point,),
        contact_limits=(PointFriction(space=space, X_WE=problem.X_WE),),
    )


def moments(problem: Problem) -> tuple[Moment, ...]:
    """Return what qpctrl is given at each tick; the measured force is the one asked for.

    Every controller gets its references as the arrays that it reads, laid out beforehand.
    """
    return tuple(_moment(problem, i) for i in range(problem.ticks))


def _moment(problem: Problem, i: int) -> Moment:
    R_WD, omega, alpha = problem.R_WD[i], problem.omega[i], problem.alpha[i]
    still = np.zeros(3)
    motion = MotionReference(
        X_WD=pin.SE3(R_WD, problem.X_WE.translation),
        V_des=np.concatenate((still, R_WD.T @ omega)),
        V_dot_des=np.concatenate((still, R_WD.T @ alpha)),
    )
    R_WF = problem.robot.pose(problem.q[i], problem.frame).rotation
    pressed = np.concatenate((R_WF.T @ (-FORCE * problem.normal), still))
    force = ForceReference(F_ref=pressed, F_meas=pressed)
    references: dict[str, Reference] = {"motion": motion, "force": force}
    laid_out: dict[str, Reference] = {
        name: Given(reference.arrays) for name, reference in references.items()
    }
    return Moment(problem.q[i], problem.v[i], laid_out)


class Answer(NamedTuple):
    """What a controller answered, tick by tick."""

    tau: Matrix
    """Torque (ticks×nu) [Nm]."""
    force: Matrix
    """Force on the environment (ticks×3) [N], in the world."""


def with_limits(problem: Problem, tau_max: Vector) -> Problem:
    """Return the problem with other torque limits (nu) [Nm]."""
    limits = replace(problem.robot.limits, tau_max=tau_max)
    return replace(problem, robot=replace(problem.robot, limits=limits))


def answer(problem: Problem) -> Answer:
    """Return qpctrl's answer, interpreted: the code of every formula runs, no compiler does.

    Raises:
        InputError: a tick has no solution.
    """
    controller, given = Controller(problem.robot, [contact_mode(problem)], dt=DT), moments(problem)
    memory = controller.start(CONTACT, given[-WARM].q)
    tau, lam = [], []
    for i in range(-WARM, len(given)):
        q, v, references = given[i]
        now = Measurement((i + WARM) * DT, q, v)
        command, report, memory = controller.step(CONTACT, now, references, memory)
        if i >= 0 and report.status is not Status.OK:
            raise InputError(f"tick {i} of the problem has no solution: {report.status.value}")
        tau.append(command.tau)
        lam.append(report.lam)
    force = np.array(lam[WARM:]) @ problem.X_WE.rotation.T
    return Answer(np.array(tau[WARM:]), force)
