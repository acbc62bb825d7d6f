"""Moving pictures of a run, rendered without a display, as GIF, WebP, PNG, MP4 or WebM."""

import importlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import mujoco
import numpy as np

from qpctrl.arrays import Array, Matrix, Vector, positive
from qpctrl.errors import InputError, reason_of, unknown_name
from scenarios.run import all_or_none, writable_folder
from scenarios.video.reel import Reel
from scenarios.video.screen import Screen, lit
from scenarios.video.take import Arrow, Take, View

FPS, SIZE = 25.0, (640, 480)
"""Pictures in a second [1/s], and width and height [pixels], where nothing else is asked for."""
SMALLEST, LARGEST = 16, 4096  # pixels

Writer: TypeAlias = Callable[[Path, Reel], None]


class Format(NamedTuple):
    """How a kind of file is written."""

    module: str
    """Where the function is that writes it."""
    writer: str
    """Its name; it takes a file and a reel."""
    extra: str
    """Extra of this package that brings what it needs."""
    fastest: float
    """Most pictures in a second [1/s]."""
    step: int = 1
    """Width and height are multiples of it [pixels]."""


FORMATS = {
    ".gif": Format("scenarios.video.gif", "write_gif", "scenarios", 50.0),
    ".webp": Format("scenarios.video.webp", "write_webp", "scenarios", 60.0),
    ".png": Format("scenarios.video.png", "write_png", "scenarios", 60.0),
    ".mp4": Format("scenarios.video.stream", "write_stream", "video", 60.0, step=2),
    ".webm": Format("scenarios.video.stream", "write_stream", "video", 60.0, step=2),
}
"""Kinds of files by suffix; players slow down a GIF of more than 50 pictures in a second."""


def write_video(
    file: Path,
    model: mujoco.MjModel,
    qpos: Matrix,
    *,
    view: View,
    fps: float = FPS,
    size: tuple[int, int] = SIZE,
    arrows: Sequence[Sequence[Arrow]] = (),
    places: Mapping[str, Array] | None = None,
    watch: Callable[[int], None] | None = None,
) -> None:
    """Write moving pictures of a run; the whole file or none.

    Pictures are made one at a time. The same arguments on the same machine give the same bytes.

    Args:
        file: where they go; its suffix says how: .gif, .webp, .png (animated), .mp4 or .webm.
        model: the scene.
        qpos: its configurations (frames×nq) in MuJoCo's order, one for each picture; see `sampled`.
        view: where the camera stands.
        fps: pictures in a second [1/s].
        size: width and height [pixels].
        arrows: what is drawn with each picture; default: nothing.
        places: poses (frames×4×4) in the world of bodies that move otherwise, by name.
        watch: called with the number of each picture that is written.

    Raises:
        InputError: as of `check_video`, or configurations, arrows or places that do not fit.
    """
    write = checked_writer(file, fps, size)
    take = Take(model=model, qpos=qpos, view=view, arrows=arrows, places=places or {})
    with take.shot(size) as picture, all_or_none(file.parent) as staging:
        reel = Reel(picture=picture, count=len(qpos), fps=fps, size=size, watch=watch)
        write(staging / file.name, reel)


def check_video(file: Path, *, fps: float = FPS, size: tuple[int, int] = SIZE) -> None:
    """Refuse before a run what `write_video` would refuse after it; make the file's folder.

    Args:
        file: where moving pictures shall go.
        fps: pictures in a second [1/s].
        size: width and height [pixels].

    Raises:
        InputError: an unknown kind of file, one that needs an extra, a rate or size that it cannot
            have, a folder that cannot be written, or no OpenGL.
    """
    checked_writer(file, fps, size)
    with Screen(lit(mujoco.MjSpec().compile(), size), size):
        pass


def sampled(times: Vector, values: Array, fps: float) -> Array:
    """Return what a record says at the times of pictures: the rows nearest to k / ``fps``.

    Args:
        times: of the record (n) [s], rising; pictures count from the first.
        values: one row for each of them (n×…).
        fps: pictures in a second [1/s].

    Raises:
        InputError: an empty record, times that do not rise, or another number of values.
    """
    rate = float(positive(fps, (), "fps"))
    if not len(times) or len(times) != len(values):
        raise InputError(f"record: got {len(times)} times and {len(values)} values, need one each")
    since = times - times[0]
    if not (np.diff(since) > 0).all():
        raise InputError("record: its times do not rise from row to row, need one after the other")
    wanted = np.arange(int(since[-1] * rate + 1e-6) + 1) / rate
    return values[np.searchsorted((since[1:] + since[:-1]) / 2, wanted)]


def checked_writer(file: Path, fps: float, size: tuple[int, int]) -> Writer:
    """Return what writes moving pictures to ``file``, whose folder is made.

    Raises:
        InputError: as of `check_video`, but for OpenGL.
    """
    suffix = file.suffix.lower()
    if suffix not in FORMATS:
        raise unknown_name("suffix of a video", suffix, FORMATS)
    kind = FORMATS[suffix]
    if not 1.0 <= fps <= kind.fastest:
        raise InputError(f"fps: got {fps}, need 1 to {kind.fastest:g} pictures/s in a {suffix}")
    if not all(SMALLEST <= n <= LARGEST and n % kind.step == 0 for n in size):
        which = "even numbers" if kind.step == 2 else "numbers"
        need = f"need {which} from {SMALLEST} to {LARGEST} in a {suffix}"
        raise InputError(f"size: got {size[0]}×{size[1]}, {need}")
    try:
        writer: Writer = getattr(importlib.import_module(kind.module), kind.writer)
    except ImportError as error:
        install = f"pip install 'qpctrl[{kind.extra}]'"
        raise InputError(f"a {suffix} needs the extra: {install}; a .png needs none") from error
    try:
        writable_folder(file.parent, [file.name])
    except OSError as error:  # a name that is too long
        raise InputError(f"video {str(file)!r}: {reason_of(error)}") from error
    return writer
