"""A measurement from plan to figures."""

import json
import os
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scenarios.bench.goal import goals
from scenarios.bench.growth import Growth, growth, in_the_way
from scenarios.bench.peer import Beside, beside_peers
from scenarios.bench.plan import Plan
from scenarios.bench.row import Row, Section
from scenarios.bench.suite import build
from scenarios.bench.timing import Timing, clock_cost, one_core, take_turns
from scenarios.processes import THREADS
from scenarios.run import all_or_none, plain, versions, writable_folder
from scenarios.scenario import Criterion

FILES = ("bench.json", "bench.html")
"""What a measurement leaves behind."""

WHAT_IS_TIMED = (
    "A tick is what a loop of a user's makes: a Measurement from arrays that are there, and one "
    "Controller.step with references that are there, other ones each tick; memory is carried on. "
    "Reading the report is not in it."
)
HOW = (
    "All cases take turns, block by block; the first ticks of a block are not kept. Medians are "
    "over all samples; collections of cycles are off; a sample holds one pair of clock readings. "
    "Preempted: ticks in which another process took the core; undisturbed figures leave them out."
)


@dataclass(frozen=True, kw_only=True)
class Result:
    """What was measured, where, and how."""

    plan: Plan
    machine: dict[str, Any]
    clock: Timing
    """What the readings of the clock take that every sample includes."""
    rows: tuple[Row, ...]
    growth: tuple[Growth, ...]
    goals: tuple[Criterion, ...]
    notes: tuple[str, ...]
    """What a reader should know."""
    left_out: tuple[str, ...] = ()
    """What each peer's problem leaves out."""

    def of(self, section: Section) -> list[Row]:
        """Return the lines of one section."""
        return [row for row in self.rows if row.section == section]

    def plain(self) -> dict[str, Any]:
        """Return all of it as JSON knows it."""
        reached = [{**goal._asdict(), "reached": goal.passed} for goal in self.goals]
        found: dict[str, Any] = plain(
            {
                "plan": asdict(self.plan),
                "machine": self.machine,
                "clock_us": self.clock.median_us,
                "what_is_timed": WHAT_IS_TIMED,
                "how": HOW,
                "notes": list(self.notes),
                "rows": [row.plain() for row in self.rows],
                "growth": [asdict(one) for one in self.growth],
                "goals": reached,
                "left_out": list(self.left_out),
            }
        )
        return found


def measure(
    plan: Plan, *, required: bool = False, watch: Callable[[str], None] | None = None
) -> Result:
    """Measure what a plan says, in one run, on one core.

    Args:
        plan: what.
        required: whether code that cannot be compiled is an error.
        watch: called with what is being done.

    Raises:
        InputError: it is one.
    """
    said = watch or (lambda _: None)
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        with one_core() as core:
            clock = clock_cost()
            suite = build(plan, said, required=required)
            take_turns(suite.trials, plan.turns, said)
            rows, first = suite.rows(), suite.ticks[0].loop.compiled
            beside = Beside()
            if plan.peers:
                beside = beside_peers(plan, compiled=first, core=core, watch=said)
    finally:
        _restore(before)
    rows += beside.rows
    grown = growth(rows)
    notes = [*suite.notes, *beside.notes, *_notes(core, before)]
    notes += [words for compiled in (True, False) if (words := in_the_way(grown, compiled))]
    return Result(
        plan=plan,
        machine=_machine(core),
        clock=clock,
        rows=tuple(rows),
        growth=tuple(grown),
        goals=tuple(goals(rows, grown)),
        notes=tuple(notes),
        left_out=beside.left_out,
    )


def _restore(variables: dict[str, str | None]) -> None:
    """Set environment variables to what they were."""
    for name, value in variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def _notes(core: int | None, threads: dict[str, str | None]) -> list[str]:
    """Return what of the machine's state is not as it should be."""
    found = []
    if core is None:
        found.append("not pinned to one core: this system does not let a process choose")
    if "1" not in (threads["OMP_NUM_THREADS"], threads["OPENBLAS_NUM_THREADS"]):
        found.append(
            "OMP_NUM_THREADS was not 1 when numpy was loaded, which may have started more threads; "
            "next time: OMP_NUM_THREADS=1 qpctrl bench"
        )
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    if load > 1.5:
        found.append(f"{load:.1f} processes wanted a core meanwhile: tails and ratios suffer")
    return found


def _machine(core: int | None) -> dict[str, Any]:
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "pinned_to": core,
        "system": f"{platform.system()} {platform.release()}",
        "versions": versions(),
    }


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


def usable_folder(path: Path) -> Path:
    """Return ``path`` as a folder that takes `FILES`.

    Raises:
        InputError: it cannot be made or written.
    """
    return writable_folder(path, FILES)


def write_result(result: Result, page: str, folder: Path) -> None:
    """Write bench.json and bench.html; both of them or none.

    Raises:
        InputError: the folder cannot be written.
    """
    text = json.dumps(result.plain(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with all_or_none(usable_folder(folder)) as staging:
        for name, content in zip(FILES, (text, page), strict=True):
            (staging / name).write_text(content, encoding="utf-8")
