"""The world of the system `wipe`: the true board, the true arm, its joints and its sensors.

What is wrong is in here; the controller keeps its belief.
"""

import functools
from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector
from qpctrl.robot import Robot
from scenarios.disturbed_plant import DisturbedPlant, TorqueError
from scenarios.force_sensor import ForceSensor, SensedPlant
from scenarios.joint_level import Actuator, JointLevel
from scenarios.model_error import ModelError
from scenarios.plant import Plant, PlantState, SteppedPlant
from scenarios.plant_mujoco import MujocoPlant
from scenarios.scenario import Options
from scenarios.state_sensor import ObservedPlant, StateSensor
from scenarios.study.system import Setting
from scenarios.world import BALL_RADIUS, TOOL, Pad, Tip, World, build_world

STEP = 1e-3
"""Step of the physics [s] under ideal joints, and unit of the control period."""

TIPS: tuple[Tip, ...] = ("ball", "pad")
ACTUATORS: tuple[Actuator, ...] = get_args(Actuator)

PAD_HALF = np.array([0.06, 0.025, 0.0])
"""Half lengths of the pad's face [m]."""

START_STEPS, START_ACCURACY = 50, 1e-12


class Draw(NamedTuple):
    """Random numbers of one rollout: the same whatever the setting, so that settings compare."""

    gain: Vector
    """For each joint, −1 to 1."""
    bias: Vector
    """For each joint, −1 to 1."""
    seeds: tuple[int, int, int]
    """Of the noise of the force sensor, of the state and of the drives."""


class Scene(NamedTuple):
    """Everything of a rollout that is not its controller."""

    level: JointLevel
    """Its robot is the one that the controller believes in."""
    X_WE: pin.SE3
    """Board as the controller believes it to be, z into it."""
    X_WE_true: pin.SE3
    """Board as it is."""
    q_start: Vector
    """Configuration (nq) [rad] in which the tool, held as if the belief were true, just touches."""
    plant: Plant
    observed: ObservedPlant | None
    """The plant, where the controller sees its state with errors."""


class HeldPlant:
    """A plant whose torque is held for some of its steps."""

    def __init__(self, plant: SteppedPlant, steps: int) -> None:
        self._plant, self._steps = plant, steps

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq)."""
        return self._plant.reset(q)

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for all steps."""
        for _ in range(self._steps):
            self._plant.advance(tau)
        return self._plant.read()


def draw(seed: int, joints: int) -> Draw:
    """Return the random numbers of a rollout."""
    rng = np.random.default_rng(seed)
    gain, bias = rng.uniform(-1.0, 1.0, (2, joints))
    force, state, drives = (int(x) for x in rng.integers(2**31, size=3))
    return Draw(gain, bias, (force, state, drives))


def scene(setting: Setting, radius: float, seed: int) -> Scene:
    """Return the world of a rollout.

    Args:
        setting: value of every parameter.
        radius: distance of the start from the origin of the board [m], along its x axis.
        seed: of every random number.
    """
    world = believed_world(TIPS[int(setting["tip"])])
    level = joint_level(int(setting["actuator"]), int(setting["period"]))
    drawn = draw(seed, level.robot.nv)
    level = replace(level, seed=drawn.seeds[2])
    X_WE_true = world.X_WE * board_error(setting)
    plant, observed = _wrapped(_joints(world, level, setting, X_WE_true), level, setting, drawn)
    return Scene(
        level=level,
        X_WE=world.X_WE,
        X_WE_true=X_WE_true,
        q_start=_touching(world, TIPS[int(setting["tip"])], X_WE_true, radius),
        plant=plant,
        observed=observed,
    )


def board_error(setting: Setting) -> pin.SE3:
    """Return the pose of the true board in the believed one: turned, then shifted along its z."""
    R = pin.rpy.rpyToMatrix(*np.radians([setting["tilt_x"], setting["tilt_y"], 0.0]))
    return pin.SE3(R, setting["offset"] * R[:, 2])


@functools.lru_cache(maxsize=4)
def believed_world(tip: Tip) -> World:
    """Return the scene whose board the tool touches at home, flat."""
    return build_world("fr3", tip=tip, clearance=0.0, dt=STEP)


