"""The MuJoCo plant of a whole body: contacts that are told one by one, bodies that float."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from qpctrl.arrays import Vector, Wrench
from qpctrl.errors import InputError
from qpctrl.robot import Robot
from scenarios.plant import PlantState
from scenarios.plant_coordinates import coordinates
from scenarios.plant_model import frame_pose


@dataclass(frozen=True, kw_only=True)
class Touch:
    """A contact that is measured: what one body does to what it touches."""

    name: str
    frame: str
    """Site or body in whose axes, and about whose origin, the wrench is given."""
    body: str
    """Body that touches; those welded to it count as well."""
    others: tuple[str, ...] = ()
    """Bodies that it touches; default: any."""


class BodiesPlant:
    """A robot among bodies, driven by joint torques; what moves in it is the plant's own."""

    def __init__(
        self, model: mujoco.MjModel, robot: Robot, touches: Sequence[Touch], *, main: str
    ) -> None:
        """Prepare the plant.

        Args:
            model: the scene; its timestep is the period.
            robot: its coordinates; the model's own robot.
            touches: the contacts whose wrenches every state tells, in this order.
            main: name of the one whose wrench is the measured one.

        Raises:
            InputError: no such body, frame or contact.
        """
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # or time runs backwards
        self.model, self.data = model, mujoco.MjData(model)
        self._coordinates = coordinates(model, robot)
        self._touches = tuple(touches)
        names = [touch.name for touch in touches]
        if main not in names:
            raise InputError(f"contact: got {main!r}, allowed: {', '.join(names)}")
        self._main = names.index(main)
        self._own = self._marked([touch.body] for touch in touches)
        self._others = self._marked(touch.others for touch in touches)
        self._others[[not touch.others for touch in touches]] = True

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq)."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self._coordinates.qpos_from_pinocchio(q)
        mujoco.mj_forward(self.model, self.data)
        return self.read()

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv), B times the torques [Nm], acted for one period."""
        self.data.qfrc_applied[:] = self._coordinates.qfrc_from_pinocchio(self._q, tau)
        mujoco.mj_step(self.model, self.data)
        return self.read()

    def read(self) -> PlantState:
        """Return what the sensors say; wrenches are those of the start of the period."""
        data = self.data
        self._q = q = self._coordinates.q_from_mujoco(data.qpos)
        v = self._coordinates.v_from_mujoco(data.qpos, data.qvel)
        contacts = self._wrenches()
        main = contacts[self._main]
        return PlantState(data.time, q, v, main, main, touching=bool(main.any()), contacts=contacts)

    def push(self, body: str, F_W: Wrench) -> None:
        """Apply a wrench (6) [N, Nm], world axes, at the centre of mass of a body from now on."""
        self.data.xfrc_applied[self._body(body)] = F_W

    def _wrenches(self) -> tuple[Wrench, ...]:
        """Return the wrench of each body on what it touches, in the axes of its frame."""
        model, data, count = self.model, self.data, self.data.ncon
        if not count:
            return tuple(np.zeros(6) for _ in self._touches)
        found = np.empty((count, 6))
        for k in range(count):
            mujoco.mj_contactForce(model, data, k, found[k])
        axes = data.contact.frame.reshape(count, 3, 3)  # x from the first geom to the second
        force = np.einsum("kij,ki->kj", axes, found[:, :3])
        moment = np.einsum("kij,ki->kj", axes, found[:, 3:]) + _cross(data.contact.pos, force)
        one, other = model.geom_bodyid[data.contact.geom].T
        sign = np.where(self._own[:, one] & self._others[:, other], 1.0, 0.0)
        sign -= np.where(self._own[:, other] & self._others[:, one], 1.0, 0.0)
        wrenches = []
        for touch, total, turning in zip(self._touches, sign @ force, sign @ moment, strict=True):
            X_WF = frame_pose(model, data, touch.frame)
            R_FW = X_WF.rotation.T
            about = turning - _cross(X_WF.translation, total)
            wrenches.append(np.concatenate((R_FW @ total, R_FW @ about)))
        return tuple(wrenches)

    def _marked(self, names: Iterable[Iterable[str]]) -> np.ndarray:
        """Return which bodies (touches×bodies) are some, or cannot move against them."""
        return np.array(
            [
                np.isin(range(self.model.nbody), [b for name in own for b in self._welded(name)])
                for own in names
            ]
        )

    def _body(self, name: str) -> int:
        index = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
        if index < 0:
            raise InputError(f"body: the model has none named {name!r}")
        return int(index)

    def _welded(self, name: str) -> set[int]:
        """Return the numbers of a body and of those that cannot move against it."""
        weld = self.model.body_weldid
        own = weld[self._body(name)]
        return {body for body in range(self.model.nbody) if weld[body] == own}


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a × b along the last axis; numpy's own takes ten times as long for so few."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    u, v, w = b[..., 0], b[..., 1], b[..., 2]
    return np.stack((y * w - z * v, z * u - x * w, x * v - y * u), axis=-1)
