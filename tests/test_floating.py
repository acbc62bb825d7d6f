"""Floating bodies: every term against pinocchio, and against differences."""

import casadi as ca
import numpy as np
import oracles
import pinocchio as pin
import pytest
from cases import ROUND_OFF

from qpctrl import InputError, Robot, from_pinocchio
from qpctrl.dynamics import Dynamics

DIFFERENCE = 1e-7
"""Central differences with a step of 1e-6, of quantities up to 1e2."""

STEP = 1e-6


def humanoid() -> Robot:
    """Return pinocchio's sample humanoid and a free box, with some armature."""
    model = pin.buildSampleModelHumanoid()
    box = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    inertia = pin.Inertia(2.0, np.array([0.01, 0.02, 0.03]), np.diag([0.02, 0.03, 0.04]))
    model.appendBodyToJoint(box, inertia, pin.SE3.Identity())
    X_JF = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.1, 0.2, -0.3]))
    for name, joint in (("hand", "rarm_wrist2_joint"), ("box", "box")):
        holder = model.getJointId(joint) if model.existJointName(joint) else model.njoints - 2
        model.addFrame(pin.Frame(f"{name}_tool", holder, 0, X_JF, pin.FrameType.OP_FRAME))
    armature = np.full(model.nv, 0.05)
    armature[:6] = armature[-6:] = 0.0
    model.armature = armature
    return from_pinocchio(model)


def states(robot: Robot, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng, found = np.random.default_rng(7), []
    for _ in range(count):
        q = robot.integrate(robot.home, rng.uniform(-2, 2, robot.nv))
        found.append((q, rng.normal(size=robot.nv)))
    return found


def test_names_and_sizes_say_what_floats():
    robot = humanoid()
    assert (robot.nq, robot.nv, robot.nu) == (robot.model.nq, robot.nq - 2, robot.nv - 12)
    assert robot.floats
    assert robot.joint_names[:6] == tuple(
        f"root_joint.{axis}" for axis in ("vx", "vy", "vz", "wx", "wy", "wz")
    )
    assert robot.joint_names[-1] == "box.wz"
    assert robot.coordinates[:7] == (None,) * 6 + (7,)
    assert robot.coordinates[-6:] == (None,) * 6
    assert robot.actuator_names == tuple(name for name in robot.joint_names if "." not in name)
    assert not robot.B[:6].any()
    assert (robot.B.sum(axis=0) == 1).all()
    assert np.isinf(robot.limits.q_max[:6]).all()


def test_every_term_is_pinocchios():
    robot = humanoid()
    dynamics, model, data = Dynamics(robot), robot.model, robot.model.createData()
    tool, centroid = dynamics.frame("hand_tool"), dynamics.centroid()
    function = ca.Function(
        "terms",
        [dynamics.q, dynamics.v],
        [
            *(dynamics.M, dynamics.h, tool.J, tool.J_dot_v, tool.X_WF.R, tool.X_WF.p),
            *(centroid.p_WC, centroid.A_G, centroid.A_G_dot_v),
        ],
    )
    for q, v in states(robot, 10):
        M, h, J, J_dot_v, R, p, p_WC, A_G, A_G_dot_v = (
            np.array(ca.densify(x)).squeeze() for x in function(q, v)
        )
        expected = oracles.frame_terms(model, q, v, "hand_tool")
        for ours, theirs in (
            *((M, expected.M), (h, expected.h), (J, expected.J), (J_dot_v, expected.J_dot_v)),
            *((R, expected.X_WF.rotation), (p, expected.X_WF.translation)),
            (p_WC, pin.centerOfMass(model, data, q).copy()),
            (A_G, pin.computeCentroidalMap(model, data, q).copy()),
            (A_G_dot_v, _momentum_rate(model, data, q, v)),
        ):
            assert np.abs(ours - theirs).max() <= ROUND_OFF * max(1, np.abs(theirs).max())
    assert centroid.mass == pytest.approx(pin.computeTotalMass(model))


def _momentum_rate(model: pin.Model, data: pin.Data, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return Ȧ_G v: the rate of the momentum where nothing accelerates."""
    rate = pin.computeCentroidalMomentumTimeVariation(model, data, q, v, np.zeros(model.nv))
    return np.array(rate.vector)


def test_the_motion_of_one_frame_seen_from_another_is_that_of_its_pose():
    robot = humanoid()
    dynamics = Dynamics(robot)
    seen = dynamics.relative("hand_tool", "box_tool")
    function = ca.Function(
        "seen", [dynamics.q, dynamics.v], [seen.X_WF.R, seen.X_WF.p, seen.J, seen.J_dot_v]
    )

    def at(q: np.ndarray, v: np.ndarray) -> tuple[pin.SE3, np.ndarray, np.ndarray]:
        R, p, J, drift = (np.array(ca.densify(x)) for x in function(q, v))
        return pin.SE3(R, p.ravel()), J @ v, drift.ravel()

    for q, v in states(robot, 3):
        X, V, drift = at(q, v)
        assert X.isApprox(robot.pose(q, "box_tool").inverse() * robot.pose(q, "hand_tool"))
        ahead, behind = (at(robot.integrate(q, side * STEP * v), v) for side in (1, -1))
        moved = pin.log6(behind[0].inverse() * ahead[0]).vector / (2 * STEP)
        assert pytest.approx(moved, abs=DIFFERENCE) == V
        assert drift == pytest.approx((ahead[1] - behind[1]) / (2 * STEP), abs=DIFFERENCE)
        assert np.abs(drift).max() > 1


def test_a_quaternion_that_is_none_is_refused_and_a_long_one_made_one():
    robot = humanoid()
    home = robot.home.copy()
    home[3:7] = 0.0
    with pytest.raises(InputError, match=r"home: quaternion of 'root_joint' has norm 0, need 1"):
        Robot(model=robot.model, limits=robot.limits, home=home)
    home[3:7] = np.array([0.0, 0.6, 0.0, 0.8]) * 1.0005
    made = Robot(model=robot.model, limits=robot.limits, home=home)
    assert made.home[3:7] == pytest.approx([0.0, 0.6, 0.0, 0.8])
    with pytest.raises(InputError, match=r"home: got shape \(3,\), need"):
        Robot(model=robot.model, limits=robot.limits, home=np.zeros(3))
