"""What can be wrong between controller and world: sensors, torque, friction, model, board."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import oracles
import pinocchio as pin
import pytest

from qpctrl import FaceOnPlane, InputError, TaskSpace
from qpctrl.constraint import Pfaffian, PointOnPlane
from qpctrl.controller import Controller
from qpctrl.memory import Measurement
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from scenarios.critical_gain import DT, SPACE, UNBOUNDED, WALL, one_mass
from scenarios.disturbed_plant import DisturbedPlant, TorqueError
from scenarios.environment import Hand, SpringWall
from scenarios.force_sensor import ForceSensor, SensedPlant, WrenchNoise
from scenarios.joint_friction import dry_friction
from scenarios.model_error import ModelError
from scenarios.plant import SteppedPlant
from scenarios.plant_compliant import CompliantPlant
from scenarios.plant_model import check_agreement, robot_from_mujoco
from scenarios.plant_mujoco import MujocoPlant
from scenarios.plant_rigid import RigidPlant
from scenarios.slider import slider
from scenarios.state_sensor import ObservedPlant, StateSensor
from scenarios.world import TOOL, Pad, World, build_world
from tasks import ForceReference, ForceTask, MotionReference, MotionTask

ROUND_OFF = 1e-12
"""Relative: sums of a few numbers."""

STUCK = {"rigid": 1e-6, "compliant": 1e-6, "mujoco": 1e-6}
"""rad, in 0.3 s: a stuck joint creeps by SOFTNESS, or in MuJoCo by 1 − STIFFEST, of the speed
that it would gain in a period."""

ENGINES = 1e-9
"""Relative: two engines evaluate the same sums in another order."""


@pytest.fixture(scope="module")
def world() -> World:
    return build_world("fr3", pad=Pad(friction=0.0))


def free_slider(mass: float = 2.0, push: float = 0.0, **options) -> CompliantPlant:
    """Return a mass on a rail, pushed with a constant force [N]."""
    return CompliantPlant(slider(mass), "tool", Hand(lambda t: push * np.eye(6)[0]), **options)


def make_plant(kind: str, world: World, **options) -> SteppedPlant:
    """Return a plant with the tool on a plane, in free air, or in the scene."""
    robot = world.robot
    if kind == "rigid":
        R_WE = robot.pose(robot.home, TOOL).rotation
        return RigidPlant(robot, FaceOnPlane(space=TaskSpace(TOOL), R_WE=R_WE), **options)
    if kind == "compliant":
        return CompliantPlant(robot, TOOL, Hand(lambda t: np.zeros(6)), **options)
    return MujocoPlant(world, **options)


def gravity(robot, q: np.ndarray | None = None) -> np.ndarray:
    """Return the torque that holds the robot."""
    at = robot.home if q is None else q
    return pin.computeGeneralizedGravity(robot.model, robot.model.createData(), at).copy()


# Sensors


def test_the_reading_is_gain_times_the_old_wrench_plus_bias() -> None:
    gain, bias = np.array([1.1, 0.9, 1, 1, 1, 2.0]), np.arange(6.0)

    def push(time: float) -> np.ndarray:
        return (1 + 1e3 * time) * np.array([-1.0, 2, -3, 4, -5, 6])

    hand = CompliantPlant(slider(2.0), "tool", Hand(push))
    plant = SensedPlant(hand, ForceSensor(gain=gain, bias=bias, delay=2))
    plant.reset(np.zeros(1))
    states = [plant.step(np.zeros(1)) for _ in range(6)]
    assert states[-1].wrench == pytest.approx(-push(5e-3))
    assert states[-1].wrench_meas == pytest.approx(gain * -push(3e-3) + bias)


def test_the_low_pass_follows_a_step_as_its_cutoff_says() -> None:
    def push(time: float) -> np.ndarray:
        return -np.eye(6)[0] * (5.0 if time < 2.5e-3 else 9.0)

    plant = SensedPlant(CompliantPlant(slider(2.0), "tool", Hand(push)), ForceSensor(cutoff=30.0))
    plant.reset(np.zeros(1))
    readings = [plant.step(np.zeros(1)).wrench_meas[0] for _ in range(20)]
    # the wrench of 3 ms is in the state of 4 ms, whose low-pass has had it for one period
    answer = [5 + 4 * (1 - math.exp(-2 * math.pi * 30 * 1e-3 * max(0, i - 2))) for i in range(20)]
    assert readings == pytest.approx(answer, rel=ROUND_OFF)
    assert 5 < readings[5] < readings[19] < 9


def test_the_low_pass_smooths_noise_as_its_cutoff_says() -> None:
    def spread(cutoff: float) -> float:
        plant = SensedPlant(free_slider(), ForceSensor(noise=1.0, cutoff=cutoff), seed=3)
        plant.reset(np.zeros(1))
        return float(np.std([plant.step(np.zeros(1)).wrench_meas[:3] for _ in range(4000)]))

    follow = 1 - math.exp(-2 * math.pi * 20 * 1e-3)
    assert spread(0.0) == pytest.approx(1.0, rel=0.03)
    assert spread(20.0) == pytest.approx(math.sqrt(follow / (2 - follow)), rel=0.05)


def readings(plant, ticks: int = 30) -> np.ndarray:
    """Return all that is seen after a reset, one row a tick."""
    states = [plant.reset(np.zeros(1)), *(plant.step(np.ones(1)) for _ in range(ticks))]
    return np.array([np.concatenate([s.q, s.v, s.wrench_meas]) for s in states])


def all_wrong(seed: int) -> ObservedPlant:
    """Return a plant with everything between it and its controller wrong."""
    robot, sensor = slider(2.0), ForceSensor(noise=0.3, cutoff=40.0, delay=3, gain=1.1)
    arm = CompliantPlant(robot, "tool", Hand(lambda t: np.sin(np.arange(6) + 200 * t)))
    torque = DisturbedPlant(arm, TorqueError(gain=1.2, bias=0.5, delay=2), robot)
    watch = StateSensor(noise_q=1e-3, noise_v=1e-2, latency=2)
    return ObservedPlant(SensedPlant(torque, sensor, seed), watch, seed)


def test_everything_repeats_from_its_seed_and_from_a_reset() -> None:
    plant = all_wrong(1)
    first = readings(plant)
    assert np.array_equal(first, readings(plant))
    assert np.array_equal(first, readings(all_wrong(1)))
    assert not np.array_equal(first, readings(all_wrong(2)))


def test_the_noise_of_the_scene_starts_again_at_a_reset(world: World) -> None:
    plant = MujocoPlant(world, force_noise=0.5, seed=1)
    first, second = (plant.reset(world.robot.home).wrench_meas for _ in range(2))
    assert np.array_equal(first, second)
    assert np.abs(first).max() > 0.1


def test_noise_is_the_stream_of_its_seed_however_much_is_drawn_at_once() -> None:
    noise, rng = WrenchNoise(2.0, seed=4), np.random.default_rng(4)
    expected = [[2.0, 2.0, 2.0, 0.2, 0.2, 0.2] * rng.normal(size=6) for _ in range(600)]
    for _ in range(2):
        assert np.array_equal([noise.draw() for _ in range(600)], expected)
        noise.restart()


def test_q_and_v_are_noisy_and_late_and_the_truth_is_kept() -> None:
    sensor = StateSensor(noise_q=1e-3, noise_v=np.array([0.02]), latency=3)
    plant = ObservedPlant(free_slider(), sensor, seed=5)
    seen = [plant.reset(np.zeros(1))]
    seen += [plant.step(np.ones(1)) for _ in range(3000)]
    time = np.array([state.time for state in seen])
    motion, late = plant.motion(), np.maximum(time - 3e-3, 0.0)
    assert motion.v[:, 0] == pytest.approx(time / 2)
    assert motion.q[:, 0] == pytest.approx(time**2 / 4)
    assert plant.truth.v[0] == motion.v[-1, 0]
    errors = {
        1e-3: np.array([state.q[0] for state in seen]) - late**2 / 4,
        2e-2: np.array([state.v[0] for state in seen]) - late / 2,
    }
    for size, error in errors.items():
        assert error.std() == pytest.approx(size, rel=0.05)
        assert abs(error.mean()) < 4 * size / math.sqrt(len(seen))


# Torque


def test_delivered_torque_is_gain_times_the_old_command_plus_bias() -> None:
    error = TorqueError(gain=0.8, bias=np.array([0.5]), delay=2)
    plant = DisturbedPlant(free_slider(), error, slider(2.0))
    plant.reset(np.zeros(1))
    asked = [3.0, -1.0, 4.0, 1.0, -5.0]
    v = [plant.step(np.array([tau])).v[0] for tau in asked]
    delivered = 0.8 * np.array([0.0, 0.0, *asked[:3]]) + 0.5  # nothing holds a slider
    assert v == pytest.approx(np.cumsum(delivered) * 1e-3 / 2.0, rel=ROUND_OFF)
    assert plant.delivered[0] == pytest.approx(delivered[-1])


def test_late_torque_starts_with_that_which_holds_at_rest(world: World) -> None:
    robot = world.robot
    plant = DisturbedPlant(make_plant("compliant", world), TorqueError(delay=5), robot)
    plant.reset(robot.home)
    held = [plant.step(np.zeros(7)) for _ in range(5)][-1]
    falls = plant.step(np.zeros(7))
    assert np.abs(gravity(robot)).max() > 10  # Nm: there is something to hold
    assert np.abs(held.v).max() < 1e-12
    assert np.abs(falls.v).max() > 1e-2


@pytest.mark.parametrize("kind", STUCK)
def test_dry_friction_holds_an_arm_that_is_pushed_by_less(kind: str, world: World) -> None:
    """Joints with friction are pushed by 80 % of it, one way and the other; the last is free."""
    robot, c = world.robot, np.array([2.0, 2, 1.5, 1.5, 0.8, 0.8, 0.5])
    plant, way = make_plant(kind, world, joint_friction=c), 0.8 * np.array([1, -1, 1, 1, -1, 1, -1])
    plant.reset(robot.home)
    hold = gravity(robot) + way * c
    for _ in range(300):
        q, _ = plant.advance(hold)
    assert np.abs(q - robot.home).max() < STUCK[kind]
    loose = make_plant(kind, world)
    loose.reset(robot.home)
    for _ in range(300):
        q, _ = loose.advance(hold)
    assert np.abs(q - robot.home).max() > 0.05


@pytest.mark.parametrize("dt", [1e-3, 1e-4])
def test_a_sliding_joint_brakes_at_its_rate_stops_and_stays(dt: float) -> None:
    m, c, v_0 = 2.0, 3.0, 0.45
    plant = free_slider(m, joint_friction=c, dt=dt)
    plant.reset(np.zeros(1))
    while (v := plant.advance(np.array([c + m * v_0 / 0.1]))[1][0]) < v_0:
        pass
    start = plant.read()
    stop, way = v / (c / m), v**2 / (2 * c / m)
    half = [plant.advance(np.zeros(1))[1].copy() for _ in range(round(stop / 2 / dt))][-1][0]
    assert half == pytest.approx(v / 2, rel=0.01)
    speeds = np.array([plant.advance(np.zeros(1))[1][0] for _ in range(round(stop / dt))])
    assert plant.read().q[0] - start.q[0] == pytest.approx(way, rel=1e-2)
    assert speeds.min() > -1e-9  # it does not turn round
    assert np.abs(speeds[round(0.6 * stop / dt) :]).max() < 1e-9


def test_a_sliding_joint_of_the_scene_brakes_at_the_same_rate(world: World) -> None:
    """Joint by joint M a = τ − h − c sign(v) − b v, from the first period of a moving arm."""
    robot, c, b = world.robot, 1.3, 0.7
    way, tau = np.array([1.0, -1, 1, 1, -1, 1, -1]), gravity(robot)
    push = oracles.frame_terms(robot.model, robot.home, np.zeros(7), TOOL).M @ (30 * way) + 2 * way
    found = {}
    for kind in ("compliant", "mujoco"):
        plant = make_plant(kind, world, joint_friction=c, joint_damping=b, dt=1e-5)
        plant.reset(robot.home)
        for _ in range(2000):
            q, v = plant.advance(tau + push)
        q, before = q.copy(), v.copy()
        terms = oracles.frame_terms(robot.model, q, before, TOOL)
        answer = np.linalg.solve(terms.M, tau - terms.h - c * np.sign(before) - b * before)
        found[kind] = (plant.advance(tau)[1] - before) / 1e-5
        assert np.abs(before).min() > 0.01
        assert found[kind] == pytest.approx(answer, rel=2e-3, abs=2e-3 * np.abs(answer).max())


def test_viscous_friction_of_the_joints_slows_a_point_on_its_wall() -> None:
    plant = RigidPlant(one_mass(5.0), WALL, joint_damping=np.array([0.0, 20.0]))
    plant.reset(np.zeros(2))
    state = [plant.step(np.array([1.0, 6.0])) for _ in range(500)][-1]
    assert state.v[1] == pytest.approx(6.0 / 20.0 * (1 - math.exp(-20.0 / 5.0 * 0.5)), rel=1e-6)


def test_dry_friction_meets_its_conditions_on_random_arms() -> None:
    rng = np.random.default_rng(0)
    counts = np.zeros(2)
    for _ in range(300):
        root = rng.normal(size=(7, 7))
        W, v_free, c = root @ root.T / 7, rng.normal(size=7), rng.uniform(0.0, 3.0, 7)
        f = dry_friction(W, v_free, c)
        after = v_free + W @ f
        stuck = np.abs(after) < 1e-5
        counts += stuck.sum(), (~stuck).sum()
        assert (np.abs(f) <= c).all()
        assert f[~stuck] == pytest.approx(-c[~stuck] * np.sign(after[~stuck]))
    assert (counts > 300).all()


# Model


ERRORS = {
    "mass": ModelError(mass=0.2),
    "mass of each": ModelError(mass=np.linspace(-0.3, 0.3, 7)),
    "com": ModelError(com=np.array([0.02, -0.01, 0.03])),
    "gravity": ModelError(gravity=-0.05),
    "armature": ModelError(armature=0.4),
    "payload": ModelError(payload=1.5),
    "all": ModelError(mass=0.1, com=np.full((7, 3), 0.01), gravity=0.02, armature=0.3, payload=0.7),
}


@pytest.mark.parametrize("name", ["fr3", "ur5"])
@pytest.mark.parametrize("kind", ERRORS)
def test_both_engines_get_the_same_error(kind: str, name: str) -> None:
    world = build_world(name)
    robot, error = world.robot, ERRORS[kind]
    if name == "ur5" and kind in ("mass of each", "all"):
        error = ModelError(mass=np.linspace(0.3, 0, 6), com=np.full((6, 3), 0.01), payload=0.7)
    true = replace(robot, model=error.perturbed(robot.model, TOOL))
    plant = MujocoPlant(world, model_error=error)
    check_agreement(plant._model, true, TOOL, states=5)  # M, h and J to ENGINES
    at = np.full(robot.nv, 0.3)
    M, M_true = (oracles.frame_terms(r.model, at, 0 * at, TOOL).M for r in (robot, true))
    gap = np.abs(M - M_true).max(), np.abs(gravity(robot, at) - gravity(true, at)).max()
    assert max(gap) > 0.02
    assert np.array_equal(robot.model.inertias[1].lever, world.robot.model.inertias[1].lever)
    assert not np.array_equal(plant._model.body_ipos, world.model.body_ipos) or kind != "com"


TWISTED = """
<mujoco>
  <worldbody>
    <body name="cart">
      <joint name="x" type="slide" axis="1 0 0"/>
      <geom size="0.1" mass="3"/>
      <body name="arm" pos="0 0 0.2">
        <joint name="turn" axis="0 1 0" armature="0.1"/>
        <geom type="box" size="0.1 0.2 0.3" mass="2"/>
        <body name="bracket" pos="0.1 0.2 0.3" euler="20 30 40">
          <geom type="box" size="0.05 0.1 0.2" mass="1" pos="0.1 0 0"/>
          <body name="tip" pos="0 0.1 0" euler="70 -20 10">
            <geom type="capsule" size="0.05 0.1" mass="0.5"/>
            <site name="hand" pos="0.1 0 0.2" euler="10 20 30"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def test_bodies_that_are_turned_in_their_link_and_centred_ones_shift_alike() -> None:
    model = mujoco.MjModel.from_xml_string(TWISTED)
    robot = robot_from_mujoco(model)
    shift = np.array([[0.1, 0.0, 0.05], [0.03, -0.05, 0.08]])
    error = ModelError(mass=np.array([0.1, 0.4]), com=shift, payload=0.8)
    assert model.body_sameframe[1:].any()  # MuJoCo takes a shortcut for these
    error.perturb_mujoco(model, "hand")
    true = replace(robot, model=error.perturbed(robot.model, "hand"))
    check_agreement(model, true, "hand", states=20)
    M = oracles.frame_terms(true.model, model.qpos0, np.zeros(2), "hand").M
    assert model.dof_invweight0 == pytest.approx(np.diag(np.linalg.inv(M)), rel=ENGINES)


