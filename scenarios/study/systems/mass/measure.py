"""What is measured of a mass on a wall, beside its closed forms."""

import math

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix, Vector
from scenarios.metric import column, rms
from scenarios.study.outcome import (
    CONTACT_MEASURES,
    FORCE_MEASURES,
    TICK_MEASURES,
    contact_measures,
    force_measures,
    tick_measures,
)
from scenarios.study.system import Measures, Setting
from scenarios.study.systems.compared import compared, compared_words
from scenarios.study.systems.mass.forms import COMPLIANT, steady_force, steady_offset, true_axes

STEADY = 0.1  # share of a run, at its end, over which what does not change any more is averaged
NO_OFFSET = 1e-3  # mm, what an offset is compared with where its closed form is smaller
ROUND_OFF = 1e-10  # times the set-point, from tick to tick
LETS_GO = 2.0  # least growth of a force that lets go of its wall meanwhile

MEASURES = {
    **compared_words("force_ratio", "force on the wall over the set-point, at the end"),
    **compared_words("offset_mm", "offset along the wall at the end, holding still"),
    **compared_words("slide_speed_m_s", "speed at the end, sliding", "closed form, v / cos α"),
    "growth": "changes of force in the last quarter over those in the second; ≤ 1: it settles; "
    "2 or more where the mass leaves a compliant wall meanwhile",
    **FORCE_MEASURES,
    **CONTACT_MEASURES,
    **TICK_MEASURES,
}
"""Words of what `mass_measures` returns."""


def mass_measures(table: pl.DataFrame, setting: Setting) -> Measures:
    """Return the measures of a run that lasted to its end.

    Args:
        table: its ticks.
        setting: value of every parameter of the system.
    """
    force = setting["force"]
    lam = _xy(table, "wrench.f").dot(true_axes(setting)[0])[1:]  # the first one is not known
    judged = lam[len(lam) // 2 :]
    bounces = setting["wall"] == COMPLIANT and (lam[len(lam) // 4 :] <= 0).any()
    return {
        **_beside_closed_forms(table.tail(math.ceil(STEADY * len(table))), setting),
        "growth": max(growth(lam / force), LETS_GO if bounces else 0.0),
        **force_measures(judged, force),
        **contact_measures(_touching(lam, setting)[len(lam) // 2 :], 1 / setting["rate"]),
        **tick_measures(table),
    }


def growth(lam: Vector) -> float:
    """Return the RMS change of ``lam`` (ticks) in its last quarter over that in its second [1].

    Both are weighted with a Hann window, so that it matters little where a period begins. A force
    that does not change any more has 0.

    Args:
        lam: force over the set-point [1].
    """
    change = np.diff(lam)
    quarter = len(change) // 4
    window = np.hanning(quarter + 2)[1:-1]
    early, late = (rms(window * change[n * quarter : (n + 1) * quarter]) for n in (1, 3))
    return late / max(early, ROUND_OFF) if late > ROUND_OFF else 0.0


def _beside_closed_forms(end: pl.DataFrame, setting: Setting) -> Measures:
    """Return what the last ticks of a run say, and the closed forms that are known."""
    n, t = true_axes(setting)
    force, speed = setting["force"], abs(setting["speed"])
    lam = float(_xy(end, "wrench.f").dot(n).mean())
    steady = speed < setting["acceleration"] * setting["duration"] / 2  # reached by half of it
    closed = steady_force(setting) if steady else None
    ratio_closed = None if closed is None else closed / force
    none = dict.fromkeys(MEASURES)
    pressed = compared("force_ratio", lam / force, ratio_closed)
    if speed > 0:
        v = float(np.linalg.norm(_xy(end, "v."), axis=1).mean())
        slid = compared("slide_speed_m_s", v, speed / n[0] if steady else None)
        return {**none, **pressed, **slid}
    offset = 1e3 * float(_xy(end, "q.").dot(t).mean())
    offset_closed = None if closed is None else 1e3 * steady_offset(setting, closed)
    held = compared("offset_mm", offset, offset_closed, floor=NO_OFFSET)
    return {**none, **pressed, **held}


def _touching(lam: Vector, setting: Setting) -> Vector:
    """Return whether the mass touches, tick by tick: a rigid wall that pulled once has let go."""
    pushed = lam > 0
    return pushed if setting["wall"] == COMPLIANT else np.logical_and.accumulate(pushed)


def _xy(table: pl.DataFrame, name: str) -> Matrix:
    """Return the columns of a quantity along x and y (ticks×2)."""
    return np.stack([column(table, f"{name}{axis}") for axis in "xy"], axis=1)
