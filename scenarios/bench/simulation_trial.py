"""Simulated runs: the plant's step, the eraser against real time, and rollouts of a study."""

import contextlib
import gc
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from qpctrl.arrays import Vector
from qpctrl.compiled import CompileMode
from scenarios.bench.row import Row
from scenarios.bench.timing import timing
from scenarios.eraser import DT, Eraser
from scenarios.plant import PlantState
from scenarios.plant_mujoco import MujocoPlant
from scenarios.scenario import Options
from scenarios.simulation import simulate
from scenarios.study.systems.wipe import Wipe


class Run(NamedTuple):
    """What one run took, and how much time it simulated."""

    wall_s: float
    """Time on the clock [s]."""
    cpu_s: float
    """Time of the core [s]: less, where other processes had it."""
    simulated_s: float
    """Time in the simulation [s]."""


def real_time(runs: Sequence[Run]) -> dict[str, float]:
    """Return simulated time over that on the clock, and over that of the core."""
    simulated = sum(run.simulated_s for run in runs)
    return {
        "realtime_factor": simulated / sum(run.cpu_s for run in runs),
        "realtime_factor_wall": simulated / sum(run.wall_s for run in runs),
    }


@contextlib.contextmanager
def clocked() -> Iterator[list[float]]:
    """Yield a list that, after the block, holds what it took on the clock and on the core [s].

    Collections of cycles are on in the block, as they are in a run.
    """
    was_on, took = gc.isenabled(), list[float]()
    gc.enable()
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        yield took
    finally:
        took += [time.perf_counter() - wall, time.process_time() - cpu]
        if not was_on:
            gc.disable()


class TimedPlant:
    """A MuJoCo plant that notes what each step and its sensors take [ns]."""

    def __init__(self, plant: MujocoPlant, spans: list[tuple[int, int]]) -> None:
        self._plant, self._spans = plant, spans

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq)."""
        return self._plant.reset(q)

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] has acted for one period."""
        clock = time.perf_counter_ns
        started = clock()
        self._plant.advance(tau)
        between = clock()
        state = self._plant.read()
        ended = clock()
        self._spans.append((between - started, ended - between))
        return state


class EraserTrial:
    """Whole runs of `eraser`, as `qpctrl run` makes them but for its files and report."""

    name = "eraser"

    def __init__(self, compile: CompileMode, duration: float, runs: int) -> None:
        """Prepare the trial.

        Args:
            compile: how the controller runs.
            duration: time spent wiping [s].
            runs: how many runs are wanted.
        """
        self.ticks = runs
        self._scenario, self._options = Eraser(duration=duration), Options(compiled=compile)
        self._runs: list[Run] = []
        self._spans: list[tuple[int, int]] = []
        self._compiled = compile != "no"

    def run(self, count: int) -> None:
        """Make ``count`` runs; a look at the clock at each step of the plant is in them."""
        for _ in range(count):
            experiment = self._scenario.prepare(self._options)
            if isinstance(experiment.plant, MujocoPlant):
                experiment = replace(experiment, plant=TimedPlant(experiment.plant, self._spans))
            with clocked() as took:
                table = simulate(experiment)
            self._runs.append(Run(took[0], took[1], float(table["time"][-1])))

    def rows(self) -> list[Row]:
        """Return lines for the plant's step, its sensors, and the whole run."""
        steps, sensors = (timing(spans) for spans in zip(*self._spans, strict=True))
        ticks = timing([run.wall_s * 1e9 / (run.simulated_s / DT) for run in self._runs])
        return [
            Row(
                section="simulation", name="MuJoCo step of the eraser world", timing=steps, joints=7
            ),
            Row(section="simulation", name="its sensors", timing=sensors, joints=7),
            Row(
                section="simulation",
                name="eraser, whole loop",
                timing=ticks,
                joints=7,
                k=3,
                compiled=self._compiled,
                facts={"runs": len(self._runs), **real_time(self._runs)},
            ),
        ]


class RolloutTrial:
    """Rollouts of the system `wipe` as a study makes them: world and controller are kept."""

    name = "rollouts"

    def __init__(self, duration: float, rollouts: int) -> None:
        """Prepare the trial; the first rollout builds what the others use, and is not timed.

        Args:
            duration: time in motion [s].
            rollouts: how many are wanted.
        """
        self.ticks = rollouts
        self._system = Wipe()
        usual = {name: one.usual for name, one in self._system.parameters.items()}
        self._setting = {**usual, "duration": duration, "judged_from": duration / 2}
        self._runs: list[Run] = []
        self._started = False

    def run(self, count: int) -> None:
        """Make ``count`` rollouts."""
        if not self._started:
            self._system.run(self._setting, "qp", seed=0)
            self._started = True
        for _ in range(count):
            with clocked() as took:
                rollout = self._system.run(self._setting, "qp", seed=len(self._runs))
            self._runs.append(Run(took[0], took[1], float(rollout.table["time"][-1])))

    def row(self) -> Row:
        """Return the figures of the rollouts so far."""
        cpu_s = sum(run.cpu_s for run in self._runs)
        return Row(
            section="simulation",
            name="rollout of the study system wipe",
            timing=timing([run.wall_s * 1e9 for run in self._runs]),
            joints=7,
            k=1,
            facts={
                "runs": len(self._runs),
                "rollouts_per_s": len(self._runs) / cpu_s,
                **real_time(self._runs),
            },
        )
