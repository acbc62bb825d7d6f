"""One run of an experiment as a rollout: brief or full record, and an end where it diverges."""

import polars as pl

from scenarios.brief import BriefRecord
from scenarios.plant import PlantState
from scenarios.scenario import Experiment
from scenarios.simulation import simulate, wild
from scenarios.study.system import DivergedError


def run_trial(experiment: Experiment, *, full: bool) -> pl.DataFrame:
    """Return the ticks of an experiment, whose controller starts as if it were new.

    Args:
        experiment: what to run; its controller may have served other rollouts.
        full: whether all that is known of each tick is kept.

    Raises:
        DivergedError: a state that left all bounds.
    """
    experiment.controller.reset()
    gone: list[float] = []

    def until(state: PlantState) -> bool:
        if wild(state):
            gone.append(state.time)
        return bool(gone)

    record = None if full else BriefRecord(experiment.controller)
    table = simulate(experiment, record=record, until=until)
    if gone:
        raise DivergedError(f"left all bounds at {gone[0]:.3f} s", table)
    return table
