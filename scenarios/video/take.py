"""A take: a run as a camera sees it, picture by picture, with forces as arrows."""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import final

import mujoco
import numpy as np

from qpctrl.arrays import Array, Matrix, Vector, finite_array, positive
from qpctrl.errors import InputError, unknown_name
from scenarios.video.screen import Colour, Pixels, Screen, add_backdrop, add_shape, lit

SAMPLES, SHADOW = 4, 2048  # of a pixel; width of the map of shadows [pixels]
SHORTEST = 1e-3  # m, of an arrow that is drawn
HIDDEN = 0.5  # share of an arrow's colour where something is in front of it
SHAFT = 0.012  # m, radius of an arrow


@final
@dataclass(frozen=True, kw_only=True)
class View:
    """Where a camera stands that looks on a scene."""

    azimuth: float = 60.0
    """Direction in which it looks, about z of the world from its x [deg]."""
    elevation: float = -15.0
    """The same above the horizon [deg]; below zero it looks down."""
    distance: float = 3.0
    """From what is looked at [m]."""
    lookat: tuple[float, float, float] = (0.0, 0.0, 0.7)
    """What is looked at, in the world [m]."""
    shadows: bool = True
    """Whether there are shadows; without a graphics card these take two thirds of the time."""

    def __post_init__(self) -> None:
        finite_array([self.azimuth, self.elevation, *self.lookat], (5,), "view")
        positive(self.distance, (), "distance of the view")

    def camera(self) -> mujoco.MjvCamera:
        """Return the camera."""
        camera = mujoco.MjvCamera()
        camera.azimuth, camera.elevation = self.azimuth, self.elevation
        camera.distance, camera.lookat[:] = self.distance, self.lookat
        return camera


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Arrow:
    """A force as an arrow from the point where it acts; what hides it becomes half clear."""

    point: Vector
    """Where it starts, in the world (3) [m]."""
    vector: Vector
    """The force, in the world (3) [N]."""
    colour: Colour = (0.85, 0.15, 0.10)
    """Red, green and blue [1]."""
    scale: float = 0.002
    """Length per force [m/N]; below zero the arrow shows the reaction."""

    def __post_init__(self) -> None:
        for name in ("point", "vector"):
            object.__setattr__(self, name, finite_array(getattr(self, name), (3,), f"arrow {name}"))

    def draw(self, scene: mujoco.MjvScene) -> None:
        """Add it to a scene, if it is long enough to be seen."""
        way, kind = self.scale * self.vector, mujoco.mjtGeom.mjGEOM_ARROW
        if np.linalg.norm(way) >= SHORTEST:
            geom = add_shape(scene, kind, np.zeros(3), self.point, np.eye(3), self.colour)
            end = self.point + 2 * way  # MuJoCo draws an arrow half as long as it is told
            mujoco.mjv_connector(geom, kind, SHAFT, self.point, end)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Take:
    """What is seen of a run; checked when it is made."""

    model: mujoco.MjModel
    """The scene."""
    qpos: Matrix
    """Configurations (frames×nq) [rad, m or 1] in MuJoCo's order, one for each picture."""
    view: View
    arrows: Sequence[Sequence[Arrow]] = ()
    """What is drawn with each picture; or nothing."""
    places: Mapping[str, Array] = field(default_factory=dict)
    """Poses (frames×4×4) in the world of bodies that move otherwise, by name."""

    def __post_init__(self) -> None:
        frames, free = len(self.qpos), bodies_on_the_world(self.model)
        if not frames or self.qpos.shape != (frames, self.model.nq):
            need = f"need (frames, {self.model.nq}), one frame at least"
            raise InputError(f"qpos: got shape {self.qpos.shape}, {need}")
        if not (known := np.isfinite(self.qpos).all(axis=1)).all():
            first = int(np.argmin(known))
            raise InputError(f"qpos: frame {first} is not finite, need finite numbers")
        if len(self.arrows) not in (0, frames):
            raise InputError(f"arrows: got those of {len(self.arrows)} frames, need {frames}")
        for name, poses in self.places.items():
            if name not in free:
                raise unknown_name("body on the world", name, free)
            if poses.shape != (frames, 4, 4) or not np.isfinite(poses).all():
                need = f"need finite poses {(frames, 4, 4)}"
                raise InputError(f"places of {name!r}: got shape {poses.shape}, {need}")

    @contextlib.contextmanager
    def shot(self, size: tuple[int, int]) -> Iterator[Callable[[int], Pixels]]:
        """Give what makes picture k (height×width×3), in any order, while the screen is open.

        Args:
            size: width and height [pixels].

        Raises:
            InputError: this machine cannot render (no OpenGL).
        """
        model = lit(self.model, size, samples=SAMPLES, shadow=SHADOW)
        data, option, camera = mujoco.MjData(model), mujoco.MjvOption(), self.view.camera()
        every, none = mujoco.mjtCatBit.mjCAT_ALL.value, 0
        most = max((len(arrows) for arrows in self.arrows), default=0)
        with Screen(model, size, shapes=1 + most) as screen:
            scene = screen.scene
            scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self.view.shadows

            def picture(k: int) -> Pixels:
                self._pose(model, data, k)
                mujoco.mjv_updateScene(model, data, option, None, camera, every, scene)
                add_backdrop(scene, camera)
                arrows = self.arrows[k] if self.arrows else ()
                for arrow in arrows:
                    arrow.draw(scene)
                pixels = screen.pixels()
                if not arrows:
                    return pixels
                mujoco.mjv_updateScene(model, data, option, None, camera, none, scene)
                for arrow in arrows:
                    arrow.draw(scene)
                return seen_through(pixels, screen.pixels())

            yield picture

    def _pose(self, model: mujoco.MjModel, data: mujoco.MjData, k: int) -> None:
        free = bodies_on_the_world(model)
        for name, poses in self.places.items():
            model.body_pos[free[name]] = poses[k, :3, 3]
            mujoco.mju_mat2Quat(model.body_quat[free[name]], poses[k, :3, :3].flatten())
        data.qpos[:] = self.qpos[k]
        mujoco.mj_fwdPosition(model, data)


def bodies_on_the_world(model: mujoco.MjModel) -> dict[str, int]:
    """Return the numbers of the bodies that hang on nothing else, by name."""
    return {model.body(i).name: i for i in range(1, model.nbody) if not model.body_parentid[i]}


def seen_through(pixels: Pixels, alone: Pixels) -> Pixels:
    """Return a picture with what else ``alone`` shows, on black, where that is hidden in it."""
    mixed = (HIDDEN * alone + (1 - HIDDEN) * pixels).astype(np.uint8)
    return np.where(alone.any(axis=2, keepdims=True), mixed, pixels)