@functools.lru_cache(maxsize=32)
def joint_level(actuator: int, period: int) -> JointLevel:
    """Return the joints of the arm: ideal, or with drives that change what a controller believes.

    Args:
        actuator: number of the design in `ACTUATORS`.
        period: of the controller [`STEP`].
    """
    options = Options(actuator=ACTUATORS[actuator], compiled="no")
    return options.joints(believed_world("pad").robot, period * STEP)


def _joints(world: World, level: JointLevel, setting: Setting, board: pin.SE3) -> Plant:
    """Return the arm in front of its board, moved by ideal joints or drives."""
    ideal = not level.drives
    pad = Pad(friction=setting["friction"], solref=(setting["pad_time"], setting["pad_damping"]))
    error = ModelError(
        mass=setting["mass_error"],
        com=np.array([setting["com_error"], 0.0, 0.0]),
        gravity=setting["gravity_error"],
        payload=setting["payload"],
    )
    exact = not any(setting[key] for key in ("mass_error", "com_error", "gravity_error", "payload"))
    plant = MujocoPlant(
        world,
        board=board,
        pad=pad,
        joint_friction=setting["joint_friction"],
        joint_damping=setting["joint_damping"],
        model_error=None if exact else error,
        armature=level.armature,
        dt=STEP if ideal else level.dt,
    )
    if not ideal:
        return level.drive(plant)
    steps = int(setting["period"])
    return plant if steps == 1 else HeldPlant(plant, steps)


def _wrapped(
    plant: Plant, level: JointLevel, setting: Setting, drawn: Draw
) -> tuple[Plant, ObservedPlant | None]:
    """Return the plant behind the errors of its joints and sensors; what is none costs nothing."""
    torque = TorqueError(
        gain=setting["torque_gain"] * (1 + setting["torque_spread"] * drawn.gain),
        bias=setting["torque_bias"] * drawn.bias,
        delay=int(setting["torque_delay"]),
    )
    if torque.delay or np.any(torque.bias) or np.any(np.asarray(torque.gain) != 1):
        plant = DisturbedPlant(plant, torque, level.robot)
    bias = np.array([0.0, 0.0, setting["sensor_bias"], 0.0, 0.0, 0.0])
    force = ForceSensor(
        gain=setting["sensor_gain"],
        noise=setting["sensor_noise"],
        bias=bias,
        cutoff=setting["sensor_cutoff"],
        delay=int(setting["sensor_delay"]),
    )
    keys = ("sensor_noise", "sensor_bias", "sensor_cutoff", "sensor_delay")
    if setting["sensor_gain"] != 1 or any(setting[key] for key in keys):
        plant = SensedPlant(plant, force, drawn.seeds[0])
    if not any(setting[key] for key in ("noise_q", "noise_v", "latency")):
        return plant, None
    state = StateSensor(
        noise_q=setting["noise_q"], noise_v=setting["noise_v"], latency=int(setting["latency"])
    )
    observed = ObservedPlant(plant, state, drawn.seeds[1])
    return observed, observed


def _touching(world: World, tip: Tip, X_WE_true: pin.SE3, radius: float) -> Vector:
    """Return the configuration (nq) in which the tool, flat on the believed board, just touches."""
    X_error = world.X_WE.actInv(X_WE_true)
    n, o = X_error.rotation[:, 2], X_error.translation
    ahead = BALL_RADIUS * (1 - n[2]) if tip == "ball" else float(PAD_HALF @ np.abs(n))
    p_E = np.array([radius, 0.0, 0.0])
    p_E[2] = (n @ (o - p_E) - ahead) / n[2]
    return solve_pose(world.robot, world.X_WE * pin.SE3(np.eye(3), p_E))


def solve_pose(robot: Robot, X_WT: pin.SE3) -> Vector:
    """Return the configuration (nq) near home in which the tool has the pose ``X_WT``."""
    model, data, fid = robot.model, robot.model.createData(), robot.frame_id(TOOL)
    q: Vector = robot.home.copy()
    for _ in range(START_STEPS):
        pin.framesForwardKinematics(model, data, q)
        X_e = pin.log6(data.oMf[fid].actInv(X_WT)).vector
        if np.abs(X_e).max() < START_ACCURACY:
            break
        J = pin.computeFrameJacobian(model, data, q, fid, pin.ReferenceFrame.LOCAL)
        q = q + np.linalg.lstsq(J, X_e, rcond=None)[0]
    return q
