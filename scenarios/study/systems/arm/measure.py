"""What is measured of a rollout of the system `arm-on-plane`, beside closed forms."""

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix, Vector
from scenarios.metric import column
from scenarios.record import WRENCH
from scenarios.study.outcome import (
    CONTACT_MEASURES,
    FORCE_MEASURES,
    TICK_MEASURES,
    contact_measures,
    force_measures,
    tick_measures,
)
from scenarios.study.system import Measures, Setting
from scenarios.study.systems.arm.forms import at_rest, depth, sliding
from scenarios.study.systems.arm.scene import (
    DT,
    Arm,
    true_normal,
)
from scenarios.study.systems.compared import compared, compared_words
from scenarios.study.systems.wrong_normal import Held

PRESSED = 0.2  # s, from which on the force is judged
STEADY = 0.1  # s at the end, over which the speed is averaged
NO_OFFSET = 1e-3  # mm, what an offset is compared with where its closed form is smaller

MEASURES = {
    **compared_words("force_ratio", "force on the plane over the set-point, holding still"),
    **compared_words("offset_mm", "tangential offset, holding still"),
    **compared_words("slide_ratio", "force into the plane over the set-point, sliding"),
    **compared_words("speed_m_s", "speed while sliding", "closed form, v / cos α"),
    "force_ratio_ball_gap": "force from the closed form that knows where a ball touches",
    "offset_ball_gap": "offset from the closed form that knows where a ball touches",
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
    return {
        **_holding(arm, table, rest, float(lam[rest]), setting),
        **_sliding(arm, table, F, setting),
        **force_measures(judged, setting["force"]),
        **contact_measures(pushing, DT),
        **tick_measures(table),
    }


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
            "depth_mm", 1e3 * float(centre @ true_normal(setting)), depth(arm, lam, setting)
        ),
    }


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
