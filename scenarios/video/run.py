"""Moving pictures of a scenario's run: what ``qpctrl run SCENARIO --video FILE`` leaves."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, final, runtime_checkable

import mujoco
import numpy as np
import pinocchio as pin
import polars as pl

from qpctrl.arrays import Array, Matrix
from qpctrl.robot import Robot
from scenarios.metric import column
from scenarios.plant_coordinates import coordinates
from scenarios.scenario import Outcome
from scenarios.video.take import Arrow, View
from scenarios.video.write import FPS, SIZE, sampled, write_video


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Where a run took place, and what of it is shown."""

    model: mujoco.MjModel
    """Robot and environment; its joints are those of the robot."""
    view: View
    forces: Mapping[str, str]
    """Forces that are drawn, robot on environment: the columns ``NAME.fx``, ``NAME.fy`` and
    ``NAME.fz`` of the record by their NAME, with the frame along whose axes they are, and at
    whose origin they act."""
    scale: float = 0.02
    """Length of an arrow per force [m/N]; below zero their reactions are drawn."""
    places: Callable[[pl.DataFrame], Mapping[str, Array]] = lambda _: {}
    """Poses (ticks×4×4) in the world, at ticks of the record, of bodies that move without a joint,
    by name."""


@runtime_checkable
class Filmed(Protocol):
    """A scenario of which there are moving pictures."""

    def scene(self, outcome: Outcome) -> Scene:
        """Return where the run took place."""


def film_run(
    file: Path,
    scene: Scene,
    robot: Robot,
    table: pl.DataFrame,
    *,
    fps: float = FPS,
    size: tuple[int, int] = SIZE,
    watch: Callable[[int], None] | None = None,
) -> None:
    """Write moving pictures of a run, as fast as it was, with its forces as arrows.

    Those of a run that diverges end where its numbers do.

    Args:
        file: where they go, see `write_video`.
        scene: where the run took place.
        robot: what moved there.
        table: the record, in the coordinates of ``robot``.
        fps: pictures in a second [1/s].
        size: width and height [pixels].
        watch: called with the number of each picture that is written.

    Raises:
        InputError: as of `write_video`, a record without a tick, or no such frame.
        ModelMismatchError: scene and robot have different joints.
    """
    shown = table[sampled(column(table, "time"), np.arange(len(table)), fps)]
    q = beside(shown, [name for name in shown.columns if name.startswith("q.")])
    known = int(np.argmin([*np.isfinite(q).all(axis=1), False]))
    shown, q = shown[:known], q[:known]
    write_video(
        file,
        scene.model,
        q[:, coordinates(scene.model, robot).qpos_at],
        view=scene.view,
        fps=fps,
        size=size,
        arrows=force_arrows(scene, robot, shown, q),
        places=scene.places(shown),
        watch=watch,
    )


def force_arrows(scene: Scene, robot: Robot, table: pl.DataFrame, q: Matrix) -> list[list[Arrow]]:
    """Return the forces of each tick at its ``q`` (ticks×nq); those that are not known are not."""
    arrows: list[list[Arrow]] = [[] for _ in q]
    for name, frame in scene.forces.items():
        force = beside(table, [f"{name}.f{axis}" for axis in "xyz"])
        for tick in np.flatnonzero(np.isfinite(force).all(axis=1)):
            X_WF = robot.pose(q[tick], frame)
            vector = X_WF.rotation @ force[tick]
            arrows[tick].append(Arrow(point=X_WF.translation, vector=vector, scale=scene.scale))
    return arrows


def beside(table: pl.DataFrame, names: list[str]) -> Matrix:
    """Return columns of a record side by side (ticks×n)."""
    return np.stack([column(table, name) for name in names], axis=1)


def board_view(X_WE: pin.SE3) -> View:
    """Return the view on a robot in front of a board, from the robot's side.

    Args:
        X_WE: frame on the face of the board, x up and z into it.
    """
    x, y, z = X_WE.act(np.array([0.0, 0.0, -0.15]))
    return View(azimuth=-42.0, elevation=-12.0, distance=2.0, lookat=(x, y, 0.68 * z))
