"""The loop: guide, controller, plant, record."""

import gc
import time
from collections.abc import Callable

import numpy as np
import polars as pl

from qpctrl.controller import Measurement
from scenarios.record import Record, Tick
from scenarios.scenario import Experiment


def simulate(
    experiment: Experiment, *, watch: Callable[[float, str], None] | None = None
) -> pl.DataFrame:
    """Run an experiment to its end and return its record, one row a tick.

    A row holds the state at the tick, its command, and what drives make of that in the period
    until the next tick.

    Args:
        experiment: what to run.
        watch: called with the simulated time [s] and the phase, a few times a second.
    """
    controller, plant, guide = experiment.controller, experiment.plant, experiment.guide
    state = plant.reset(experiment.q_start)
    record = Record(controller, driven=state.joints is not None)
    memory = controller.start(experiment.start_mode, experiment.q_start)
    clock, ticks = time.perf_counter_ns, 0
    gc.collect()
    gc.freeze()  # what the loop makes is short-lived; the rest need not be looked at again
    while state.time < experiment.horizon:
        directive = guide.direct(state)
        if directive is None:
            break
        measurement = Measurement(state.time, state.q, state.v, directive.contact)
        started = clock()
        command, report, memory = controller.step(
            directive.mode, measurement, directive.references, memory
        )
        tick_us = (clock() - started) / 1e3
        with np.errstate(over="ignore", invalid="ignore"):  # a plant that diverges; judged later
            after = plant.step(controller.robot.B @ command.tau)
        record.add(Tick(directive, state, command, report, tick_us, after.joints))
        state = after
        ticks += 1
        if watch is not None and ticks % 250 == 0:
            watch(state.time, directive.phase)
    gc.unfreeze()
    return record.table()
