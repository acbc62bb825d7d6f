"""A wrong normal under an arm: what it presses with at rest, while sliding, and on a soft board.

Holding still, `wrong_normal.held` says all. Sliding, friction turns the wrench of the plane from
A_tᵀ λ to w λ, w = A_tᵀ + σ μ t, t the way along the true plane; the law asks nothing of A_t but its
wrench, so the same form holds with w in its place: λ / f_d = 1 / (cos α + σ μ sin α) with an
integral. A bias b of the reading takes its share of the set-point: f_d − b with an integral,
f_d − b K_fp / (1 + K_fp) without, and so does damping, d S_b⁻¹ σ v tan α / (1 + K_fp) without an
integral. A ball touches r (n_t − n_b) beside the end it is known by, so its A_t has a moment; the
force at rest then depends on it where inertia couples the directions.

MuJoCo pushes back with m k(δ) at the depth δ, k = d(δ)² δ / (d_max² T² (1 − d(δ))) with impedance
d and time constant T; m is the inverse of the mobility of the bodies as compiled, in the
model's reference posture, whatever the arm does.
"""

import numpy as np
from scipy.optimize import brentq

from qpctrl.arrays import Vector
from scenarios.plant_rigid import SLIP_SPEED
from scenarios.study.system import Setting
from scenarios.study.systems.arm.scene import DIRECTIONS, K_P, Arm, true_normal
from scenarios.study.systems.wrong_normal import ForceLaw, Held, held, mobility


def at_rest(arm: Arm, q: Vector, setting: Setting, *, ball: float = 0.0) -> Held | None:
    """Return what is left at rest in ``q`` (nq), exactly; none with friction, which holds it.

    Args:
        arm: the arm.
        q: its configuration (nq) [rad].
        setting: of the rollout.
        ball: radius [m] of what touches.
    """
    if setting["friction"] > 0:
        return None
    return _held(arm, q, true_normal(setting), setting, ball, 0.0)


def sliding(arm: Arm, q: Vector, setting: Setting) -> Held | None:
    """Return what a steady slide does in ``q`` (nq); none where friction jams it."""
    n, sigma, mu = true_normal(setting), DIRECTIONS[int(setting["direction"])], setting["friction"]
    if arm.world is None:
        mu *= min(setting["speed"] / n[2] / SLIP_SPEED, 1.0)
    w, V_n = n + sigma * mu * np.array([0.0, n[2], -n[1]]), -sigma * setting["speed"] * n[1] / n[2]
    return _held(arm, q, w, setting, arm.ball, V_n)


def _held(arm: Arm, q: Vector, w: Vector, setting: Setting, ball: float, V_n: float) -> Held | None:
    """Return what balances a force λ ``w`` (3), in the axes of E, at a speed V_n [m/s] into E."""
    R_FE = arm.robot.pose(q, arm.frame).rotation.T @ arm.X_WE.rotation
    A_b = np.array([*R_FE[:, 2], 0, 0, 0])
    touch = ball * (R_FE @ true_normal(setting) - np.eye(3)[2])
    A_t = np.concatenate([R_FE @ w, np.cross(touch, R_FE @ w)])
    Lambda_inv, force, K = mobility(arm.robot, arm.frame, q), setting["force"], setting["k_fp"]
    left = force - setting["sensor_bias"] * A_b[2]
    if setting["k_fi"] == 0:
        brake = setting["damping"] * V_n / float(A_b @ Lambda_inv @ A_b)
        left = (force + K * left - brake) / (1 + K)
    if A_b @ A_t <= 0 or left <= 0:
        return None
    law = ForceLaw(left, K, setting["k_fi"], K_P, outside=setting["cutoff"] > 0)
    found = held(Lambda_inv, A_b, A_t, law)
    return found._replace(force_ratio=float(found.force_ratio * left / force))


def depth(arm: Arm, lam: float, setting: Setting) -> float | None:
    """Return how deep [mm] a ball presses into MuJoCo's board with ``lam`` [N]; none elsewhere."""
    if arm.world is None or lam <= 0:
        return None
    first, largest, width = arm.world.pad.solimp
    model = arm.world.model
    mobility = sum(model.body(name).invweight0[0] for name in ("eraser/eraser", "qpctrl/board"))

    def missing(depth: float) -> float:
        x = min(depth / width, 1.0)
        d = first + (largest - first) * (2 * x**2 if x < 0.5 else 1 - 2 * (1 - x) ** 2)
        k = d**2 * depth / (largest * setting["contact_time"]) ** 2 / (1 - d)
        return k / mobility - lam

    return 1e3 * float(brentq(missing, 0.0, 1.0, xtol=1e-12))