def test_an_error_leaves_what_is_believed_and_what_touches_where_they_are(world: World) -> None:
    before = copied = mujoco.MjData(world.model)
    mujoco.mj_forward(world.model, before)
    plant = MujocoPlant(world, model_error=ERRORS["all"])
    mujoco.mj_forward(plant._model, plant._data)
    for name in ("geom_xpos", "site_xpos", "xpos"):
        assert getattr(plant._data, name) == pytest.approx(getattr(before, name), abs=1e-12)
    mujoco.mj_forward(world.model, copied)
    assert world.model.opt.gravity[2] == -9.81


def test_gravity_torque_changes_by_the_weight_that_moved(world: World) -> None:
    """τ_g = ∂U/∂q with U = −Σ m g·c, the true masses and centres summed up by hand."""
    robot, model = world.robot, world.robot.model
    growth, payload = np.linspace(-0.3, 0.3, 7), 0.7
    shift = np.random.default_rng(2).uniform(-0.03, 0.03, (7, 3))
    error = ModelError(mass=growth, com=shift, gravity=0.1, payload=payload)
    true = replace(robot, model=error.perturbed(model, TOOL))
    data, tool = model.createData(), robot.frame_id(TOOL)

    def potential(q: np.ndarray) -> float:
        pin.framesForwardKinematics(model, data, q)
        weights = payload * data.oMf[tool].translation
        for i in range(7):
            Y = model.inertias[i + 1]
            weights = weights + Y.mass * (1 + growth[i]) * data.oMi[i + 1].act(Y.lever + shift[i])
        return -1.1 * float(model.gravity.linear @ weights)

    q, h = robot.home + 0.1, 1e-4
    answer = [(potential(q + h * e) - potential(q - h * e)) / (2 * h) for e in np.eye(7)]
    assert gravity(true, q) == pytest.approx(answer, abs=1e-5)
    assert np.abs(gravity(true, q) - gravity(robot, q)).max() > 3  # Nm


