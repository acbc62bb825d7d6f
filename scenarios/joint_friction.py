"""Dry friction of joints that holds them exactly still, for plants that integrate themselves.

Torque is held over a period h, and so is friction f: of all torques within ±c it is the one that
opposes the motion most. With v⁺ = v_free + W f, the velocity at the end of the period to first
order, W = h × mobility of the joints, and joint by joint

    v⁺ = 0 and |f| ≤ c (stuck),  v⁺ > 0 and f = −c,  or  v⁺ < 0 and f = c.

A joint that is stuck stays where it is, without a threshold of speed and without chatter. Where a
rigid contact leaves open which of the stuck joints carries what, the least torques do.
"""

import numpy as np

from qpctrl.arrays import Matrix, Vector

SOFTNESS = 1e-8
"""Added to W, in units of its largest diagonal entry: it makes the least torques the answer, and
lets a stuck joint creep by as much of the speed that it would gain in a period."""

EXCHANGES = 30
"""Of joints between stuck and sliding, before the answer is approached sweep by sweep."""

SWEEPS = 200


def dry_friction(W: Matrix, v_free: Vector, coulomb: Vector) -> Vector:
    """Return the friction torque f (nv) [Nm or N] on the joints over a period.

    Args:
        W: velocity at the end of the period per torque held over it (nv×nv) [rad/(s Nm)].
        v_free: velocity there without dry friction (nv) [rad/s or m/s].
        coulomb: largest friction c (nv) [Nm or N].
    """
    if not np.isfinite(v_free).all():  # a plant that diverges; judged later
        return np.zeros_like(v_free)
    W = W + SOFTNESS * W.diagonal().max() * np.eye(len(W))
    size = W.diagonal()
    f = np.clip(-v_free / size, -coulomb, coulomb)
    for _ in range(EXCHANGES):
        wanted = f - (W.dot(f) + v_free) / size
        low, high = wanted <= -coulomb, wanted >= coulomb
        slides = low | high
        after = np.where(low, -coulomb, np.where(high, coulomb, 0.0))
        stuck = np.flatnonzero(~slides)
        if len(stuck):
            rest = W[stuck].dot(after) + v_free[stuck]
            after[stuck] = np.linalg.solve(W[np.ix_(stuck, stuck)], -rest)
        if np.array_equal(after, f):
            return f
        f = after
    return _swept(W, v_free, coulomb, np.clip(f, -coulomb, coulomb))


def _swept(W: Matrix, v_free: Vector, coulomb: Vector, f: Vector) -> Vector:
    """Return the answer of projected Gauss–Seidel, which converges for every W > 0."""
    for _ in range(SWEEPS):
        for i, c in enumerate(coulomb):
            f[i] = min(max(f[i] - (W[i].dot(f) + v_free[i]) / W[i, i], -c), c)
    return f
