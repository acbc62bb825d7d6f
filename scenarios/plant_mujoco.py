"""The MuJoCo plant: real contact of pad and board, force sensed by the simulator's sensor."""

from copy import copy

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector, Wrench, non_negative, positive
from scenarios.force_sensor import WrenchNoise
from scenarios.model_error import ModelError
from scenarios.plant import PlantState
from scenarios.plant_model import frame_pose
from scenarios.sensor import ToolReading, WrenchSensor
from scenarios.world import SENSOR, TOOL, Pad, World, place_board, set_pad

STIFFEST = 0.9999
"""Impedance [1] of a joint's dry friction: a stuck joint creeps by what it lacks to 1, times the
speed that it would gain in a period. MuJoCo takes no more."""


class MujocoPlant:
    """The scene of a world, driven by joint torques; what moves in it is the plant's own."""

    def __init__(
        self,
        world: World,
        *,
        frame: str = TOOL,
        force_noise: float = 0.0,
        seed: int = 0,
        board: pin.SE3 | None = None,
        pad: Pad | None = None,
        joint_friction: Vector | float = 0.0,
        joint_damping: Vector | float = 0.0,
        model_error: ModelError | None = None,
        armature: Vector | None = None,
        dt: float | None = None,
    ) -> None:
        """Prepare the plant.

        Args:
            world: the scene.
            frame: frame of the eraser at which the wrench is given, along its axes.
            force_noise: standard deviation of each measured force [N]; moments get a tenth
                of the number [Nm].
            seed: seed of that noise.
            board: X_WE of the true board; default: the world's ``X_WE_true``. Worlds take long to
                build; one of them serves for many boards.
            pad: contact of pad and board; default: the world's. ``replace(world.pad, friction=μ)``
                changes its friction alone.
            joint_friction: Coulomb friction of the joints (nv) [Nm or N], which holds them while
                it can; of each joint, or one of all.
            joint_damping: their viscous friction (nv) [Nm s/rad or N s/m], the same.
            model_error: how the true robot differs from the believed one; a payload hangs at
                ``frame``.
            armature: the true inertia of the rotors at their joints (nv) [kg m² or kg]; default:
                the world's. Zero where the motor is simulated apart, behind an elastic gear.
            dt: period [s]; default: the world's.

        Raises:
            InputError: no such frame, or a number that cannot be used.
        """
        world.robot.frame_id(frame)
        self._model, nv = _scene(world, board, pad, dt), world.robot.nv
        _rub(self._model, joint_friction, joint_damping)
        self._data = mujoco.MjData(self._model)
        if armature is not None:
            self._model.dof_armature[:] = non_negative(armature, (nv,), "armature")
            mujoco.mj_setConst(self._model, self._data)  # contacts are as stiff as inertia says
        if model_error is not None:
            model_error.perturb_mujoco(self._model, frame)
        self._sensor = WrenchSensor(*_tool(self._model, frame), _reading(self._data))
        self._tau, self._q, self._v = self._data.qfrc_applied, self._data.qpos, self._data.qvel
        self._noise, self._noisy = WrenchNoise(force_noise, seed), bool(force_noise > 0)

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq), held against gravity."""
        mujoco.mj_resetData(self._model, self._data)
        self._noise.restart()
        self._q[:] = q
        mujoco.mj_forward(self._model, self._data)
        self._tau[:] = self._data.qfrc_bias
        mujoco.mj_forward(self._model, self._data)
        return self.read()

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period."""
        self.advance(tau)
        return self.read()

    def advance(self, tau: Vector) -> tuple[Vector, Vector]:
        """Return views of q (nq) and v (nv) after ``tau`` (nv) [Nm] has acted for one period."""
        self._tau[:] = tau
        mujoco.mj_step(self._model, self._data)
        return self._q, self._v

    def read(self) -> PlantState:
        """Return what the sensors say, with new noise; wrench as of the start of the period."""
        data, wrench = self._data, self._sensor.wrench_on_env()
        measured = wrench + self._noise.draw() if self._noisy else wrench
        q, v = self._q.copy(), self._v.copy()
        return PlantState(data.time, q, v, measured, wrench, touching=data.ncon > 0)

    def push_tool(self, F_W: Wrench) -> None:
        """Apply a wrench (6) [N, Nm], world axes, to the eraser at the tool point from now on."""
        point, body = self._data.site(TOOL).xpos, self._model.body("eraser/eraser").id
        arm = point - self._data.xipos[body]
        self._data.xfrc_applied[body] = np.r_[F_W[:3], F_W[3:] + np.cross(arm, F_W[:3])]

    def move_board(self, way_W: Vector) -> None:
        """Move the board by ``way_W`` (3) [m], world axes, from one period to the next."""
        self._model.body("qpctrl/board").pos[:] += way_W


def _scene(
    world: World, board: pin.SE3 | None, pad: Pad | None, dt: float | None
) -> mujoco.MjModel:
    """Return the scene with what is given in the place of its own."""
    model = copy(world.model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # or time would run backwards
    if dt is not None:
        model.opt.timestep = float(positive(dt, (), "dt"))
    if board is not None:
        place_board(model, board)
    if pad is not None:
        set_pad(model, pad)
    return model


def _rub(model: mujoco.MjModel, friction: Vector | float, damping: Vector | float) -> None:
    """Give the joints dry friction (nv) [Nm or N] and viscous friction (nv) [Nm s/rad or N s/m].

    A stuck joint shall stop within a period: that is the least time constant, two periods.
    """
    coulomb = non_negative(friction, (model.nv,), "joint_friction")
    viscous = non_negative(damping, (model.nv,), "joint_damping")
    if coulomb.any():
        model.dof_frictionloss[:] = coulomb
        model.dof_solref[:] = 2 * model.opt.timestep, 1.0
        model.dof_solimp[:, :2] = STIFFEST
    if viscous.any():
        model.dof_damping[:] = viscous


def _reading(data: mujoco.MjData) -> ToolReading:
    """Return where the simulator writes what the sensors say."""
    names = ("force", "torque", "accelerometer", "gyro", "angular acceleration")
    channels = [data.sensor(f"qpctrl/{name}").data for name in names]
    return ToolReading._make([*channels, data.site(SENSOR).xmat.reshape(3, 3).T])


def _tool(model: mujoco.MjModel, frame: str) -> tuple[pin.Inertia, pin.SE3]:
    """Return the eraser's inertia in the sensor frame, and the pose of ``frame`` there."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    X_WS = frame_pose(model, data, SENSOR)
    body = model.body("eraser/eraser").id
    R_WI = data.ximat[body].reshape(3, 3)
    about_com = R_WI @ np.diag(model.body_inertia[body]) @ R_WI.T
    in_world = pin.Inertia(float(model.body_mass[body]), data.xipos[body].copy(), about_com)
    return X_WS.actInv(in_world), X_WS.inverse() * frame_pose(model, data, frame)
