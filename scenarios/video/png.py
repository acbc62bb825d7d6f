"""Animated PNG: without loss, and with nothing but the standard library.

Source: W3C-PNG3.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from jaxtyping import UInt8

from scenarios.video.reel import Reel
from scenarios.video.screen import Pixels

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_RGBA = 6  # colour type
_OVER = 1  # blending: what is clear shows the picture before
_LEVEL = 6  # of zlib; 9 takes twice the time for 2 % less


class Patch(NamedTuple):
    """The rectangle in which a picture differs from the one before."""

    left: int
    top: int
    rgba: UInt8[np.ndarray, "_ _ 4"]
    """Its pixels; those that stay as they were are clear."""


def write_png(file: Path, reel: Reel) -> None:
    """Write a reel as an animated PNG that repeats for ever."""
    rate = reel.rate
    with file.open("wb") as out:
        out.write(SIGNATURE)
        _put(out, b"IHDR", struct.pack(">IIBBBBB", *reel.size, 8, _RGBA, 0, 0, 0))
        _put(out, b"acTL", struct.pack(">II", reel.count, 0))
        number = 0
        for k, (left, top, rgba) in enumerate(patches(reel)):
            height, width, _ = rgba.shape
            shown = (rate.denominator, rate.numerator)
            place = (width, height, left, top)
            _put(out, b"fcTL", struct.pack(">IIIIIHHBB", number, *place, *shown, 0, _OVER))
            number += 1
            if k == 0:
                _put(out, b"IDAT", _packed(rgba))
            else:
                _put(out, b"fdAT", struct.pack(">I", number) + _packed(rgba))
                number += 1
        _put(out, b"IEND", b"")


def patches(reel: Reel) -> Iterator[Patch]:
    """Yield what is new in each picture; the first is new as a whole."""
    before: Pixels | None = None
    for pixels in reel:
        new = np.full(pixels.shape[:2], True) if before is None else (pixels != before).any(axis=2)
        left, top, right, bottom = box_around(new)
        part = np.s_[top:bottom, left:right]
        opaque = new[part].astype(np.uint8)[..., None]
        yield Patch(left, top, np.concatenate([pixels[part] * opaque, 255 * opaque], axis=2))
        before = pixels


def box_around(new: np.ndarray) -> tuple[int, int, int, int]:
    """Return left, top, right and bottom of what is true in ``new``; one pixel if nothing is."""
    rows, columns = np.flatnonzero(new.any(axis=1)), np.flatnonzero(new.any(axis=0))
    if not len(rows):
        return 0, 0, 1, 1
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def chunk(kind: bytes, content: bytes) -> bytes:
    """Return a chunk of a PNG file: length, kind, content and checksum."""
    check = struct.pack(">I", zlib.crc32(kind + content))
    return struct.pack(">I", len(content)) + kind + content + check


def _put(out: BinaryIO, kind: bytes, content: bytes) -> None:
    out.write(chunk(kind, content))


def _packed(rgba: UInt8[np.ndarray, "_ _ 4"]) -> bytes:
    height = len(rgba)
    lines = np.concatenate([np.zeros((height, 1), np.uint8), rgba.reshape(height, -1)], axis=1)
    return zlib.compress(lines.tobytes(), _LEVEL)