@pytest.mark.parametrize("kind", ["rigid", "compliant", "mujoco"])
def test_plants_move_as_the_true_model_says(kind: str, world: World) -> None:
    robot, error, dt = world.robot, ERRORS["all"], 1e-6
    plant = make_plant(kind, world, model_error=error, dt=dt)
    plant.reset(robot.home)
    true = error.perturbed(robot.model, TOOL)
    terms = oracles.frame_terms(true, robot.home, np.zeros(7), TOOL)
    tau = gravity(robot) + np.array([3.0, -2, 1, 1, 0.5, 0.5, 0.1])
    AJ = terms.J[[2, 3, 4] if kind == "rigid" else []]
    kkt = np.block([[terms.M, AJ.T], [AJ, np.zeros((len(AJ), len(AJ)))]])
    answer = np.linalg.solve(kkt, np.r_[tau - terms.h, np.zeros(len(AJ))])[:7]
    found = plant.advance(tau)[1] / dt
    assert found == pytest.approx(answer, rel=1e-5, abs=1e-6 * np.abs(answer).max())


def test_the_sensor_knows_its_tool_and_payload(world: World) -> None:
    plant = MujocoPlant(world, model_error=ERRORS["all"])
    worst, state = 0.0, plant.reset(world.robot.home)
    for tick in range(100):
        shake = np.sin(0.05 * tick + np.arange(7)) * np.array([9, 9, 9, 9, 2, 2, 2])
        state = plant.step(plant._data.qfrc_bias + shake)
        worst = max(worst, np.abs(state.wrench_meas).max())
    assert np.abs(state.v).max() > 0.05
    assert worst < 1e-9
    raw = np.linalg.norm(plant._data.sensor("qpctrl/force").data)
    assert raw > 0.9 * 9  # N: the payload hangs on it


