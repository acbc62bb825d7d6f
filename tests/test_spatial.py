"""Spatial algebra against pinocchio, the group axioms and finite differences."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qpctrl import spatial
from qpctrl.spatial import SymbolicPose

EXACT = 1e-12
"""A few products of numbers up to 10."""

LOG_NEAR_PI = 1e-9
"""The axis of a rotation by 3.1 rad comes from R − Rᵀ, whose entries are 25 times smaller."""

DIFFERENCE = 1e-8
"""Central differences with a step of 1e-5: error h² ≈ 1e-10, round-off 1e-16 / h ≈ 1e-11."""

ANGLES = (0.0, 1e-12, 1e-8, 1e-4, 0.03, 0.0316227, 0.0316228, 0.04, 0.5, 1.5, 2.5, 3.0, 3.1)
"""Both sides of the switch from series to closed form (√1e-3), and close to π."""

_R, _S = ca.SX.sym("R", 3, 3), ca.SX.sym("S", 3, 3)
_p, _r = ca.SX.sym("p", 3), ca.SX.sym("r", 3)
_V, _W = ca.SX.sym("V", 6), ca.SX.sym("W", 6)
_X, _Y = SymbolicPose(_R, _p), SymbolicPose(_S, _r)

LOG = ca.Function("log", [_R, _p], [spatial.log6(_X)])
COMPOSE = ca.Function("compose", [_R, _p, _S, _r], [*spatial.compose(_X, _Y)])
INVERSE = ca.Function("inverse", [_R, _p], [*spatial.inverse(_X)])
TO_PARENT = ca.Function("to_parent", [_R, _p, _V], [spatial.motion_to_parent(_X, _V)])
TO_CHILD = ca.Function("to_child", [_R, _p, _V], [spatial.motion_to_child(_X, _V)])
FORCE = ca.Function("force", [_R, _p, _V], [spatial.force_to_parent(_X, _V)])
MOTION_CROSS = ca.Function("motion_cross", [_V, _W], [spatial.motion_cross(_V, _W)])
FORCE_CROSS = ca.Function("force_cross", [_V, _W], [spatial.force_cross(_V, _W)])

twists = st.lists(st.floats(-2, 2), min_size=6, max_size=6).map(np.array)
poses = twists.map(lambda V: pin.exp6(V))  # a Boost function breaks hypothesis' printing
quickly = settings(derandomize=True, deadline=None, max_examples=40, database=None)


def parts(X: pin.SE3) -> tuple[np.ndarray, np.ndarray]:
    return X.rotation, X.translation


def arrays(results: tuple[ca.DM, ...]) -> list[np.ndarray]:
    return [np.array(result) for result in results]


def vector(result: ca.DM) -> np.ndarray:
    return np.array(result).ravel()


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("seed", range(3))
def test_the_logarithm_is_pinocchios_at_every_angle(angle, seed):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    X = pin.exp6(np.r_[rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
    assert vector(LOG(*parts(X))) == pytest.approx(pin.log6(X).vector, abs=LOG_NEAR_PI)


@quickly
@given(poses)
def test_the_exponential_of_the_logarithm_is_the_pose(X):
    back = pin.exp6(vector(LOG(*parts(X))))
    assert np.allclose(back.homogeneous, X.homogeneous, atol=LOG_NEAR_PI)


@quickly
@given(poses, poses)
def test_poses_compose_and_invert_as_pinocchios_do(X, Y):
    R, p = arrays(COMPOSE(*parts(X), *parts(Y)))
    assert np.allclose(R, (X * Y).rotation, atol=EXACT)
    assert np.allclose(p.ravel(), (X * Y).translation, atol=EXACT)
    R, p = INVERSE(*parts(X))
    R, p = arrays(COMPOSE(R, p, *parts(X)))
    assert np.allclose(R, np.eye(3), atol=EXACT)
    assert np.allclose(p, 0, atol=EXACT)


@quickly
@given(poses, poses, poses)
def test_composition_is_associative(X, Y, Z):
    left = arrays(COMPOSE(*COMPOSE(*parts(X), *parts(Y)), *parts(Z)))
    right = arrays(COMPOSE(*parts(X), *COMPOSE(*parts(Y), *parts(Z))))
    for a, b in zip(left, right, strict=True):
        assert np.allclose(a, b, atol=10 * EXACT)


@quickly
@given(poses, poses, twists)
def test_twists_move_between_frames_as_poses_compose(X, Y, V):
    step_by_step = TO_PARENT(*parts(X), TO_PARENT(*parts(Y), V))
    assert vector(step_by_step) == pytest.approx((X * Y).action @ V, abs=10 * EXACT)
    assert vector(TO_CHILD(*parts(X), TO_PARENT(*parts(X), V))) == pytest.approx(V, abs=10 * EXACT)


@quickly
@given(poses, twists, twists)
def test_power_does_not_depend_on_the_frame(X, V, F):
    power = vector(TO_PARENT(*parts(X), V)) @ vector(FORCE(*parts(X), F))
    assert power == pytest.approx(V @ F, abs=10 * EXACT)


@quickly
@given(twists, twists)
def test_motion_cross_is_the_derivative_of_the_adjoint(V, W):
    step = 1e-5
    ahead, behind = (pin.exp6(s * V).action @ W for s in (step, -step))
    rate = (ahead - behind) / (2 * step)
    assert vector(MOTION_CROSS(V, W)) == pytest.approx(rate, abs=100 * DIFFERENCE)
    assert vector(MOTION_CROSS(V, W)) == pytest.approx(-vector(MOTION_CROSS(W, V)), abs=EXACT)


@quickly
@given(twists, twists)
def test_force_cross_is_pinocchios(V, F):
    assert vector(FORCE_CROSS(V, F)) == pytest.approx(
        pin.Motion(V).cross(pin.Force(F)).vector, abs=EXACT
    )


def test_angular_first_swaps_the_halves_and_linear_first_swaps_them_back():
    spatial_vector = np.arange(6.0)
    assert spatial.angular_first(spatial_vector).tolist() == [3, 4, 5, 0, 1, 2]
    J = np.random.default_rng(0).normal(size=(4, 6))
    assert np.array_equal(spatial.linear_first(spatial.angular_first(J)), J)
