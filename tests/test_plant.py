"""The plants: two engines agree, the sensor reads true, the rigid plant is exact."""

from dataclasses import replace

import casadi as ca
import mujoco
import numpy as np
import oracles
import pinocchio as pin
import pytest

from qpctrl import FaceOnPlane, InputError, ModelMismatchError, TaskSpace
from qpctrl.constraint import row_function
from qpctrl.dynamics import Dynamics
from scenarios.encoder import EncodedPlant
from scenarios.environment import Hand, Springs
from scenarios.force_sensor import ForceSensor, SensedPlant
from scenarios.plant import JointReading, PlantState, SteppedPlant
from scenarios.plant_compliant import CompliantPlant
from scenarios.plant_model import check_agreement, robot_from_mujoco
from scenarios.plant_mujoco import MujocoPlant
from scenarios.plant_rigid import RigidPlant
from scenarios.robot_file import ROBOTS, compile_spec, load_robot, robot_spec
from scenarios.runge_kutta import FINE
from scenarios.sensor import ToolReading, WrenchSensor
from scenarios.slider import slider
from scenarios.world import TOOL, Pad, World, build_world

THREE_ENGINES = 1e-10
"""CasADi, pinocchio and MuJoCo evaluate the same sums in another order."""

SENSOR_NOISE_FREE = 1e-9
"""N and Nm: what is left of a compensated reading is round-off."""

WEIGHT = 0.2 * 9.81
"""N: the eraser."""

STEP = 1e-4  # s, of the fine plants: the midpoint rule
ROUND_OFF = 1e-13
"""Relative: a solution of six equations."""

CONSERVED = 1e-6
"""Energy that a swing of 1 s may lose, in units of its kinetic energy: (h ω)² at 10 rad/s."""


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
    mass, arm, radius = 2.0, np.array([0.3, 0.0, 0.0]), 0.3
    X_WS = pin.SE3(pin.utils.rotate("x", 0.5), np.zeros(3))  # the world is at rest in no axis of S
    reading = ToolReading(*np.zeros((5, 3)), np.zeros((3, 3), order="F"))
    X_ST = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    sensor = WrenchSensor(pin.Inertia(mass, arm, np.zeros((3, 3))), X_ST, reading)
    spin, spin_up = 4.0, 5.0  # rad/s, rad/s², about z
    centripetal = [-mass * radius * spin**2, 0.0, 0.0]  # N, the arm pulls the tool inwards
    swing, lift = [0.0, mass * radius * spin_up, 0.0], [0.0, 0.0, mass * 9.81]
    moment = [0.0, -radius * mass * 9.81, radius**2 * mass * spin_up]
    extra = np.array([1.0, -2.0, 3.0])  # N, and pushes this much on the environment
    reading.force[:] = np.sum([centripetal, swing, lift, extra], axis=0)
    reading.moment[:] = moment
    reading.acceleration[:] = 0.0, 0.0, 9.81
    reading.angular_velocity[:] = 0.0, 0.0, spin
    reading.angular_acceleration[:] = X_WS.rotation @ [0.0, 0.0, spin_up]
    reading.R_SW[...] = X_WS.rotation.T
    lever = -np.cross(X_ST.translation, extra)  # the force acts at the sensor's origin
    assert sensor.wrench_on_env() == pytest.approx([*extra, *lever], abs=1e-12)


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


PLANTS = ("rigid", "compliant", "mujoco")


def make_plant(kind: str, world: World, **options) -> SteppedPlant:
    """Return a plant with the tool on the board's plane, in free air, or in the scene."""
    robot = world.robot
    if kind == "rigid":
        R_WE = robot.pose(robot.home, TOOL).rotation
        return RigidPlant(robot, FaceOnPlane(space=TaskSpace(TOOL), R_WE=R_WE), **options)
    if kind == "compliant":
        return CompliantPlant(robot, TOOL, Hand(lambda t: np.zeros(6)), **options)
    return MujocoPlant(world, **options)


