"""The record: each row has its command, and what the joints made of it until the next tick."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from cases import planar_2r

from qpctrl import Controller, InputError, Mode, Status, TaskSpace, Weighted, from_pinocchio
from scenarios import record
from scenarios.brief import QUANTITIES, BriefRecord
from scenarios.environment import Hand
from scenarios.eraser import Eraser
from scenarios.plant import JointReading, Plant, PlantState
from scenarios.plant_compliant import CompliantPlant
from scenarios.record import Record, Tick
from scenarios.scenario import Directive, Experiment, Options
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


@pytest.mark.parametrize(("piece", "sheet"), [(record.PIECE, record.SHEET), (4, 3), (5, 5)])
def test_a_row_has_its_command_and_what_drives_make_of_it_until_the_next(
    piece: int, sheet: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(record, "PIECE", piece)
    monkeypatch.setattr(record, "SHEET", sheet)
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


class Kept(Record):
    """A record beside the ticks that it is made of."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        self.ticks: list[Tick] = []

    def add(self, tick: Tick) -> None:
        """Append one tick."""
        self.ticks.append(tick)
        super().add(tick)


class Blind:
    """A plant whose encoders say nothing after some periods, once."""

    def __init__(self, plant: Plant, period: int) -> None:
        self._plant, self._left = plant, period

    def reset(self, q: np.ndarray) -> PlantState:
        """Return the state at rest."""
        return self._plant.reset(q)

    def step(self, tau: np.ndarray) -> PlantState:
        """Return the state after a period."""
        state, self._left = self._plant.step(tau), self._left - 1
        return state if self._left else state._replace(q=np.full_like(state.q, np.nan))


def cells(tick: Tick, experiment: Experiment) -> dict[str, Any]:
    """Return what a row shall hold, read from what its tick left."""
    directive, state, command, report, tick_us, _ = tick
    graph = experiment.controller.engines[report.mode].tick
    joints = experiment.robot.joint_names
    wrench = ("fx", "fy", "fz", "mx", "my", "mz")
    vectors = {
        **{"q": (state.q, joints), "v": (state.v, joints), "tau": (command.tau, joints)},
        **dict.fromkeys(("tau_delivered", "tau_meas"), (command.tau, joints)),
        **{n: (getattr(report, n), joints) for n in ("tau_qp", "tau_hybrid", "tau_textbook")},
        **{"wrench": (state.wrench, wrench), "wrench_meas": (state.wrench_meas, wrench)},
        "lam": (report.lam, graph.rows.constraint),
    }
    signals = [f"{name}.{i}" for name, size in graph.signals.items() for i in range(size)]
    gaps = ("law_gap", "textbook_gap", "unexplained_gap", "curvature")
    eventful = report.saturated or command.fallback
    return {
        **{"phase": directive.phase, "mode": report.mode, "status": report.status.name},
        **{"contact": directive.contact.name, "fallback": command.fallback},
        **{"touching": state.touching, "saturated": report.saturated},
        "active": ", ".join(limit.name for limit in report.active),
        "explanation": report.explain() if eventful else "",
        **{name: getattr(report, name) for name in (*gaps, "damping", "kkt_residual")},
        **{"time": state.time, "tick_us": tick_us},
        **{
            f"{name}.{part}": float(value)
            for name, (vector, parts) in vectors.items()
            for value, part in zip(vector, parts, strict=True)
        },
        **dict(zip(signals, report.signals.tolist(), strict=True)),
    }


def test_every_cell_is_what_its_tick_left_and_what_a_mode_does_not_have_is_nan() -> None:
    experiment = Eraser().prepare(Options())
    blind = replace(experiment, plant=Blind(experiment.plant, 1450), horizon=1.4995)
    kept = Kept(experiment.controller)
    table = simulate(blind, record=kept)
    assert len(table) == len(kept.ticks) == 1500
    assert set(table["mode"].unique()) == {"free", "contact"}
    assert table["saturated"].any()
    assert table["status"].to_list().count(Status.NOT_FINITE.name) == 1
    for row, tick in zip(table.iter_rows(named=True), kept.ticks, strict=True):
        expected = cells(tick, experiment)
        own = {name: expected.get(name, math.nan) for name in table.columns}
        assert not set(expected) - set(own)
        differ = [name for name in own if not same(row[name], own[name])]
        assert not differ, (row["time"], {name: (row[name], own[name]) for name in differ})


def same(found: Any, expected: Any) -> bool:
    """Return whether two cells are equal, or both not a number."""
    return found == expected or (found != found and expected != expected)


def test_a_brief_record_has_its_columns_and_they_are_those_of_the_full_one() -> None:
    experiment = replace(Eraser().prepare(Options()), horizon=0.3)
    kept, brief = Kept(experiment.controller), BriefRecord(experiment.controller)
    full = simulate(experiment, record=kept)
    for tick in kept.ticks:
        brief.add(tick)
    table = brief.table()
    assert full.select(table.columns).equals(table, null_equal=True)
    signals = experiment.controller.engines["contact"].tick.signals
    assert {name.rpartition(".")[0] or name for name in table.columns} - set(signals) == (
        set(QUANTITIES) - {"signals"}
    )


def test_a_run_without_ticks_leaves_a_table_with_all_columns() -> None:
    experiment = Eraser(plant="rigid").prepare(Options())
    empty = simulate(experiment, until=lambda state: True)
    assert len(empty) == 0
    one = simulate(replace(experiment, horizon=1e-3))
    assert len(one) == 1
    assert empty.schema == one.schema
