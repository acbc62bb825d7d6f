"""Every natural constraint: what it allows, what it forbids, how its rows turn."""

from collections.abc import Callable

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from cases import SPACES

from qpctrl import InputError, TaskSpace
from qpctrl.constraint import (
    Constraint,
    Crank,
    Drawer,
    EdgeOnPlane,
    Embedded,
    Hinge,
    Moving,
    PointOnPlane,
    PoseConstraint,
    Screw,
    Surface,
    cylinder,
    row_function,
    saddle,
    sphere,
)

SPACE = SPACES["arm_7"]
ROUND_OFF = 1e-12
STEP = 1e-6  # of the central differences
DIFFERENCE = 1e-7
"""Central differences of order one with that step: truncation 1e-12, round-off 1e-10 and more."""

X_WE = pin.exp6(np.array([0.4, -0.2, 0.3, 0.5, -0.7, 0.9]))
LEAD = 0.02


def sphere_of(face: bool) -> Surface:
    phi, p = sphere(np.array([0.0, 0.1, 0.0]), 0.25)
    at = pin.SE3(np.eye(3), np.array([0.0, 0.1, -0.25]))
    return Surface(space=SPACE, X_WE=X_WE, phi=phi, p=p, contact=at, face=face)


def saddle_face() -> Surface:
    phi, p = saddle(3.0, 2.0)
    return Surface(space=SPACE, X_WE=X_WE, phi=phi, p=p, contact=pin.SE3.Identity(), face=True)


def rod() -> Surface:
    phi, p = cylinder(0.1)
    at = pin.SE3(np.eye(3), np.array([0.0, -0.1, 0.0]))
    return Surface(space=SPACE, X_WE=X_WE, phi=phi, p=p, contact=at)


def hinge_by_pose() -> PoseConstraint:
    """Return a hinge written as five equations: distance, height, and two tilts of z."""
    R, p = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3)
    c = ca.vertcat(ca.sumsqr(p[:2]), p[2], R[0, 2], R[1, 2], p[0] * R[1, 0] - p[1] * R[0, 0])
    at = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))
    return PoseConstraint(space=SPACE, X_WE=X_WE, c=c, R=R, p=p, contact=at)


CASES: dict[str, tuple[Constraint, pin.SE3, list[list[float]]]] = {
    # constraint, pose X_EF in contact, twists about E's origin, in E, that it allows
    "point": (
        PointOnPlane(space=SPACE, X_WE=X_WE),
        pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.zeros(3)),
        [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], *np.eye(6)[3:].tolist()],
    ),
    "edge": (
        EdgeOnPlane(space=SPACE, X_WE=X_WE),
        pin.SE3(pin.exp3(np.array([0, 0.4, 0.0])), np.zeros(3)),
        [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]],
    ),
    "hinge": (
        Hinge(space=SPACE, X_WE=X_WE),
        pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.3, 0.1, 0.2])),
        [[0, 0, 0, 0, 0, 1]],
    ),
    "screw": (
        Screw(space=SPACE, X_WE=X_WE, lead=LEAD),
        pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.3, 0.1, 0.2])),
        [[0, 0, LEAD, 0, 0, 1]],
    ),
    "drawer": (
        Drawer(space=SPACE, X_WE=X_WE),
        pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.3, 0.1, 0.2])),
        [[1, 0, 0, 0, 0, 0]],
    ),
    "crank": (
        Crank(space=SPACE, X_WE=X_WE),
        pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.5])), np.array([0.3, 0.4, 0.2])),
        [[0, 0, 0, 0, 0, 1], [-0.4, 0.3, 0, 0, 0, 0]],
    ),
    "embedded": (Embedded(space=SPACE, X_WE=X_WE), X_WE, []),
    "sphere": (
        sphere_of(face=True),
        pin.SE3(np.eye(3), np.array([0.0, 0.1, -0.25])),
        [[0.1, 0, 0, 0, 0, 1], [0, 0, -0.1, 1, 0, 0], [0, 0, 0, 0, 1, 0]],
    ),
    "sphere point": (
        sphere_of(face=False),
        pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.15, 0.1, -0.2])),
        [[-0.2, 0, -0.15, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 0]],
    ),
    "saddle": (
        saddle_face(),
        pin.SE3.Identity(),
        # the face turns by −∂²z/∂x² per metre along x, and the other way along y
        [[1, 0, 0, 0, -3, 0], [0, 1, 0, -2, 0, 0], [0, 0, 0, 0, 0, 1]],
    ),
    "cylinder": (
        rod(),
        pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.06, -0.08, 0.4])),
        [[0, 0, 1, 0, 0, 0], [0.08, 0.06, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1]],
    ),
    "pose": (
        hinge_by_pose(),
        pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0])),
        [[0, 0, 0, 0, 0, 1]],
    ),
}
each = pytest.mark.parametrize("name", list(CASES))