def drive(plant: SteppedPlant, robot, dt: float, tau: np.ndarray, duration: float = 1.0):
    """Return q and v (periods×nv each) from home under a constant torque."""
    state = plant.reset(robot.home)
    q, v = [state.q], [state.v]
    for _ in range(round(duration / dt)):
        for kept, now in zip((q, v), plant.advance(tau), strict=True):
            kept.append(now.copy())
    return np.array(q), np.array(v)


def gravity(robot) -> np.ndarray:
    """Return the torque that holds the robot at home."""
    return pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.home).copy()


@pytest.mark.parametrize("kind", PLANTS)
def test_a_step_is_an_advance_and_a_reading(kind: str, world: World) -> None:
    stepped, advanced = (make_plant(kind, world, dt=STEP) for _ in range(2))
    held = [plant.reset(world.robot.home) for plant in (stepped, advanced)]
    kept = held[1].q.copy()
    tau = gravity(world.robot) + np.arange(7)
    for _ in range(10):
        state = stepped.step(tau)
        q, v = advanced.advance(tau)
        assert np.array_equal(q, state.q)
        assert np.array_equal(v, state.v)
    for one, other in zip(state, advanced.read(), strict=True):
        assert np.array_equal(one, other)
    assert state.time == pytest.approx(10 * STEP)
    assert np.abs(state.v).max() > 1e-2
    assert np.array_equal(held[1].q, kept)  # a reading is not overwritten
    assert state.joints is None


@pytest.mark.parametrize("kind", PLANTS)
def test_the_true_armature_is_in_the_plant_and_not_in_what_the_controller_believes(
    kind: str, world: World
) -> None:
    robot, believed = world.robot, world.robot.model.armature.copy()
    armature = np.array([0.5, 0.0, 0.3, 0.2, 0.0, 0.05, 0.0])
    tau, dt = gravity(robot) + np.array([3.0, -2, 1, 1, 0.5, 0.5, 0.1]), 1e-6
    terms = oracles.frame_terms(robot.model, robot.home, np.zeros(7), TOOL)
    found = {}
    for name, rotors in (("believed", None), ("true", armature)):
        plant = make_plant(kind, world, dt=dt, armature=rotors)
        plant.reset(robot.home)
        M = terms.M + (0 if rotors is None else np.diag(rotors - believed))
        AJ = terms.J[[2, 3, 4] if kind == "rigid" else []]
        kkt = np.block([[M, AJ.T], [AJ, np.zeros((len(AJ), len(AJ)))]])
        a = np.linalg.solve(kkt, np.r_[tau - terms.h, np.zeros(len(AJ))])[:7]
        found[name] = plant.advance(tau)[1] / dt
        assert found[name] == pytest.approx(a, rel=1e-6, abs=1e-6 * np.abs(a).max())
    assert np.abs(found["true"] / found["believed"] - 1).max() > 0.5
    assert np.array_equal(robot.model.armature, believed)
    assert np.array_equal(world.model.dof_armature, believed)


def test_contact_in_mujoco_is_scaled_by_the_true_inertia(world: World) -> None:
    armature = np.array([0.5, 0.4, 0.3, 0.2, 0.1, 0.05, 0.0])
    plant, model = MujocoPlant(world, armature=armature), world.robot.model
    M = oracles.frame_terms(model, world.model.qpos0, np.zeros(7), TOOL).M
    M = M + np.diag(armature - model.armature)
    assert plant._model.dof_invweight0 == pytest.approx(np.diag(np.linalg.inv(M)), rel=1e-9)


@pytest.mark.parametrize("kind", PLANTS)
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"armature": np.full(7, -0.1)}, "armature: .*>= 0"),
        ({"armature": np.ones(6)}, "armature: got shape"),
        ({"dt": 0.0}, "dt: .*> 0"),
    ],
    ids=str,
)
def test_plants_refuse_what_they_cannot_use(kind: str, wrong, words: str, world: World) -> None:
    with pytest.raises(InputError, match=words):
        make_plant(kind, world, **wrong)


