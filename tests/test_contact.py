"""What a contact can carry: friction cone, footprint, largest force, as rows of the QP."""

import functools
from typing import NamedTuple

import numpy as np
import oracles
import pinocchio as pin
import pytest
import qpsolvers
from cases import SPACES, UNLIMITED_RATE, chain

from qpctrl import (
    Controller,
    InputError,
    Limits,
    Measurement,
    Mode,
    Pfaffian,
    Robot,
    TaskSpace,
    TickReport,
    Weighted,
)
from qpctrl.contact import Footprint, FrictionCone, MaxForce, WrenchLimit
from tasks import ForceReference, ForceTask, MotionReference, MotionTask, PostureTask

SPACE = SPACES["arm_7"]
AGREEMENT = 1e-7
"""N and Nm: what a general solver at its default accuracy leaves of an optimum of 30 N."""
EXACT = 1e-9
"""N: round-off of a force of 30 N on its bound, and of the motion beside it."""


@functools.cache
def arm() -> Robot:
    """Return the 7-joint arm without limits of its own."""
    free = chain(7, seed=7)
    unlimited = np.full(7, np.inf)
    limits = Limits(
        q_min=free.limits.q_min,
        q_max=free.limits.q_max,
        v_max=unlimited,
        tau_max=unlimited,
        tau_rate=np.full(7, UNLIMITED_RATE),
    )
    return Robot(model=free.model, limits=limits, home=free.home)


class Pressed(NamedTuple):
    """One tick of an arm held in all six directions."""

    report: TickReport
    F: np.ndarray
    Lambda_inv: np.ndarray


def press(
    F_ref: np.ndarray, *limits: WrenchLimit, rows: tuple[int, ...] = tuple(range(6))
) -> Pressed:
    """Return the tick in which the arm shall press with ``F_ref`` (6) through ``rows`` of V."""
    robot, A = arm(), np.eye(6)[list(rows)]
    mode = Mode(
        name="press",
        tasks=(
            Weighted(MotionTask(space=SPACE)),
            Weighted(ForceTask(space=SPACE, ramp=1e9, cutoff=0.0)),
            Weighted(PostureTask(q_ref=robot.home)),
        ),
        constraints=(Pfaffian(space=SPACE, A=A, name="hold"),),
        contact_limits=limits,
    )
    controller = Controller(robot, [mode])
    X_WF = robot.pose(robot.home, SPACE.frame)
    step = pin.SE3(np.eye(3), np.array([0.01, 0.02, 0.0]))
    references = {
        "motion": MotionReference(X_WD=X_WF * step),
        "force": ForceReference(F_ref=F_ref, F_meas=np.zeros(6)),
    }
    start = controller.start("press", robot.home)
    measured = Measurement(time=1e-3, q=robot.home, v=np.full(7, 0.1))
    _, report, _ = controller.step("press", measured, references, start)
    terms = oracles.body_terms(robot.model, robot.home, measured.v, SPACE.frame, SPACE.index)
    return Pressed(report, A.T @ report.lam, np.linalg.inv(terms.Lambda))


def nearest(pressed: Pressed, F_ref: np.ndarray, W: np.ndarray, ub: np.ndarray) -> np.ndarray:
    """Return the wrench nearest to ``F_ref`` in the metric Λ⁻¹ that the limits allow."""
    H = pressed.Lambda_inv
    problem = qpsolvers.Problem((H + H.T) / 2, -H @ F_ref, W, ub)
    found = qpsolvers.solve_problem(problem, "quadprog")
    assert found.x is not None
    return found.x


def cone(mu: float, sides: int) -> np.ndarray:
    """Return the pyramid's rows, written anew: each side from two neighbouring edges."""
    edge = 2 * np.pi * (np.arange(sides) - 0.5) / sides
    corners = np.column_stack([mu * np.cos(edge), mu * np.sin(edge), np.ones(sides)])
    normals = np.cross(np.roll(corners, -1, axis=0), corners)
    return np.pad(normals / np.linalg.norm(normals[:, :2], axis=1)[:, None], ((0, 0), (0, 3)))


def active(report: TickReport) -> list[str]:
    """Return the names of the limits that bind."""
    return [limit.name for limit in report.active]


@pytest.mark.parametrize("sides", [4, 16, 64])
def test_a_force_outside_the_cone_becomes_the_nearest_one_inside(sides: int) -> None:
    F_ref = np.array([12.0, 5.0, 20.0, 0.3, -0.2, 0.1])
    pressed = press(F_ref, FrictionCone(space=SPACE, mu=0.4, sides=sides))
    expected = nearest(pressed, F_ref, cone(0.4, sides), np.zeros(sides))
    assert pytest.approx(expected, abs=AGREEMENT) == pressed.F
    assert np.hypot(*pressed.F[:2]) <= 0.4 * pressed.F[2] + EXACT
    assert np.hypot(*pressed.F[:2]) >= 0.4 * np.cos(np.pi / sides) * pressed.F[2] - EXACT
    assert any(name.startswith("contact friction.") for name in active(pressed.report))
    assert pressed.report.kkt_residual <= 1e-9
    assert pressed.report.saturated
    assert "contact friction." in pressed.report.explain()


