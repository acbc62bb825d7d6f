"""The robot as data: a pinocchio model, its limits, its actuation, its named frames."""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from qpctrl.arrays import Array, Matrix, Vector, finite_array, non_negative, positive
from qpctrl.errors import InputError, unknown_name

DEFAULT_TORQUE_RATE = 1000.0
"""Torque-rate limit [Nm/s] of a robot whose file gives none (Franka FR3's figure)."""


NO_LIMIT = 1e9
"""Limits of a file from here on mean none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """What joints and motors can do. ``inf`` means no limit."""

    q_min: Vector
    """Lowest configuration (nq) [rad or m]."""
    q_max: Vector
    """Highest configuration (nq) [rad or m]."""
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
    """A robot: tree of one-degree-of-freedom joints with named frames.

    Torques act through ``B`` (nv×nu): ``M a + h + Jᵀ Aᵀ λ = B τ``; identity for an arm whose
    every joint is driven. The mass matrix includes the armature (reflected rotor inertia).
    """

    model: pin.Model
    limits: Limits
    home: Vector
    """Configuration (nq) [rad or m] from which scenarios start."""
    B: Matrix = field(default_factory=lambda: np.empty((0, 0)))

    def __post_init__(self) -> None:
        for joint in list(self.model.joints)[1:]:
            if joint.nv != 1 or joint.nq != 1:
                name = self.model.names[joint.id]
                raise InputError(
                    f"joint {name!r} is {joint.shortname()}; need revolute or prismatic joints"
                )
        object.__setattr__(self, "home", finite_array(self.home, (self.nv,), "home"))
        if self.B.size == 0:
            object.__setattr__(self, "B", np.eye(self.nv))
        if self.B.shape[0] != self.nv or np.linalg.matrix_rank(self.B) < self.nu:
            raise InputError(
                f"B: got shape {self.B.shape}, need {self.nv} rows of full column rank"
            )

    @property
    def name(self) -> str:
        """Name of the model."""
        return str(self.model.name)

    @property
    def nv(self) -> int:
        """Number of velocity coordinates (equal to configuration coordinates)."""
        return int(self.model.nv)

    @property
    def nu(self) -> int:
        """Number of actuators."""
        return int(self.B.shape[1])

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in the order of ``v``."""
        return tuple(str(name) for name in self.model.names)[1:]

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
        model: fixed-base tree of revolute and prismatic joints; zero limits mean none.
        home: start configuration (nq) [rad or m]; default: zero, moved inside the limits.
        tau_rate: torque-rate limit (nu) [Nm/s].
        B: actuation matrix (nv×nu); default identity.
    """
    actuation = np.eye(model.nv) if B is None else np.asarray(B, dtype=np.float64)
    effort = np.asarray(model.upperEffortLimit, dtype=np.float64)
    if actuation.shape[1] != effort.shape[0]:
        effort = np.full(actuation.shape[1], np.inf)
    limits = Limits(
        q_min=-_far_is_none(-np.array(model.lowerPositionLimit)),
        q_max=_far_is_none(np.array(model.upperPositionLimit)),
        v_max=_zero_is_none(np.array(model.upperVelocityLimit)),
        tau_max=_zero_is_none(effort),
        tau_rate=positive(tau_rate, effort.shape, "tau_rate"),
    )
    start = np.clip(np.zeros(model.nq), limits.q_min, limits.q_max)
    if home is not None:
        start = finite_array(home, (model.nq,), "home")
    return Robot(model=model, limits=limits, home=start, B=actuation)


def from_urdf(path: Path | str, *, home: Vector | None = None) -> Robot:
    """Return the robot of a URDF file (continuous joints become unlimited revolute ones).

    Raises:
        InputError: no such file, not XML, or not a URDF that pinocchio can read.
    """
    try:
        model = pin.buildModelFromXML(urdf_text(Path(path)))
    except (ValueError, RuntimeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a usable URDF ({error})") from error
    return from_pinocchio(model, home=home)


def xml_root(path: Path) -> ElementTree.Element:
    """Return the root element of an XML file.

    Raises:
        InputError: it cannot be read, or is not XML.
    """
    try:
        return ElementTree.parse(path).getroot()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise InputError(f"{path}: not XML ({error})") from error


def urdf_text(path: Path) -> str:
    """Return the URDF text without meshes, with continuous joints as unlimited revolute."""
    root = xml_root(path)
    if root.tag != "robot":
        raise InputError(f"{path}: got <{root.tag}>, need a URDF with <robot> at its root")
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    for joint in root.findall("joint"):
        if joint.find("mimic") is not None:
            raise InputError(f"{path}: joint {joint.get('name')!r} is a mimic; not supported")
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
            limit.attrib = {"effort": "0", "velocity": "0", **limit.attrib}
            limit.attrib |= {"lower": f"{-NO_LIMIT}", "upper": f"{NO_LIMIT}"}
    return ElementTree.tostring(root, encoding="unicode")


def _positive_or_inf(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    none = np.asarray(value) == np.inf
    return np.where(none, np.inf, positive(np.where(none, 1.0, value), shape, name))


def _far_is_none(limit: Vector) -> Vector:
    return np.where(limit >= NO_LIMIT, np.inf, limit)


def _zero_is_none(limit: Vector) -> Vector:
    return np.where((limit <= 0) | (limit >= NO_LIMIT), np.inf, limit)