# Contact


def pressed_ratio(alpha: float, mu: float, sigma: int) -> float:
    """Return λ/f_d of a point that slides on a plane tilted by ``alpha`` [rad], feed-forward."""
    robot, f_d, speed = one_mass(), 10.0, 0.5
    n = np.array([[math.cos(alpha), -math.sin(alpha)]])  # moving along +y it presses deeper
    plant = RigidPlant(robot, Pfaffian(space=SPACE, A=n, name="true"), friction=mu, dt=DT)
    force = ForceTask(space=SPACE, ramp=UNBOUNDED)
    motion = MotionTask(space=SPACE, K_p=2500.0, K_d=100.0)
    mode = Mode(name="slide", tasks=(Weighted(motion), Weighted(force)), constraints=(WALL,))
    controller = Controller(robot, (mode,), dt=DT)
    state, memory = plant.reset(robot.home), controller.start("slide", robot.home)
    for _ in range(500):
        y = sigma * speed * state.time
        V = np.array([0.0, sigma * speed, 0, 0, 0, 0])
        still = pin.SE3(np.eye(3), np.array([0.0, y, 0.0]))
        references = {
            "motion": MotionReference(X_WD=still, V_des=V),
            "force": ForceReference(F_ref=f_d * np.eye(2)[0], F_meas=state.wrench_meas[:2]),
        }
        seen = Measurement(state.time, state.q, state.v)
        command, _, memory = controller.step("slide", seen, references, memory)
        state = plant.step(robot.B @ command.tau)
    assert state.v[1] == pytest.approx(sigma * speed, rel=1e-6)
    normal = float(n[0] @ state.wrench[:2])
    along = float(np.array([math.sin(alpha), math.cos(alpha)]) @ state.wrench[:2])
    assert along == pytest.approx(sigma * mu * normal, abs=1e-9)  # it drags the plane along
    return normal / f_d