def evaluate(constraint: Constraint, X_WF: pin.SE3, V: np.ndarray, **given: np.ndarray) -> list:
    """Return A, Ȧ V, v_c and v̇_c."""
    inputs = {**constraint.inputs(), **given}
    rows = row_function(constraint)(X_WF.rotation, X_WF.translation, V, *inputs.values())
    return [np.array(part) for part in rows]


@each
def test_a_constraint_allows_what_its_mechanism_allows_and_nothing_else(name: str) -> None:
    constraint, X_EF, allowed = CASES[name]
    A = evaluate(constraint, X_WE * X_EF, np.zeros(6))[0]
    k = len(constraint.row_names)
    assert A.shape == (k, 6)
    assert len(constraint.unilateral) == k
    assert np.linalg.matrix_rank(A, tol=1e-6) == k
    twists = [X_EF.actInv(pin.Motion(np.array(twist, float))).vector for twist in allowed]
    for V in twists:
        assert pytest.approx(np.zeros(k), abs=ROUND_OFF) == A @ V
    # what is not spanned by the allowed twists moves some row, wherever the table is complete
    if twists and len(twists) == 6 - k:
        basis = np.linalg.qr(np.array(twists).T, mode="complete")[0][:, len(twists) :]
        assert np.linalg.svd(A @ basis, compute_uv=False).min() > 1e-3


@each
def test_the_rows_turn_as_central_differences_say(name: str) -> None:
    constraint, X_EF, _ = CASES[name]
    rng, X_WF, largest = np.random.default_rng(1), X_WE * X_EF, 0.0
    for _ in range(3):
        V = rng.normal(size=6)
        A_dot_V, v_c, v_c_dot = (x.ravel() for x in evaluate(constraint, X_WF, V)[1:])
        ahead, behind = (evaluate(constraint, X_WF * pin.exp6(s * V), V)[0] for s in (STEP, -STEP))
        expected = (ahead - behind) / (2 * STEP) @ V
        assert A_dot_V == pytest.approx(expected, abs=DIFFERENCE)
        largest = max(largest, np.abs(expected).max())
        assert not v_c.any() and not v_c_dot.any()  # noqa: PT018
    # Ad_X V of a twist that stays the same does not change: Ad_X ad_V V = 0
    assert (largest > 1e-2) == (name not in ("hinge", "screw"))


