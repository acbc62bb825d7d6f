"""A reel: pictures in a row, each made when it is asked for, and how long each is shown."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

from scenarios.video.screen import Pixels

_FINEST = 1000  # largest denominator of a rate: 30000/1001 frames/s is 29.97


@dataclass(frozen=True, kw_only=True, eq=False)
class Reel:
    """What is written to a file of moving pictures; never held as a whole."""

    picture: Callable[[int], Pixels]
    """Makes picture k (height×width×3)."""
    count: int
    """Number of pictures."""
    fps: float
    """Pictures in a second [1/s]."""
    size: tuple[int, int]
    """Width and height [pixels]."""
    watch: Callable[[int], None] | None = None
    """Told the number of each picture when its turn comes."""

    @property
    def rate(self) -> Fraction:
        """Pictures in a second [1/s], as a fraction of small numbers."""
        return Fraction(self.fps).limit_denominator(_FINEST)

    def __iter__(self) -> Iterator[Pixels]:
        """Yield all pictures in turn."""
        return map(self.turn, range(self.count))

    def turn(self, k: int) -> Pixels:
        """Return picture k, whose turn has come."""
        if self.watch is not None:
            self.watch(k)
        return self.picture(k)

    def delays(self, second: int) -> list[int]:
        """Return how long each picture is shown, in whole units of 1/``second`` s.

        What rounding takes from one picture the next ones get: no error grows.
        """
        starts = [round(k * second / self.rate) for k in range(self.count + 1)]
        return [end - start for start, end in pairwise(starts)]
