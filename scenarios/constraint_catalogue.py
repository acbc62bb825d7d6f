"""The constraints that ``qpctrl constraints`` explains, by name: one entry each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Twist
from qpctrl.constraint import (
    Constraint,
    Crank,
    Drawer,
    EdgeOnPlane,
    Embedded,
    FaceOnPlane,
    Hinge,
    Moving,
    PointOnPlane,
    Screw,
    Surface,
    cylinder,
    saddle,
    sphere,
)
from qpctrl.spatial import SX
from scenarios.guided import FLANGE

Build: TypeAlias = Callable[[pin.SE3], Constraint]
"""Makes the constraint of an environment at X_WE."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Entry:
    """A constraint, a pose in contact, and a motion that it allows."""

    build: Build | None
    """The constraint; none where nothing is in contact."""
    axes: str
    """How the frame E of the environment lies."""
    X_EF: pin.SE3
    """Pose of the tool in contact."""
    motion: Mapping[str, float]
    """What the task chooses in the example [m/s, rad/s], by axis; the other choices are 0."""
    V_E: Twist = field(default_factory=lambda: np.zeros(6))
    """Twist of E in its own axes (6) [m/s, rad/s]; not zero where the environment moves."""
    about: str = ""
    """What it is, in one line; by default the first line of the constraint's docstring."""

    @property
    def k(self) -> int:
        """Number of constraint rows."""
        return len(self.build(pin.SE3.Identity()).row_names) if self.build else 0

    @property
    def words(self) -> str:
        """What it is, in one line."""
        if self.about or self.build is None:
            return self.about
        text = type(self.build(pin.SE3.Identity())).__doc__ or ""
        return text.split("\n")[0].replace("`", "")


def at(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, *, turn: tuple[float, ...] = (0, 0, 0)
) -> pin.SE3:
    """Return the pose at (x, y, z) [m], turned by the rotation vector ``turn`` (3) [deg]."""
    return pin.SE3(pin.exp3(np.radians(turn)), np.array([x, y, z]))


def _of(kind: Callable[..., Constraint], **given: float) -> Build:
    return lambda X_WE: kind(space=FLANGE, X_WE=X_WE, **given)


def _face(X_WE: pin.SE3) -> FaceOnPlane:
    return FaceOnPlane(space=FLANGE, R_WE=X_WE.rotation)


def _surface(shape: tuple[SX, SX], contact: pin.SE3, *, face: bool = False) -> Build:
    phi, p = shape
    return lambda X_WE: Surface(space=FLANGE, X_WE=X_WE, phi=phi, p=p, contact=contact, face=face)


_BALL = sphere(np.zeros(3), 0.25)
_BELOW = at(z=-0.25)
_BESIDE = at(x=-0.1, turn=(0, 90, 0))
_ASLOPE = at(x=0.1, y=0.05, z=0.0125)

ENTRIES: dict[str, Entry] = {
    "free": Entry(
        build=None,
        axes="any",
        X_EF=at(),
        motion={"vx": 0.2},
        about="A tool in the air: every motion can be chosen, and no wrench.",
    ),
    "point_on_plane": Entry(
        build=_of(PointOnPlane),
        axes="z into the plane",
        X_EF=at(turn=(20, 0, 0)),
        motion={"vx": 0.2},
    ),
    "edge_on_plane": Entry(
        build=_of(EdgeOnPlane),
        axes="z into the plane, y along the edge",
        X_EF=at(turn=(0, 20, 0)),
        motion={"vx": 0.2},
    ),
    "face_on_plane": Entry(
        build=_face,
        axes="z into the plane",
        X_EF=at(turn=(0, 0, 30)),
        motion={"vx": 0.2, "wz": 0.5},
    ),
    "crank": Entry(
        build=_of(Crank),
        axes="z along the axis of the crank, x to the handle",
        X_EF=at(x=0.25),
        motion={"vy": 0.2},
    ),
    "drawer": Entry(
        build=_of(Drawer),
        axes="x along the slides",
        X_EF=at(turn=(0, 0, 30)),
        motion={"vx": 0.2},
    ),
    "hinge": Entry(
        build=_of(Hinge),
        axes="z along the hinge",
        X_EF=at(x=0.35),
        motion={"wz": 0.5},
    ),
    "screw": Entry(
        build=_of(Screw, lead=0.02),
        axes="z along the screw",
        X_EF=at(x=0.1),
        motion={"wz": 0.5},
    ),
    "embedded": Entry(
        build=_of(Embedded),
        axes="any",
        X_EF=at(),
        motion={},
    ),
    "sphere": Entry(
        build=_surface(_BALL, _BELOW),
        axes="at the centre of the ball, z from the contact to it",
        X_EF=_BELOW,
        motion={"vx": 0.2},
        about="A stylus on a ball of radius 0.25 m: its tip cannot move along the normal.",
    ),
    "sphere_face": Entry(
        build=_surface(_BALL, _BELOW, face=True),
        axes="at the centre of the ball, z from the contact to it",
        X_EF=_BELOW,
        motion={"wy": -0.8},
        about="A face that stays tangent to a ball of radius 0.25 m: it turns as it moves.",
    ),
    "cylinder": Entry(
        build=_surface(cylinder(0.1), _BESIDE),
        axes="z along the axis of the rod, x from the contact to it",
        X_EF=_BESIDE,
        motion={"vy": 0.2},
        about="A stylus on a rod of radius 0.1 m: its tip cannot move along the normal.",
    ),
    "saddle": Entry(
        build=_surface(saddle(3.0, 2.0), _ASLOPE),
        axes="at the saddle point, z into the surface there",
        X_EF=_ASLOPE,
        motion={"vx": 0.2},
        about="A stylus on the slope of a saddle with curvatures 3 and -2 per metre.",
    ),
    "conveyor": Entry(
        build=lambda X_WE: Moving(whole=_face(X_WE)),
        axes="z into the plane",
        X_EF=at(),
        motion={"vx": 0.2},
        V_E=np.array([0.1, 0.0, -0.05, 0.0, 0.0, 0.0]),
        about="A face on a board that runs along x and comes towards the tool.",
    ),
}
"""What the command knows; a new constraint is one more entry."""
