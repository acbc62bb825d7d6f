"""Figures of many samples of a time, and how they are taken: in turns, on one core."""

import contextlib
import gc
import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from qpctrl.arrays import Vector

try:
    import resource
except ImportError:  # there is none on Windows
    KNOWN = False
else:
    KNOWN = hasattr(resource, "RUSAGE_THREAD")
"""Whether `preemptions` can tell."""


class Timing(NamedTuple):
    """Figures of the samples of one item. A percentile is the sample at its rank."""

    samples: int
    median_us: float
    p99_us: float | None
    """None where there are fewer than 100 samples."""
    p999_us: float | None
    """None where there are fewer than 1000 samples."""
    max_us: float
    preempted: int | None = None
    """Samples in which another process took the core; none where that is not known."""
    p999_kept_us: float | None = None
    """The 99.9th percentile of the others."""
    max_kept_us: float | None = None
    """The largest of the others."""


class Trial(Protocol):
    """Something that is timed, a block of samples at a time."""

    @property
    def name(self) -> str:
        """What it is."""

    @property
    def ticks(self) -> int:
        """Samples that are wanted, all rounds together."""

    def run(self, count: int) -> None:
        """Take ``count`` samples, after some that are not kept."""


@dataclass(frozen=True, kw_only=True)
class Rounds:
    """How trials take turns."""

    rounds: int
    """Blocks of each trial."""
    longest: float
    """Time [s] that one trial may take, all rounds together; it gets fewer samples then."""
    usual: int = 1
    """Samples of the usual trial; who wants a multiple of it may take as much more time."""

    def limit(self, ticks: int) -> float:
        """Return the time [s] that a trial with so many samples may take."""
        return self.longest * max(1.0, ticks / self.usual)


def timing(samples_ns: Sequence[float] | Vector, lost: Sequence[bool] | None = None) -> Timing:
    """Return the figures of samples [ns].

    Args:
        samples_ns: at least one.
        lost: for each of them whether another process took the core meanwhile, if that is known.
    """
    given = np.asarray(samples_ns, dtype=np.float64) / 1e3
    ordered = np.sort(given)
    found = Timing(
        samples=len(ordered),
        median_us=float(np.median(ordered)),
        p99_us=_at_rank(ordered, 0.99),
        p999_us=_at_rank(ordered, 0.999),
        max_us=float(ordered[-1]),
    )
    if lost is None:
        return found
    kept = np.sort(given[~np.asarray(lost, dtype=bool)])
    return found._replace(
        preempted=len(ordered) - len(kept),
        p999_kept_us=_at_rank(kept, 0.999),
        max_kept_us=float(kept[-1]) if len(kept) else None,
    )


def _at_rank(ordered: Vector, share: float) -> float | None:
    """Return the smallest value that ``share`` of them do not exceed; none if that is the last."""
    rank = math.ceil(round(share * len(ordered), 9))
    return float(ordered[rank - 1]) if 0 < rank < len(ordered) else None


def ratio(blocks: Sequence[float], others: Sequence[float]) -> float:
    """Return how many times one trial takes what another takes.

    Args:
        blocks: medians of its turns.
        others: those of the other trial, whose turns are next to them: what slows the machine down
            for a while is in both. Where there are more or fewer, both are taken as a whole.
    """
    own, other = np.asarray(blocks, dtype=np.float64), np.asarray(others, dtype=np.float64)
    if len(own) != len(other):
        return float(np.median(own) / np.median(other))
    return float(np.median(own / other))


def preemptions() -> int:
    """Return how often another process has taken the core from this thread so far."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw if KNOWN else 0


def take_turns(
    trials: Sequence[Trial], rounds: Rounds, watch: Callable[[str], None] | None = None
) -> None:
    """Run every trial in every round, so that what disturbs the machine disturbs all of them.

    Args:
        trials: in the order of their turns; a trial that wants fewer samples than there are
            rounds sits some of them out, one that wants many has several turns in each.
        rounds: how many.
        watch: called with the name of a trial before each of its turns.
    """
    wanted = [_affordable(trial, rounds.limit(trial.ticks)) for trial in trials]
    with without_garbage_collection():
        for turn in range(rounds.rounds):
            due = [_share(ticks, turn, rounds.rounds) for ticks in wanted]
            for at, count in turns(due, -(-rounds.usual // rounds.rounds)):
                if watch is not None:
                    watch(trials[at].name)
                trials[at].run(count)
            gc.collect(1)


def turns(due: Sequence[int], block: int) -> list[tuple[int, int]]:
    """Return who takes how many samples, turn by turn, in blocks of about that size.

    Args:
        due: samples of each trial in this round.
        block: samples of a turn; who has more to take has turns all over the round.
    """
    found = []
    for i, count in enumerate(due):
        blocks = -(-count // block)
        for j in range(blocks):
            place = (j + 0.5) / blocks if blocks > 1 else (i + 0.5) / len(due)
            found.append((place, i, _share(count, j, blocks)))
    return [(i, count) for _, i, count in sorted(found)]


def _share(whole: int, part: int, parts: int) -> int:
    """Return how much of a whole number falls on one of so many parts; all sum up to it."""
    return whole * (part + 1) // parts - whole * part // parts


def _affordable(trial: Trial, longest: float) -> int:
    """Return how many samples a trial can take in its time, at least one."""
    if trial.ticks < TRIED:
        return trial.ticks
    started = time.perf_counter()
    trial.run(TRIED)
    cost = (time.perf_counter() - started) / TRIED
    return max(1, min(trial.ticks, int(longest / cost)))


TRIED = 25
"""Samples from which the cost of a trial is told; they count like any other."""


@contextlib.contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Let no collection of cycles fall into the block."""
    was_on = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if was_on:
            gc.enable()


@contextlib.contextmanager
def one_core() -> Iterator[int | None]:
    """Stay on one core in the block, and yield its number; None where that cannot be asked for.

    It is the last of those allowed: interrupts tend to go to the first.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield None
        return
    allowed = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {max(allowed)})
    except OSError:
        yield None
        return
    try:
        yield max(allowed)
    finally:
        os.sched_setaffinity(0, allowed)


def clock_cost() -> Timing:
    """Return what a pair of readings of the clock takes, which every sample includes."""
    clock = time.perf_counter_ns
    samples = []
    for _ in range(2000):
        started = clock()
        samples.append(clock() - started)
    return timing(samples)
