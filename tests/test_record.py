"""The record: each row has its command, and what the joints made of it until the next tick."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from cases import planar_2r

from qpctrl import Controller, InputError, Mode, TaskSpace, Weighted, from_pinocchio
from scenarios import record
from scenarios.environment import Hand
from scenarios.plant import JointReading, Plant, PlantState
from scenarios.plant_compliant import CompliantPlant
from scenarios.scenario import Directive, Experiment
from scenarios.simulation import simulate
from tasks import MotionReference, MotionTask, PostureTask

TICKS, SPACE = 10, TaskSpace("tool", ("vx",))
B = np.array([[2.0], [0.0]])
"""One motor, with a transmission of 2, on the first joint of two."""


class Drives:
    """A plant whose drives deliver and read numbers that tell the period."""

    def __init__(self, plant: Plant, silent: frozenset[int]) -> None:
        self._plant, self._silent = plant, silent
        self.asked: list[np.ndarray] = []

    def reset(self, q: np.ndarray) -> PlantState:
        """Return the state at rest."""
        return self._read(self._plant.reset(q))

    def step(self, tau: np.ndarray) -> PlantState:
        """Return the state after a period."""
        self.asked.append(tau.copy())
        return self._read(self._plant.step(tau))

    def _read(self, state: PlantState) -> PlantState:
        period = len(self.asked)
        if period in self._silent:
            return state
        numbers = (np.array([hundreds + period]) for hundreds in (100.0, 200.0, 300.0, 400.0))
        return state._replace(joints=JointReading(*numbers, limited=period % 3 == 0))


class Hold:
    """Holds the tool where it starts, for some ticks."""

    def __init__(self, reference: MotionReference) -> None:
        self._references = {"motion": reference}

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do."""
        return (
            None if state.time > (TICKS - 0.5) * 1e-3 else Directive("hold", "m", self._references)
        )


def run(silent: frozenset[int] | None = frozenset()) -> tuple[pl.DataFrame, Plant]:
    """Return the record of a planar arm that holds its tool, and its plant; none: no drives."""
    robot = from_pinocchio(planar_2r().model, home=np.array([0.4, 0.9]), B=B, tau_rate=1e9)
    plant: Plant = CompliantPlant(robot, "tool", Hand(lambda time: np.eye(6)[0]))
    plant = plant if silent is None else Drives(plant, silent)
    motion, posture = MotionTask(space=SPACE, K_p=100.0, K_d=20.0), PostureTask(q_ref=robot.home)
    mode = Mode(name="m", tasks=(Weighted(motion), Weighted(posture)))
    reference = MotionReference(X_WD=robot.pose(robot.home, "tool"))
    experiment = Experiment(
        robot=robot,
        controller=Controller(robot, [mode]),
        plant=plant,
        guide=Hold(reference),
        start_mode="m",
        q_start=robot.home,
        horizon=1.0,
        geometry={},
    )
    return simulate(experiment), plant


@pytest.mark.parametrize("piece", [record.PIECE, 4])
def test_a_row_has_its_command_and_what_drives_make_of_it_until_the_next(
    piece: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(record, "PIECE", piece)
    table, plant = run()
    record.write_parquet(table, tmp_path / "ticks.parquet")
    assert pl.read_parquet(tmp_path / "ticks.parquet").equals(table, null_equal=True)
    period = np.arange(1, TICKS + 1)
    assert table["time"].to_numpy() == pytest.approx(1e-3 * (period - 1))
    assert np.abs(np.diff(table["tau.shoulder"].to_numpy())).min() > 0
    assert 2 * table["tau.shoulder"].to_numpy() == pytest.approx(np.array(plant.asked)[:, 0])
    by_joint = {"tau_delivered": 2 * (100 + period), "tau_meas": 2 * (200 + period)}
    for name, expected in by_joint.items():
        assert table[f"{name}.shoulder"].to_list() == expected.tolist()
        assert not table[f"{name}.elbow"].to_numpy().any()
    assert table["current.shoulder"].to_list() == (300 + period).tolist()
    assert table["voltage.shoulder"].to_list() == (400 + period).tolist()
    assert table["motor_limited"].dtype == pl.Boolean
    assert table["motor_limited"].to_list() == (period % 3 == 0).tolist()
    assert not {"current.elbow", "voltage.elbow"} & set(table.columns)


def test_ideal_joints_deliver_and_measure_the_command_and_have_no_motors() -> None:
    table, _ = run(silent=None)
    commanded = 2 * table["tau.shoulder"].to_numpy()
    assert np.abs(commanded).max() > 1.0
    for name in ("tau_delivered", "tau_meas"):
        assert np.array_equal(table[f"{name}.shoulder"].to_numpy(), commanded)
        assert not table[f"{name}.elbow"].to_numpy().any()
    driven, _ = run()
    assert [name for name in driven.columns if name not in table.columns] == [
        *("motor_limited", "current.shoulder", "voltage.shoulder")
    ]
    assert [name for name in driven.columns if name in table.columns] == table.columns


@pytest.mark.parametrize(
    ("silent", "words"),
    [
        (frozenset({4}), "got none in a tick, need one"),
        (frozenset({0}), "got one in a tick, need none"),
    ],
    ids=["fell silent", "spoke up"],
)
def test_drives_that_speak_now_and_then_are_refused(silent: frozenset[int], words: str) -> None:
    with pytest.raises(InputError, match=f"joint reading: {words}"):
        run(silent=silent)
