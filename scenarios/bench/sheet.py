"""The results as tables, the same ones on the console and on the page."""

from collections.abc import Sequence
from dataclasses import dataclass

from scenarios.bench.growth import Growth
from scenarios.bench.part_trial import WORDS
from scenarios.bench.result import Result
from scenarios.bench.row import Row
from scenarios.report_style import number


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """One table; the first column says what a line is about, the others are figures."""

    title: str
    caption: str
    heads: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...] = ()
    """What is to be said below, line by line."""
    words: bool = False
    """Whether the last column is text."""

    def is_figure(self, column: int) -> bool:
        """Return whether a column holds figures, not words."""
        last = column == len(self.heads) - 1
        return column > 0 and self.heads[column] != "code" and not (last and self.words)


TIMES = ("median", "p99", "p99.9", "undisturbed", "max", "ticks")


def sheets(result: Result) -> list[Sheet]:
    """Return the tables that have lines, in the order in which they are read."""
    made = [
        *(_parts(result), _ticks(result), _solvers(result), _saturated(result), _paced(result)),
        *(_growth(result), _simulation(result), _peers(result), _goals(result)),
    ]
    return [sheet for sheet in made if sheet.lines]


def code(compiled: bool | None) -> str:
    """Return how a line's ticks ran."""
    return "" if compiled is None else "compiled" if compiled else "interpreted"


def times(row: Row) -> tuple[str, ...]:
    """Return the figures of a line, in the order of `TIMES`."""
    t = row.timing
    figures = (t.median_us, t.p99_us, t.p999_us, t.p999_kept_us, t.max_us)
    return (*(number(x) if x is not None else "–" for x in figures), number(t.samples, 6))


def _parts(result: Result) -> Sheet:
    own = [row for row in result.of("part") if row.joints == 7]
    lines = tuple(
        (
            row.name,
            code(row.compiled),
            *(_plain(x) for x in row.timing[1:3]),
            WORDS.get(row.name, ""),
        )
        for row in own
    )
    return Sheet(
        title="Parts of a tick, 7 joints, k = 3 [µs]",
        caption="Each part once more, on the data of a tick that was just made. What calling a "
        "compiled part by itself takes is taken off, but for the one call that the tick makes. "
        "Python around them is the whole less that call, and holds what cold caches cost it.",
        heads=("part", "code", "median", "p99", "what it is"),
        lines=lines,
        words=True,
    )


def _ticks(result: Result) -> Sheet:
    lines = tuple(
        (
            *(f"{row.name}, k = {row.k}", code(row.compiled), *times(row)),
            *(number(row.timing.preempted), _fact(row, "kkt_max", 2), _fact(row, "ready_s", 2)),
        )
        for row in result.of("tick")
    )
    return Sheet(
        title="Whole ticks, Controller.step [µs]",
        caption="undisturbed: p99.9 of the ticks in which no other process took the core; KKT: "
        "largest residual; ready: time to build the controller (to compile anew: "
        "QPCTRL_CACHE=$(mktemp -d) qpctrl bench).",
        heads=("robot", "code", *TIMES, "preempted", "KKT", "ready [s]"),
        lines=lines,
    )


def _solvers(result: Result) -> Sheet:
    rows = {row.name: row for row in result.of("solver")}
    lines = []
    for name, row in rows.items():
        if name.endswith(", alone"):
            continue
        alone = rows.get(f"{name}, alone")
        own = (_plain(alone.median_us), _fact(alone, "kkt_max", 2)) if alone else ("–", "–")
        figures = (_plain(row.median_us), _plain(row.timing.p99_us), _fact(row, "kkt_max", 2))
        lines.append((name, code(row.compiled), *figures, *own))
    return Sheet(
        title="Solvers of the QP, 7 joints, k = 3, the same ticks [µs]",
        caption="tick: Controller.step with this solver, whose answer is polished on its active "
        "set; alone: the solver by itself on the same QPs, called from Python, or in C where the "
        "compiled tick holds it, and the KKT residual of its answer, the largest over all.",
        heads=("solver", "code", "tick", "p99", "KKT", "alone", "KKT alone"),
        lines=tuple(lines),
    )