@pytest.mark.parametrize("sigma", [1, -1])
@pytest.mark.parametrize(("alpha", "mu"), [(10.0, 0.3), (-6.0, 0.3), (4.0, 0.0), (20.0, 0.8)])
def test_a_wrong_normal_with_friction_presses_as_the_closed_form_says(
    alpha: float, mu: float, sigma: int
) -> None:
    """λ/f_d = 1/(cos α + σ μ sin α): with α > 0 and σ = 1 the point slides into the tilt."""
    a = math.radians(alpha)
    answer = 1 / (math.cos(a) + sigma * mu * math.sin(a))
    assert pressed_ratio(a, mu, sigma) == pytest.approx(answer, rel=1e-6)


def test_a_point_of_an_arm_rubs_with_its_normal_force(world: World) -> None:
    robot = world.robot
    X_WE = robot.pose(robot.home, TOOL)
    plane = PointOnPlane(space=TaskSpace(TOOL), X_WE=X_WE)
    plant = RigidPlant(robot, plane, friction=0.4)
    plant.reset(robot.home)
    terms = oracles.frame_terms(robot.model, robot.home, np.zeros(7), TOOL)
    push = terms.J.T @ np.array([8.0, 3, 20, 0, 0, 0])
    for _ in range(200):
        before, state = plant.read(), plant.step(gravity(robot) + push)
    R_WF = robot.pose(before.q, TOOL).rotation
    V = oracles.frame_terms(robot.model, before.q, before.v, TOOL)
    v_E = X_WE.rotation.T @ R_WF @ (V.J @ before.v)[:3]
    F_E = X_WE.rotation.T @ R_WF @ state.wrench[:3]
    assert np.linalg.norm(v_E[:2]) > 0.05
    assert F_E[2] > 5
    assert F_E[:2] == pytest.approx(0.4 * F_E[2] * v_E[:2] / np.linalg.norm(v_E[:2]), abs=1e-9)
    # M a + h + Jᵀ F = τ
    a = (state.v - before.v) / 1e-3
    left = V.M @ a + V.h + V.J[:3].T @ state.wrench[:3]
    assert left == pytest.approx(gravity(robot) + push, abs=0.05)