def test_two_plants_of_one_world_do_not_disturb_each_other(world: World) -> None:
    moved, other = (MujocoPlant(world) for _ in range(2))
    fast = MujocoPlant(world, dt=STEP)
    way_W, before = np.array([0.0, 0.1, 0.05]), world.model.body("qpctrl/board").pos.copy()
    moved.move_board(way_W)
    at = []
    for plant in (moved, other, fast):
        state = plant.step(plant.reset(world.robot.home).q)
        at.append(plant._data.body("qpctrl/board").xpos - before)
        assert state.time == pytest.approx(STEP if plant is fast else 1e-3)
    assert at == [pytest.approx(way_W), pytest.approx(np.zeros(3)), pytest.approx(np.zeros(3))]
    assert np.array_equal(world.model.body("qpctrl/board").pos, before)


def test_a_finer_mujoco_plant_is_nearer_to_the_exact_motion(world: World) -> None:
    robot, tau = world.robot, 0.5 * gravity(world.robot)
    exact, _ = drive(make_plant("compliant", world), robot, 1e-3, tau, 0.1)
    coarse, fine = (
        drive(make_plant("mujoco", world, dt=dt), robot, dt, tau, 0.1)[0][-1] - exact[-1]
        for dt in (1e-3, STEP)
    )
    assert np.abs(coarse).max() > 1e-4  # rad
    assert np.linalg.norm(coarse) / np.linalg.norm(fine) == pytest.approx(10, rel=0.01)


@pytest.mark.parametrize("kind", ["rigid", "compliant"])
def test_fine_periods_follow_the_coarse_ones_to_second_order(kind: str, world: World) -> None:
    robot, way = world.robot, np.array([1.0, -1.0, 0.5, 0.5, 0.2, -0.2, 0.1])
    tau = gravity(robot) + 2 * way
    q, v = drive(make_plant(kind, world, dt=1e-3), robot, 1e-3, tau)
    error = {}
    for dt in (STEP, FINE, 1.25 * FINE):
        error[dt] = drive(make_plant(kind, world, dt=dt), robot, dt, tau)[0][-1] - q[-1]
    error = {dt: np.linalg.norm(gap) for dt, gap in error.items()}
    # a step errs by h³/6 |v⃛| in v at most, and 1 s carries that on into q
    third = np.linalg.norm(np.diff(v, 3, axis=0), axis=1) / 1e-3**3
    assert 1e-9 < error[STEP] < STEP**2 / 6 * 1e-3 * third.sum()
    assert error[FINE] / error[STEP] == pytest.approx((FINE / STEP) ** 2, rel=0.01)
    assert error[1.25 * FINE] < 1e-3 * error[FINE]  # four stages again
    start, end = (robot.pose(at, TOOL).translation for at in (robot.home, q[-1]))
    assert np.linalg.norm(end - start) > 0.1  # m


@pytest.mark.parametrize("dt", [1e-3, STEP])
def test_the_velocity_on_a_rigid_board_is_along_it_to_round_off(dt: float, world: World) -> None:
    robot = world.robot
    board = FaceOnPlane(space=TaskSpace(TOOL), R_WE=robot.pose(robot.home, TOOL).rotation)
    q, v = drive(make_plant("rigid", world, dt=dt), robot, dt, np.zeros(7))
    terms = oracles.frame_terms(robot.model, q[-1], v[-1], TOOL)
    V = terms.J @ v[-1]
    A = np.asarray(
        row_function(board)(terms.X_WF.rotation, terms.X_WF.translation, V, board.R_WE)[0]
    )
    assert np.linalg.norm(V) > 1.0
    assert np.abs(A @ V).max() < ROUND_OFF * np.linalg.norm(V)


@pytest.mark.parametrize("kind", ["rigid", "compliant"])
def test_a_free_swing_keeps_its_energy(kind: str, world: World) -> None:
    model = world.robot.model
    q, v = drive(make_plant(kind, world, dt=STEP), world.robot, STEP, np.zeros(7))
    data = model.createData()
    kinetic, potential = [], []
    for i in (0, -1):
        kinetic.append(v[i] @ oracles.frame_terms(model, q[i], v[i], TOOL).M @ v[i] / 2)
        potential.append(pin.computePotentialEnergy(model, data, q[i]))
    assert kinetic[1] > 10  # J
    assert abs(kinetic[1] + potential[1] - potential[0]) < CONSERVED * kinetic[1]


