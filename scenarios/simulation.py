"""The loop: guide, controller, plant, record."""

import gc
import math
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np
import polars as pl

from qpctrl.memory import Measurement
from scenarios.plant import PlantState
from scenarios.record import Record, Tick
from scenarios.scenario import Experiment

WILD_SPEED = 1e3  # m/s or rad/s
WILD_FORCE = 1e7  # N or Nm


class Recorder(Protocol):
    """Keeps what it wants of every tick."""

    def add(self, tick: Tick) -> None:
        """Append one tick."""

    def table(self) -> pl.DataFrame:
        """Return what was kept, one row a tick."""


def simulate(
    experiment: Experiment,
    *,
    record: Recorder | None = None,
    watch: Callable[[float, str], None] | None = None,
    until: Callable[[PlantState], bool] | None = None,
) -> pl.DataFrame:
    """Run an experiment to its end and return its record, one row a tick.

    A row holds the state at the tick, its command, and what drives make of that in the period
    until the next tick.

    Args:
        experiment: what to run.
        record: what is kept; default: everything.
        watch: called with the simulated time [s] and the phase, a few times a second.
        until: ends the run at a state for which it is true.
    """
    controller, plant, guide = experiment.controller, experiment.plant, experiment.guide
    B = controller.robot.B
    all_driven = np.array_equal(B, np.eye(len(B)))
    state = plant.reset(experiment.q_start)
    driven = state.joints is not None
    kept = (
        Record(controller, driven=driven, contacts=experiment.contacts)
        if record is None
        else record
    )
    memory = controller.start(experiment.start_mode, experiment.q_start)
    clock, ticks = time.perf_counter_ns, 0
    gc.collect(1)  # a full collection takes as long as a thousand ticks
    gc.freeze()  # what the loop makes is short-lived; the rest need not be looked at again
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a plant that diverges
            while state.time < experiment.horizon and not (until is not None and until(state)):
                directive = guide.direct(state)
                if directive is None:
                    break
                measurement = Measurement(state.time, state.q, state.v, directive.contact)
                started = clock()
                command, report, memory = controller.step(
                    directive.mode, measurement, directive.references, memory
                )
                tick_us = (clock() - started) / 1e3
                after = plant.step(command.tau if all_driven else B @ command.tau)
                kept.add(Tick(directive, state, command, report, tick_us, after.joints))
                state = after
                ticks += 1
                if watch is not None and ticks % 250 == 0:
                    watch(state.time, directive.phase)
    finally:
        gc.unfreeze()
    return kept.table()


def wild(state: PlantState) -> bool:
    """Return whether a plant has left all bounds."""
    v, F = state.v, state.wrench
    size = max(float(v.dot(v)) / WILD_SPEED**2, float(F.dot(F)) / WILD_FORCE**2)
    return not (size <= 1.0 and math.isfinite(float(state.q.dot(state.q))))
