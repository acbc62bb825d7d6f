"""A tool that wipes a ball.

A stylus that keeps its axes sees the normal turn: Ȧ V ≠ 0, and the textbook law errs by
Aᵀ S⁻¹ Ȧ V. A face that turns with the ball has the same rows all the way, in its own axes, and
both laws agree.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import positive
from qpctrl.constraint import Surface, sphere
from scenarios.guided import (
    FLANGE,
    CirclePath,
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
class Sphere:
    """Wipe a ball along a great circle, with a stylus or with a face tangent to it."""

    name: ClassVar[str] = "sphere"
    summary: ClassVar[str] = (
        "wipe a ball with a stylus, k = 1: the textbook law shows its curvature error"
    )

    robot: str = "fr3"
    """fr3, ur5, or a file (.xml MJCF, .urdf) with a frame ``flange``."""
    contact: Literal["point", "face"] = "point"
    """A stylus that keeps its axes (k = 1), or a face that stays tangent (k = 3)."""
    force: float = 10.0
    """Force on the ball, towards its centre [N]."""
    speed: float = 0.2
    """Speed of the face on the ball [m/s]."""
    radius: float = 0.25
    """Radius of the ball [m]."""
    swing: float = 40.0
    """Angle from start to turning point, seen from the centre [deg]."""

    def __post_init__(self) -> None:
        for name in ("force", "speed", "radius", "swing"):
            positive(getattr(self, name), (), name)

    def prepare(self, options: Options) -> Experiment:
        """Return the experiment, ready to run."""
        arm, X_WF = arm_at_home(self.robot)
        inward = X_WF.rotation[:, 2]
        X_WE = pin.SE3(X_WF.rotation, X_WF.translation + self.radius * inward)
        phi, p = sphere(np.zeros(3), self.radius)
        ball = Surface(
            space=FLANGE,
            X_WE=X_WE,
            phi=phi,
            p=p,
            face=self.contact == "face",
            contact=X_WE.actInv(X_WF),
            name="ball",
        )
        about_x = X_WE.act(pin.Motion(np.zeros(3), np.array([1.0, 0.0, 0.0]))).vector
        circle = CirclePath(X_WE=X_WE, radius=self.radius, start=(0, 0, -1), side=(0, 1, 0))
        turning = TwistPath(X_W0=X_WF, xi_W=about_x)
        push = np.array([0.0, 0.0, self.force, 0.0, 0.0, 0.0])
        face = self.contact == "face"
        guidance = Guidance(
            stroke=ThereAndBack(far=np.radians(self.swing), speed=self.speed / self.radius),
            reference=turning.reference if face else circle.reference,
            wrench=(lambda stroke: push) if face else circle.radial(-self.force),
            scenery=Scenery(X_WE, (1, 2), arc(self.radius)),
        )
        return guided_experiment(arm, ball, guidance, options)

    def metrics(self, table: pl.DataFrame) -> dict[str, float]:
        """Return the metrics of a run, taken while the face moves."""
        return guided_metrics(table)

    def judge(self, metrics: Mapping[str, float]) -> tuple[Criterion, ...]:
        """Return the scenario's own criteria on its metrics."""
        limits = {"force_rmse_N": (0.01, "N"), "position_rmse_mm": (0.05, "mm")}
        return guided_criteria(metrics, limits)

    def panels(self, outcome: Outcome) -> tuple[Panel, ...]:
        """Return the path on the ball, forces, moments and pose errors."""
        return environment_panels(
            outcome.table, outcome.experiment.geometry, "in the plane of the great circle"
        )
