"""The MuJoCo plant of a whole body: contacts that are told one by one, bodies that float."""

from collections.abc import Sequence
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
        self.model, self.data = model, mujoco.MjData(model)
        self._coordinates = coordinates(model, robot)
        self._touches = tuple(touches)
        names = [touch.name for touch in touches]
        if main not in names:
            raise InputError(f"contact: got {main!r}, allowed: {', '.join(names)}")
        self._main = names.index(main)
        self._bodies = [self._welded(touch.body) for touch in touches]
        self._others = [
            {body for other in touch.others for body in self._welded(other)} for touch in touches
        ]

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
        contacts = tuple(self._wrench(i) for i in range(len(self._touches)))
        main = contacts[self._main]
        return PlantState(data.time, q, v, main, main, touching=bool(main.any()), contacts=contacts)

    def push(self, body: str, F_W: Wrench) -> None:
        """Apply a wrench (6) [N, Nm], world axes, at the centre of mass of a body from now on."""
        self.data.xfrc_applied[self._body(body)] = F_W

    def _wrench(self, i: int) -> Wrench:
        """Return the wrench of a body on what it touches, in the axes of its frame."""
        touch, own, others = self._touches[i], self._bodies[i], self._others[i]
        X_WF, total, found = (
            frame_pose(self.model, self.data, touch.frame),
            np.zeros(6),
            np.zeros(6),
        )
        body_of = self.model.geom_bodyid
        for k in range(self.data.ncon):
            contact = self.data.contact[k]
            one, other = (int(body_of[geom]) for geom in contact.geom)
            if one in own:
                touched, sign = other, 1.0
            elif other in own:
                touched, sign = one, -1.0
            else:
                continue
            if others and touched not in others:
                continue
            mujoco.mj_contactForce(self.model, self.data, k, found)
            R = contact.frame.reshape(3, 3).T  # its x axis points from the first geom to the second
            force, moment = sign * (R @ found[:3]), sign * (R @ found[3:])
            total[:3] += force
            total[3:] += moment + np.cross(contact.pos - X_WF.translation, force)
        R_FW = X_WF.rotation.T
        return np.concatenate((R_FW @ total[:3], R_FW @ total[3:]))

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
