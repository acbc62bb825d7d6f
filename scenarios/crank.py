"""A crank with a handle that turns freely: two freedoms, four directions of force."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import positive
from qpctrl.constraint import Crank as Handle
from scenarios.guided import (
    FLANGE,
    CirclePath,
    Guidance,
    Scenery,
    ThereAndBack,
    arc,
    arm_at_home,
    guided_criteria,
    guided_experiment,
    guided_metrics,
)
from scenarios.panel import Panel, environment_panels
from scenarios.scenario import Criterion, Experiment, Options, Outcome


@dataclass(frozen=True, kw_only=True)
class Crank:
    """Turn a crank by its freely turning handle; the hand does not turn with it."""

    name: ClassVar[str] = "crank"
    summary: ClassVar[str] = "turn a crank by a handle that spins freely, k = 4"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf) with a frame ``flange``."""
    turns: float = 1.0
    """Turns forth, and as many back [1]."""
    speed: float = 0.25
    """Speed of the handle [m/s]."""
    radius: float = 0.08
    """Length of the crank [m]."""
    force: float = 10.0
    """Force held meanwhile, away from the axis [N]."""

    def __post_init__(self) -> None:
        for name in ("turns", "speed", "radius", "force"):
            positive(getattr(self, name), (), name)

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        arm, X_WF = arm_at_home(self.robot)
        start = np.array([self.radius, 0.0, 0.0])
        X_WE = pin.SE3(X_WF.rotation, X_WF.act(-start))  # axis along z of the flange at home
        circle = CirclePath(X_WE=X_WE, radius=self.radius, start=(1, 0, 0), side=(0, 1, 0))

        stroke = ThereAndBack(far=2 * np.pi * self.turns, speed=self.speed / self.radius)
        handle = Handle(space=FLANGE, X_WE=X_WE, name="handle")
        guidance = Guidance(
            stroke=stroke,
            reference=circle.reference,
            wrench=circle.radial(self.force),
            scenery=Scenery(X_WE, (0, 1), arc(self.radius)),
        )
        return guided_experiment(arm, handle, guidance, options)

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run, taken while the crank turns."""
        return guided_metrics(table)

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = {"force_error_share": (0.02, ""), "position_rmse_mm": (0.05, "mm")}
        return guided_criteria(metrics, limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the path of the handle, forces, moments and pose errors."""
        return environment_panels(
            outcome.table, outcome.experiment.geometry, "seen along the crank's axis"
        )
