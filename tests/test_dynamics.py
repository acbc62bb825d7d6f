"""M, h, J, J̇v and poses against pinocchio, finite differences and `modern_robotics`."""

from itertools import pairwise

import casadi as ca
import modern_robotics as mr
import numpy as np
import oracles
import pinocchio as pin
import pytest
from cases import DYNAMICS, ROUND_OFF, chain

from qpctrl import InputError, from_pinocchio
from qpctrl.dynamics import Dynamics
from qpctrl.spatial import angular_first, linear_first

DIFFERENCE = 1e-6
"""Central differences of the twist with a step of 1e-5; third derivatives are up to 1e3."""

GRAVITY = np.array([0.0, 0.0, -9.81])


def evaluate(robot, q, v, frame="tool"):
    dynamics = Dynamics(robot)
    seen = dynamics.frame(frame)
    outputs = [dynamics.M, dynamics.h, seen.J, seen.J_dot_v, seen.X_WF.R, seen.X_WF.p]
    found = ca.Function("dynamics", [dynamics.q, dynamics.v], outputs)(q, v)
    return [np.array(ca.densify(x)).squeeze() for x in found]


def random_states(robot, count, seed=0):
    rng = np.random.default_rng(seed)
    return [(rng.uniform(-3, 3, robot.nv), rng.normal(size=robot.nv)) for _ in range(count)]


@pytest.mark.parametrize("name", DYNAMICS)
def test_every_term_is_pinocchios(name):
    robot = DYNAMICS[name]()
    for q, v in random_states(robot, 10):
        M, h, J, J_dot_v, R, p = evaluate(robot, q, v)
        expected = oracles.frame_terms(robot.model, q, v, "tool")
        assert np.allclose(M, expected.M, atol=ROUND_OFF)
        assert np.allclose(h, expected.h, atol=ROUND_OFF)
        assert np.allclose(J, expected.J, atol=ROUND_OFF)
        assert np.allclose(J_dot_v, expected.J_dot_v, atol=ROUND_OFF)
        assert np.allclose(R, expected.X_WF.rotation, atol=ROUND_OFF)
        assert np.allclose(p, expected.X_WF.translation, atol=ROUND_OFF)


@pytest.mark.parametrize("name", DYNAMICS)
def test_the_drift_is_the_rate_of_the_body_twist_at_rest_acceleration(name):
    robot, step = DYNAMICS[name](), 1e-5
    for q, v in random_states(robot, 2):
        ahead = evaluate(robot, q + step * v, v)[2] @ v
        behind = evaluate(robot, q - step * v, v)[2] @ v
        drift = evaluate(robot, q, v)[3]
        assert drift == pytest.approx((ahead - behind) / (2 * step), abs=DIFFERENCE)
        assert np.abs(drift).max() > 1e-2  # the test says something


def test_armature_is_on_the_diagonal_of_the_mass_matrix():
    robot = chain(4, seed=1)
    q, v = random_states(robot, 1)[0]
    with_rotors = evaluate(robot, q, v)[0]
    armature = np.array(robot.model.armature)
    robot.model.armature = np.zeros(4)
    assert np.allclose(with_rotors - evaluate(robot, q, v)[0], np.diag(armature), atol=ROUND_OFF)


def test_a_frame_of_the_world_does_not_move():
    robot = chain(3, seed=2)
    q, v = random_states(robot, 1)[0]
    _, _, J, J_dot_v, R, p = evaluate(robot, q, v, frame="universe")
    assert not J.any()
    assert not J_dot_v.any()
    assert np.array_equal(R, np.eye(3))
    assert not p.any()


def test_modern_robotics_gives_the_same_terms_in_its_own_order():
    robot = chain(5, seed=5)
    robot.model.armature = np.zeros(5)  # the book has no rotors
    q, v = random_states(robot, 1)[0]
    screws, homes, inertias, tool = textbook_arm(robot.model)
    M, h, J, _, R, p = evaluate(robot, q, v)
    book_M = mr.MassMatrix(q, homes, inertias, screws)
    assert book_M == pytest.approx(M, abs=ROUND_OFF)
    c = mr.VelQuadraticForces(q, v, homes, inertias, screws)
    g = mr.GravityForces(q, GRAVITY, homes, inertias, screws)
    assert c + g == pytest.approx(h, abs=ROUND_OFF)
    body_screws = mr.Adjoint(mr.TransInv(tool)) @ screws
    book_J = mr.JacobianBody(body_screws, q)
    assert pytest.approx(angular_first(J.T), abs=ROUND_OFF) == book_J.T
    assert linear_first(book_J.T) == pytest.approx(J.T, abs=ROUND_OFF)
    assert mr.FKinSpace(tool, screws, q) == pytest.approx(pin.SE3(R, p).homogeneous, abs=ROUND_OFF)


def textbook_arm(model):
    """Screws at home, home poses between links, spatial inertias, home of the tool."""
    data = model.createData()
    zero = np.zeros(model.nq)
    pin.framesForwardKinematics(model, data, zero)
    screws = pin.computeJointJacobians(model, data, zero)
    links, inertias = [np.eye(4)], []
    for i in range(1, model.njoints):
        inertia = model.inertias[i]
        links.append(data.oMi[i].homogeneous @ pin.SE3(np.eye(3), inertia.lever).homogeneous)
        blocks = [[inertia.inertia, np.zeros((3, 3))], [np.zeros((3, 3)), inertia.mass * np.eye(3)]]
        inertias.append(np.block(blocks))
    links.append(links[-1])
    homes = [np.linalg.inv(a) @ b for a, b in pairwise(links)]
    tool = data.oMf[model.getFrameId("tool")].homogeneous
    return np.vstack([screws[3:], screws[:3]]), homes, inertias, tool


@pytest.mark.parametrize("joint", [pin.JointModelSpherical(), pin.JointModelRUBZ()])
def test_joints_with_another_number_of_coordinates_are_refused_by_name(joint):
    model = pin.Model()
    model.addJoint(0, joint, pin.SE3.Identity(), "wrist")
    with pytest.raises(InputError, match=r"'wrist'.*need revolute, prismatic or floating"):
        from_pinocchio(model)
