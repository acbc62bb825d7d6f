"""A firmly grasped drawer: it slides, and carries every other direction of force."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import positive
from qpctrl.constraint import Drawer as Slide
from scenarios.guided import (
    FLANGE,
    Guidance,
    Scenery,
    ThereAndBack,
    TwistPath,
    arm_at_home,
    axis_frame,
    guided_criteria,
    guided_experiment,
    guided_metrics,
)
from scenarios.panel import Panel, environment_panels
from scenarios.scenario import Criterion, Experiment, Options, Outcome


@dataclass(frozen=True, kw_only=True)
class Drawer:
    """Pull a drawer open and push it shut, pressing down on its handle meanwhile."""

    name: ClassVar[str] = "drawer"
    summary: ClassVar[str] = "pull a grasped drawer open and push it shut, k = 5"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf) with a frame ``flange``."""
    distance: float = 0.2
    """Distance to pull [m]."""
    speed: float = 0.2
    """Speed of the drawer [m/s]."""
    force: float = 10.0
    """Force held meanwhile, downwards [N]."""

    def __post_init__(self) -> None:
        for name in ("distance", "speed", "force"):
            positive(getattr(self, name), (), name)

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        arm, X_WF = arm_at_home(self.robot)
        outward = -X_WF.rotation[:, 2]
        down = np.array([0.0, 0.0, -1.0])
        X_WE = axis_frame(X_WF.translation, down, outward)
        slide = Slide(space=FLANGE, X_WE=X_WE, name="slide")
        push = np.zeros(6)
        push[:3] = self.force * (X_WF.rotation.T @ X_WE.rotation[:, 2])
        guidance = Guidance(
            stroke=ThereAndBack(far=self.distance, speed=self.speed),
            reference=TwistPath(
                X_W0=X_WF, xi_W=pin.Motion(X_WE.rotation[:, 0], np.zeros(3)).vector
            ).reference,
            wrench=lambda stroke: push,
            scenery=Scenery(X_WE, (0, 1)),
        )
        return guided_experiment(arm, slide, guidance, options)

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run, taken while the drawer moves."""
        return guided_metrics(table)

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = {"force_error_share": (0.02, ""), "position_rmse_mm": (0.05, "mm")}
        return guided_criteria(metrics, limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the path of the drawer, forces, moments and pose errors."""
        return environment_panels(
            outcome.table, outcome.experiment.geometry, "seen from above the slides"
        )
