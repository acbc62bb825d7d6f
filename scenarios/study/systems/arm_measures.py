"""What is measured of a rollout of the system `arm-on-plane`, beside closed forms.

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
import polars as pl
from scipy.optimize import brentq

from qpctrl.arrays import Matrix, Vector
from scenarios.metric import column, tick_metrics
from scenarios.plant_rigid import SLIP_SPEED
from scenarios.record import WRENCH
from scenarios.study.outcome import (
    CONTACT_MEASURES,
    FORCE_MEASURES,
    TICK_MEASURES,
    contact_measures,
    force_measures,
)
from scenarios.study.system import Measures, Setting
from scenarios.study.systems.arm_scene import (
    DIRECTIONS,
    DT,
    K_P,
    Arm,
    true_normal,
)
from scenarios.study.systems.compared import compared, compared_words
from scenarios.study.systems.wrong_normal import ForceLaw, Held, held, mobility

PRESSED = 0.2  # s, from which on the force is judged
STEADY = 0.1  # s at the end, over which the speed is averaged
NO_OFFSET = 1e-3  # mm, what an offset is compared with where its closed form is smaller

MEASURES = {
    **compared_words("force_ratio", "force on the plane over the set-point, holding still"),
    **compared_words("offset_mm", "tangential offset, holding still"),
    **compared_words("slide_ratio", "force into the plane over the set-point, sliding"),
    **compared_words("speed_m_s", "speed while sliding", "its closed form, v / cos α"),
    "force_ratio_ball_gap": "holding still, from the closed form that knows where a ball touches",
    "offset_ball_gap": "the same of the offset",
    "friction_ratio": "force along the plane over that into it, sliding",
    **compared_words("depth_mm", "way into the plane, holding still"),
    **FORCE_MEASURES,
    **CONTACT_MEASURES,
    **TICK_MEASURES,
}
"""Words of what `arm_measures` returns."""


def arm_measures(arm: Arm, table: pl.DataFrame, setting: Setting) -> Measures:
    """Return the measures of a rollout."""
    rest = int((table["phase"] == "hold").sum()) - 1
    F = _turned(arm, table, np.stack([column(table, f"wrench.{x}") for x in WRENCH[:3]], axis=1))
    lam = F @ true_normal(setting)
    judged = lam[round(PRESSED / DT) :]
    pushing = judged > 0
    if arm.world is None:  # a plane that cannot pull has let go
        pushing = np.logical_and.accumulate(pushing)
    ticks = tick_metrics(table)
    gap = ticks["qp_law_gap_max"]
    return {
        **_holding(arm, table, rest, float(lam[rest]), setting),
        **_sliding(arm, table, F, setting),
        **force_measures(judged, setting["force"]),
        **contact_measures(pushing, DT),
        "saturated_fraction": ticks["saturated_fraction"],
        "fallback_ticks": ticks["fallback_ticks"],
        "qp_law_gap_max": None if np.isnan(gap) else gap,
    }


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
    left = force - setting["bias"] * A_b[2]
    if setting["k_fi"] == 0:
        brake = setting["damping"] * V_n / float(A_b @ Lambda_inv @ A_b)
        left = (force + K * left - brake) / (1 + K)
    if A_b @ A_t <= 0 or left <= 0:
        return None
    law = ForceLaw(left, K, setting["k_fi"], K_P, outside=setting["cutoff"] > 0)
    found = held(Lambda_inv, A_b, A_t, law)
    return found._replace(force_ratio=float(found.force_ratio * left / force))


def _holding(arm: Arm, table: pl.DataFrame, rest: int, lam: float, setting: Setting) -> Measures:
    q = _q(arm, table, rest)
    X_WF = arm.robot.pose(q, arm.frame)
    R_EF = arm.X_WE.rotation.T @ X_WF.rotation
    point, ball = at_rest(arm, q, setting), at_rest(arm, q, setting, ball=arm.ball)
    X_e = np.array([table[f"motion.X_e.{i}"][rest] for i in range(3)])
    ratio, offset = lam / setting["force"], 1e3 * float((R_EF @ X_e)[1])

    def wanted(form: Held | None) -> float | None:
        return None if form is None else 1e3 * float((R_EF @ form.offset[:3])[1])

    centre = arm.X_WE.actInv(X_WF).translation - arm.ball * (R_EF[:, 2] - np.eye(3)[2])
    near = compared("", ratio, None if ball is None else ball.force_ratio)
    aside = compared("", offset, wanted(ball), NO_OFFSET)
    return {
        **compared("force_ratio", ratio, None if point is None else point.force_ratio),
        **compared("offset_mm", offset, wanted(point), NO_OFFSET),
        "force_ratio_ball_gap": near["_gap"],
        "offset_ball_gap": aside["_gap"],
        **compared(
            "depth_mm", 1e3 * float(centre @ true_normal(setting)), _depth(arm, lam, setting)
        ),
    }


def _depth(arm: Arm, lam: float, setting: Setting) -> float | None:
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


def _sliding(arm: Arm, table: pl.DataFrame, F: Matrix, setting: Setting) -> Measures:
    steady = column(table, "time") >= setting["hold"] + setting["slide"] - STEADY - DT / 2
    n = true_normal(setting)
    V = np.stack([column(table, f"motion.V.{i}") for i in range(3)], axis=1)[steady]
    into = F[steady] @ n
    along = np.linalg.norm(F[steady] - np.outer(into, n), axis=1)
    closed = sliding(arm, _q(arm, table, len(table) - 1), setting)
    ratio = float(into[-1]) / setting["force"]
    return {
        **compared("slide_ratio", ratio, None if closed is None else closed.force_ratio),
        **compared(
            "speed_m_s", float(np.linalg.norm(V, axis=1).mean()), float(setting["speed"] / n[2])
        ),
        "friction_ratio": float(along.mean() / into.mean()) if into.mean() > 0 else None,
    }


def _q(arm: Arm, table: pl.DataFrame, tick: int) -> Vector:
    return np.array([table[f"q.{name}"][tick] for name in arm.robot.joint_names])


def _turned(arm: Arm, table: pl.DataFrame, x: Matrix) -> Matrix:
    """Return vectors (ticks×3) of the tool's axes in those of the believed plane."""
    columns = [column(table, f"motion.X_WF.{i}") for i in range(9)]  # of R_WF, one by one
    R_WF = np.stack(columns, axis=1).reshape(-1, 3, 3).transpose(0, 2, 1)
    turned: Matrix = np.einsum("tij,tj->ti", R_WF, x) @ arm.X_WE.rotation
    return turned