def test_a_point_that_is_pulled_does_not_rub() -> None:
    robot = one_mass()
    plant = RigidPlant(robot, WALL, friction=0.5)
    plant.reset(robot.home)
    state = [plant.step(np.array([-10.0, 4.0])) for _ in range(500)][-1]
    assert state.wrench[0] == pytest.approx(-10.0)
    assert state.wrench[1] == 0.0
    assert state.v[1] == pytest.approx(4.0 / 5.0 * 0.5)


def test_friction_on_anything_but_a_point_is_refused(world: World) -> None:
    with pytest.raises(InputError, match=r"friction: got 0.3 with constraint .* of 3 rows"):
        make_plant("rigid", world, friction=0.3)
    turning = Pfaffian(space=TaskSpace(TOOL, ("vz", "wx")), A=np.array([[1.0, 0.1]]))
    with pytest.raises(InputError, match="one row that is a translation"):
        RigidPlant(world.robot, turning, friction=0.3)


# Board


TILT = pin.SE3(pin.utils.rotate("x", 0.1), np.array([0.0, 0.01, 0.004]))


def press(plant: MujocoPlant, world: World, ticks: int = 1500, push: float = 12.0):
    """Return the state after pressing along the believed normal, damped, from home."""
    robot, state = world.robot, plant.reset(world.robot.home)
    data, frame = robot.model.createData(), robot.frame_id(TOOL)
    R = world.X_WE.rotation
    for _ in range(ticks):
        R_WF = robot.pose(state.q, TOOL).rotation
        J = pin.computeFrameJacobian(robot.model, data, state.q, frame)
        turn = R_WF.T @ R @ pin.log3(R.T @ R_WF)
        side = (
            R_WF.T
            @ R
            @ np.diag([1.0, 1, 0])
            @ world.X_WE.actInv(robot.pose(state.q, TOOL)).translation
        )
        F = np.r_[R_WF.T @ R[:, 2] * push - 2000 * side, -40 * turn]
        tau = gravity(robot, state.q) + J.T @ (F - np.diag([80.0] * 3 + [4.0] * 3) @ J @ state.v)
        state = plant.step(tau - 1.0 * state.v)
    return state


