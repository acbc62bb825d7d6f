"""The robot as data: a pinocchio model, its limits, its actuation, its named frames."""

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from qpctrl.arrays import Array, Matrix, Vector, finite_array, non_negative, positive
from qpctrl.errors import InputError, unknown_name
from qpctrl.spatial import AXES

DEFAULT_TORQUE_RATE = 1000.0
"""Torque-rate limit [Nm/s] of a robot whose file gives none (Franka FR3's figure)."""


QUATERNION_OFF = 1e-3
"""How far from 1 the norm of a quaternion may be."""

POSE = ("px", "py", "pz", "qx", "qy", "qz", "qw")
"""Place and quaternion of a floating body, as they stand in q."""

NO_LIMIT = 1e9
"""Limits of a file from here on mean none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """What joints and motors can do. ``inf`` means no limit."""

    q_min: Vector
    """Lowest configuration along each velocity (nv) [rad or m]; a floating base has none."""
    q_max: Vector
    """Highest configuration along each velocity (nv) [rad or m]."""
    v_max: Vector
    """Highest speed (nv) [rad/s or m/s]."""
    tau_max: Vector
    """Highest torque (nu) [Nm or N], used with both signs."""
    tau_rate: Vector
    """Highest torque rate (nu) [Nm/s or N/s]."""
    tau_stall: Vector = field(default_factory=lambda: np.empty(0))
    """Torque at rest that the supply voltage can drive (nu) [Nm or N]; default: no limit."""
    tau_droop: Vector = field(default_factory=lambda: np.empty(0))
    """Torque lost to back-EMF per speed (nu) [Nm s/rad or N s/m]; default: 0. It matters only
    where ``tau_stall`` is finite; their ratio is the no-load speed."""

    def __post_init__(self) -> None:
        for name in ("v_max", "tau_max", "tau_rate"):
            value = getattr(self, name)
            _positive_or_inf(value, value.shape, name)
        nu = self.tau_max.shape
        stall = self.tau_stall if np.size(self.tau_stall) else np.inf
        droop = self.tau_droop if np.size(self.tau_droop) else 0.0
        object.__setattr__(self, "tau_stall", _positive_or_inf(stall, nu, "tau_stall"))
        object.__setattr__(self, "tau_droop", non_negative(droop, nu, "tau_droop"))
        if not (self.q_min < self.q_max).all():
            raise InputError(
                f"q_min {self.q_min.tolist()} is not below q_max {self.q_max.tolist()}"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """A robot: tree of one-degree-of-freedom joints and floating bodies, with named frames.

    A floating body is a joint with position and unit quaternion (x, y, z, w) in q (7), and its
    body twist in v (6). Torques act through ``B`` (nv×nu): ``M a + h + Jᵀ Aᵀ λ = B τ``; identity
    for an arm whose every joint is driven. The mass matrix includes the armature (reflected rotor
    inertia).
    """

    model: pin.Model
    limits: Limits
    home: Vector
    """Configuration (nq) [rad or m] from which scenarios start."""
    B: Matrix = field(default_factory=lambda: np.empty((0, 0)))

    def __post_init__(self) -> None:
        for joint in list(self.model.joints)[1:]:
            if (joint.nq, joint.nv) != (1, 1) and not floats(joint):
                name = self.model.names[joint.id]
                raise InputError(
                    f"joint {name!r} is {joint.shortname()}; need revolute, prismatic or floating "
                    "joints"
                )
        object.__setattr__(self, "home", self.configuration(self.home, "home"))
        if self.B.size == 0:
            object.__setattr__(self, "B", driven_joints(self.model))
        if self.B.shape[0] != self.nv or np.linalg.matrix_rank(self.B) < self.nu:
            raise InputError(
                f"B: got shape {self.B.shape}, need {self.nv} rows of full column rank"
            )

    @property
    def name(self) -> str:
        """Name of the model."""
        return str(self.model.name)

    @property
    def nq(self) -> int:
        """Number of configuration coordinates: one more than velocities for each floating body."""
        return int(self.model.nq)

    @property
    def nv(self) -> int:
        """Number of velocity coordinates."""
        return int(self.model.nv)

    @property
    def floats(self) -> bool:
        """Whether a body of it floats."""
        return self.nq != self.nv

    @property
    def nu(self) -> int:
        """Number of actuators."""
        return int(self.B.shape[1])

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the velocities: of the joint, or ``BODY.vx`` to ``BODY.wz`` where it floats."""
        return self._named(AXES)

    @property
    def configuration_names(self) -> tuple[str, ...]:
        """Names of the entries of q: of the joint; ``BODY.px`` to ``BODY.qw`` where it floats."""
        return self._named(POSE)

    def _named(self, parts: tuple[str, ...]) -> tuple[str, ...]:
        names: list[str] = []
        for joint in list(self.model.joints)[1:]:
            name = str(self.model.names[joint.id])
            names += [f"{name}.{part}" for part in parts] if floats(joint) else [name]
        return tuple(names)

    @property
    def coordinates(self) -> tuple[int | None, ...]:
        """Where in q the coordinate of each velocity is (nv); none for those of a floating body."""
        found: dict[int, int] = {joint.idx_v: joint.idx_q for joint in _single(self.model)}
        return tuple(found.get(i) for i in range(self.nv))

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Name of each column of ``B``: the joint it drives, or ``actuator i``."""
        names = []
        for i, column in enumerate(self.B.T):
            rows = np.flatnonzero(column)
            names.append(self.joint_names[rows[0]] if len(rows) == 1 else f"actuator {i}")
        return tuple(names)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names that tasks and constraints can refer to."""
        return tuple(dict.fromkeys(str(frame.name) for frame in self.model.frames))

    def configuration(self, q: ArrayLike, name: str) -> Vector:
        """Return ``q`` (nq) with unit quaternions.

        Raises:
            InputError: wrong length, not finite, or a quaternion that is none (norm off by 1e-3).
        """
        q = finite_array(q, (self.nq,), name).copy()
        for joint in list(self.model.joints)[1:]:
            if floats(joint):
                quaternion, body = q[joint.idx_q + 3 : joint.idx_q + 7], self.model.names[joint.id]
                norm = float(np.linalg.norm(quaternion))
                if abs(norm - 1) > QUATERNION_OFF:
                    raise InputError(f"{name}: quaternion of {body!r} has norm {norm:.6g}, need 1")
                quaternion /= norm
        return q

    def integrate(self, q: Vector, dq: Vector) -> Vector:
        """Return the configuration (nq) that is ``dq`` (nv) [rad or m] from ``q`` (nq)."""
        return np.asarray(pin.integrate(self.model, q, dq))

    def frame_id(self, name: str) -> int:
        """Return pinocchio's index of frame ``name``.

        Raises:
            InputError: no such frame.
        """
        if name not in self.frame_names:
            raise unknown_name("frame", name, self.frame_names)
        return int(self.model.getFrameId(name))

    def pose(self, q: Vector, frame: str) -> pin.SE3:
        """Return ``X_WF`` of ``frame`` at configuration ``q`` (nq), numerically."""
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, q)
        return data.oMf[self.frame_id(frame)].copy()


