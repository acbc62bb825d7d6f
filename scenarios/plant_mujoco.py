"""The MuJoCo plant: real contact of pad and board, force sensed by the simulator's sensor."""

from copy import copy

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector, Wrench, non_negative, positive
from scenarios.plant import PlantState
from scenarios.plant_model import frame_pose
from scenarios.sensor import ToolReading, WrenchSensor
from scenarios.world import SENSOR, TOOL, World


class MujocoPlant:
    """The scene of a world, driven by joint torques; what moves in it is the plant's own."""

    def __init__(
        self,
        world: World,
        *,
        frame: str = TOOL,
        force_noise: float = 0.0,
        seed: int = 0,
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
            armature: the true inertia of the rotors at their joints (nv) [kg m² or kg]; default:
                the world's. Zero where the motor is simulated apart, behind an elastic gear.
            dt: period [s]; default: the world's.

        Raises:
            InputError: no such frame, or a number that cannot be used.
        """
        world.robot.frame_id(frame)
        self._model = copy(world.model)
        if dt is not None:
            self._model.opt.timestep = float(positive(dt, (), "dt"))
        self._data = mujoco.MjData(self._model)
        if armature is not None:
            self._model.dof_armature[:] = non_negative(armature, (world.robot.nv,), "armature")
            mujoco.mj_setConst(self._model, self._data)  # contacts are as stiff as inertia says
        self._sensor = WrenchSensor(*_tool(self._model, frame))
        self._site = self._model.site(SENSOR).id
        self._channels = {
            name: self._data.sensor(f"qpctrl/{name}").data
            for name in ("force", "torque", "accelerometer", "gyro", "angular acceleration")
        }
        self._tau, self._q, self._v = self._data.qfrc_applied, self._data.qpos, self._data.qvel
        self._noise = force_noise * np.array([1, 1, 1, 0.1, 0.1, 0.1])
        self._rng = np.random.default_rng(seed)

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq), held against gravity."""
        mujoco.mj_resetData(self._model, self._data)
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
        data, read = self._data, self._channels
        R_WS = data.site_xmat[self._site].reshape(3, 3)
        wrench = self._sensor.wrench_on_env(
            ToolReading(
                force=read["force"],
                moment=read["torque"],
                acceleration=read["accelerometer"],
                angular_velocity=read["gyro"],
                angular_acceleration=R_WS.T @ read["angular acceleration"],
            )
        )
        measured = wrench
        if self._noise[0] > 0:
            measured = wrench + self._noise * self._rng.normal(size=6)
        return PlantState(
            time=float(data.time),
            q=data.qpos.copy(),
            v=data.qvel.copy(),
            wrench_meas=measured,
            wrench=wrench,
            touching=bool(data.ncon > 0),
        )

    def push_tool(self, F_W: Wrench) -> None:
        """Apply a wrench (6) [N, Nm], world axes, to the eraser at the tool point from now on."""
        point, body = self._data.site(TOOL).xpos, self._model.body("eraser/eraser").id
        arm = point - self._data.xipos[body]
        self._data.xfrc_applied[body] = np.r_[F_W[:3], F_W[3:] + np.cross(arm, F_W[:3])]

    def move_board(self, way_W: Vector) -> None:
        """Move the board by ``way_W`` (3) [m], world axes, from one period to the next."""
        self._model.body("qpctrl/board").pos[:] += way_W


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
