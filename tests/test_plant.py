"""The plants: two engines agree, the sensor reads true, the rigid plant is exact."""

from dataclasses import replace

import casadi as ca
import mujoco
import numpy as np
import oracles
import pinocchio as pin
import pytest

from qpctrl import FaceOnPlane, ModelMismatchError, TaskSpace
from qpctrl.dynamics import Dynamics
from scenarios.plant_model import check_agreement, robot_from_mujoco
from scenarios.plant_mujoco import MujocoPlant
from scenarios.plant_rigid import RigidPlant
from scenarios.robot_file import ROBOTS, compile_spec, load_robot, robot_spec
from scenarios.sensor import ToolReading, WrenchSensor
from scenarios.world import TOOL, Pad, World, build_world

THREE_ENGINES = 1e-10
"""CasADi, pinocchio and MuJoCo evaluate the same sums in another order."""

SENSOR_NOISE_FREE = 1e-9
"""N and Nm: what is left of a compensated reading is round-off."""

WEIGHT = 0.2 * 9.81
"""N: the eraser."""


@pytest.fixture(scope="module")
def world() -> World:
    return build_world("fr3", pad=Pad(friction=0.0))


@pytest.mark.parametrize("name", ROBOTS)
def test_casadi_pinocchio_and_mujoco_agree_on_M_and_h(name: str) -> None:
    model = compile_spec(robot_spec(name), name)
    robot = load_robot(name)
    dynamics = Dynamics(robot)
    function = ca.Function("f", [dynamics.q, dynamics.v], [dynamics.M, dynamics.h])
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(20):
        q, v = rng.uniform(-1, 1, robot.nv), rng.normal(size=robot.nv)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        M = np.zeros((robot.nv, robot.nv))
        mujoco.mj_fullM(model, data, M)
        ours = [np.asarray(value) for value in function(q, v)]
        assert np.abs(ours[0] - M).max() < THREE_ENGINES * np.abs(M).max()
        assert np.abs(ours[1].ravel() - data.qfrc_bias).max() < THREE_ENGINES * 100
        theirs = oracles.frame_terms(robot.model, q, v, "flange")
        assert np.abs(ours[0] - theirs.M).max() < THREE_ENGINES * np.abs(M).max()
        assert np.abs(ours[1].ravel() - theirs.h).max() < THREE_ENGINES * 100


