"""A screen that nobody sees, and how a scene looks on it: light, floor, backdrop, added shapes."""

import copy
import importlib
import os
import sys
from typing import Any, Self, TypeAlias

import mujoco
import numpy as np
from jaxtyping import UInt8

from qpctrl.arrays import Rotation, Vector
from qpctrl.errors import InputError, reason_of

Pixels: TypeAlias = UInt8[np.ndarray, "_ _ 3"]
Colour: TypeAlias = tuple[float, float, float]

BACKDROP: Colour = (0.93, 0.94, 0.96)
BEHIND = 3.0  # m, from what is looked at to the backdrop
GEOMS = 10_000
"""Shapes of the model that a scene has room for; MuJoCo's own default."""


class Screen:
    """An OpenGL screen of one size for scenes of one model; to be closed, or used in a ``with``.

    Attributes:
        scene: what is shown.
    """

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int], *, shapes: int = 0) -> None:
        """Open the screen.

        Args:
            model: its offscreen buffer is at least as large as the screen, see `lit`.
            size: width and height [pixels].
            shapes: room for shapes that are added to those of the model.

        Raises:
            InputError: this machine cannot render (no OpenGL).
        """
        self._rect = mujoco.MjrRect(0, 0, *size)
        self.scene = mujoco.MjvScene(model, maxgeom=GEOMS + shapes)
        try:
            self._gl = _context(*size)
            self._gl.make_current()
            self._target = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except Exception as error:  # each OpenGL back-end fails in its own way
            raise InputError(
                f"cannot render: {reason_of(error)}; set MUJOCO_GL=egl (needs libegl1) or osmesa "
                "(needs libosmesa6) before Python starts"
            ) from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._target)

    def pixels(self) -> Pixels:
        """Return the scene as it looks now (height×width×3)."""
        self._gl.make_current()
        pixels = np.empty((self._rect.height, self._rect.width, 3), np.uint8)
        mujoco.mjr_render(self._rect, self.scene, self._target)
        mujoco.mjr_readPixels(pixels, None, self._rect, self._target)
        return np.ascontiguousarray(pixels[::-1])  # OpenGL counts rows from below

    def close(self) -> None:
        """Give back what the screen holds."""
        self._gl.make_current()
        self._target.free()
        self._gl.free()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _context(width: int, height: int) -> Any:
    """Return an OpenGL context; on Linux through EGL, which needs no display, or OSMesa."""
    if sys.platform == "linux" and os.environ.get("MUJOCO_GL") != "osmesa":
        return importlib.import_module("mujoco.egl").GLContext(width, height)
    return mujoco.GLContext(width, height)


def lit(
    model: mujoco.MjModel, size: tuple[int, int], *, samples: int = 8, shadow: int = 4096
) -> mujoco.MjModel:
    """Return a copy of the model in soft light, on a floor without end.

    Args:
        model: the scene.
        size: width and height of the screen [pixels].
        samples: of each pixel, to smooth edges.
        shadow: width of the map of shadows [pixels].
    """
    model = copy.copy(model)
    model.vis.global_.offwidth, model.vis.global_.offheight = size
    model.vis.quality.offsamples, model.vis.quality.shadowsize = samples, shadow
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.38, 0.42
    model.light_cutoff[:], model.light_diffuse[:] = 80.0, 0.45
    floor = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    model.geom_size[floor, :2] = 20.0
    return model


def add_backdrop(scene: mujoco.MjvScene, camera: mujoco.MjvCamera) -> None:
    """Add a wall of one colour behind all, square to the view, and brighten the floor."""
    for geom in scene.geoms[: scene.ngeom]:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.emission, geom.specular = 0.3, 0.0
    azimuth = np.radians(camera.azimuth)
    ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    R = np.column_stack([ahead, np.cross([0.0, 0.0, 1.0], ahead), [0.0, 0.0, 1.0]])
    half = np.array([0.01, 40.0, 40.0])
    box, place = mujoco.mjtGeom.mjGEOM_BOX, camera.lookat + BEHIND * ahead
    wall = add_shape(scene, box, half, place, R, BACKDROP)
    wall.emission, wall.specular, wall.category = 1.0, 0.0, int(mujoco.mjtCatBit.mjCAT_DECOR)


def add_shape(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: Vector,
    p_W: Vector,
    R: Rotation,
    colour: Colour,
) -> mujoco.MjvGeom:
    """Add a shape of half sizes ``size`` (3) [m] at ``p_W`` (3) [m], turned by ``R``."""
    geom = scene.geoms[scene.ngeom]
    rgba = np.array([*colour, 1.0], dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, size, p_W, R.flatten(), rgba)
    scene.ngeom += 1
    return geom