@pytest.fixture(scope="module")
def ball() -> World:
    return build_world("fr3", pad=Pad(friction=0.0), tip="ball", radius=0.008)


def test_a_board_can_be_wrong_from_the_start_or_be_moved_later(ball: World) -> None:
    wrong = build_world("fr3", pad=Pad(friction=0.0), tip="ball", radius=0.008, board_error=TILT)
    assert wrong.X_WE == ball.X_WE
    assert wrong.X_WE_true.isApprox(ball.X_WE * TILT)
    assert ball.X_WE_true == ball.X_WE
    later = MujocoPlant(ball, board=ball.X_WE * TILT)
    built, moved = (press(plant, ball) for plant in (MujocoPlant(wrong), later))
    assert np.array_equal(built.q, moved.q)
    assert built.touching
    R_WF = ball.robot.pose(built.q, TOOL).rotation
    force_E = (ball.X_WE * TILT).rotation.T @ R_WF @ built.wrench[:3]
    assert np.abs(force_E[:2]).max() < 0.05  # a smooth board pushes along its true normal
    assert force_E[2] == pytest.approx(12 / math.cos(0.1), rel=0.02)  # holding still
    straight = press(MujocoPlant(ball), ball)
    assert np.abs(straight.q - built.q).max() > 1e-3


def test_the_ball_touches_at_the_tool_point(ball: World, world: World) -> None:
    plants = {"ball": MujocoPlant(ball), "pad": MujocoPlant(world)}
    states = {name: press(plant, ball) for name, plant in plants.items()}
    assert plants["ball"]._data.ncon == 1
    assert plants["pad"]._data.ncon > 1
    tool = ball.robot.pose(states["ball"].q, TOOL).translation
    contact, inward = plants["ball"]._data.contact, ball.X_WE.rotation[:, 2]
    # it lies half-way between ball and board, which overlap by −dist
    assert contact.pos[0] - contact.dist[0] / 2 * inward == pytest.approx(tool, abs=2e-5)
    assert contact.dist[0] < -1e-4
    assert states["ball"].wrench[2] == pytest.approx(12.0, rel=0.02)
    assert np.array_equal(ball.model.body_inertia, world.model.body_inertia)


def test_the_pad_of_a_built_world_can_be_exchanged(world: World) -> None:
    pad = Pad(friction=0.6, solref=(0.02, 0.9), solimp=(0.1, 0.9, 0.003))
    plant, built = MujocoPlant(world, pad=pad), build_world("fr3", pad=pad)
    for name in ("pair_friction", "pair_solref", "pair_solimp"):
        assert np.array_equal(getattr(plant._model, name), getattr(built.model, name))
        assert not np.array_equal(getattr(plant._model, name), getattr(world.model, name))
    assert built.pad == pad


# Spring wall

WALL_X = pin.SE3(pin.utils.rotate("y", math.pi / 2), np.array([0.01, 0.0, 0.0]))  # z along x


@pytest.mark.parametrize("dt", [1e-3, 1e-4])
def test_a_spring_wall_carries_the_push_at_its_depth_and_never_pulls(dt: float) -> None:
    wall = SpringWall(WALL_X, stiffness=5000.0, damping=200.0)
    plant = CompliantPlant(slider(2.0), "tool", wall, dt=dt)
    states = [plant.reset(np.zeros(1))]
    states += [plant.step(np.array([10.0])) for _ in range(round(0.6 / dt))]
    assert states[-1].wrench[0] == pytest.approx(10.0, rel=1e-4)
    assert states[-1].q[0] - 0.01 == pytest.approx(10.0 / 5000, rel=1e-4)
    states += [plant.step(np.array([-10.0])) for _ in range(round(0.1 / dt))]
    assert min(state.wrench[0] for state in states) == 0.0
    assert not states[0].touching
    assert not states[-1].touching
    assert states[-1].q[0] < 0


