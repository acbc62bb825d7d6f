"""Evaluation of a CasADi function on preallocated arrays: under a microsecond of overhead."""

from collections.abc import Collection, Mapping
from typing import Any

import casadi as ca
import numpy as np

from qpctrl.arrays import Array


class Evaluator:
    """A function with fixed buffers: write the inputs, call, read the outputs.

    Attributes:
        inputs, outputs: arrays by name; outputs are overwritten by the next call.
    """

    def __init__(
        self,
        function: ca.Function,
        shared: Mapping[str, Array] | None = None,
        matrices: Collection[str] = (),
    ) -> None:
        """Bind ``function``.

        Args:
            function: what to evaluate.
            shared: arrays that inputs are read from, and outputs written to, in place.
            matrices: inputs and outputs that stay matrices when they have a single column.
        """
        buffer: Any
        buffer, self._call = function.buffer()
        self._buffer = buffer  # casadi's stubs miss the one-argument form of set_arg
        shared = shared or {}
        self.inputs: dict[str, Array] = {}
        self.outputs: dict[str, Array] = {}
        for i, name in enumerate(function.name_in()):
            self.inputs[name] = shared.get(name, _zeros(function.size_in(i), name in matrices))
            buffer.set_arg(i, memoryview(_flat(self.inputs[name])))
        for i, name in enumerate(function.name_out()):
            made = _zeros(function.size_out(i), name in matrices)
            self.outputs[name] = shared.get(name, made)
            buffer.set_res(i, memoryview(_flat(self.outputs[name])))

    def __call__(self) -> None:
        """Evaluate."""
        self._call()


def _zeros(shape: tuple[int, int], matrix: bool) -> Array:
    rows, cols = shape
    return np.zeros(rows) if cols == 1 and not matrix else np.zeros((rows, cols), order="F")


def _flat(array: Array) -> Any:
    return array.reshape(-1, order="A")
