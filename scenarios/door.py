"""A firmly grasped cabinet door: one freedom, five directions of force."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import positive
from qpctrl.constraint import Hinge
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

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Door:
    """Open a cabinet door and close it, pulling at the handle away from the hinge meanwhile."""

    name: ClassVar[str] = "door"
    summary: ClassVar[str] = "open a grasped cabinet door by 60° and close it, k = 5"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf) with a frame ``flange``."""
    angle: float = 60.0
    """Angle to open [deg]."""
    rate: float = 40.0
    """Speed of the door [deg/s]."""
    radius: float = 0.35
    """Distance from hinge to handle [m]."""
    force: float = 8.0
    """Force held in the grasp, away from the hinge [N]."""

    def __post_init__(self) -> None:
        for name in ("angle", "rate", "radius", "force"):
            positive(getattr(self, name), (), name)

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        arm, X_WF = arm_at_home(self.robot)
        sideways = np.cross(UP, X_WF.rotation[:, 2])
        hinge_at = X_WF.translation + self.radius * sideways / np.linalg.norm(sideways)
        X_WE = axis_frame(hinge_at, UP, X_WF.translation - hinge_at)
        hinge = Hinge(space=FLANGE, X_WE=X_WE, name="hinge")
        opening = X_WE.act(pin.Motion(np.zeros(3), -UP)).vector
        push = np.zeros(6)
        push[:3] = self.force * (X_WF.rotation.T @ X_WE.rotation[:, 0])
        guidance = Guidance(
            stroke=ThereAndBack(far=np.radians(self.angle), speed=np.radians(self.rate)),
            reference=TwistPath(X_W0=X_WF, xi_W=opening).reference,
            wrench=lambda stroke: push,
            scenery=Scenery(X_WE, (0, 1), np.array([[0.0, 0.0], [self.radius, 0.0]])),
        )
        return guided_experiment(arm, hinge, guidance, options)

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run, taken while the door moves."""
        found = guided_metrics(table)
        return found | {"hinge_angle_rmse_deg": found.get("orientation_rmse_deg", float("nan"))}

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = {"force_error_share": (0.02, ""), "hinge_angle_rmse_deg": (0.2, "deg")}
        return guided_criteria(metrics, limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the path of the handle, forces, moments and pose errors."""
        return environment_panels(
            outcome.table, outcome.experiment.geometry, "seen along the hinge"
        )
