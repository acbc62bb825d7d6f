"""What a system is: a robot, its world and its controllers, with everything that can be wrong."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol, TypeAlias

import polars as pl

from qpctrl.errors import QpctrlError
from scenarios.study.parameter import Parameter

Measures: TypeAlias = Mapping[str, float | None]
"""Numbers of one rollout by name; none where the rollout has no such quantity."""

Setting: TypeAlias = Mapping[str, float]
"""Value of every parameter of a system by name."""


class Rollout(NamedTuple):
    """What a rollout leaves."""

    measures: Measures
    table: pl.DataFrame
    """Its ticks."""


class DivergedError(QpctrlError):
    """A rollout that left all bounds; its outcome, and no fault of the program.

    Attributes:
        table: the ticks until then.
    """

    def __init__(self, reason: str, table: pl.DataFrame) -> None:
        super().__init__(reason)
        self.table = table


class System(Protocol):
    """Runs one rollout for each setting; without a state of its own.

    A measure ``x`` with a known answer has ``x_closed``, that answer, and ``x_gap``, the relative
    distance from it, beside it.
    """

    @property
    def name(self) -> str:
        """Name in study files."""

    @property
    def summary(self) -> str:
        """One line for the list of systems."""

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """What a study can set or vary, by name."""

    @property
    def controllers(self) -> Mapping[str, str]:
        """What each controller is, by name."""

    @property
    def measures(self) -> Mapping[str, str]:
        """What each number of a rollout is, by name; units stand at the end of the name."""

    def run(self, setting: Setting, controller: str, seed: int, *, full: bool = False) -> Rollout:
        """Return one rollout.

        Args:
            setting: value of every parameter.
            controller: one of `controllers`.
            seed: of every random number of the rollout, the same for all controllers.
            full: whether the table shall hold all that is known of each tick; the measures are
                the same.

        Raises:
            DivergedError: a state that left all bounds.
        """

    def limit(self, setting: Setting, controller: str, parameter: str) -> float | None:
        """Return the closed form of the value of ``parameter`` up to which all is well, if known.

        Args:
            setting: value of every other parameter.
            controller: one of `controllers`.
            parameter: name of what is raised until something gives way.
        """
