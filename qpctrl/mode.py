"""A mode: the constraints, contact limits and weighted tasks that are active together."""

from dataclasses import dataclass
from typing import Literal, get_args

from qpctrl.constraint import Constraint
from qpctrl.contact import WrenchLimit
from qpctrl.errors import InputError, unknown_name
from qpctrl.objective import GraspTask, Weighted

Metric = Literal["inertia", "home"]


@dataclass(frozen=True, kw_only=True)
class Mode:
    """A set of active constraints, contact limits and weighted tasks; names are unique in it."""

    name: str
    tasks: tuple[Weighted, ...]
    constraints: tuple[Constraint, ...] = ()
    contact_limits: tuple[WrenchLimit, ...] = ()
    """What the contacts can carry; each acts on the constraints of its task space."""
    metric: Metric = "inertia"
    """What weighs the costs: the inertia Λ of each task space where the robot is, or that at its
    home, a constant. The first alone makes costs orthogonal, and closed forms exist for it; the
    second costs less, for robots with many joints and tasks on many frames."""
    slack: float | None = None
    """Weight w_s of the constraints as a cost ½ w_s ‖A V̇ + Ȧ V − v̇_c‖²_{S⁻¹} that can give way
    when a limit binds, and the input ``slack.weight`` then; None where they hold exactly."""

    def __post_init__(self) -> None:
        names = [weighted.task.name for weighted in self.tasks]
        names += [constraint.name for constraint in self.constraints]
        names += [limit.name for limit in self.contact_limits]
        names += ["slack"] if self.slack is not None else []
        if len(set(names)) < len(names):
            raise InputError(f"mode {self.name!r}: names must differ, got {', '.join(names)}")
        if self.metric not in get_args(Metric):
            raise unknown_name("metric", self.metric, get_args(Metric))
        if not self.tasks:
            raise InputError(f"mode {self.name!r}: need at least one task")
        held = {constraint.space for constraint in self.constraints}
        for limit in self.contact_limits:
            if limit.space not in held:
                raise InputError(
                    f"mode {self.name!r}: contact limit {limit.name!r} has no constraint on its "
                    "task space"
                )
        for task in (weighted.task for weighted in self.tasks):
            for space in task.contacts if isinstance(task, GraspTask) else ():
                if space not in held:
                    raise InputError(
                        f"mode {self.name!r}: task {task.name!r} has no constraint on its contact "
                        f"{space.frame!r}"
                    )
        if self.slack is not None and not self.constraints:
            raise InputError(f"mode {self.name!r}: slack needs a constraint that can give way")
        if self.slack is not None and len(self.priorities) > 1:
            raise InputError(f"mode {self.name!r}: slack and priorities exclude each other")
        for task, weight, priority in self.tasks:
            _check_weight(weight, f"weight of task {task.name!r}")
            if not isinstance(priority, int):
                raise InputError(f"priority of task {task.name!r}: got {priority}, need an integer")
        if self.slack is not None:
            _check_weight(self.slack, f"slack of mode {self.name!r}")

    @property
    def priorities(self) -> tuple[int, ...]:
        """Priorities of its tasks, the highest first: the smallest number."""
        return tuple(sorted({weighted.priority for weighted in self.tasks}))


def _check_weight(weight: float, name: str) -> None:
    if not 1e-6 <= weight <= 1e6:
        raise InputError(f"{name}: got {weight}, need a number from 1e-6 to 1e6")
