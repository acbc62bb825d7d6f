"""How the true robot differs from the one that a controller believes in.

A link is all that one joint moves and no later joint does, its tool included. Both engines get
the same changes: pinocchio keeps one inertia for a link, MuJoCo one for each of its bodies.
"""

from dataclasses import dataclass, field
from typing import final

import mujoco
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Matrix, Vector, finite_array, non_negative
from qpctrl.errors import InputError
from qpctrl.robot import Robot


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ModelError:
    """Errors of a robot's model: what is true, compared with what is believed.

    A sensor of force knows its tool and the payload as they are: it reads the contact alone.
    """

    mass: Vector | float = 0.0
    """Relative error [1] of a link's mass, its moments of inertia growing with it; of each link
    (nv), in the order of the joints, or one of all."""
    com: Vector | Matrix = field(default_factory=lambda: np.zeros(3))
    """Shift of a link's centre of mass [m], along the axes of its joint's frame, which turn with
    it; of each link (nv×3), or one of all (3)."""
    gravity: float = 0.0
    """Relative error of the size of gravity [1]."""
    armature: Vector | float = 0.0
    """Relative error of the rotors' inertia [1]; of each joint (nv), or one of all."""
    payload: float = 0.0
    """Point mass [kg] at the tool."""

    def __post_init__(self) -> None:
        for name, least in (("mass", -0.99), ("gravity", -np.inf), ("armature", -1.0)):
            value = getattr(self, name)
            array = finite_array(value, np.shape(value), f"{name} error")
            if (array < least).any():
                got = array.tolist()
                raise InputError(f"{name} error: got {got}, need values >= {least:g}")
        shape = np.shape(self.com)
        if len(shape) not in (1, 2) or shape[-1] != 3:
            raise InputError(f"com error: got shape {shape}, need (3,) or (nv, 3)")
        object.__setattr__(self, "com", finite_array(self.com, shape, "com error"))
        non_negative(self.payload, (), "payload")

    def perturbed(self, model: pin.Model, frame: str) -> pin.Model:
        """Return the true model, a copy.

        Args:
            model: what the controller believes, or that with the true rotors.
            frame: where a payload hangs.

        Raises:
            InputError: errors of another number of links, or no such frame.
        """
        true, nv = model.copy(), int(model.nv)
        growth, shift = 1 + self._of_links("mass", nv), self._shifts(nv)
        for link in range(nv):
            Y = true.inertias[link + 1]
            s, lever = float(growth[link]), Y.lever + shift[link]
            true.inertias[link + 1] = pin.Inertia(s * Y.mass, lever, s * Y.inertia)
        true.gravity.linear = (1 + self.gravity) * model.gravity.linear
        true.armature = (1 + self._of_links("armature", nv)) * model.armature
        if self.payload > 0:
            if not model.existFrame(frame):
                raise InputError(f"payload: robot {model.name!r} has no frame {frame!r}")
            held = model.frames[model.getFrameId(frame)]
            true.appendBodyToJoint(held.parentJoint, _point(self.payload), held.placement)
        return true

    def perturb_mujoco(self, model: mujoco.MjModel, frame: str) -> None:
        """Change the ``model`` of a plant of its own likewise.

        Args:
            model: as compiled, maybe with the true rotors.
            frame: site or body where a payload hangs.

        Raises:
            InputError: errors of another number of links, or no such frame.
        """
        nv = int(model.nv)
        growth, shift = 1 + self._of_links("mass", nv), self._shifts(nv)
        for body, (link, R_LB) in _links(model).items():
            model.body_mass[body] *= growth[link]
            model.body_inertia[body] *= growth[link]
            model.body_ipos[body] += R_LB.T @ shift[link]
        model.opt.gravity[:] *= 1 + self.gravity
        model.dof_armature[:] *= 1 + self._of_links("armature", nv)
        if self.payload > 0:
            body, X_BF = _place(model, frame)
            _add(model, body, X_BF.act(_point(self.payload)))
        for flag in ("body_sameframe", "geom_sameframe", "site_sameframe", "body_simple"):
            getattr(model, flag)[:] = 0  # shortcuts for inertias that are where their body is
        model.dof_simplenum[:] = 0
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def _of_links(self, name: str, nv: int) -> Array:
        return finite_array(getattr(self, name), (nv,), f"{name} error")

    def _shifts(self, nv: int) -> Matrix:
        each = np.ndim(self.com) == 2
        return finite_array(self.com if each else np.tile(self.com, (nv, 1)), (nv, 3), "com error")


def true_model(
    robot: Robot, frame: str, error: ModelError | None, armature: Vector | None
) -> pin.Model:
    """Return the model of the true robot, a copy.

    Args:
        robot: the robot as the controller believes it to be.
        frame: where a payload hangs.
        error: how it differs; none: not at all.
        armature: the true inertia of the rotors at their joints (nv) [kg m² or kg], before
            ``error``; default: the robot's.

    Raises:
        InputError: no such frame, or a number that cannot be used.
    """
    model = robot.model.copy()
    if armature is not None:
        model.armature = non_negative(armature, (robot.nv,), "armature")
    return model if error is None else error.perturbed(model, frame)


def _point(mass: float) -> pin.Inertia:
    return pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))


def _links(model: mujoco.MjModel) -> dict[int, tuple[int, Matrix]]:
    """Return for each body that moves its link, counted from 0, and its orientation R_LB there."""
    found: dict[int, tuple[int, Matrix]] = {}
    for body in range(1, model.nbody):
        joints, parent = int(model.body_jntnum[body]), int(model.body_parentid[body])
        if joints:
            last = int(model.body_jntadr[body]) + joints - 1
            found[body] = int(model.jnt_dofadr[last]), np.eye(3)
        elif parent in found:
            link, R_LP = found[parent]
            found[body] = link, R_LP @ _rotation(model.body_quat[body])
    return found


def _place(model: mujoco.MjModel, frame: str) -> tuple[int, pin.SE3]:
    """Return the body that has ``frame``, a site or body, and the pose of the frame in it."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, frame)
    if site >= 0:
        R_BF = _rotation(model.site_quat[site])
        return int(model.site_bodyid[site]), pin.SE3(R_BF, model.site_pos[site].copy())
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, frame)
    if body < 0:
        raise InputError(f"payload: the scene has no site or body {frame!r}")
    return body, pin.SE3.Identity()


def _rotation(quaternion: Vector) -> Matrix:
    w, x, y, z = (float(part) for part in quaternion)
    return pin.Quaternion(w, x, y, z).normalized().toRotationMatrix()


def _add(model: mujoco.MjModel, body: int, load: pin.Inertia) -> None:
    """Add ``load``, in the frame of ``body``, to its inertia."""
    R_BI = _rotation(model.body_iquat[body])
    about_com = R_BI @ np.diag(model.body_inertia[body]) @ R_BI.T
    own = pin.Inertia(float(model.body_mass[body]), model.body_ipos[body].copy(), about_com)
    whole = own + load
    moments, R_BI = np.linalg.eigh(whole.inertia)
    R_BI[:, 0] *= np.sign(np.linalg.det(R_BI))
    x, y, z, w = pin.Quaternion(R_BI).coeffs()
    model.body_mass[body], model.body_ipos[body] = whole.mass, whole.lever
    model.body_inertia[body], model.body_iquat[body] = moments, (w, x, y, z)
