"""Virtual mass, damping and stiffness as symmetric matrices, checked where they enter."""

import numpy as np
from numpy.typing import ArrayLike

from qpctrl.arrays import Matrix, finite_array
from qpctrl.errors import InputError

ROUND_OFF = 1e-12
"""Share of the largest entry up to which a matrix may be unsymmetric or have negative
eigenvalues."""


def mass_matrix(value: ArrayLike, n: int, name: str) -> Matrix:
    """Return a virtual mass (n×n) from a scalar, a diagonal (n) or a matrix.

    Raises:
        InputError: wrong shape, not finite, not symmetric, or not positive definite.
    """
    return _definite(value, n, name, strictly=True)


def stiffness_matrix(value: ArrayLike, n: int, name: str) -> Matrix:
    """Return a virtual stiffness (n×n) from a scalar, a diagonal (n) or a matrix.

    Raises:
        InputError: wrong shape, not finite, not symmetric, or not positive semidefinite.
    """
    return _definite(value, n, name, strictly=False)


damping_matrix = stiffness_matrix
"""The same for a virtual damping."""


def _definite(value: ArrayLike, n: int, name: str, *, strictly: bool) -> Matrix:
    dims = np.ndim(value)
    matrix = finite_array(value, (n, n) if dims == 2 else (n,), name)
    matrix = matrix if dims == 2 else np.diag(matrix)
    size = max(float(np.abs(matrix).max()), ROUND_OFF)
    if np.abs(matrix - matrix.T).max() > ROUND_OFF * size:
        raise InputError(f"{name}: got {matrix.tolist()}, need a symmetric matrix")
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    got = f"{name}: got smallest eigenvalue {smallest:.3g}"
    if strictly and not smallest > ROUND_OFF * size:
        raise InputError(f"{got}, need a positive definite matrix")
    if smallest < -ROUND_OFF * size:
        raise InputError(f"{got}, need a positive semidefinite matrix")
    return matrix
