"""Doors, drawers, valves, cranks and balls on the exact plant: criteria, and what they show."""

import numpy as np
import polars as pl
import pytest
from runs import Ran, ran

from qpctrl import InputError
from scenarios.catalogue import SCENARIOS
from scenarios.crank import Crank
from scenarios.door import Door
from scenarios.drawer import Drawer
from scenarios.guided import ThereAndBack
from scenarios.sphere import Sphere
from scenarios.valve import Valve

JOBS = {
    **{name: (name,) for name in ("door", "drawer", "valve", "crank", "sphere")},
    "sphere with a face": ("sphere", "--contact", "face"),
}


def outcome(name: str, law: str = "qp") -> Ran:
    """Return a run, made once."""
    return ran(*JOBS[name], "--law", law)


@pytest.mark.parametrize("name", list(JOBS))
def test_a_job_meets_its_own_criteria(name: str) -> None:
    found = outcome(name)
    assert found.passed, found.missed
    assert found.metrics["force_peak_N"] > 5  # measured: it does press
    assert found.metrics["qp_law_gap_max"] <= 1e-8


def turned(table: pl.DataFrame) -> np.ndarray:
    """Return the angle [deg] by which the tool has turned since the start."""
    turns = np.stack([table[f"motion.X_WF.{i}"].to_numpy() for i in range(9)], axis=1)
    R = turns.reshape(-1, 3, 3).transpose(0, 2, 1)
    return np.degrees(np.arccos(np.clip((np.trace(R[0].T @ R, axis1=1, axis2=2) - 1) / 2, -1, 1)))


def test_the_door_opens_by_sixty_degrees_and_closes() -> None:
    angle = turned(outcome("door").table)
    assert angle.max() == pytest.approx(60, abs=0.2)
    assert angle[-1] == pytest.approx(0, abs=0.2)


def test_the_valve_turns_by_fifty_degrees_to_each_side_and_advances_by_its_lead() -> None:
    table = outcome("valve").table
    angle, z = turned(table), table.select(f"motion.X_WF.{i}" for i in (6, 7, 8)).row(0)
    p = table.select(f"motion.X_WF.{i}" for i in (9, 10, 11)).to_numpy()
    assert angle.max() == pytest.approx(100, abs=0.2)
    assert angle[-1] == pytest.approx(0, abs=0.2)
    assert (p - p[0]) @ z == pytest.approx(5e-3 * np.radians(angle), abs=1e-6)


def test_the_valve_is_pulled_pressed_and_twisted_as_asked() -> None:
    table = outcome("valve").table.filter(pl.col("phase") == "move")
    f, m = (table.select(f"wrench_meas.{x}{axis}" for axis in "xyz").to_numpy() for x in "fm")
    about_axis = m + np.cross([0.08, 0.0, 0.0], f)  # the spoke is x of the tool
    assert f == pytest.approx(np.tile([8.0, 0.0, 8.0], (len(f), 1)), abs=0.05)
    assert about_axis == pytest.approx(np.tile([0.5, 0.0, -5e-3 * 8.0], (len(f), 1)), abs=5e-3)


def test_the_textbook_law_errs_on_the_ball_and_the_qp_does_not() -> None:
    error = {law: outcome("sphere", law).metrics["force_rmse_N"] for law in LAWS}
    assert error["textbook"] >= 5 * error["qp"]
    assert error["hybrid"] == pytest.approx(error["qp"], rel=1e-6)
    assert not outcome("sphere", "textbook").passed


def test_a_face_that_turns_with_the_ball_has_no_curvature_term() -> None:
    turning = outcome("sphere with a face").metrics["curvature_term_max"]
    assert turning < 1e-3 * outcome("sphere").metrics["curvature_term_max"]


def test_the_way_there_and_back_is_smooth_and_as_long_as_asked() -> None:
    way = ThereAndBack(far=0.7, speed=0.5)
    time = np.linspace(0, 2 * way.half, 20_001)
    s, s_dot, s_ddot = np.array([way.at(t) for t in time]).T
    assert s.max() == pytest.approx(0.7, abs=1e-12)
    assert s[-1] == pytest.approx(0, abs=1e-12)
    assert np.abs(s_dot).max() == pytest.approx(0.5, abs=1e-12)
    assert np.gradient(s, time) == pytest.approx(s_dot, abs=1e-3)
    assert np.gradient(s_dot, time)[1:-1] == pytest.approx(s_ddot[1:-1], abs=1e-2)


@pytest.mark.parametrize("kind", [Door, Drawer, Valve, Crank, Sphere])
def test_a_job_refuses_what_makes_no_sense(kind: type) -> None:
    assert SCENARIOS[kind.name] is kind
    for value in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="force"):
            kind(force=value)


@pytest.mark.parametrize("name", ["angle", "rate", "radius", "lead", "moment"])
def test_the_valve_refuses_numbers_that_make_no_sense(name: str) -> None:
    for value in (0.0, -1.0, float("inf")):
        with pytest.raises(InputError, match=f"{name}: "):
            Valve(**{name: value})


LAWS = ("qp", "hybrid", "textbook")
