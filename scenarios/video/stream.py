"""MP4 (H.264) and WebM (VP9): the smallest files, which players show everywhere."""

import importlib
from pathlib import Path

from scenarios.video.reel import Reel

av = importlib.import_module("av")

CODECS = {
    ".mp4": ("libx264", {"crf": "20", "preset": "medium"}),
    ".webm": ("libvpx-vp9", {"crf": "30", "b": "0", "deadline": "realtime", "cpu-used": "5"}),
}
"""Encoder of each kind of file, with constant quality."""


def write_stream(file: Path, reel: Reel) -> None:
    """Write a reel as MP4 or WebM, as the suffix says; width and height are even."""
    codec, options = CODECS[file.suffix.lower()]
    with av.open(str(file), "w", options={"fflags": "+bitexact"}) as out:
        stream = out.add_stream(codec, rate=reel.rate, options=options)
        stream.width, stream.height = reel.size
        stream.pix_fmt = "yuv420p"  # what every player shows
        stream.codec_context.thread_count = 1  # with more, bytes depend on the machine
        for pixels in reel:
            out.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        out.mux(stream.encode(None))
