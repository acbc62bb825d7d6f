"""Robots from pinocchio and URDF: limits, actuation, names, refusals."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from cases import PLANE_AXES, SPACES, Given, chain, given_mode, planar_2r, tick

from qpctrl import Controller, InputError, Limits, Robot, TaskSpace, from_pinocchio, from_urdf
from qpctrl.limit import UNBOUNDED

URDF = """
<robot name="pendulum">
  <link name="base"/>
  <link name="arm">
    <visual><geometry><mesh filename="package://nowhere/arm.stl"/></geometry></visual>
    <inertial><mass value="2"/><origin xyz="0.5 0 0"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="hand"><inertial><mass value="1"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="continuous">
    <parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint>
  <joint name="reach" type="prismatic">
    <parent link="arm"/><child link="hand"/><axis xyz="1 0 0"/>
    <limit lower="0.2" upper="0.9" effort="50" velocity="1.5"/></joint>
</robot>
"""


def written(folder: Path, text: str) -> Path:
    """Return the path of a file with ``text``."""
    path = folder / "robot.urdf"
    path.write_text(text)
    return path


def test_a_urdf_gives_its_limits_and_no_limit_where_it_has_none(tmp_path: Path) -> None:
    robot = from_urdf(written(tmp_path, URDF))
    assert robot.name == "pendulum"
    assert robot.joint_names == robot.actuator_names == ("turn", "reach")
    assert robot.limits.q_min[1] == 0.2
    assert robot.limits.q_max[1] == 0.9
    assert robot.limits.v_max.tolist() == [np.inf, 1.5]
    assert robot.limits.tau_max.tolist() == [np.inf, 50.0]
    assert robot.home.tolist() == [0.0, 0.2]  # zero, moved inside the limits


def test_a_continuous_joint_has_no_position_limit_in_the_qp(tmp_path: Path) -> None:
    robot = from_urdf(written(tmp_path, URDF), home=np.array([0.3, 0.5]))
    controller = Controller(robot, [given_mode(robot, TaskSpace("hand", ("vx", "vz")), 0)])
    tick(controller, robot.home, np.zeros(2), {})
    bounds = controller.engines["contact"].terms
    turn = robot.nu  # rows: torques, then accelerations
    assert bounds["ub"][turn] >= UNBOUNDED
    assert bounds["lb"][turn] <= -UNBOUNDED


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<robot", "not XML"),
        ("<mujoco/>", r"got <mujoco>, need a URDF"),
        ('<robot name="x"><joint name="j" type="revolute"/></robot>', "not a usable URDF"),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_a_file_that_is_no_urdf_is_refused_in_one_line(
    tmp_path: Path, text: str, says: str
) -> None:
    with pytest.raises(InputError, match=says):
        from_urdf(written(tmp_path, text))


def test_a_file_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match=r"nowhere\.urdf: cannot be read"):
        from_urdf("nowhere.urdf")


def test_an_unknown_frame_or_axis_is_refused_with_the_nearest_name() -> None:
    robot = planar_2r()
    with pytest.raises(InputError, match=r"unknown frame 'tol'.*did you mean 'tool'"):
        robot.frame_id("tol")
    with pytest.raises(InputError, match=r"unknown axis 'vX'"):
        TaskSpace("tool", ("vX", "vy"))
    with pytest.raises(InputError, match="need one or more different ones"):
        TaskSpace("tool", ("vx", "vx"))
    with pytest.raises(InputError, match="need one or more different ones"):
        TaskSpace("tool", ())


def test_the_pose_is_pinocchios() -> None:
    robot = chain(5, seed=8)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.home)
    expected = data.oMf[robot.model.getFrameId("tool")]
    assert robot.pose(robot.home, "tool").isApprox(expected)


def test_limits_that_cannot_be_are_refused() -> None:
    good = {"q_min": -np.ones(2), "q_max": np.ones(2)}
    good |= dict.fromkeys(("v_max", "tau_max", "tau_rate"), np.ones(2))
    for name in ("v_max", "tau_max", "tau_rate"):
        for bad in (0.0, -1.0, np.nan):
            with pytest.raises(InputError, match=rf"{name}: got .*need"):
                Limits(**{**good, name: np.array([1.0, bad])})
    with pytest.raises(InputError, match="is not below q_max"):
        Limits(**{**good, "q_min": np.ones(2)})
    with pytest.raises(InputError):
        Limits(**{**good, "q_max": np.array([1.0, np.nan])})


def test_actuation_of_another_height_or_rank_is_refused() -> None:
    model = planar_2r().model
    with pytest.raises(InputError, match=r"B: got shape \(3, 1\), need 2 rows"):
        from_pinocchio(model, B=np.ones((3, 1)))
    with pytest.raises(InputError, match="full column rank"):
        from_pinocchio(model, B=np.ones((2, 2)))


@pytest.mark.parametrize("form", ["reduced", "full"])
def test_an_underactuated_arm_obeys_its_dynamics_with_the_torques_it_has(form: str) -> None:
    """The elbow hangs free: row 2 of M a + h = B τ has no torque in it."""
    model = planar_2r().model
    robot = from_pinocchio(
        model, home=np.array([0.4, 0.9]), B=np.array([[1.0], [0.0]]), tau_rate=1e9
    )
    controller = Controller(robot, [given_mode(robot, TaskSpace("tool", PLANE_AXES), 0)], form=form)
    assert robot.actuator_names == ("shoulder",)
    q, v, a_cmd = robot.home, np.array([0.3, -0.5]), np.array([1.0, 2.0])
    command, report, _ = tick(controller, q, v, {"motion": Given(a_cmd=a_cmd)})
    assert report.status.name == "OK"
    assert command.tau.shape == (1,)
    data = model.createData()
    a = pin.aba(model, data, q, v, np.r_[command.tau, 0.0])
    # the best acceleration along the one direction that the shoulder can give, in the metric Λ
    M = pin.crba(model, data, q)
    J_inv_T = np.linalg.solve(M, np.array([1.0, 0.0]))
    frame = model.getFrameId("tool")
    J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)[:2]
    pin.forwardKinematics(model, data, q, v, a)
    V_dot = pin.getFrameAcceleration(model, data, frame, pin.LOCAL).vector[:2]
    Lambda = np.linalg.inv(J @ np.linalg.solve(M, J.T))
    assert (J @ J_inv_T) @ Lambda @ (V_dot - a_cmd) == pytest.approx(0, abs=1e-8)


def test_a_row_is_named_after_what_it_moves() -> None:
    robot = from_pinocchio(planar_2r().model, B=np.array([[1.0, 0], [1.0, 1.0]]))
    assert robot.actuator_names == ("actuator 0", "elbow")


def test_home_must_have_the_size_of_the_configuration() -> None:
    with pytest.raises(InputError, match=r"home: got shape \(3,\), need \(2,\)"):
        from_pinocchio(planar_2r().model, home=np.zeros(3))
    robot = planar_2r()
    with pytest.raises(InputError, match="home"):
        Robot(model=robot.model, limits=robot.limits, home=np.zeros(3))


def test_every_space_of_the_tables_has_its_axes_in_order() -> None:
    assert SPACES["planar_2r"].index == [0, 1]
    assert TaskSpace("tool", ("wz", "vx")).index == [5, 0]
