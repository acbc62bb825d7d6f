"""A firmly grasped valve on a screw: it advances as it turns."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Wrench, positive
from qpctrl.constraint import Screw
from scenarios.guided import (
    FLANGE,
    Guidance,
    Scenery,
    ThereAndBack,
    TwistPath,
    arc,
    arm_at_home,
    guided_criteria,
    guided_experiment,
    guided_metrics,
)
from scenarios.panel import Panel, environment_panels
from scenarios.scenario import Criterion, Experiment, Options, Outcome


@dataclass(frozen=True, kw_only=True)
class Valve:
    """Turn a valve by its rim, over and back, pulling and leaning on it meanwhile."""

    name: ClassVar[str] = "valve"
    summary: ClassVar[str] = "turn a grasped valve by ±50° on its screw, k = 5"

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf) with a frame ``flange``."""
    angle: float = 50.0
    """Angle to each side of the middle [deg]; the valve starts at one end."""
    rate: float = 80.0
    """Speed of the valve [deg/s]."""
    radius: float = 0.08
    """Distance from the axis to the grasp [m]."""
    lead: float = 5e-3
    """Advance of the screw [m/rad], away from the arm."""
    force: float = 8.0
    """Force held in the grasp, away from the axis, and as much along it [N]."""
    moment: float = 0.5
    """Moment held about the spoke that is grasped [Nm]."""

    def __post_init__(self) -> None:
        for name in ("angle", "rate", "radius", "lead", "force", "moment"):
            positive(getattr(self, name), (), name)

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        arm, X_WF = arm_at_home(self.robot)
        X_FE = pin.SE3(np.eye(3), np.array([-self.radius, 0.0, 0.0]))
        X_WE = X_WF * X_FE
        turning = pin.Motion(np.array([0.0, 0.0, self.lead]), np.array([0.0, 0.0, 1.0]))
        held = self.held(X_FE)
        guidance = Guidance(
            stroke=ThereAndBack(far=2 * np.radians(self.angle), speed=np.radians(self.rate)),
            reference=TwistPath(X_W0=X_WF, xi_W=X_WE.act(turning).vector).reference,
            wrench=lambda stroke: held,
            scenery=Scenery(X_WE, (0, 1), arc(self.radius)),
        )
        screw = Screw(space=FLANGE, X_WE=X_WE, lead=self.lead, name="valve")
        return guided_experiment(arm, screw, guidance, options)

    def held(self, X_FE: pin.SE3) -> Wrench:
        """Return the set-point (6) [N, Nm] in the tool frame.

        A force f along the axis goes with the moment −h f about it: alone it would turn the valve.
        """
        f = self.force
        in_E = pin.Force(np.array([f, 0.0, f]), np.array([self.moment, 0.0, -self.lead * f]))
        return X_FE.act(in_E).vector

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run, taken while the valve turns."""
        found = guided_metrics(table)
        return found | {"valve_angle_rmse_deg": found.get("orientation_rmse_deg", float("nan"))}

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = {
            "force_error_share": (0.02, ""),
            "moment_rmse_Nm": (0.02 * self.moment, "Nm"),
            "position_rmse_mm": (0.05, "mm"),
            "valve_angle_rmse_deg": (0.2, "deg"),
        }
        return guided_criteria(metrics, limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the path of the grasp, forces, moments and pose errors."""
        return environment_panels(
            outcome.table, outcome.experiment.geometry, "seen along the valve's axis"
        )
