"""Named arrays packed column by column into one vector, the calling form of a tick."""

from collections.abc import Mapping

import casadi as ca
import numpy as np

from qpctrl.arrays import Array, Vector
from qpctrl.spatial import SX


class Layout:
    """Order, shapes and default values of the named arrays in one vector.

    Attributes:
        size: length of the vector.
    """

    def __init__(self, defaults: Mapping[str, Array]) -> None:
        self._defaults = {name: np.asarray(value, float) for name, value in defaults.items()}
        self._slices: dict[str, slice] = {}
        self.size = 0
        for name, value in self._defaults.items():
            self._slices[name] = slice(self.size, self.size + value.size)
            self.size += value.size

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays, in order."""
        return tuple(self._defaults)

    def vector(self) -> Vector:
        """Return a new vector that holds the default of every array."""
        flat = [value.ravel(order="F") for value in self._defaults.values()]
        return np.concatenate([np.empty(0), *flat])

    def views(self, vector: Vector) -> dict[str, Array]:
        """Return writable views of the arrays inside ``vector`` (size)."""
        return {
            name: vector[self._slices[name]].reshape(value.shape, order="F")
            for name, value in self._defaults.items()
        }

    def view(self, vector: Vector, name: str) -> Array:
        """Return a writable view of one array inside ``vector`` (size)."""
        return vector[self._slices[name]].reshape(self._defaults[name].shape, order="F")

    def place(self, name: str) -> slice:
        """Return where in the vector an array lies."""
        return self._slices[name]

    def symbols(self, name: str) -> tuple[SX, dict[str, SX]]:
        """Return one symbolic vector and the named arrays cut from it."""
        vector = ca.SX.sym(name, self.size)
        cut = {}
        for key, value in self._defaults.items():
            rows, cols = (*value.shape, 1, 1)[:2]
            cut[key] = ca.reshape(vector[self._slices[key]], rows, cols)
        return vector, cut

    def pack(self, arrays: Mapping[str, SX]) -> SX:
        """Return the symbolic vector of ``arrays``, in this layout's order."""
        return ca.vertcat(ca.SX(0, 1), *(ca.vec(ca.densify(arrays[name])) for name in self.names))