def from_pinocchio(
    model: pin.Model,
    *,
    home: Vector | None = None,
    tau_rate: Vector | float = DEFAULT_TORQUE_RATE,
    B: Matrix | None = None,
) -> Robot:
    """Return the robot of a pinocchio model, with the limits that the model carries.

    Args:
        model: tree of revolute, prismatic and floating joints; zero limits mean none.
        home: start configuration (nq) [rad or m]; default: zero, moved inside the limits.
        tau_rate: torque-rate limit (nu) [Nm/s].
        B: actuation matrix (nv×nu); default: a torque at every joint that does not float.
    """
    actuation = driven_joints(model) if B is None else np.asarray(B, dtype=np.float64)
    singles = _single(model)
    at_q, at_v = [joint.idx_q for joint in singles], [joint.idx_v for joint in singles]
    q_min, q_max = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    q_min[at_v] = -_far_is_none(-np.array(model.lowerPositionLimit)[at_q])
    q_max[at_v] = _far_is_none(np.array(model.upperPositionLimit)[at_q])
    v_max = np.full(model.nv, np.inf)
    v_max[at_v] = _zero_is_none(np.array(model.upperVelocityLimit)[at_v])
    effort = _effort(np.array(model.upperEffortLimit), actuation)
    limits = Limits(
        q_min=q_min,
        q_max=q_max,
        v_max=v_max,
        tau_max=_zero_is_none(effort),
        tau_rate=positive(tau_rate, effort.shape, "tau_rate"),
    )
    start = pin.neutral(model)
    start[at_q] = np.clip(0.0, q_min[at_v], q_max[at_v])
    return Robot(
        model=model, limits=limits, home=start if home is None else np.asarray(home), B=actuation
    )


def floats(joint: pin.JointModel) -> bool:
    """Return whether a joint leaves its body free."""
    return str(joint.shortname()) == "JointModelFreeFlyer"


def driven_joints(model: pin.Model) -> Matrix:
    """Return the B (nv×nu) of a torque at every joint that does not float."""
    return np.ascontiguousarray(np.eye(model.nv)[:, [joint.idx_v for joint in _single(model)]])


def _single(model: pin.Model) -> list[pin.JointModel]:
    """Return the joints with one degree of freedom."""
    return [joint for joint in list(model.joints)[1:] if (joint.nq, joint.nv) == (1, 1)]


def _effort(of_joints: Vector, B: Matrix) -> Vector:
    """Return the limits (nu) of the torques; none where B is no choice of joints."""
    rows, columns = np.nonzero(B)
    if not (B[rows, columns] == 1).all() or sorted(columns) != list(range(B.shape[1])):
        return np.full(B.shape[1], np.inf)
    effort = np.empty(B.shape[1])
    effort[columns] = of_joints[rows]
    return effort


def _positive_or_inf(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    none = np.asarray(value) == np.inf
    return np.where(none, np.inf, positive(np.where(none, 1.0, value), shape, name))


def _far_is_none(limit: Vector) -> Vector:
    return np.where(limit >= NO_LIMIT, np.inf, limit)


def _zero_is_none(limit: Vector) -> Vector:
    return np.where((limit <= 0) | (limit >= NO_LIMIT), np.inf, limit)