def _saturated(result: Result) -> Sheet:
    own = result.of("saturated")
    lines = tuple(
        (
            *(row.name, code(row.compiled), *times(row), _fact(row, "limits_mean")),
            _fact(row, "ratio"),
        )
        for row in own
    )
    return Sheet(
        title="Torque limits that bind, 7 joints, k = 3 [µs]",
        caption="active: limits that are active in a tick, their mean; ratio: to no joint limited, "
        "the median over turns that are next to each other.",
        heads=("limits", "code", *TIMES, "active", "ratio"),
        lines=lines,
    )


def _paced(result: Result) -> Sheet:
    own = result.of("paced")
    code_of = {row.compiled for row in own}
    first = [row for row in result.of("tick") if row.joints == 7 and row.k == 3]
    lines = tuple(
        ("back to back" if row.section == "tick" else row.name, code(row.compiled), *times(row))
        for row in (*(r for r in first if r.compiled in code_of), *own)
    )
    return Sheet(
        title="Paced at 1 kHz, 7 joints, k = 3 [µs]",
        caption="Asleep between ticks others use the core, and its caches and clock rate are not "
        "what they were; awake only the tick's own data has to be fetched again.",
        heads=("pace", "code", *TIMES),
        lines=lines if own else (),
    )


def _growth(result: Result) -> Sheet:
    grown = result.growth
    joints = sorted({n for one in grown for n in one.joints})
    lines = tuple(
        (
            *(one.part, code(one.compiled), *_over(one, joints)),
            *(" ".join(f"{p:.1f}" for p in one.powers), f"{one.power:.2f}"),
        )
        for one in grown
    )
    return Sheet(
        title="Growth with the number of joints, k = 3 [µs]",
        caption="Medians, and p in t ~ nᵖ from each number of joints to the next and of all of "
        "them. Arms in series: every joint moves the tool, so M has no zero entry.",
        heads=("part", "code", *(f"n = {n}" for n in joints), "p, step by step", "p"),
        lines=lines,
    )


def _over(one: Growth, joints: Sequence[int]) -> list[str]:
    known = dict(zip(one.joints, one.median_us, strict=True))
    return [number(known[n]) if n in known else "–" for n in joints]


def _simulation(result: Result) -> Sheet:
    lines = tuple(
        (
            *(row.name, code(row.compiled), _plain(row.median_us), number(row.timing.samples, 6)),
            *(_fact(row, "realtime_factor"), _fact(row, "realtime_factor_wall")),
            _fact(row, "rollouts_per_s"),
        )
        for row in result.of("simulation")
    )
    return Sheet(
        title="Simulation, one core",
        caption="× real time: simulated time over that of the core, and over that on the clock; "
        "the whole loop of eraser is given for each of its ticks.",
        heads=("what", "code", "median [µs]", "samples", "× real time", "on the clock", "1/s"),
        lines=lines,
    )


def _peers(result: Result) -> Sheet:
    lines = tuple(
        (
            *(row.name, *times(row), _fact(row, "kkt_max", 2)),
            *(_fact(row, "over_ours"), _fact(row, "ours_over_tsid")),
        )
        for row in result.of("peer")
    )
    return Sheet(
        title="Beside the peers, one problem [µs]",
        caption="saturated: two joints reach their limits, each half of the time; ratios: median "
        "over turns that are next to each other.",
        heads=("controller", *TIMES, "KKT", "× ours", "ours / TSID"),
        lines=lines,
        remarks=result.left_out,
    )


def _goals(result: Result) -> Sheet:
    lines = tuple(
        (
            *(goal.name, f"{number(goal.value)} {goal.unit}".strip()),
            *(f"≤ {number(goal.limit)} {goal.unit}".strip(), "yes" if goal.passed else "no"),
        )
        for goal in result.goals
    )
    return Sheet(
        title="Goals",
        caption="A goal that is missed fails nothing: times depend on the machine.",
        heads=("what", "found", "goal", "reached"),
        lines=lines,
    )


def _plain(value: float | None) -> str:
    return "–" if value is None else number(value)


def _fact(row: Row, name: str, digits: int = 3) -> str:
    value = row.facts.get(name)
    return "–" if value is None else number(value, digits)
