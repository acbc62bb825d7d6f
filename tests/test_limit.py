"""Bounds that never cross, and the scale by which a singularity is judged."""

import casadi as ca
import numpy as np
import pytest

from qpctrl import limit
from qpctrl.space import _whole_mobility


def numbers(expression: ca.SX) -> np.ndarray:
    """Return a constant expression as an array."""
    return np.asarray(ca.evalf(expression)).ravel()


@pytest.mark.parametrize("last", [-90.0, -10.0, 0.0, 9.5, 90.0])
def test_torque_bounds_keep_room_inside_a_limit_that_was_just_lowered(last: float) -> None:
    u = {"tau_max": ca.SX(10), "tau_rate": ca.SX(1000), "tau_last": ca.SX(last)}
    lb, ub = (numbers(side)[0] for side in limit.torque_bounds(u, ca.SX(1e-3)))
    inside = np.clip(last, -10, 10)
    assert -10 <= lb <= inside <= ub <= 10
    assert ub - lb >= 1.0  # at least one step of the rate


@pytest.mark.parametrize("q", [-9.0, -2.1, 0.0, 2.1, 9.0])
@pytest.mark.parametrize("v", [-3.0, 0.0, 3.0])
def test_acceleration_bounds_never_cross_however_far_outside(q: float, v: float) -> None:
    u = {
        "q_min": ca.SX(-2),
        "q_max": ca.SX(2),
        "v_max": ca.SX(2.5),
        "rates": ca.SX([limit.POSITION_RATE, limit.VELOCITY_RATE]),
    }
    lb, ub = (numbers(side)[0] for side in limit.acceleration_bounds(u, ca.SX(q), ca.SX(v)))
    assert lb <= ub
    if abs(v) <= 2.5 and abs(q) > 2.5:
        assert ub <= 0 if q > 0 else lb >= 0  # it comes back


def test_each_axis_is_measured_against_the_directions_of_its_own_unit() -> None:
    mobility = ca.SX(np.diag([1.0, 2.0, 3.0, 40.0, 50.0, 60.0]))
    assert numbers(_whole_mobility(mobility)).tolist() == [6.0] * 3 + [150.0] * 3
