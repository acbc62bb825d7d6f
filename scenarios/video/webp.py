"""Animated WebP: small, at a loss that is hard to see."""

from pathlib import Path

from PIL import Image

from scenarios.video.reel import Reel

QUALITY = 90
EFFORT = 2  # of 6; more takes longer and saves little
KEYS = {"kmin": 9, "kmax": 17}  # pictures from one whole picture to the next


class Strip(Image.Image):
    """A reel as Pillow sees files of many pictures: one at a time, when it is sought."""

    def __init__(self, reel: Reel) -> None:
        """Show the first picture."""
        super().__init__()
        first = Image.fromarray(reel.picture(0))
        self.im, self._mode, self._size = first.im, first.mode, first.size
        self.n_frames, self._reel, self._next = reel.count, reel, 0

    def seek(self, frame: int) -> None:
        """Show picture number ``frame``, when its turn has come; there is no way back."""
        if frame == self._next:
            self.paste(Image.fromarray(self._reel.turn(frame)))
            self._next += 1


def write_webp(file: Path, reel: Reel) -> None:
    """Write a reel as a WebP that repeats for ever; a picture like the one before prolongs it."""
    Strip(reel).save(
        file,
        "WEBP",
        save_all=True,
        duration=reel.delays(1000),
        quality=QUALITY,
        method=EFFORT,
        **KEYS,
    )
