"""A picture of the eraser scene, rendered without a display."""

import copy
import struct
import zlib
from itertools import pairwise
from typing import TypeAlias

import mujoco
import numpy as np
import pinocchio as pin
from jaxtyping import UInt8

from qpctrl.arrays import Matrix, Rotation, Vector, finite_array, positive
from qpctrl.errors import InputError
from scenarios.world import World

Pixels: TypeAlias = UInt8[np.ndarray, "_ _ 3"]

CHALK, WIPED, BACKDROP = (0.96, 0.95, 0.88), (0.25, 0.42, 0.35), (0.93, 0.94, 0.96)
LINE = 0.003  # m, radius of the drawn path
PAD = np.array([0.060, 0.025, 0.0004])  # m, half sizes of the wiped patch below the eraser
PIECES = 500  # of the drawn path, at most
APART = 3e-6  # m, height between two patches, so that they do not flicker
BEHIND = 3.0  # m, from the board to the backdrop


def render_scene(
    world: World,
    q: Vector,
    path: Matrix | None = None,
    *,
    size: tuple[int, int] = (960, 720),
    view: tuple[float, float, float] = (-42.0, -12.0, 2.0),
) -> bytes:
    """Return a PNG of the robot in front of the board.

    Args:
        world: the scene.
        q: configuration (nq) [rad or m].
        path: where the eraser was, x and y in E (samples×2) [m]: drawn with the wiped area.
        size: width and height [pixels].
        view: azimuth and elevation of the camera [deg], and its distance from the board [m].

    Raises:
        InputError: wrong shapes, or this machine cannot render (no OpenGL).
    """
    width, height = size
    positive(np.array(size, dtype=np.float64), (2,), "size")
    model = _lit(world.model, width, height)
    data = mujoco.MjData(model)
    data.qpos[:] = finite_array(q, (model.nq,), "q")
    mujoco.mj_forward(model, data)
    renderer = _renderer(model, width, height)
    try:
        camera = _camera(world.X_WE, *view)
        renderer.update_scene(data, camera)
        _draw_backdrop(renderer.scene, camera)
        if path is not None:
            _draw_path(renderer.scene, world.X_WE, path)
        return png(renderer.render())
    finally:
        renderer.close()


def png(pixels: Pixels) -> bytes:
    """Return pixels (height×width×3), 8 bits a channel, as a PNG file."""
    height, width, _ = pixels.shape
    lines = np.concatenate([np.zeros((height, 1), np.uint8), pixels.reshape(height, -1)], axis=1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    image = zlib.compress(lines.tobytes(), level=9)
    chunks = (_chunk(b"IHDR", header), _chunk(b"IDAT", image), _chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def _chunk(kind: bytes, content: bytes) -> bytes:
    check = struct.pack(">I", zlib.crc32(kind + content))
    return struct.pack(">I", len(content)) + kind + content + check


def _renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    try:
        return mujoco.Renderer(model, height, width, max_geom=model.ngeom + 2 * PIECES + 10)
    except Exception as error:  # each OpenGL back-end fails in its own way
        raise InputError(
            f"cannot render: {error}; set MUJOCO_GL=egl (needs libegl1) or osmesa (needs "
            "libosmesa6) before Python starts"
        ) from error


def _lit(model: mujoco.MjModel, width: int, height: int) -> mujoco.MjModel:
    """Return a copy of the model in soft light, on a floor without end."""
    model = copy.copy(model)
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    model.vis.quality.offsamples, model.vis.quality.shadowsize = 8, 4096
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.38, 0.42
    model.light_cutoff[:], model.light_diffuse[:] = 80.0, 0.45
    floor = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    model.geom_size[floor, :2] = 20.0
    return model


def _camera(X_WE: pin.SE3, azimuth: float, elevation: float, distance: float) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, distance
    centre = X_WE.act(np.array([0.0, 0.0, -0.15]))
    camera.lookat[:] = [*centre[:2], 0.68 * centre[2]]
    return camera


def _draw_backdrop(scene: mujoco.MjvScene, camera: mujoco.MjvCamera) -> None:
    """Add a wall of one colour behind all, square to the view, and brighten the floor."""
    for geom in scene.geoms[: scene.ngeom]:
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
            geom.emission, geom.specular = 0.3, 0.0
    azimuth = np.radians(camera.azimuth)
    ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    R = np.column_stack([ahead, np.cross([0.0, 0.0, 1.0], ahead), [0.0, 0.0, 1.0]])
    size = np.array([0.01, 40.0, 40.0])
    wall = _add(scene, mujoco.mjtGeom.mjGEOM_BOX, size, camera.lookat + BEHIND * ahead, R, BACKDROP)
    wall.emission, wall.specular, wall.category = 1.0, 0.0, int(mujoco.mjtCatBit.mjCAT_DECOR)


def _draw_path(scene: mujoco.MjvScene, X_WE: pin.SE3, path: Matrix) -> None:
    """Add the wiped patches, and the path as short capsules half sunk into the board."""
    points = path[:: max(1, -(-len(path) // PIECES))]
    p_W = np.column_stack([points, np.zeros(len(points))]) @ X_WE.rotation.T + X_WE.translation
    for i, p in enumerate(p_W):
        above = p - (1 + i) * APART * X_WE.rotation[:, 2]
        _add(scene, mujoco.mjtGeom.mjGEOM_BOX, PAD, above, X_WE.rotation, WIPED)
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    for start, end in pairwise(p_W):
        piece = _add(scene, capsule, np.zeros(3), start, np.eye(3), CHALK)
        mujoco.mjv_connector(piece, capsule, LINE, start, end)


def _add(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: Vector,
    p_W: Vector,
    R: Rotation,
    colour: tuple[float, float, float],
) -> mujoco.MjvGeom:
    geom = scene.geoms[scene.ngeom]
    rgba = np.array([*colour, 1.0], dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, size, p_W, R.flatten(), rgba)
    scene.ngeom += 1
    return geom
