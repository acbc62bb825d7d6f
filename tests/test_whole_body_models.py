"""Models with floating bodies: two engines agree, and each stands, reaches and holds at home."""

from dataclasses import replace

import mujoco
import numpy as np
import oracles
import pinocchio as pin
import pytest

from qpctrl import InputError, ModelMismatchError
from qpctrl.robot import Robot
from scenarios.plant_coordinates import Coordinates, coordinates
from scenarios.plant_model import check_agreement, robot_from_mujoco
from scenarios.robot_file import MODELS

EXACT = 1e-9
"""m and 1: how exactly a pose of the keyframe was solved for; it holds to round-off."""

ENGINES = 1e-9
"""Relative: the engines evaluate the same sums in another order."""

ROUND_OFF = 1e-12
"""Of coordinates that are turned there and back."""

STEP = 1e-6
"""s, of a difference quotient."""

FIRST_ORDER = 20 * STEP
"""m/s, rad/s, and relative to a: a quotient is off by half the step, times ω × v of up to 10."""

GRAVITY = 9.81  # m/s²

FRAMES = {
    "humanoid": ("left_sole", "right_sole", "left_hand", "right_hand", "torso", "wall"),
    "mobile_arm": ("eraser/tool", "carriage", "flange"),
    "two_arms": ("left_pad", "right_pad", "box", "box_bottom", "table"),
}
SIZES = {"humanoid": (36, 35, 29), "mobile_arm": (10, 10, 10), "two_arms": (21, 20, 14)}
"""nq, nv, nu."""

MASS = {"humanoid": 61.6, "mobile_arm": 40 + 15.4948 + 0.2, "two_arms": 2 * (15.4948 + 0.3) + 2}
"""kg: what moves; 15.4948 kg are the seven links of an arm."""

TWO_BODIES = """
<mujoco model="two_bodies">
  <option gravity="0.5 -3 -9"/>
  <worldbody>
    {}
  </worldbody>
</mujoco>
"""
BASE = """
    <body name="base" pos="0.1 0.2 0.3" euler="20 30 40">
      <freejoint name="base"/>
      <geom size="0.1" mass="3" pos="0.1 0.05 0.02"/>
      <body name="reach" pos="0 0 0.5" euler="10 0 80">
        <joint name="reach" type="slide" axis="1 2 3" range="-1 1" actuatorfrcrange="-7 7"/>
        <geom type="box" size="0.1 0.2 0.3" mass="2" pos="0.1 0 0"/>
      </body>
      <body name="turn" pos="0 0.3 0">
        <joint name="turn" axis="1 0 1" pos="0 0.1 0.2" armature="0.3" actuatorfrcrange="-5 5"/>
        <geom type="capsule" size="0.05 0.2" mass="1" pos="0 0.1 0" euler="0 50 0"/>
        <site name="hand" pos="0.1 0.2 0.3" euler="5 6 7"/>
      </body>
    </body>
"""
BOX = """
    <body name="box" pos="1 1 1">
      <freejoint name="box"/>
      <geom type="box" size=".1 .2 .3" mass="2" pos=".1 0 0"/>
      <site name="corner" pos="-.1 .2 .3" euler="50 20 30"/>
    </body>
"""
SWAPPED = TWO_BODIES.format(BOX + BASE)
"""The same bodies, listed the other way round."""


