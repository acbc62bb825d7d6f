"""``qpctrl run --video``: what can be filmed, and what is refused before a run."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from PIL import Image

from qpctrl import InputError
from scenarios import cli_run
from scenarios.bimanual import Bimanual
from scenarios.catalogue import SCENARIOS
from scenarios.edge import Edge
from scenarios.eraser import Eraser
from scenarios.gap import Gap
from scenarios.humanoid_wipe import HumanoidWipe
from scenarios.mobile_eraser import MobileEraser
from scenarios.run import run_scenario
from scenarios.scenario import Options, Outcome
from scenarios.video.run import Filmed, film_run

FPS, SIZE = 2.0, (160, 120)


@pytest.mark.parametrize(
    "scenario", [Eraser(duration=0.3), Gap(), Edge()], ids=lambda scenario: scenario.name
)
def test_a_scenario_on_a_board_can_be_filmed(scenario: Any, tmp_path: Path) -> None:
    """The pixels of the tool move, and the arrow of the force comes with the contact."""
    outcome = run_scenario(scenario, Options())
    robot, table, file = outcome.experiment.robot, outcome.table, tmp_path / "run.png"
    film_run(file, scenario.scene(outcome), robot, table, fps=FPS, size=SIZE)
    frames = []
    with Image.open(file) as image:
        for k in range(image.n_frames):
            image.seek(k)
            frames.append(np.asarray(image.convert("RGB")).astype(int))
    assert len(frames) == int(table["time"][-1] * FPS) + 1
    touching = table["touching"][: len(table) : int(1000 / FPS)].to_numpy()[: len(frames)]
    red = np.array([(f[..., 0] - f[..., 1:].max(axis=2) > 60).sum() for f in frames])
    assert red[~touching].max() < red[touching].max()
    assert np.mean([(a != b).any() for a, b in itertools.pairwise(frames)]) > 0.5


@pytest.mark.parametrize(
    "scenario", [MobileEraser(), Bimanual(), HumanoidWipe()], ids=lambda scenario: scenario.name
)
def test_a_whole_body_is_seen_with_the_forces_of_its_contacts(
    scenario: Any, tmp_path: Path
) -> None:
    experiment = scenario.prepare(Options(compiled="no"))
    outcome = Outcome(experiment=experiment, table=pl.DataFrame(), summary={})
    scene, robot = scenario.scene(outcome), experiment.robot
    state = experiment.plant.reset(experiment.q_start)
    row = dict(zip([f"q.{n}" for n in robot.configuration_names], state.q, strict=True))
    red = []
    for size in (0.0, 40.0):
        forces = {f"{name}.f{axis}": size for name in scene.forces for axis in "xyz"}
        film_run(tmp_path / "one.png", scene, robot, pl.DataFrame({"time": [0.0], **row, **forces}))
        with Image.open(tmp_path / "one.png") as image:
            picture = np.asarray(image.convert("RGB")).astype(int)
        assert picture.std() > 20  # there is something to see
        red.append(int((picture[..., 0] - picture[..., 1:].max(axis=2) > 60).sum()))
    assert red[1] > red[0] + 20


def test_the_board_is_seen_to_fall(tmp_path: Path) -> None:
    outcome = run_scenario(Gap(), Options())
    places = Gap().scene(outcome).places(outcome.table)["qpctrl/board"]
    way = places[:, :3, 3] - places[0, :3, 3]
    falls = np.flatnonzero(np.diff(np.linalg.norm(way, axis=1)))
    lost = np.flatnonzero(np.diff(outcome.table["touching"].to_numpy().astype(int)) < 0)
    assert len(falls) == 1
    assert lost[0] == pytest.approx(falls[0], abs=2)
    assert np.linalg.norm(way[-1]) == pytest.approx(Gap().depth)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["press", "--video", "a.gif"], "got scenario 'press', need one with a scene: eraser"),
        (["eraser", "--video", "a.avi"], "unknown suffix of a video '.avi'"),
    ],
)
def test_a_video_that_cannot_be_is_refused_before_the_run(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message):
        cli_run.run_command([*arguments, "--out", "results"])
    assert not list(tmp_path.iterdir())


def test_the_video_is_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[Any] = []
    monkeypatch.setattr(cli_run, "film_run", lambda *given: taken.append(given))
    out, file = tmp_path / "out", tmp_path / "video" / "run.gif"
    flags = ["--duration", "0.3", "--out", str(out), "--video", str(file)]
    cli_run.run_command(["eraser", *flags])
    ((path, scene, robot, table),) = taken
    assert path == file
    assert file.parent.is_dir()
    assert scene.model.nq == robot.nq == 7
    assert table.equals(pl.read_parquet(out / "ticks.parquet"))


def test_scenarios_on_a_board_are_those_with_a_scene() -> None:
    filmed = {name for name, kind in SCENARIOS.items() if issubclass(kind, Filmed)}
    assert {"eraser", "gap", "edge"} <= filmed
    assert "press" not in filmed
