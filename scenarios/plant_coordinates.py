"""The coordinates of MuJoCo and of pinocchio, and the way from one to the other.

Of a floating body MuJoCo keeps the quaternion as (w, x, y, z) and the velocity as (ṗ along world
axes, ω along body axes); pinocchio has (x, y, z, w) and the body twist. So v = T(q) q̇_mujoco with
T = diag(Rᵀ, 1) there and 1 elsewhere. The two may list joints in different orders.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Int

from qpctrl.arrays import Matrix, Vector
from qpctrl.errors import ModelMismatchError
from qpctrl.robot import Robot

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_TO_PINOCCHIO = np.array([0, 1, 2, 4, 5, 6, 3])  # of (p, w, x, y, z)
_INVERSE = np.array([1.0, -1.0, -1.0, -1.0])  # of a quaternion (w, x, y, z), by its signs

Indices = Int[np.ndarray, " _"]
"""Where one engine keeps what the other lists."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Coordinates:
    """How the coordinates of a compiled model and of its robot belong together.

    Made once by `coordinates`; the methods take and return new arrays, a few µs each. Quaternions
    are of unit length. Names of MuJoCo, ``qpos qvel qacc qfrc``, stand for its coordinates; ``q v
    a`` and forces in the order of ``v`` for those of pinocchio and of the controller.
    """

    q_at: Indices
    """Index in ``qpos`` of each coordinate of ``q`` (nq)."""
    qpos_at: Indices
    """Index in ``q`` of each coordinate of ``qpos`` (nq)."""
    v_at: Indices
    """Index in ``qvel`` of each coordinate of ``v`` (nv)."""
    qvel_at: Indices
    """Index in ``v`` of each coordinate of ``qvel`` (nv)."""
    floating: tuple[tuple[slice, slice, slice], ...]
    """Of each floating body: its quaternion in ``qpos``, its linear and angular part in ``v``."""

    def q_from_mujoco(self, qpos: Vector) -> Vector:
        """Return ``q`` (nq) [m, rad] of ``qpos`` (nq)."""
        return qpos[self.q_at]

    def v_from_mujoco(self, qpos: Vector, qvel: Vector) -> Vector:
        """Return ``v = T qvel`` (nv) [m/s, rad/s] at ``qpos`` (nq)."""
        return self._turned(qvel[self.v_at], qpos, _INVERSE)

    def a_from_mujoco(self, qpos: Vector, qvel: Vector, qacc: Vector) -> Vector:
        """Return ``a = T qacc + Ṫ qvel`` (nv) [m/s², rad/s²]."""
        return self.v_from_mujoco(qpos, qacc) + self.drift(self.v_from_mujoco(qpos, qvel))

    def qpos_from_pinocchio(self, q: Vector) -> Vector:
        """Return ``qpos`` (nq) of ``q`` (nq) [m, rad]."""
        return q[self.qpos_at]

    def qvel_from_pinocchio(self, q: Vector, v: Vector) -> Vector:
        """Return ``qvel = T⁻¹ v`` (nv) of ``v`` (nv) [m/s, rad/s] at ``q`` (nq)."""
        return self._turned(v, q[self.qpos_at], 1.0)[self.qvel_at]

    def qfrc_from_pinocchio(self, q: Vector, force: Vector) -> Vector:
        """Return generalised forces of MuJoCo ``Tᵀ force`` (nv); ``force`` (nv) is ``B tau``."""
        return self.qvel_from_pinocchio(q, force)  # Tᵀ is T⁻¹

    def force_from_mujoco(self, qpos: Vector, qfrc: Vector) -> Vector:
        """Return generalised forces in the coordinates of ``v`` ``T⁻ᵀ qfrc`` (nv) [N, Nm]."""
        return self.v_from_mujoco(qpos, qfrc)

    def T(self, q: Vector) -> Matrix:
        """Return T (nv×nv) in ``v = T qvel``: rotations, and the order of the joints."""
        return np.array([self.qfrc_from_pinocchio(q, row) for row in np.eye(len(self.v_at))])

    def drift(self, v: Vector) -> Vector:
        """Return ``Ṫ qvel`` (nv): ``−ω × v`` of each floating body [m/s²], else zero."""
        found = np.zeros(len(v))
        for _, linear, angular in self.floating:
            (x, y, z), (wx, wy, wz) = v[linear].tolist(), v[angular].tolist()
            found[linear] = y * wz - z * wy, z * wx - x * wz, x * wy - y * wx
        return found

    def _turned(self, v: Vector, qpos: Vector, sign: Vector | float) -> Vector:
        turned = v.copy()
        for quaternion, linear, _ in self.floating:
            mujoco.mju_rotVecQuat(turned[linear], v[linear], qpos[quaternion] * sign)
        return turned


def coordinates(model: mujoco.MjModel, robot: Robot) -> Coordinates:
    """Return how the coordinates of ``model`` and ``robot`` belong together, joint by joint.

    Raises:
        ModelMismatchError: they have different joints.
    """
    names = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
    joints = {
        str(name): joint for name, joint in zip(robot.model.names, robot.model.joints, strict=True)
    }
    ours = {
        name: 6 if kind == _FREE else 1 for name, kind in zip(names, model.jnt_type, strict=True)
    }
    theirs = {name: int(joint.nv) for name, joint in list(joints.items())[1:]}
    if ours != theirs:
        raise ModelMismatchError(
            f"robot {robot.name!r}: MuJoCo has joints {_listed(ours)}, pinocchio {_listed(theirs)}"
        )
    q_at, v_at = np.empty(robot.nq, dtype=np.int64), np.empty(robot.nv, dtype=np.int64)
    floating = []
    for j, name in enumerate(names):
        q, v = joints[name].idx_q, joints[name].idx_v
        qpos, qvel = model.jnt_qposadr[j], model.jnt_dofadr[j]
        if model.jnt_type[j] == _FREE:
            q_at[q : q + 7], v_at[v : v + 6] = qpos + _TO_PINOCCHIO, qvel + np.arange(6)
            floating.append((slice(qpos + 3, qpos + 7), slice(v, v + 3), slice(v + 3, v + 6)))
        else:
            q_at[q], v_at[v] = qpos, qvel
    return Coordinates(
        q_at=q_at,
        qpos_at=np.argsort(q_at),
        v_at=v_at,
        qvel_at=np.argsort(v_at),
        floating=tuple(floating),
    )


def _listed(velocities: dict[str, int]) -> str:
    return ", ".join(f"{name} (floating)" if n == 6 else name for name, n in velocities.items())