def loaded(name: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a model and its data in keyframe ``home``, with poses and bias."""
    model = mujoco.MjModel.from_xml_path(str(MODELS / f"{name}.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return model, data


def robot_of(model: mujoco.MjModel) -> Robot:
    """Return the robot of a model, at home."""
    return robot_from_mujoco(model, model.key_qpos[0] if model.nkey else None)


def axes(data: mujoco.MjData, site: str) -> np.ndarray:
    """Return the rotation R_WS of a site."""
    return data.site(site).xmat.reshape(3, 3)


def scattered(robot: Robot, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return q far from home, turned bases included, and v."""
    q = robot.integrate(pin.neutral(robot.model), rng.uniform(-2, 2, robot.nv))
    return q, rng.normal(size=robot.nv)


def moving(model: mujoco.MjModel, robot: Robot, both: Coordinates, seed: int) -> mujoco.MjData:
    """Return data of a random state, with torques on all joints."""
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    q, v = scattered(robot, rng)
    data.qpos[:], data.qvel[:] = both.qpos_from_pinocchio(q), both.qvel_from_pinocchio(q, v)
    data.qfrc_applied[:] = both.qfrc_from_pinocchio(q, robot.B @ rng.normal(size=robot.nu))
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("name", FRAMES)
def test_the_engines_agree_and_the_sizes_are_what_they_should_be(name: str) -> None:
    model, _ = loaded(name)
    robot = robot_of(model)
    assert (robot.nq, robot.nv, robot.nu) == SIZES[name]
    assert pin.computeTotalMass(robot.model) == pytest.approx(MASS[name], abs=1e-3)
    moved = model.body_mass[model.body_dofnum > 0]
    assert (moved > 0.1).all()
    for frame in FRAMES[name]:
        check_agreement(model, robot, frame, states=20)


@pytest.mark.parametrize(
    ("term", "spoil"),
    [
        ("M", lambda model: model.body_mass.__setitem__(model.body("pelvis").id, 7.01)),
        ("h", lambda model: model.opt.gravity.__setitem__(1, 0.01)),
        ("J", lambda model: model.site_pos.__setitem__((model.site("left_sole").id, 0), 0.041)),
    ],
)
def test_a_mismatch_of_a_floating_robot_is_refused(term: str, spoil) -> None:
    model, _ = loaded("humanoid")
    robot = robot_of(model)
    check_agreement(model, robot, "left_sole")
    spoil(model)
    with pytest.raises(ModelMismatchError, match=f": {term} of MuJoCo and pinocchio differ"):
        check_agreement(model, robot, "left_sole")


@pytest.mark.parametrize("name", FRAMES)
def test_both_engines_accelerate_alike(name: str) -> None:
    model, _ = loaded(name)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    robot = robot_of(model)
    both = coordinates(model, robot)
    for seed in range(10):
        data = moving(model, robot, both, seed)
        q, v = both.q_from_mujoco(data.qpos), both.v_from_mujoco(data.qpos, data.qvel)
        a = both.a_from_mujoco(data.qpos, data.qvel, data.qacc)
        terms = oracles.frame_terms(robot.model, q, v, FRAMES[name][0])
        applied = both.force_from_mujoco(data.qpos, data.qfrc_applied)
        gap = terms.M @ a + terms.h - applied
        assert np.abs(gap).max() < ENGINES * np.abs(terms.h).max()
        assert applied @ v == pytest.approx(data.qfrc_applied @ data.qvel, abs=1e-12)
        assert np.abs(applied).max() > 0.1


@pytest.mark.parametrize("text", [TWO_BODIES.format(BASE + BOX), SWAPPED], ids=["same", "swapped"])
def test_states_go_there_and_back_whatever_the_order_of_the_branches(text: str) -> None:
    model = mujoco.MjModel.from_xml_string(TWO_BODIES.format(BASE + BOX))
    robot = robot_from_mujoco(mujoco.MjModel.from_xml_string(text))
    both = coordinates(model, robot)
    first = "box.vx" if text == SWAPPED else "base.vx"
    assert robot.joint_names[0] == first
    assert robot.limits.tau_max.tolist() == [7.0, 5.0]
    for frame in ("hand", "turn", "corner"):
        check_agreement(model, robot, frame, states=20)
    rng = np.random.default_rng(1)
    for _ in range(20):
        q, v = scattered(robot, rng)
        qpos, qvel = both.qpos_from_pinocchio(q), both.qvel_from_pinocchio(q, v)
        assert both.q_from_mujoco(qpos) == pytest.approx(q, abs=0)
        assert both.v_from_mujoco(qpos, qvel) == pytest.approx(v, abs=ROUND_OFF)
        assert both.T(q) @ qvel == pytest.approx(v, abs=ROUND_OFF)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(model, data)
        for frame in ("hand", "corner"):
            X_WF = robot.pose(q, frame)
            assert data.site(frame).xpos == pytest.approx(X_WF.translation, abs=ROUND_OFF)
            assert axes(data, frame) == pytest.approx(X_WF.rotation, abs=ROUND_OFF)


@pytest.mark.parametrize("name", ["humanoid", "two_arms"])
def test_a_step_of_mujoco_moves_q_by_v_and_v_by_a(name: str) -> None:
    model, _ = loaded(name)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.opt.timestep = STEP
    robot = robot_of(model)
    both = coordinates(model, robot)
    for seed in range(5):
        data = moving(model, robot, both, seed)
        q, v = both.q_from_mujoco(data.qpos), both.v_from_mujoco(data.qpos, data.qvel)
        a = both.a_from_mujoco(data.qpos, data.qvel, data.qacc)
        mujoco.mj_step(model, data)
        later = both.q_from_mujoco(data.qpos)
        dq = pin.difference(robot.model, q, later) / STEP
        dv = (both.v_from_mujoco(data.qpos, data.qvel) - v) / STEP
        assert dq == pytest.approx(v + STEP * a, abs=FIRST_ORDER)  # MuJoCo moves by its new v
        assert dv == pytest.approx(a, abs=FIRST_ORDER * np.abs(a).max())
        floating = [i for i, joint in enumerate(robot.joint_names) if "." in joint]
        assert np.abs(both.drift(v)[floating]).max() > 0.1  # the body twist's own term is there


@pytest.mark.parametrize("name", FRAMES)
def test_torques_and_limits_are_in_the_order_of_the_joints(name: str) -> None:
    model, _ = loaded(name)
    robot = robot_of(model)
    driven = [model.joint(int(joint)).name for joint in model.actuator_trnid[:, 0]]
    assert list(robot.actuator_names) == driven
    for i, joint in enumerate(driven):
        at = robot.joint_names.index(joint)
        assert robot.B[at, i] == 1.0
        assert robot.limits.tau_max[i] == model.jnt_actfrcrange[model.joint(joint).id, 1]
        assert robot.limits.q_max[at] == model.joint(joint).range[1]
        assert robot.limits.v_max[at] == model.numeric("velocity_limit").data[i]
        assert robot.limits.tau_rate[i] == model.numeric("torque_rate_limit").data[i]
    assert (model.actuator_ctrlrange[:, 1] == robot.limits.tau_max).all()
    free = [i for i, joint in enumerate(robot.joint_names) if joint not in driven]
    assert len(free) == robot.nv - robot.nu
    assert np.isinf(robot.limits.v_max[free]).all()
    assert not robot.B[free].any()
    assert not robot.model.armature[free].any()
    assert (robot.home == robot.configuration(robot.home, "home")).all()
    low, high = robot.limits.q_min, robot.limits.q_max
    at_home = pin.difference(robot.model, pin.neutral(robot.model), robot.home)
    driven_at = [robot.joint_names.index(joint) for joint in driven]
    assert (low[driven_at] <= at_home[driven_at]).all()
    assert (at_home[driven_at] <= high[driven_at]).all()


def static_torque(robot: Robot, feet: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the torques at home and the wrenches on the feet (6 each) of least norm."""
    data = robot.model.createData()
    g = pin.computeGeneralizedGravity(robot.model, data, robot.home)
    world = pin.LOCAL_WORLD_ALIGNED
    J = np.vstack(
        [
            pin.computeFrameJacobian(robot.model, data, robot.home, robot.frame_id(foot), world)
            for foot in feet
        ]
    )
    F = np.linalg.lstsq(J[:, :6].T, g[:6], rcond=None)[0]
    left = g - J.T @ F
    assert np.abs(left[:6]).max() < ENGINES * np.abs(g).max()
    return robot.B.T @ left, F


def test_the_humanoid_stands_with_flat_soles_and_its_mass_over_the_middle() -> None:
    model, data = loaded("humanoid")
    robot = robot_of(model)
    for sole in ("left_sole", "right_sole"):
        assert data.site(sole).xpos[2] == pytest.approx(0.0, abs=EXACT)
        assert axes(data, sole) == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=EXACT)
        foot = model.geom(sole)
        corner = data.geom(sole).xpos - foot.size * [0, 0, 1]
        assert data.site(sole).xpos == pytest.approx(corner, abs=EXACT)  # middle of the face
        assert foot.size[:2] == pytest.approx([0.11, 0.05])
    feet = data.site("left_sole").xpos, data.site("right_sole").xpos
    assert feet[0][1] - feet[1][1] == pytest.approx(0.2, abs=EXACT)
    com = pin.centerOfMass(robot.model, robot.model.createData(), robot.home)
    assert com[:2] == pytest.approx((feet[0] + feet[1])[:2] / 2, abs=EXACT)
    assert 0.7 < com[2] < 0.9
    knees = [robot.home[7 + robot.actuator_names.index(f"{s}_knee")] for s in ("left", "right")]
    assert min(knees) > 0.5


def test_the_right_hand_faces_the_wall_three_centimetres_ahead() -> None:
    model, data = loaded("humanoid")
    hand, wall = data.site("right_hand"), data.site("wall")
    gap = wall.xpos - hand.xpos
    assert gap[1:] == pytest.approx([0.0, 0.0], abs=EXACT)
    assert gap[0] == pytest.approx(0.03, abs=1e-3)
    assert axes(data, "right_hand") == pytest.approx(axes(data, "wall"), abs=EXACT)
    assert axes(data, "wall")[:, 2] == pytest.approx([1.0, 0.0, 0.0], abs=EXACT)
    assert 1.0 < hand.xpos[2] < 1.2  # at the chest
    ball = data.geom("right_ball").xpos + model.geom("right_ball").size[0] * np.eye(3)[0]
    assert hand.xpos == pytest.approx(ball, abs=EXACT)


def test_the_humanoid_is_as_tall_and_as_strong_as_it_should_be() -> None:
    model, data = loaded("humanoid")
    robot = robot_of(model)
    data.qpos[:] = 0.0
    data.qpos[2:4] = 0.8, 1.0
    mujoco.mj_forward(model, data)
    low, high = np.inf, -np.inf
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] and model.geom(geom).name != "wall":
            half = np.abs(data.geom_xmat[geom].reshape(3, 3)[2]) @ model.geom_aabb[geom, 3:]
            z = data.geom_xpos[geom, 2]
            low, high = min(low, z - half), max(high, z + half)
    assert low == pytest.approx(0.0, abs=1e-9)
    assert high == pytest.approx(1.6, abs=0.01)
    tau, F = static_torque(robot, ("left_sole", "right_sole"))
    weight = MASS["humanoid"] * GRAVITY
    assert F[[2, 8]] == pytest.approx([weight / 2, weight / 2], rel=1e-6)
    used = np.abs(tau) / robot.limits.tau_max
    assert 0.1 < used.max() < 0.25
    assert np.abs(tau[robot.actuator_names.index("left_knee")]) == pytest.approx(27.9, abs=0.3)


def test_the_humanoid_stands_on_soles_that_neither_sink_nor_creep() -> None:
    model, data = loaded("humanoid")
    robot = robot_of(model)
    tau, _ = static_torque(robot, ("left_sole", "right_sole"))
    M = oracles.frame_terms(robot.model, robot.home, np.zeros(35), "torso").M
    stiffness = 900 * np.maximum(np.diag(M)[6:], 0.02)  # 30 rad/s, Nm/rad
    start = data.site("left_sole").xpos.copy()
    for foot in ("left_foot", "right_foot"):
        data.xfrc_applied[model.body(foot).id, :2] = 20.0  # N forward and sideways
    for _ in range(1000):
        data.qfrc_applied[6:] = tau + stiffness * (robot.home[7:] - data.qpos[7:])
        data.qfrc_applied[6:] -= stiffness * (2 / 30) * data.qvel[6:]
        mujoco.mj_step(model, data)
    way = data.site("left_sole").xpos - start
    assert np.linalg.norm(way[:2]) < 2e-4
    assert -5e-4 < way[2] < -5e-5
    force, total = np.zeros(6), np.zeros(3)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        total += data.contact[i].frame.reshape(3, 3).T @ force[:3]
    assert np.abs(total[2]) == pytest.approx(MASS["humanoid"] * GRAVITY, rel=0.02)


@pytest.mark.parametrize(
    ("name", "side"), [("mobile_arm", ""), ("two_arms", "left_"), ("two_arms", "right_")]
)
def test_the_arms_are_the_fr3_of_its_own_file(name: str, side: str) -> None:
    (ours, _), (arm, _) = loaded(name), loaded("fr3")
    for i in range(1, 8):
        mine, its = ours.body(f"{side}link{i}"), arm.body(f"link{i}")
        for what in ("pos", "quat", "ipos", "iquat", "inertia", "mass"):
            assert getattr(mine, what).tolist() == getattr(its, what).tolist()
        drive, other = ours.joint(f"{side}joint{i}"), arm.joint(f"joint{i}")
        for what in ("axis", "range", "armature"):
            assert getattr(drive, what).tolist() == getattr(other, what).tolist()
        effort = ours.jnt_actfrcrange[drive.id], arm.jnt_actfrcrange[other.id]
        assert effort[0].tolist() == effort[1].tolist()
    flange = ours.site(f"{side}flange")
    assert flange.pos.tolist() == arm.site("flange").pos.tolist()
    speed = robot_of(ours).limits.v_max[robot_of(ours).joint_names.index(f"{side}joint1") :][:7]
    assert speed.tolist() == robot_of(arm).limits.v_max.tolist()


def test_the_mobile_arm_holds_the_eraser_before_one_end_of_a_long_board() -> None:
    model, data = loaded("mobile_arm")
    eraser = mujoco.MjModel.from_xml_path(str(MODELS / "eraser.xml"))
    mine, its = model.body("eraser/eraser"), eraser.body("eraser")
    for what in ("ipos", "iquat", "inertia", "mass"):
        assert getattr(mine, what).tolist() == getattr(its, what).tolist()
    for what in ("tool", "ft", "edge"):
        assert model.site(f"eraser/{what}").pos.tolist() == eraser.site(what).pos.tolist()
    R_WE, tool = axes(data, "board"), data.site("eraser/tool").xpos
    gap = R_WE.T @ (data.site("board").xpos - tool)
    assert gap == pytest.approx([0.0, 0.0, 0.02], abs=EXACT)
    assert axes(data, "eraser/tool") == pytest.approx(R_WE, abs=EXACT)
    board, half = data.geom("board").xpos, model.geom("board").size
    assert 2 * half[1] >= 2.0
    assert 0.06 < tool[1] - (board[1] - half[1]) < 0.5  # the pad is on it, near its end
    assert abs(tool[2] - board[2]) < 0.1
    robot = robot_of(model)
    J = oracles.frame_terms(robot.model, robot.home, np.zeros(10), "eraser/tool").J
    assert np.linalg.svd(J[:, 3:])[1][-1] > 0.1  # far from singular with the base at rest
    g = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.home)
    assert g[:3] == pytest.approx(np.zeros(3), abs=1e-9)
    assert 0.1 < (np.abs(g) / robot.limits.tau_max).max() < 0.3


def test_the_pads_touch_the_box_flat_and_exactly() -> None:
    model, data = loaded("two_arms")
    half = model.geom("box").size
    for side, sign in (("left", 1.0), ("right", -1.0)):
        face = data.body("box").xpos + sign * half[1] * np.eye(3)[1]
        pad, shape = data.site(f"{side}_pad"), model.geom(f"{side}_pad")
        assert pad.xpos == pytest.approx(face, abs=EXACT)
        assert axes(data, f"{side}_pad")[:, 2] == pytest.approx([0, -sign, 0], abs=EXACT)
        middle = data.geom(f"{side}_pad").xpos - [0, sign * shape.size[2], 0]
        assert pad.xpos == pytest.approx(middle, abs=EXACT)
    gap = data.site("box_bottom").xpos[2] - data.site("table").xpos[2]
    assert gap == pytest.approx(0.05, abs=EXACT)
    for site in ("box_bottom", "table"):
        assert axes(data, site)[:, 2] == pytest.approx([0, 0, -1], abs=EXACT)


def squeeze(model: mujoco.MjModel, data: mujoco.MjData, force: float) -> np.ndarray:
    """Return torques (nv) that carry the arms and half the box each, and press with ``force``."""
    tau = data.qfrc_bias.copy()
    for side, sign in (("left", -1.0), ("right", 1.0)):
        J = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, J, None, model.site(f"{side}_pad").id)
        tau += J.T @ [0.0, sign * force, GRAVITY]  # 1 kg each
    tau[:6] = 0.0
    return tau


def held(friction: float, duration: float) -> tuple[mujoco.MjModel, mujoco.MjData, np.ndarray]:
    """Return what is after pressing with 40 N, by forces that know no position, and the way [m]."""
    model, data = loaded("two_arms")
    model.pair_friction[:2, :2] = friction
    tau, start = squeeze(model, data, 40.0), data.body("box").xpos.copy()
    for _ in range(round(duration / model.opt.timestep)):
        data.qfrc_applied[6:] = tau[6:] - 20.0 * data.qvel[6:]  # damping alone
        mujoco.mj_step(model, data)
    return model, data, data.body("box").xpos - start


def test_two_pads_hold_the_box_by_friction() -> None:
    model, data, way = held(1.0, 2.0)
    assert np.linalg.norm(way) < 2e-4
    turn = np.linalg.norm(pin.log3(data.body("box").xmat.reshape(3, 3)))
    assert np.degrees(turn) < 0.01
    force, pressed = np.zeros(6), 0.0
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        pressed += force[0]
    assert pressed == pytest.approx(80.0, rel=0.01)
    robot = robot_of(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    used = np.abs(squeeze(model, data, 40.0)[6:]) / robot.limits.tau_max
    assert 0.15 < used.max() < 0.3


def test_slippery_pads_let_the_box_fall_on_the_table() -> None:
    _, _, way = held(0.1, 0.7)
    assert way[2] == pytest.approx(-0.05, abs=1e-3)


def test_a_ball_joint_is_refused_by_name() -> None:
    text = TWO_BODIES.format(BASE.replace('type="slide" axis="1 2 3" range="-1 1"', 'type="ball"'))
    model = mujoco.MjModel.from_xml_string(text.replace(' actuatorfrcrange="-7 7"', ""))
    with pytest.raises(InputError, match="joint 'reach': got a ball joint, need hinge, slide or f"):
        robot_from_mujoco(model)


def test_limits_are_one_for_each_hinge_and_slide() -> None:
    numeric = '<custom><numeric name="velocity_limit" data="{}"/></custom><worldbody>'
    text = TWO_BODIES.format(BASE).replace("<worldbody>", numeric)
    model = mujoco.MjModel.from_xml_string(text.format("3 4"))
    v_max = robot_from_mujoco(model).limits.v_max
    assert v_max.tolist() == [*[np.inf] * 6, 3.0, 4.0]
    wrong = mujoco.MjModel.from_xml_string(text.format("0 0 0 0 0 0 3 4"))
    with pytest.raises(InputError, match="'velocity_limit': got 8 values, need 2"):
        robot_from_mujoco(wrong)


def test_other_joints_and_a_home_of_another_size_are_refused() -> None:
    model = mujoco.MjModel.from_xml_string(TWO_BODIES.format(BASE + BOX))
    alone = mujoco.MjModel.from_xml_string(TWO_BODIES.format(BASE))
    with pytest.raises(ModelMismatchError, match=r"box \(floating\), pinocchio base \(floating\)"):
        coordinates(model, robot_from_mujoco(alone))
    with pytest.raises(InputError, match=r"home: got shape \(9,\), need \(16,\)"):
        robot_from_mujoco(model, alone.qpos0)
    turned = robot_from_mujoco(alone, alone.qpos0)
    assert turned.home[[3, 6]] == pytest.approx(alone.qpos0[[4, 3]])  # (x … w) of (w, x …)
    assert replace(turned, home=turned.home).home == pytest.approx(turned.home)
