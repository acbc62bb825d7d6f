"""Doors, drawers, cranks and balls on the exact plant: the criteria, and what they show."""

import functools

import numpy as np
import pytest

from qpctrl import InputError
from scenarios.catalogue import SCENARIOS
from scenarios.crank import Crank
from scenarios.door import Door
from scenarios.drawer import Drawer
from scenarios.guided import ThereAndBack
from scenarios.run import Outcome, run_scenario
from scenarios.scenario import Options, Scenario
from scenarios.sphere import Sphere

JOBS: dict[str, Scenario] = {
    "door": Door(),
    "drawer": Drawer(),
    "crank": Crank(),
    "sphere": Sphere(),
    "sphere with a face": Sphere(contact="face"),
}


@functools.cache
def outcome(name: str, law: str = "qp") -> Outcome:
    """Return a run, made once."""
    return run_scenario(JOBS[name], Options(law=law))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", list(JOBS))
def test_a_job_meets_its_own_criteria(name: str) -> None:
    summary = outcome(name).summary
    assert summary["passed"], summary["criteria"]
    assert summary["metrics"]["force_peak_N"] > 5  # measured: it does press
    assert summary["metrics"]["qp_law_gap_max"] <= 1e-8


def test_the_door_opens_by_sixty_degrees_and_closes() -> None:
    table = outcome("door").table
    turns = np.stack([table[f"motion.X_WF.{i}"].to_numpy() for i in range(9)], axis=1)
    R = turns.reshape(-1, 3, 3).transpose(0, 2, 1)
    angle = np.degrees(np.arccos(np.clip((np.trace(R[0].T @ R, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert angle.max() == pytest.approx(60, abs=0.2)
    assert angle[-1] == pytest.approx(0, abs=0.2)


def test_the_textbook_law_errs_on_the_ball_and_the_qp_does_not() -> None:
    error = {law: outcome("sphere", law).summary["metrics"]["force_rmse_N"] for law in LAWS}
    assert error["textbook"] >= 5 * error["qp"]
    assert error["hybrid"] == pytest.approx(error["qp"], rel=1e-6)
    assert not outcome("sphere", "textbook").summary["passed"]


def test_a_face_that_turns_with_the_ball_has_no_curvature_term() -> None:
    turning = outcome("sphere with a face").summary["metrics"]["curvature_term_max"]
    assert turning < 1e-3 * outcome("sphere").summary["metrics"]["curvature_term_max"]


def test_the_way_there_and_back_is_smooth_and_as_long_as_asked() -> None:
    way = ThereAndBack(far=0.7, speed=0.5)
    time = np.linspace(0, 2 * way.half, 20_001)
    s, s_dot, s_ddot = np.array([way.at(t) for t in time]).T
    assert s.max() == pytest.approx(0.7, abs=1e-12)
    assert s[-1] == pytest.approx(0, abs=1e-12)
    assert np.abs(s_dot).max() == pytest.approx(0.5, abs=1e-12)
    assert np.gradient(s, time) == pytest.approx(s_dot, abs=1e-3)
    assert np.gradient(s_dot, time)[1:-1] == pytest.approx(s_ddot[1:-1], abs=1e-2)


@pytest.mark.parametrize("kind", [Door, Drawer, Crank, Sphere])
def test_a_job_refuses_what_makes_no_sense(kind: type) -> None:
    assert SCENARIOS[kind.name] is kind
    for value in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="force"):
            kind(force=value)


LAWS = ("qp", "hybrid", "textbook")
