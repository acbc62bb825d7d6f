"""Rest on a true constraint under the hybrid law with believed rows, for any number of rows.

At rest the wrench W on the true constraint is what the law commands with the believed rows A_b,
W = P Λ K_p N X_e + (I − P) F_cmd, with Π = A_b⁺ A_b and N = I − Π. The range of P is Λ N, so that
P W is given by N W, and A_b Λ⁻¹ P = 0. Hence the law says

    N W = K_p N Λ N X_e                                      along what it believes free
    A_b W = A_b F_d                                          across, with an integral
    A_b Λ⁻¹ (W + K_fp Π W) = (1 + K_fp) A_b Λ⁻¹ F_d          across, without

and the true constraint says (I − A_t⁺ A_t) W = 0: together they determine W and the pose on the
constraint. Where the wrench outside A_b is fed forward, the first line is N X_e = 0 and the second
holds for all gains.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

from qpctrl.arrays import Matrix, Vector, Wrench

STEPS, ACCURACY = 30, 1e-13
DIFFERENCE = 1e-6  # m and rad, for slopes

RowsAt = Callable[[pin.SE3], Matrix]
"""Rows (k×6) on the body twist of the tool, as a function of its pose."""


class Loop(NamedTuple):
    """What of the controller decides on force and pose at rest."""

    F_d: Callable[[pin.SE3], Wrench]
    """Set-point (6) [N, Nm] in the axes of the tool, within the range of A_bᵀ at each pose."""
    K_fp: float
    """Proportional force gain [1]."""
    K_fi: float
    """Integral force gain [1/s]; any positive one gives the same."""
    K_p: float
    """Stiffness of the motion task, in all directions [1/s²]."""
    outside: bool = False
    """Whether the wrench outside the believed rows is fed forward."""


class Place(NamedTuple):
    """Where the tool is, and what it is asked for."""

    Lambda_inv: Matrix
    """Mobility (6×6) of the tool, in its own axes."""
    believed: RowsAt
    true: RowsAt
    """Rows of a constraint whose freedoms make a group: a pose X on it stays on it as
    X exp(Z ξ)."""
    X_WF: pin.SE3
    """A pose of the tool on the true constraint, near that of rest."""
    X_WD: pin.SE3
    """The pose that is asked for."""


class Rest(NamedTuple):
    """What is left at rest."""

    wrench: Wrench
    """On the environment (6) [N, Nm], in the axes of the tool."""
    X_WF: pin.SE3
    """Pose of the tool."""


def has_rest(place: Place, loop: Loop) -> bool:
    """Return whether there is a rest.

    There is none with more believed than true rows: nothing pushes back along the additional
    one. With fewer, there is none if the wrench outside them is fed forward: it feeds itself.
    """
    believed, true = len(place.believed(place.X_WF)), len(place.true(place.X_WF))
    return believed == true or (believed < true and not loop.outside)


def rest(place: Place, loop: Loop) -> Rest:
    """Return wrench and pose at rest, exactly, if `has_rest`."""
    W, X = loop.F_d(place.X_WF), place.X_WF
    small = ACCURACY * (1 + np.abs(W).max())
    for _ in range(STEPS):
        value = _residual(place, loop, W, X)
        if np.abs(value).max() <= small:
            break
        Z = null_space(place.true(X))
        slopes = [
            *(_residual(place, loop, W + e, X) - value for e in np.eye(6)),
            *(
                (_residual(place, loop, W, X * pin.exp6(DIFFERENCE * z)) - value) / DIFFERENCE
                for z in Z.T
            ),
        ]
        step = np.linalg.lstsq(np.array(slopes).T, -value)[0]
        W, X = W + step[:6], X * pin.exp6(Z @ step[6:])
    return Rest(W, X)


def _residual(place: Place, loop: Loop, W: Wrench, X: pin.SE3) -> Vector:
    """Return by how much the equations do not hold at wrench ``W`` and pose ``X``."""
    A, Lambda_inv, F_d, K = place.believed(X), place.Lambda_inv, loop.F_d(X), loop.K_fp
    N, N_true = _free(A), _free(place.true(X))
    along = N @ pin.log6(X.actInv(place.X_WD)).vector
    if not loop.outside:
        along = N @ (W - loop.K_p * np.linalg.solve(Lambda_inv, along))
    if loop.outside or loop.K_fi > 0:
        across = A @ (W - F_d)
    else:
        carried = W - N @ W
        across = A @ Lambda_inv @ (W + K * carried - (1 + K) * F_d)
    return np.concatenate([along, across, N_true @ W])


def _free(A: Matrix) -> Matrix:
    """Return I − A⁺ A (6×6)."""
    N: Matrix = np.eye(6) - np.linalg.pinv(A) @ A
    return N
