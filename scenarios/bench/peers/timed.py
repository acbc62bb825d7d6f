"""What the peers' scripts share: reading the problem, timing ticks on one core, writing answers.

It runs in a peer's Python beside the script that imports it, and knows numpy alone.
"""

import gc
import json
import os
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

WARM = 100
"""Ticks before the first that is kept."""

KNOWN = hasattr(resource, "RUSAGE_THREAD")
"""Whether it is known in which samples another process took the core."""


class Given(NamedTuple):
    """The problem, as it was written into a folder."""

    folder: Path
    out: Path
    facts: dict[str, Any]
    """Numbers and names, of problem.json."""
    arrays: dict[str, np.ndarray]
    """Of arrays.npz."""

    def rows(self, name: str) -> list[np.ndarray]:
        """Return the rows of an array, each of its own: taking one out is not timed then."""
        return [np.ascontiguousarray(row) for row in self.arrays[name]]


class Ticks(NamedTuple):
    """One peer on one variant of the problem, ready to run."""

    whole: Callable[[int], tuple[bool, np.ndarray, np.ndarray]]
    """Answer a tick: whether it has a solution, torque [Nm], force on the robot [N]."""
    parts: dict[str, Callable[[int], object]]
    """The same in steps, each with the tick's number."""
    scene: object
    """What must live as long: the peers' own objects don't keep each other."""


def given() -> Given:
    """Return the problem that the command line names: FOLDER, and OUT for the answers."""
    folder, out = (Path(word) for word in sys.argv[1:3])
    facts = json.loads((folder / "problem.json").read_text())
    if facts["core"] is not None:
        os.sched_setaffinity(0, {facts["core"]})
    with np.load(folder / "arrays.npz") as file:
        arrays = dict(file)
    return Given(folder, out, facts, arrays)


def model_gaps(
    problem: Given, terms: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
) -> dict[str, float]:
    """Return the largest differences of M [kg m²] and h [Nm] from those that were handed over."""
    gaps = {"M": 0.0, "h": 0.0}
    names = ("check_q", "check_v", "check_M", "check_h")
    for q, v, M, h in zip(*(problem.arrays[name] for name in names), strict=True):
        M_found, h_found = terms(q, v)
        gaps["M"] = max(gaps["M"], float(np.abs(M_found - M).max()))
        gaps["h"] = max(gaps["h"], float(np.abs(h_found - h).max()))
    return gaps


def run(problem: Given, build: Callable[[str], Ticks], about: dict[str, Any]) -> None:
    """Time every variant, write the answers to OUT, and print what is known of them as JSON.

    Args:
        problem: of `given`.
        build: returns the ticks of a variant, by name.
        about: what else to print.
    """
    found: dict[str, Any] = {}
    for variant in problem.facts["variants"]:
        ticks = build(variant)
        gc.collect()
        gc.freeze()
        gc.disable()
        timed = _time(ticks, problem.facts["ticks"], len(problem.arrays["q"]))
        found |= {f"{variant} {name}": value for name, value in timed.items()}
        gc.unfreeze()
        gc.enable()
    np.savez(problem.out, **found)
    print(json.dumps({**about, "parts": list(ticks.parts)}))


def _time(ticks: Ticks, count: int, length: int) -> dict[str, np.ndarray]:
    """Return times [ns] and answers of one variant, whose path closes after ``length`` ticks."""
    clock, whole = time.perf_counter_ns, ticks.whole
    samples, lost, solved, tau, force = [], [], [], [], []
    for i in range(-WARM, count):
        k = i % length
        before = _preemptions()
        started = clock()
        good, torque, pushed = whole(k)
        ended = clock()
        if i < 0:
            continue
        samples.append(ended - started)
        lost.append(_preemptions() > before)
        solved.append(good)
        tau.append(np.array(torque))
        force.append(np.array(pushed))
    parts = np.zeros((count, len(ticks.parts)), dtype=np.int64)
    for i in range(count):
        k = i % length
        for j, part in enumerate(ticks.parts.values()):
            started = clock()
            part(k)
            parts[i, j] = clock() - started
    return {
        "samples": np.array(samples),
        **({"lost": np.array(lost)} if KNOWN else {}),
        "solved": np.array(solved),
        "tau": np.array(tau),
        "force": np.array(force),
        "parts": parts,
    }


def _preemptions() -> int:
    """Return how often another process has taken the core from this thread so far."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nivcsw if KNOWN else 0
