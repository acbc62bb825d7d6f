"""Where the arrays of a tick lie in one vector of numbers, sharing what they share here."""

from collections.abc import Iterable

from numpy.lib.array_utils import byte_bounds

from qpctrl.arrays import Array

BYTES = 8
"""Of one number."""


class Places:
    """One vector of numbers in which every array has its place; views share that of the whole.

    Attributes:
        size: length of the vector.
    """

    def __init__(self, arrays: Iterable[Array]) -> None:
        """Lay the arrays out, in their order."""
        bounds = [byte_bounds(array) for array in arrays if array.size]
        blocks: list[tuple[int, int]] = []
        for low, high in sorted(bounds):
            if blocks and low < blocks[-1][1]:
                blocks[-1] = (blocks[-1][0], max(high, blocks[-1][1]))
            else:
                blocks.append((low, high))
        self._blocks, self.size = blocks, 0
        self._first: dict[tuple[int, int], int] = {}
        for low, _ in bounds:
            block = self._block(low)
            if block not in self._first:
                self._first[block] = self.size
                self.size += (block[1] - block[0]) // BYTES

    def of(self, array: Array) -> int:
        """Return where an array begins; 0 for one without numbers."""
        if not array.size:
            return 0
        low, _ = byte_bounds(array)
        block = self._block(low)
        return self._first[block] + (low - block[0]) // BYTES

    def _block(self, address: int) -> tuple[int, int]:
        return next(block for block in self._blocks if block[0] <= address < block[1])