def test_a_spring_wall_rubs_along_it() -> None:
    robot, mu = one_mass(), 0.4
    turned = pin.SE3(WALL_X.rotation, np.zeros(3))
    plant = CompliantPlant(robot, "tool", SpringWall(turned, 2000.0, 300.0, mu))
    plant.reset(robot.home)
    state = [plant.step(np.array([20.0, 12.0])) for _ in range(1000)][-1]
    assert state.wrench[:3] == pytest.approx([20.0, mu * 20.0, 0.0], rel=1e-4)
    assert state.v[1] == pytest.approx((12.0 - mu * 20.0) / 5.0, rel=0.05)
    slow = [plant.step(np.array([20.0, 0.0])) for _ in range(1500)][-1]
    assert abs(slow.v[1]) < 1e-3  # it comes to rest, and stays


def test_a_light_link_flies_free_then_meets_a_stiff_wall_without_growth() -> None:
    """The step is explicit in the air and implicit on the wall: 1 g on 10 kN/m in 0.1 ms."""
    wall = SpringWall(WALL_X, stiffness=1e4, damping=80.0)
    plant = CompliantPlant(slider(1e-3), "tool", wall, dt=1e-4)
    plant.reset(np.zeros(1))
    air = [plant.step(np.array([0.1])) for _ in range(100)][-1]
    assert air.q[0] == pytest.approx(0.1 / 1e-3 * 0.01**2 / 2, rel=1e-6)
    states = [plant.step(np.array([0.1])) for _ in range(1500)]
    assert max(state.q[0] for state in states) < 0.0105
    assert states[-1].wrench[0] == pytest.approx(0.1, rel=1e-3)


def test_a_tilted_wall_reports_no_less_than_its_stiffness() -> None:
    wall = SpringWall(pin.SE3(pin.utils.rotate("x", 0.7), np.zeros(3)), 100.0, 3.0)
    inside = pin.SE3(pin.utils.rotate("y", 0.4), wall._X_EW.inverse().rotation[:, 2] * 0.01)
    F = wall.wrench(0.0, inside, np.zeros(6))
    assert np.linalg.norm(F) == pytest.approx(1.0)
    n = F[:3]
    K, D = wall.impedance()
    assert np.linalg.eigvalsh(np.diag(K[:3]) - 100.0 * np.outer(n, n)).min() > -1e-9
    assert K[:3].sum() < 300.0
    assert pytest.approx(K * 0.03) == D
    wall.wrench(0.0, pin.SE3(np.eye(3), -0.1 * np.ones(3)), np.zeros(6))
    assert not wall.impedance()[0].any()


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: ForceSensor(gain=0.0), "force gain: .*> 0"),
        (lambda: ForceSensor(gain=np.ones(3)), "force gain: got shape"),
        (lambda: ForceSensor(cutoff=-1.0), "force cutoff"),
        (lambda: StateSensor(noise_q=-1.0), "noise_q"),
        (lambda: StateSensor(latency=-1), "latency: got -1"),
        (lambda: TorqueError(delay=-2), "torque delay: got -2"),
        (lambda: TorqueError(bias=math.nan), "torque bias: .*finite"),
        (lambda: DisturbedPlant(free_slider(), TorqueError(gain=np.ones(2)), slider(1.0)), "gain"),
        (lambda: free_slider(joint_friction=-1.0), "joint_friction"),
        (lambda: ModelError(mass=-1.0), "mass error: .*>= -0.99"),
        (lambda: ModelError(com=np.zeros(2)), r"com error: got shape \(2,\)"),
        (lambda: ModelError(payload=-0.1), "payload"),
        (lambda: free_slider(model_error=ModelError(mass=np.zeros(3))), "mass error: got shape"),
        (lambda: build_world("fr3", tip="cone"), "unknown tip 'cone'"),
        (lambda: build_world("fr3", tip="ball", radius=0.0), "radius"),
        (lambda: SpringWall(WALL_X, stiffness=0.0), "wall stiffness"),
        (lambda: SpringWall(WALL_X, 1.0, friction=-1.0), "wall friction"),
        (lambda: RigidPlant(one_mass(), WALL, friction=-0.1), "friction"),
        (lambda: RigidPlant(one_mass(), WALL, slip_speed=0.0), "slip_speed"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(build, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        build()
    assert "\n" not in str(caught.value)
