"""Pareto fronts: the rollouts that no other betters in everything."""

import numpy as np
from jaxtyping import Bool
from numpy.typing import ArrayLike

from qpctrl.arrays import Matrix, Vector
from qpctrl.errors import InputError


def pareto_front(costs: ArrayLike) -> Bool[np.ndarray, " _"]:
    """Return which rows are on the front: no other is as low in all columns and lower in one.

    Rows that are equal are on it together or not at all. A row with a NaN never is, and puts no
    other off. One or two columns take n log n; more of them, rows times length of the front.

    Args:
        costs: what to minimise (n × columns), any units; infinite is worse than all finite.

    Raises:
        InputError: not a matrix with at least one column.
    """
    array = np.asarray(costs, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] == 0:
        raise InputError(f"costs: got shape {array.shape}, need rows × columns")
    front = np.zeros(len(array), dtype=bool)
    known = ~np.isnan(array).any(axis=1)
    if known.any():
        # sorted by the columns, from left to right
        rows, which = np.unique(array[known], axis=0, return_inverse=True)
        best = _front_of_two(rows) if rows.shape[1] <= 2 else _front_of_many(rows)
        front[known] = best[which.ravel()]
    return front


def _front_of_two(rows: Matrix) -> Bool[np.ndarray, " _"]:
    """Return the front of sorted rows without doubles: the last column falls to a new low."""
    if rows.shape[1] == 1:
        return np.arange(len(rows)) == 0
    last: Vector = rows[:, 1]
    lowest = np.minimum.accumulate(last)
    return np.concatenate([[True], last[1:] < lowest[:-1]])


def _front_of_many(rows: Matrix) -> Bool[np.ndarray, " _"]:
    """Return the front of sorted rows without doubles: only an earlier one betters another."""
    front = np.zeros(len(rows), dtype=bool)
    left = np.arange(len(rows))
    while len(left):
        first, left = left[0], left[1:]
        front[first] = True
        left = left[(rows[left] < rows[first]).any(axis=1)]
    return front