@pytest.mark.parametrize(
    ("options", "calls"),
    [({}, 8), ({"dt": STEP}, 2), ({"dt": STEP, "substeps": 3}, 6), ({"substeps": 1}, 4)],
    ids=str,
)
def test_a_fine_period_asks_its_environment_twice(options, calls: int) -> None:
    asked: list[float] = []

    def push(time: float) -> np.ndarray:
        asked.append(time)
        return np.eye(6)[0]

    plant = CompliantPlant(slider(2.0), "tool", Hand(push), **options)
    plant.reset(np.zeros(1))
    asked.clear()
    state = plant.step(np.zeros(1))
    assert len(asked) == calls
    assert state.v[0] == pytest.approx(state.time / 2.0)


def test_energy_given_to_a_spring_is_what_it_holds() -> None:
    plant = CompliantPlant(slider(2.0), "tool", Springs(np.full(6, 50.0), np.zeros(6)), dt=STEP)
    plant.reset(np.zeros(1))
    for _ in range(3000):
        state = plant.step(np.ones(1))
    omega = np.sqrt(50.0 / 2.0)
    assert state.q[0] == pytest.approx((1 - np.cos(0.3 * omega)) / 50.0, rel=1e-6)
    assert plant.energy == pytest.approx(50.0 * state.q[0] ** 2 / 2, rel=1e-6)


class DrivenSlider:
    """A plant whose drives deliver half of what is asked, and count the periods in ampere."""

    def __init__(self) -> None:
        self._plant, self._count = (
            CompliantPlant(slider(2.0), "tool", Hand(lambda t: np.ones(6))),
            0,
        )

    def reset(self, q: np.ndarray) -> PlantState:
        """Return the state at rest."""
        return self._driven(self._plant.reset(q), np.zeros(1))

    def step(self, tau: np.ndarray) -> PlantState:
        """Return the state after a period."""
        self._count += 1
        return self._driven(self._plant.step(tau / 2), tau)

    def _driven(self, state: PlantState, tau: np.ndarray) -> PlantState:
        reading = JointReading(tau / 2, tau / 4, np.full(1, self._count), tau, limited=True)
        return state._replace(joints=reading)


def test_sensors_pass_on_what_the_drives_say() -> None:
    sensed = SensedPlant(DrivenSlider(), ForceSensor(noise=0.1, delay=2))
    plant = EncodedPlant(sensed, 1e-4, 1e-3)
    states = [plant.reset(np.zeros(1)), *(plant.step(np.full(1, 3.0 + i)) for i in range(3))]
    readings = [state.joints for state in states]
    assert [reading.current[0] for reading in readings] == [0, 1, 2, 3]
    assert readings[-1].tau_delivered == pytest.approx([2.5])
    assert readings[-1].tau_meas == pytest.approx([1.25])
    assert readings[-1].limited


@pytest.mark.parametrize("mass", [1e-3, 1.0])
def test_a_light_link_on_stiff_springs_is_integrated_without_growth(mass: float) -> None:
    """Of m ẍ + d ẋ + k x = f; with 1 g an explicit step of 0.1 ms grows threefold."""
    k, d, f, dt = 2000.0, 40.0, 3.0, 1e-4
    springs = Springs(np.full(6, k), np.full(6, d))
    plant = CompliantPlant(slider(mass), "tool", springs, dt=dt)
    plant.reset(np.zeros(1))
    poles = np.roots([mass, d, k]).astype(complex)
    residues = [f / (mass * p * (p - other)) for p, other in zip(poles, poles[::-1], strict=True)]
    for i in range(1, 1001):
        x = plant.advance(np.array([f]))[0][0]
        answer = f / k + sum(r * np.exp(p * i * dt) for r, p in zip(residues, poles, strict=True))
        assert x == pytest.approx(answer.real, abs=0.01 * f / k)  # first order: h k / d is 0.5 %
    assert x == pytest.approx(answer.real, rel=1e-3)
