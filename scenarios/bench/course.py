"""The ticks that are measured: states that move along a contact, and a new reference each time.

The tool goes out and back on a stroke of the environment's frame E, which is the tool's frame at
home, once a second, and never stops. q and v are those of an arm whose tool does just that, so the
contact is kept; no tick has the references of the one before.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Vector
from qpctrl.constraint import Constraint, Drawer, FaceOnPlane, Pfaffian, PointOnPlane
from qpctrl.errors import InputError
from qpctrl.mode import Mode
from qpctrl.objective import Reference, Weighted
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from qpctrl.spatial import AXES
from tasks import ForceReference, ForceTask, MotionReference, MotionTask, PostureTask

DT = 1e-3
"""Period of the loop [s]."""
LENGTH = 1000
"""Ticks of the stroke, out and back; what they point to fits into the second-level cache."""
STROKE = 0.06
"""Length of the stroke [m]."""
BEND = 0.05
"""Radius of the arc that it follows where the contact leaves a plane to move in [m]."""
FORCE = 10.0
"""Set-point [N], with a tenth of it coming and going."""
OFFSET = 1e-4
"""How far the references are from where the tool is [m]."""

_SETTLED = 1e-12
_STEPS = 20


@dataclass(frozen=True, eq=False)
class Given:
    """A reference made elsewhere."""

    arrays: Mapping[str, Array] = field(default_factory=dict)
    """The task inputs that this reference sets."""


class Moment(NamedTuple):
    """What one tick is given."""

    q: Vector
    v: Vector
    references: dict[str, Reference]


class Place(NamedTuple):
    """Where the tool is on its stroke, along the axes of E."""

    p_E: Vector
    v_E: Vector
    a_E: Vector


def contact_mode(robot: Robot, frame: str, k: int) -> Mode:
    """Return motion, force and posture on a contact with ``k`` rows.

    1: a point on a plane; 3: a face on a plane, as in `eraser`; 5: a drawer. An arm with two
    joints moves a point along a wall in its plane (k = 1).

    Raises:
        InputError: another k.
    """
    space = _space(robot, frame)
    X_WE = robot.pose(robot.home, frame)
    kinds: dict[int, Constraint] = {1: Pfaffian(space=space, A=np.eye(space.n)[1:2], name="wall")}
    if space.axes == AXES:
        kinds = {
            1: PointOnPlane(space=space, X_WE=X_WE),
            3: FaceOnPlane(space=space, R_WE=X_WE.rotation),
            5: Drawer(space=space, X_WE=X_WE),
        }
    if k not in kinds:
        raise InputError(f"k: got {k}, allowed: {', '.join(map(str, kinds))}")
    motion = MotionTask(space=space, K_p=1600.0, K_d=80.0)
    force = ForceTask(space=space, K_fp=0.5, K_fi=20.0, damping=20.0, ramp=1e4)
    posture = PostureTask(q_ref=robot.home)
    tasks = (Weighted(motion), Weighted(force), Weighted(posture))
    return Mode(name="contact", tasks=tasks, constraints=(kinds[k],))


def course(robot: Robot, frame: str, k: int, length: int = LENGTH) -> tuple[Moment, ...]:
    """Return the ticks of one stroke, out and back, on the contact of `contact_mode`.

    Args:
        robot: the arm.
        frame: frame of its tool.
        k: rows of the contact.
        length: how many ticks; even.

    Raises:
        InputError: the arm cannot follow the stroke.
    """
    index = _space(robot, frame).index
    X_WE = robot.pose(robot.home, frame)
    places = [_place(i * DT, length * DT, bent=k < 5 and len(index) == 6) for i in range(length)]
    there = list(_follow(robot, frame, index, X_WE, places[: length // 2 + 1]))
    states = [*there, *((q, -v) for q, v in there[-2:0:-1])]
    planar = len(index) == 2
    return tuple(
        Moment(q, v, _references(i / length, place, X_WE, _rows(robot, frame, X_WE, q, v, planar)))
        for i, (place, (q, v)) in enumerate(zip(places, states, strict=True))
    )


def _space(robot: Robot, frame: str) -> TaskSpace:
    return TaskSpace(frame, AXES if robot.nv >= len(AXES) else AXES[:2])


def _place(time: float, period: float, *, bent: bool) -> Place:
    """Return the place on a stroke that starts and turns at rest."""
    w = 2 * np.pi / period
    s, s_dot = STROKE * (1 - np.cos(w * time)) / 2, STROKE * w * np.sin(w * time) / 2
    s_ddot = STROKE * w**2 * np.cos(w * time) / 2
    if not bent:
        along = np.array([1.0, 0.0, 0.0])
        return Place(s * along, s_dot * along, s_ddot * along)
    angle = s / BEND
    out = np.array([np.sin(angle), 1 - np.cos(angle), 0.0])
    along, across = np.array([1 - out[1], out[0], 0.0]), np.array([-out[0], 1 - out[1], 0.0])
    return Place(BEND * out, s_dot * along, s_ddot * along + s_dot**2 / BEND * across)


def _follow(
    robot: Robot, frame: str, index: list[int], X_WE: pin.SE3, places: list[Place]
) -> Iterator[tuple[Vector, Vector]]:
    """Yield q and v (nv each) with the tool at each place, moving as it shall."""
    model, data, fid = robot.model, robot.model.createData(), robot.frame_id(frame)
    q = np.array(robot.home)
    for place in places:
        X_WD = X_WE * pin.SE3(np.eye(3), place.p_E)
        for _ in range(_STEPS):
            pin.framesForwardKinematics(model, data, q)
            J = pin.computeFrameJacobian(model, data, q, fid, pin.ReferenceFrame.LOCAL)[index]
            X_FD = data.oMf[fid].actInv(X_WD)
            X_e = pin.log6(X_FD).vector if len(index) == 6 else X_FD.translation[index]
            if np.abs(X_e).max() < _SETTLED:
                break
            q = q + np.linalg.pinv(J) @ X_e
        else:
            raise InputError(f"robot {robot.name!r}: cannot follow the stroke from its home")
        v_F = X_FD.rotation @ place.v_E
        V = np.concatenate((v_F, np.zeros(3)))[index]
        yield q.copy(), np.linalg.pinv(J) @ V


def _rows(
    robot: Robot, frame: str, X_WE: pin.SE3, q: Vector, v: Vector, planar: bool
) -> dict[str, Reference]:
    """Return A and Ȧ V of the wall of a planar arm, which turns before its tool; else nothing."""
    if not planar:
        return {}
    model, data, fid = robot.model, robot.model.createData(), robot.frame_id(frame)
    pin.framesForwardKinematics(model, data, q)
    J = pin.computeFrameJacobian(model, data, q, fid, pin.ReferenceFrame.LOCAL)
    V, R_WF = J @ v, data.oMf[fid].rotation
    normal = R_WF.T @ X_WE.rotation[:, 1]
    turned = np.cross(normal, V[3:])  # ṅ in the axes of the tool
    return {"wall": Given({"A": normal[None, :2], "A_dot_V": np.array([turned[:2] @ V[:2]])})}


def _references(
    share: float, place: Place, X_WE: pin.SE3, rows: dict[str, Reference]
) -> dict[str, Reference]:
    """Return what the tasks shall follow at a share of the period; no two ticks have the same."""
    angle = 2 * np.pi * share
    off = OFFSET * np.array([np.sin(3 * angle), np.cos(2 * angle), np.sin(angle)])
    X_WD = X_WE * pin.SE3(pin.exp3(off[::-1].copy()), place.p_E + off)
    motion = MotionReference(
        X_WD=X_WD,
        V_des=np.concatenate((place.v_E, np.zeros(3))),
        V_dot_des=np.concatenate((place.a_E, np.zeros(3))),
    )
    n = 2 if rows else 6
    normal = np.eye(n)[1 if rows else 2]
    wanted = FORCE * (1 + 0.1 * np.sin(angle))
    measured = wanted + 0.02 * FORCE * np.sin(7 * angle)
    force = ForceReference(F_ref=wanted * normal, F_meas=measured * normal)
    return {"motion": motion, "force": force, **rows}