TRICKY = """
<mujoco model="tricky">
  <option gravity="0 -3 -9"/>
  <worldbody>
    <body name="base" pos="0.1 0.2 0.3" euler="20 30 40">
      <geom size="0.1" mass="3"/>
      <body name="slider" pos="0 0 0.5" euler="10 0 80">
        <joint name="reach" type="slide" axis="1 2 3" range="-1 1"/>
        <geom type="box" size="0.1 0.2 0.3" mass="2" pos="0.1 0 0"/>
        <body name="door" pos="0.2 0 0">
          <joint name="lift" axis="0 1 0" pos="0.1 -0.2 0.05" armature="0.3"/>
          <joint name="turn" axis="1 0 1" pos="0 0.1 0.2"/>
          <geom type="capsule" size="0.05 0.2" mass="1" pos="0 0.1 0" euler="0 50 0"/>
          <site name="hand" pos="0.1 0.2 0.3" euler="5 6 7"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def test_anchored_joints_slides_armature_and_tilted_gravity_are_read_alike() -> None:
    model = mujoco.MjModel.from_xml_string(TRICKY)
    robot = robot_from_mujoco(model)
    assert robot.joint_names == ("reach", "lift", "turn")
    check_agreement(model, robot, "hand", states=20)
    check_agreement(model, robot, "door", states=20)


@pytest.mark.parametrize(
    ("term", "spoil"),
    [
        ("M", lambda model: model.dof_armature.__setitem__(1, 0.31)),
        ("h", lambda model: model.opt.gravity.__setitem__(0, 0.1)),
        ("J", lambda model: model.site_pos.__setitem__((0, 0), 0.11)),
    ],
)
def test_a_mismatch_is_refused_and_names_the_term(term: str, spoil) -> None:
    model = mujoco.MjModel.from_xml_string(TRICKY)
    robot = robot_from_mujoco(model)
    spoil(model)
    with pytest.raises(ModelMismatchError, match=f": {term} of MuJoCo and pinocchio differ"):
        check_agreement(model, robot, "hand")


def test_the_raw_sensor_carries_the_eraser_and_the_compensated_one_nothing(world: World) -> None:
    plant = MujocoPlant(world)
    state = plant.reset(world.robot.home)
    raw = plant._data.sensor("qpctrl/force").data
    assert np.linalg.norm(raw) == pytest.approx(WEIGHT, rel=1e-9)
    assert np.abs(state.wrench_meas).max() < SENSOR_NOISE_FREE


def test_a_swing_in_free_air_reads_zero(world: World) -> None:
    plant, worst, fastest = MujocoPlant(world), 0.0, 0.0
    plant.reset(world.robot.home)
    for tick in range(250):
        shake = np.sin(0.05 * tick + np.arange(7)) * np.array([9, 9, 9, 9, 2, 2, 2])
        state = plant.step(plant._data.qfrc_bias + shake)
        assert not state.touching
        worst = max(worst, np.abs(state.wrench_meas).max())
        fastest = max(fastest, np.abs(state.v).max())
    assert fastest > 0.3  # rad/s: it did swing
    assert worst < SENSOR_NOISE_FREE


def test_a_known_weight_hung_on_the_tool_is_read_with_its_sign(world: World) -> None:
    plant = MujocoPlant(world)
    plant.reset(world.robot.home)
    hung = np.array([0.0, 0.0, -5.0, 0.0, 0.0, 0.0])  # world: the weight pulls the tool down
    plant.push_tool(hung)
    state = plant.step(plant._data.qfrc_bias)
    R_WT = world.robot.pose(world.robot.home, TOOL).rotation
    assert state.wrench_meas[:3] == pytest.approx(R_WT.T @ -hung[:3], abs=1e-9)
    assert state.wrench_meas[3:] == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_known_push_on_the_wall_is_read_as_force_into_it(world: World) -> None:
    plant, robot, push = MujocoPlant(world), world.robot, 12.0
    state = plant.reset(robot.home)
    data = robot.model.createData()
    frame = robot.frame_id(TOOL)
    for _ in range(3000):
        J = pin.computeFrameJacobian(robot.model, data, state.q, frame)
        damping = 30.0 * J.T @ (J @ state.v)
        g = pin.computeGeneralizedGravity(robot.model, data, state.q)
        posture = 2.0 * (robot.home - state.q) - 4.0 * state.v
        free = np.eye(7) - np.linalg.pinv(J) @ J
        tau = g + J.T @ np.array([0, 0, push, 0, 0, 0]) - damping + free @ posture
        state = plant.step(tau)
    assert state.touching
    assert np.abs(state.v).max() < 1e-3  # at rest, so the force is the statics'
    assert state.wrench_meas[2] == pytest.approx(push, rel=1e-3)


def test_the_sensor_compensates_a_spinning_tool_against_hand_calculation() -> None:
    mass, arm = 2.0, np.array([0.3, 0.0, 0.0])
    sensor = WrenchSensor(pin.Inertia(mass, arm, np.zeros((3, 3))), pin.SE3.Identity())
    spin = np.array([0.0, 0.0, 4.0])
    centripetal = np.array([-mass * 0.3 * 16.0, 0.0, 0.0])  # N, the arm pulls the tool inwards
    extra = np.array([1.0, -2.0, 3.0])  # N, and pushes this much on the environment
    wrench = sensor.wrench_on_env(
        ToolReading(centripetal + extra, np.zeros(3), np.zeros(3), spin, np.zeros(3))
    )
    assert wrench == pytest.approx([*extra, 0, 0, 0], abs=1e-12)


def test_the_rigid_plant_matches_constrained_dynamics_and_stays_on_its_board(world: World) -> None:
    robot, space = world.robot, TaskSpace(TOOL)
    X_WE = robot.pose(robot.home, TOOL)
    plant = RigidPlant(robot, FaceOnPlane(space=space, R_WE=X_WE.rotation))
    state = plant.reset(robot.home)
    rng, inward = np.random.default_rng(3), X_WE.rotation[:, 2]
    for _ in range(400):
        tau = pin.computeGeneralizedGravity(
            robot.model, robot.model.createData(), state.q
        ) + rng.normal(size=7)
        before = state
        state = plant.step(tau)
    terms = oracles.frame_terms(robot.model, before.q, before.v, TOOL)
    A = np.zeros((3, 6))
    A[0, 2] = A[1, 3] = A[2, 4] = 1.0  # board and tool axes coincide: the tool stays flat
    AJ = A @ terms.J
    kkt = np.block([[terms.M, AJ.T], [AJ, np.zeros((3, 3))]])
    V = terms.J @ before.v
    A_dot_V = np.array([np.cross(V[3:], V[:3])[2], 0.0, 0.0])
    found = np.linalg.solve(kkt, np.r_[tau - terms.h, -A_dot_V - A @ terms.J_dot_v])
    assert state.wrench_meas == pytest.approx(A.T @ found[7:], abs=1e-6)
    pose = robot.pose(state.q, TOOL)
    assert abs(inward @ (pose.translation - X_WE.translation)) < 1e-9
    assert np.linalg.norm(pose.translation - X_WE.translation) > 1e-4  # it did slide
    assert abs(inward @ (pose.rotation @ (terms.J @ state.v)[:3])) < 1e-3


def test_force_noise_is_seeded(world: World) -> None:
    def readings(seed: int) -> np.ndarray:
        plant = MujocoPlant(world, force_noise=0.5, seed=seed)
        plant.reset(world.robot.home)
        return np.array([plant.step(np.zeros(7)).wrench_meas for _ in range(50)])

    assert np.array_equal(readings(1), readings(1))
    assert not np.array_equal(readings(1), readings(2))
    assert 0.3 < readings(1)[:, 0].std() < 0.8


def test_the_pad_rubs_with_its_friction() -> None:
    slippery, rough = (build_world("fr3", pad=Pad(friction=mu)) for mu in (0.0, 0.7))
    assert slippery.model.pair_friction[0, 0] == 0.0
    assert rough.model.pair_friction[0, 0] == 0.7
    assert replace(Pad(), friction=0.1).solimp == Pad().solimp