@each
def test_rows_of_a_moving_environment_change_as_central_differences_say(name: str) -> None:
    constraint, X_EF, _ = CASES[name]
    moving, rng = Moving(whole=constraint), np.random.default_rng(2)
    D0, V_D, V_dot_D = pin.exp6(rng.normal(size=6) * 0.3), rng.normal(size=6), rng.normal(size=6)
    X0, V0, V_dot = D0 * X_WE * X_EF, rng.normal(size=6), rng.normal(size=6)

    def slip(t: float) -> tuple[np.ndarray, list]:
        """Return A V − v_c at time t of a tool and an environment on their ways."""
        D = D0 * pin.exp6(t * V_D + t**2 / 2 * V_dot_D)
        X = X0 * pin.exp6(t * V0 + t**2 / 2 * V_dot)
        V, V_env = V0 + t * V_dot, V_D + t * V_dot_D  # to first order, in the moving frames
        shift = {"X_shift": D.homogeneous[:3], "V_env": V_env, "V_dot_env": V_dot_D}
        rows = evaluate(moving, X, V, **shift)
        return rows[0] @ V - rows[2].ravel(), rows

    _, (A, A_dot_V, v_c, v_c_dot) = slip(0.0)
    rate = (slip(STEP)[0] - slip(-STEP)[0]) / (2 * STEP)
    assert (A @ V_dot + A_dot_V.ravel() - v_c_dot.ravel()) == pytest.approx(rate, abs=1e-6)
    assert np.abs(v_c).max() > 1e-2
    assert np.abs(v_c_dot).max() > 1e-2
    # a tool that rides along slips nowhere
    riding = (X0.inverse() * D0).act(pin.Motion(V_D)).vector
    shift = {"X_shift": D0.homogeneous[:3], "V_env": V_D, "V_dot_env": V_dot_D}
    rows = evaluate(moving, X0, riding, **shift)
    assert rows[0] @ riding == pytest.approx(rows[2].ravel(), abs=ROUND_OFF)


def surface(phi: Callable[[ca.SX], ca.SX], at: tuple[float, float, float]) -> Surface:
    """Return a surface written by a user."""
    p = ca.SX.sym("p", 3)
    contact = pin.SE3(np.eye(3), np.array(at))
    return Surface(space=SPACE, X_WE=X_WE, phi=phi(p), p=p, contact=contact)


PLANE = TaskSpace("tool", ("vx", "vy"))
R_, P_ = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3)
HERE = pin.SE3.Identity()
BROKEN: dict[str, tuple[Callable[[], object], str]] = {
    "free symbol": (lambda: surface(lambda p: p[2] - ca.SX.sym("k"), (0, 0, 0)), "free symbols k"),
    "two numbers": (lambda: surface(lambda p: p[:2], (0, 0, 0)), "one number"),
    "zero gradient": (lambda: surface(lambda p: p[2] ** 2, (0, 0, 0)), "zero gradient"),
    "not finite": (lambda: surface(lambda p: ca.sqrt(p[2]), (0, 0, 0)), "not finite"),
    "point of two": (
        lambda: Surface(space=SPACE, X_WE=X_WE, phi=P_[0], p=P_[:2], contact=HERE),
        "shape",
    ),
    "axes": (lambda: Hinge(space=PLANE, X_WE=X_WE), "axes"),
    "moving axes": (lambda: Moving(whole=PointOnPlane(space=PLANE, X_WE=X_WE)), "axes"),
    "no edge": (lambda: EdgeOnPlane(space=SPACE, X_WE=X_WE, edge=(0.0, 0.0, 0.0)), "not zero"),
    "lead": (lambda: Screw(space=SPACE, X_WE=X_WE, lead=float("nan")), "finite"),
    "seven rows": (
        lambda: PoseConstraint(space=SPACE, X_WE=X_WE, c=ca.SX.zeros(7), R=R_, p=P_, contact=HERE),
        "1 ≤ m ≤ 6",
    ),
    "dependent": (
        lambda: PoseConstraint(
            space=SPACE, X_WE=X_WE, c=ca.vertcat(P_[0], 2 * P_[0]), R=R_, p=P_, contact=HERE
        ),
        "depend on each other",
    ),
    "ball": (lambda: sphere(np.zeros(3), -1.0), "> 0"),
    "rod": (lambda: cylinder(0.0), "> 0"),
    "saddle": (lambda: saddle(1.0, -2.0), "> 0"),
}


@pytest.mark.parametrize("name", list(BROKEN))
def test_what_cannot_be_a_constraint_is_refused_in_one_line(name: str) -> None:
    build, words = BROKEN[name]
    with pytest.raises(InputError, match=words) as refused:
        build()
    assert "\n" not in str(refused.value)
