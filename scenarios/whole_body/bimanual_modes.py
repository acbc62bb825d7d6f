"""The modes of two arms that carry a box: hands free, box on the table in both hands, in the air.

The box is a body of the robot that nothing drives. Pads are held to it, seen from it; the table
holds its lowest face. Constraints and contacts share their names.
"""

from dataclasses import dataclass

import numpy as np

from qpctrl.constraint import Embedded, FaceOnPlane
from qpctrl.contact import Footprint, FrictionCone, MaxForce, WrenchLimit
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.robot import Robot
from scenarios.whole_body.bimanual_world import BOTTOM, HANDS, PAD_HALF, PADS, SIDES, BoxWorld
from tasks import ForceTask, GraspForceTask, MotionTask, PostureTask

REACH, STAND, CARRY, SLIDE = "reach", "stand", "carry", "slide"
"""Modes: hands free; box in the hands and resting on the table; in the air; sliding on the table.

A box at rest is held by the table's friction in all directions, one that slides in three."""


NORMAL = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 0.0])
"""Parts of the wrench on the table that pressure carries."""


@dataclass(frozen=True, kw_only=True)
class Gains:
    """Gains of a box in two hands."""

    K_p: float = 400.0
    K_d: float = 40.0
    K_fp: float = 0.3
    K_fi: float = 10.0
    damping: float = 100.0
    cutoff: float = 10.0
    """Of what is known of the table's friction [Hz]."""
    posture: float = 1e-3
    """Weight of the posture, which a metric at home does not keep out of the other tasks."""


@dataclass(frozen=True, kw_only=True)
class Grip:
    """What the controller believes that pads can carry."""

    friction: float
    """Coulomb friction of a pad on the box [1]."""
    most: float
    """Largest force of a pad [N]."""


def box_modes(world: BoxWorld, grip: Grip, gains: Gains | None = None) -> tuple[Mode, ...]:
    """Return the modes: reach, stand, carry and slide."""
    gains = gains or Gains()
    press = ForceTask(
        space=BOTTOM,
        K_fp=gains.K_fp * NORMAL,  # friction answers the pads; it has no set-point
        K_fi=gains.K_fi * NORMAL,
        damping=gains.damping,
        cutoff=gains.cutoff,
        ramp=1e4,  # the guide's set-points are smooth
        name="press",
    )
    floor = FaceOnPlane(space=BOTTOM, R_WE=world.X_WT.rotation, name="table")
    tasks = (
        Weighted(MotionTask(space=BOTTOM, K_p=gains.K_p, K_d=gains.K_d), 10.0),
        Weighted(
            GraspForceTask(contacts=(PADS[0], PADS[1]), K_fp=gains.K_fp, K_fi=gains.K_fi, ramp=1e4)
        ),
        _posture(world.robot, gains.posture),
    )
    robot = world.robot
    X_WO = robot.pose(robot.home, "box")
    pads = tuple(
        Embedded(space=pad, X_WE=X_WO.inverse() * robot.pose(robot.home, pad.frame), name=side)
        for pad, side in zip(PADS, SIDES, strict=True)
    )
    limits = pad_limits(grip)
    hands = tuple(
        Weighted(MotionTask(space=hand, K_p=gains.K_p, K_d=gains.K_d, name=f"{side} hand"))
        for hand, side in zip(HANDS, SIDES, strict=True)
    )
    rest = Embedded(space=BOTTOM, X_WE=world.X_WT, name="table")
    return (
        Mode(
            name=REACH,
            tasks=(*hands, Weighted(press), _posture(world.robot, gains.posture)),
            constraints=(rest,),
            metric="home",
        ),
        Mode(
            name=STAND,
            tasks=(*tasks[1:], Weighted(press)),
            constraints=(*pads, rest),
            contact_limits=limits,
            metric="home",
        ),
        Mode(
            name=SLIDE,
            tasks=(*tasks, Weighted(press)),
            constraints=(*pads, floor),
            contact_limits=limits,
            metric="home",
        ),
        Mode(name=CARRY, tasks=tasks, constraints=pads, contact_limits=limits, metric="home"),
    )


def pad_limits(grip: Grip) -> tuple[WrenchLimit, ...]:
    """Return friction, footprint and largest force of both pads."""
    limits: list[WrenchLimit] = []
    for pad, side in zip(PADS, SIDES, strict=True):
        limits += [
            FrictionCone(space=pad, mu=grip.friction, name=f"{side} friction"),
            Footprint(space=pad, half=PAD_HALF, name=f"{side} footprint"),
            MaxForce(space=pad, limit=grip.most, name=f"{side} force"),
        ]
    return tuple(limits)


def _posture(robot: Robot, weight: float) -> Weighted:
    return Weighted(PostureTask(q_ref=robot.home, K_p=np.array(20.0)), weight)
