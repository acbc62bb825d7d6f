"""A system whose rollouts do what they are told, at once; and studies of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import polars as pl

from scenarios.study.design import Design
from scenarios.study.factor import Factor
from scenarios.study.parameter import Parameter, choice
from scenarios.study.study import Study
from scenarios.study.system import DivergedError, Measures, Rollout, Setting

X, Y = Factor("x", "1", -10.0, 10.0), Factor("y", "m", 0.01, 1.0, "log-uniform")
TICKS = 3


def squares(setting: Setting, controller: str, seed: int) -> Measures:
    """Return the square of x."""
    return {"value_N": setting["x"] ** 2}


@dataclass(frozen=True)
class Scripted:
    """Runs what its script says, and notes it."""

    name: ClassVar[str] = "scripted"
    summary: ClassVar[str] = "rollouts that do what they are told"
    parameters: ClassVar[Mapping[str, Parameter]] = {
        "x": Parameter("1", 1.0, -10.0, 10.0, "some number"),
        "y": Parameter("m", 0.1, 0.01, 100.0, "some length"),
        "count": Parameter("1", 2.0, 0.0, 6.0, "some whole number", whole=True),
        "colour": choice("some colour", "red", "green", "blue"),
    }
    controllers: ClassVar[Mapping[str, str]] = {"one": "the first", "two": "the second"}
    measures: ClassVar[Mapping[str, str]] = {
        "value_N": "some force",
        "longest_loss_ms": "time without contact",
        "contact_breaks": "losses of contact",
        "saturated_fraction": "share of saturated ticks",
        "fallback_ticks": "fallback ticks",
        "force_rmse_ratio": "some error",
    }
    script: Callable[[Setting, str, int], Measures] = squares
    """What is measured; what it leaves out is none."""
    edge: float | None = None
    """Closed form of every limit."""
    calls: list[tuple[Setting, str, int]] = field(default_factory=list)
    """What was run, in order."""

    def run(self, setting: Setting, controller: str, seed: int, *, full: bool = False) -> Rollout:
        """Return what the script says, or raise it."""
        self.calls.append((setting, controller, seed))
        table = pl.DataFrame({"tick": range(TICKS), **({"x": setting["x"]} if full else {})})
        try:
            found = self.script(setting, controller, seed)
        except DivergedError as error:
            raise DivergedError(str(error), table) from error
        return Rollout({**dict.fromkeys(self.measures), **found}, table)

    def limit(self, setting: Setting, controller: str, parameter: str) -> float | None:
        """Return what was given."""
        return self.edge


def scripted(
    script: Callable[..., Any] = squares, *, edge: float | None = None, **of: Any
) -> Study:
    """Return a study of x in [−10, 10] whose system runs ``script``."""
    usual = {"controllers": ("one",), "factors": (X,), "design": Design(size=5)}
    return Study(name="squares", summary="", system=Scripted(script, edge), **{**usual, **of})


def diverge(setting: Setting, controller: str, seed: int) -> Measures:
    """Leave all bounds."""
    raise DivergedError("left all bounds", pl.DataFrame())
