"""Array aliases with named shapes, and the checks applied where arrays enter.

Shapes: ``nq`` configuration, ``nv`` velocity, ``nu`` actuators, ``n`` task axes, ``k``
constraint rows.
"""

from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from qpctrl.errors import InputError

Vector: TypeAlias = Float[np.ndarray, " _"]
Matrix: TypeAlias = Float[np.ndarray, "_ _"]
Array: TypeAlias = Float[np.ndarray, "..."]
Twist: TypeAlias = Float[np.ndarray, " 6"]
Wrench: TypeAlias = Float[np.ndarray, " 6"]
Rotation: TypeAlias = Float[np.ndarray, "3 3"]


def finite_array(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """Return ``value`` as float64 of ``shape``; scalars are broadcast.

    Raises:
        InputError: wrong shape, not numeric, or not finite.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: got {value!r}, need numbers of shape {shape}") from error
    if array.ndim == 0:
        array = np.full(shape, float(array))
    if array.shape != shape:
        raise InputError(f"{name}: got shape {array.shape}, need {shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name}: got {array.tolist()}, need finite numbers")
    return array.copy()


def non_negative(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """Return ``value`` as in `finite_array`, refusing negative entries."""
    array = finite_array(value, shape, name)
    if (array < 0).any():
        raise InputError(f"{name}: got {array.tolist()}, need values >= 0")
    return array


def positive(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """Return ``value`` as in `finite_array`, refusing entries that are not above zero."""
    array = finite_array(value, shape, name)
    if (array <= 0).any():
        raise InputError(f"{name}: got {array.tolist()}, need values > 0")
    return array
