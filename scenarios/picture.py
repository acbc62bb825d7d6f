"""A picture of the eraser scene, rendered without a display."""

import struct
import zlib
from itertools import pairwise

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Matrix, Vector, finite_array, positive
from scenarios.video.png import SIGNATURE, chunk
from scenarios.video.screen import Pixels, Screen, add_backdrop, add_shape, lit
from scenarios.world import World

CHALK, WIPED = (0.96, 0.95, 0.88), (0.25, 0.42, 0.35)
LINE = 0.003  # m, radius of the drawn path
PAD = np.array([0.060, 0.025, 0.0004])  # m, half sizes of the wiped patch below the eraser
PIECES = 500  # of the drawn path, at most
APART = 3e-6  # m, height between two patches, so that they do not flicker


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
    positive(np.array(size, dtype=np.float64), (2,), "size")
    model = lit(world.model, size)
    data = mujoco.MjData(model)
    data.qpos[:] = finite_array(q, (model.nq,), "q")
    mujoco.mj_forward(model, data)
    camera, every = _camera(world.X_WE, *view), mujoco.mjtCatBit.mjCAT_ALL.value
    with Screen(model, size, shapes=2 * PIECES + 10) as screen:
        mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, every, screen.scene)
        add_backdrop(screen.scene, camera)
        if path is not None:
            _draw_path(screen.scene, world.X_WE, path)
        return png(screen.pixels())


def png(pixels: Pixels) -> bytes:
    """Return pixels (height×width×3), 8 bits a channel, as a PNG file."""
    height, width, _ = pixels.shape
    lines = np.concatenate([np.zeros((height, 1), np.uint8), pixels.reshape(height, -1)], axis=1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    image = zlib.compress(lines.tobytes(), level=9)
    return SIGNATURE + chunk(b"IHDR", header) + chunk(b"IDAT", image) + chunk(b"IEND", b"")


def _camera(X_WE: pin.SE3, azimuth: float, elevation: float, distance: float) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, distance
    centre = X_WE.act(np.array([0.0, 0.0, -0.15]))
    camera.lookat[:] = [*centre[:2], 0.68 * centre[2]]
    return camera


def _draw_path(scene: mujoco.MjvScene, X_WE: pin.SE3, path: Matrix) -> None:
    """Add the wiped patches, and the path as short capsules half sunk into the board."""
    points = path[:: max(1, -(-len(path) // PIECES))]
    p_W = np.column_stack([points, np.zeros(len(points))]) @ X_WE.rotation.T + X_WE.translation
    for i, p in enumerate(p_W):
        above = p - (1 + i) * APART * X_WE.rotation[:, 2]
        add_shape(scene, mujoco.mjtGeom.mjGEOM_BOX, PAD, above, X_WE.rotation, WIPED)
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    for start, end in pairwise(p_W):
        piece = add_shape(scene, capsule, np.zeros(3), start, np.eye(3), CHALK)
        mujoco.mjv_connector(piece, capsule, LINE, start, end)