def test_a_force_inside_its_limits_is_left_alone_and_the_law_holds() -> None:
    F_ref = np.array([2.0, -3.0, 20.0, 0.2, -0.3, 0.1])
    pressed = press(
        F_ref,
        FrictionCone(space=SPACE, mu=0.4),
        Footprint(space=SPACE, half=(0.06, 0.025)),
        MaxForce(space=SPACE, limit=25.0),
    )
    assert pytest.approx(F_ref, abs=EXACT) == pressed.F
    assert not pressed.report.active
    assert pressed.report.law_gap <= 1e-9


def test_the_centre_of_pressure_stays_on_the_face() -> None:
    half, f = (0.06, 0.025), 20.0
    for x, y, edge in ((0.1, 0.0, "+x"), (-0.1, 0.0, "-x"), (0.0, 0.05, "+y"), (0.0, -0.05, "-y")):
        F_ref = np.array([0.0, 0.0, f, y * f, -x * f, 0.0])  # moment of a force at (x, y, 0)
        pressed = press(F_ref, Footprint(space=SPACE, half=half))
        p = -pressed.F[4] / pressed.F[2], pressed.F[3] / pressed.F[2]
        side = 0 if x else 1
        assert p[side] == pytest.approx(np.sign(x + y) * half[side], abs=EXACT)
        assert f"contact footprint.{edge}" in active(pressed.report)
        W = np.zeros((4, 6))
        W[0, 4], W[1, 4], W[2, 3], W[3, 3] = 1, -1, 1, -1
        W[:2, 2], W[2:, 2] = -half[0], -half[1]
        expected = nearest(pressed, F_ref, W, np.zeros(4))
        assert pytest.approx(expected, abs=AGREEMENT) == pressed.F


def test_the_force_stops_at_its_largest_value_and_the_motion_goes_on() -> None:
    F_ref = np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0])
    capped = press(F_ref, MaxForce(space=SPACE, limit=12.0), rows=(2, 3, 4))
    free = press(F_ref, rows=(2, 3, 4))
    assert free.F[2] == pytest.approx(30.0, abs=EXACT)
    assert capped.F[2] == pytest.approx(12.0, abs=EXACT)
    assert active(capped.report) == ["contact max force.fz"]
    lost = {item.task: np.abs(item.amount).max() for item in capped.report.yields}
    assert lost["force"] == pytest.approx(18.0, rel=0.5)
    assert lost["motion"] <= EXACT  # the two costs are orthogonal: only the force gives way


def test_pulling_ends_at_the_tip_of_the_cone_and_the_tick_still_has_a_solution() -> None:
    F_ref = np.array([3.0, 1.0, -20.0, 0.0, 0.0, 0.0])
    pressed = press(F_ref, FrictionCone(space=SPACE, mu=0.3), rows=(0, 1, 2))
    assert pressed.report.kkt_residual <= 1e-9
    assert pressed.F[2] >= -EXACT
    assert np.hypot(*pressed.F[:2]) <= 0.3 * pressed.F[2] + EXACT


def test_limits_that_make_no_sense_are_refused_in_one_line() -> None:
    for broken, words in (
        (lambda: FrictionCone(space=SPACE, mu=-0.1), "friction.mu"),
        (lambda: FrictionCone(space=SPACE, mu=float("nan")), "finite"),
        (lambda: FrictionCone(space=SPACE, mu=0.3, sides=2), "3 or more"),
        (lambda: FrictionCone(space=TaskSpace("tool", ("vx", "vy")), mu=0.3), "axes"),
        (lambda: Footprint(space=SPACE, half=(0.1, -0.1)), "footprint.half"),
        (lambda: Footprint(space=SPACE, half=(0.0, 0.1)), "> 0"),
        (lambda: MaxForce(space=SPACE, limit=0.0), "> 0"),
        (lambda: MaxForce(space=SPACE, limit=float("inf")), "finite"),
    ):
        with pytest.raises(InputError, match=words) as refused:
            broken()
        assert "\n" not in str(refused.value)


def test_a_limit_needs_a_contact_and_a_name_of_its_own() -> None:
    task = Weighted(MotionTask(space=SPACE))
    cone_here = FrictionCone(space=SPACE, mu=0.3)
    with pytest.raises(InputError, match="no constraint on its task space"):
        Mode(name="free", tasks=(task,), contact_limits=(cone_here,))
    hold = Pfaffian(space=SPACE, A=np.eye(6))
    with pytest.raises(InputError, match="names must differ"):
        Mode(name="two", tasks=(task,), constraints=(hold,), contact_limits=(cone_here, cone_here))
