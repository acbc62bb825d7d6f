"""What a task asks of the QP: desired accelerations, wrenches, postures – all expressions."""

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol, TypeAlias, runtime_checkable

from qpctrl.arrays import Array
from qpctrl.space import FrameMotion, TaskSpace
from qpctrl.spatial import SX


class MotionObjective(NamedTuple):
    """Ask for ``V̇ = a_cmd`` along the axes of the space: cost ½‖J a + J̇v − a_cmd‖²_Λ."""

    a_cmd: SX
    """Commanded acceleration (n) [m/s², rad/s²]."""
    F_ext: SX | None = None
    """Known wrench on the environment (n) [N, Nm] to compensate, a hand's for instance."""


class ForceObjective(NamedTuple):
    """Ask for ``Aᵀ λ = F_cmd``: cost ½‖Aᵀ λ − F_cmd‖²_{Λ⁻¹}."""

    F_cmd: SX
    """Commanded wrench on the environment (n) [N, Nm]."""
    F_ext: SX
    """Known wrench on the environment outside A's rows (n) [N, Nm], friction for instance."""


class GraspObjective(NamedTuple):
    """Ask for ``Σ E_i A_iᵀ λ_i = F_cmd`` of some contacts: cost ½‖Σ E_i A_iᵀ λ_i − F_cmd‖²_W.

    W is the mobility of the contact frames, averaged over contacts and directions.
    """

    E: Mapping[TaskSpace, SX]
    """For each contact the map (6×n) of its wrench on the environment."""
    F_cmd: SX
    """Commanded sum (6) [N, Nm]."""


class PostureObjective(NamedTuple):
    """Ask for ``a = a_post`` in the null space: cost ½‖a − a_post‖²_{M_N}.

    With the metric of home, M_N is the part of M(home) that belongs to joints.
    """

    a_post: SX
    """Commanded joint acceleration (nv) [rad/s² or m/s²]."""


Objective: TypeAlias = MotionObjective | ForceObjective | GraspObjective | PostureObjective


class Scene(NamedTuple):
    """What a task may refer to when it writes its objective."""

    q: SX
    """Configuration (nq) [rad or m]."""
    v: SX
    """Velocity (nv) [rad/s or m/s]."""
    dt: SX
    """Control period [s]."""
    freeze: SX
    """1 while integrators hold (a limit was active or contact lost), else 0."""
    mass: SX
    """Mass of all that moves [kg]."""
    coordinates: Callable[[SX], SX]
    """Maps an array like q (nq) to one like v (nv), with 0 for floating bodies."""
    motion: FrameMotion
    """Pose and twist of the task's frame; a posture must not use it."""
    motions: Mapping[TaskSpace, FrameMotion]
    """The same of every space of the mode."""
    A: SX
    """Constraint rows (k×n) acting on that space; k = 0 in free space."""
    v_c: SX
    """Velocity of the environment along those rows (k) [m/s, rad/s]."""
    S: SX
    """A Λ⁻¹ Aᵀ (k×k), the mobility of the constrained directions."""
    Lambda_inv: SX
    """Λ⁻¹ (n×n) [1/kg, 1/(kg m), 1/(kg m²)], the mobility of that space."""


class TaskExpressions(NamedTuple):
    """One task, written out."""

    objective: Objective
    memory: Mapping[str, SX]
    """The task's memory after this tick."""
    signals: Mapping[str, SX]
    """Quantities worth recording."""


@runtime_checkable
class Reference(Protocol):
    """What a task shall follow at one tick."""

    @property
    def arrays(self) -> Mapping[str, Array]:
        """Task inputs that this reference sets."""


@runtime_checkable
class Task(Protocol):
    """Frozen parameters and a pure method from (scene, inputs, memory) to an objective."""

    @property
    def name(self) -> str:
        """Name under which references and reports refer to the task."""

    @property
    def space(self) -> TaskSpace | None:
        """Task space of the objective; none for a posture."""

    @property
    def needs_reference(self) -> bool:
        """Whether a mode must not be entered without a reference for this task."""

    def inputs(self) -> dict[str, Array]:
        """Return references, measurements and gains with their defaults."""

    def memory(self) -> dict[str, Array]:
        """Return the initial memory: integrators, filters, ramps."""

    def objective(
        self, scene: Scene, u: Mapping[str, SX], memory: Mapping[str, SX]
    ) -> TaskExpressions:
        """Return the objective at the inputs ``u``."""


@runtime_checkable
class GraspTask(Protocol):
    """A task on the wrenches of several contacts."""

    @property
    def contacts(self) -> tuple[TaskSpace, ...]:
        """Task spaces of the contacts."""


class Weighted(NamedTuple):
    """A task in a composition."""

    task: Task
    weight: float = 1.0
    """Who gives way when a limit binds, among tasks of one priority; without an active limit it
    changes nothing where costs are orthogonal."""
    priority: int = 0
    """A task never disturbs one with a smaller number, limits included."""
