"""GIF: one palette for the whole run, and of each picture what is new in it."""

import struct
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import GifImagePlugin, Image

from scenarios.video.png import box_around
from scenarios.video.reel import Reel

COLOURS = 255
CLEAR = 255  # the colour through which the picture before is seen
LOOKS = 12  # pictures from which the palette is taken
FOR_EVER = b"\x21\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"


def write_gif(file: Path, reel: Reel) -> None:
    """Write a reel as a GIF that repeats for ever."""
    palette = _palette(reel)
    before = np.full(reel.size[::-1], CLEAR, np.uint8)
    with file.open("wb") as out:
        out.write(b"GIF89a" + struct.pack("<HHBBB", *reel.size, 0xF7, 0, 0))
        out.write(bytes(palette.getpalette() or ()).ljust(3 * 256, b"\0"))
        out.write(FOR_EVER)
        for pixels, delay in zip(reel, reel.delays(100), strict=True):
            picture = Image.fromarray(pixels).quantize(palette=palette, dither=Image.Dither.NONE)
            colours = np.asarray(picture)
            out.write(_frame(colours, colours != before, delay))
            before = colours
        out.write(b";")


def _palette(reel: Reel) -> Image.Image:
    """Return an image with the palette of all pictures, taken from some along the run."""
    some = np.unique(np.linspace(0, reel.count - 1, LOOKS).round().astype(int)).tolist()
    strip = Image.fromarray(np.concatenate([reel.picture(k)[::2, ::2].copy() for k in some]))
    median = Image.Quantize.MEDIANCUT  # alone it gives what is rare, an arrow, the colour of others
    return strip.quantize(COLOURS, method=median, kmeans=1)


def _frame(colours: UInt8[np.ndarray, "h w"], new: Bool[np.ndarray, "h w"], delay: int) -> bytes:
    """Return the blocks of one picture, of which ``new`` is drawn, shown for ``delay`` [s/100]."""
    left, top, right, bottom = box_around(new)
    part = np.where(new, colours, np.uint8(CLEAR))[top:bottom, left:right]
    blocks = GifImagePlugin.getdata(
        Image.frombytes("P", part.shape[::-1], part.tobytes()),
        (left, top),
        duration=10 * delay,
        transparency=CLEAR,
        disposal=1,
    )
    return b"".join(blocks)
