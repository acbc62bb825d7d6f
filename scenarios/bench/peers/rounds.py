"""qpctrl and its peers on one problem, in turns: what disturbs the machine disturbs all of them."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from qpctrl.errors import InputError
from scenarios.bench.peers.agreement import Agreement, agreement
from scenarios.bench.peers.folder import SATURATED, UNSATURATED, Course, write
from scenarios.bench.peers.left_out import left_out
from scenarios.bench.peers.run import TIME_LIMIT, PeerError, PeerRun, run_peer
from scenarios.bench.row import Fact, Row
from scenarios.bench.timing import Timing

ROUNDS, TICKS = 5, 4000
"""How often everyone has a turn, and the ticks of each variant in it."""

OURS = "qpctrl"
"""Our name among theirs."""

TIMED = (UNSATURATED, SATURATED)
"""Variants that are timed."""

OurRound: TypeAlias = Callable[[str, int], Row]
"""Times so many ticks of a variant, and says what else is known of them."""


@dataclass(frozen=True, kw_only=True)
class Side:
    """One controller on one variant, round by round."""

    name: str
    variant: str
    rounds: tuple[Timing, ...]
    facts: Mapping[str, Fact]
    """What else is known of it; of a peer the median of each step of a tick [µs]."""

    @property
    def timing(self) -> Timing:
        """Each figure's median over the rounds; the largest sample is that of all of them."""
        return over_rounds(self.rounds)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What `peer_rounds` found."""

    sides: tuple[Side, ...]
    agreements: tuple[Agreement, ...]
    left_out: tuple[str, ...]
    """What each peer's problem leaves out, and how far its answers are from ours."""
    versions: Mapping[str, Mapping[str, str]]
    """Of packages, by peer."""
    faults: tuple[str, ...]
    """One line for each peer that could not be measured, or not to the end."""

    def side(self, name: str, variant: str) -> Side | None:
        """Return one of the sides; none if it was not measured."""
        for side in self.sides:
            if (side.name, side.variant) == (name, variant):
                return side
        return None

    def ratio(self, peer: str, variant: str) -> float | None:
        """Return our tick over a peer's: the median over the rounds that both have."""
        ours, theirs = self.side(OURS, variant), self.side(peer, variant)
        if ours is None or theirs is None:
            return None
        pairs = zip(ours.rounds, theirs.rounds, strict=False)
        return float(np.median([mine.median_us / its.median_us for mine, its in pairs]))

    def rows(self, *, joints: int, compiled: bool) -> tuple[Row, ...]:
        """Return a line for each side.

        Args:
            joints: number of them.
            compiled: whether our ticks ran as generated C.
        """
        return tuple(
            Row(
                section="peer",
                name=f"{side.name}, {side.variant}",
                timing=side.timing,
                joints=joints,
                k=3,
                compiled=compiled if side.name == OURS else None,
                facts={**side.facts, **self._ratios(side)},
            )
            for side in self.sides
        )

    def _ratios(self, side: Side) -> dict[str, Fact]:
        """Return our tick over TSID's, or a peer's over ours."""
        if side.name == OURS:
            found = self.ratio("tsid", side.variant)
            return {} if found is None else {"ours_over_tsid": found}
        found = self.ratio(side.name, side.variant)
        return {} if found is None else {"over_ours": 1 / found}


def over_rounds(rounds: tuple[Timing, ...]) -> Timing:
    """Return the median of each figure over the rounds; samples add up, maxima are kept."""

    def middle(name: str) -> float | None:
        known = [value for one in rounds if (value := getattr(one, name)) is not None]
        return float(np.median(known)) if known else None

    kept = [one.max_kept_us for one in rounds if one.max_kept_us is not None]
    lost = [one.preempted for one in rounds if one.preempted is not None]
    return Timing(
        samples=sum(one.samples for one in rounds),
        median_us=float(np.median([one.median_us for one in rounds])),
        p99_us=middle("p99_us"),
        p999_us=middle("p999_us"),
        max_us=max(one.max_us for one in rounds),
        preempted=sum(lost) if lost else None,
        p999_kept_us=middle("p999_kept_us"),
        max_kept_us=max(kept) if kept else None,
    )


def peer_rounds(
    ours: OurRound,
    variants: Mapping[str, Course],
    pythons: Mapping[str, Path],
    *,
    rounds: int = ROUNDS,
    ticks: int = TICKS,
    core: int | None = None,
    watch: Callable[[str], None] | None = None,
    time_limit: float = TIME_LIMIT,
) -> Comparison:
    """Time our ticks in this process, and the peers' in theirs, in turns; compare their answers.

    Args:
        ours: times our ticks of a variant.
        variants: the problem, of `courses`.
        pythons: of the peers' environments, by name.
        rounds: turns of everyone.
        ticks: of each variant in a turn.
        core: on which the peers shall run: the one on which this process does.
        watch: called with the name of who has a turn.
        time_limit: of one turn of a peer [s].

    Raises:
        InputError: a number that cannot be used.
    """
    if min(rounds, ticks) < 1:
        raise InputError(f"rounds and ticks: got {rounds} and {ticks}, need numbers >= 1")
    said = watch or (lambda _: None)
    with tempfile.TemporaryDirectory(prefix="qpctrl-peers-") as name:
        turns = _Turns(variants, Path(name), pythons, time_limit)
        turns.check(said)
        turns.prepare(ticks, core)
        for _ in range(rounds):
            said(OURS)
            for variant in TIMED:
                turns.ours(variant, ours(variant, ticks))
            turns.peers(said)
    return turns.comparison()


class _Turns:
    """Whose turn it is, and what came out so far."""

    def __init__(
        self,
        variants: Mapping[str, Course],
        folder: Path,
        pythons: Mapping[str, Path],
        time_limit: float,
    ) -> None:
        self._variants, self._folder = variants, folder
        self._pythons, self._limit = dict(pythons), time_limit
        self._timings: dict[tuple[str, str], list[Timing]] = {}
        self._facts: dict[tuple[str, str], list[Mapping[str, Fact]]] = {}
        self._agreements: list[Agreement] = []
        self._left_out: list[str] = []
        self._versions: dict[str, Mapping[str, str]] = {}
        self._faults: list[str] = []

    def check(self, said: Callable[[str], None]) -> None:
        """Let each peer answer every tick of every variant once, and compare."""
        ticks = min(one.problem.ticks for one in self._variants.values())
        write(self._variants, self._folder, ticks=ticks, core=None)
        free = self._variants[UNSATURATED].answer
        for peer in list(self._pythons):
            said(f"{peer}, its answers")
            run = self._run(peer, self._variants)
            if run is None:
                continue
            found = {
                name: agreement(peer, name, course, free, run.courses[name])
                for name, course in self._variants.items()
            }
            self._agreements += found.values()
            self._left_out += left_out(peer, run, found)
            self._versions[peer] = run.versions

    def prepare(self, ticks: int, core: int | None) -> None:
        """Write what is timed."""
        self._timed = {name: self._variants[name] for name in TIMED}
        write(self._timed, self._folder, ticks=ticks, core=core)

    def ours(self, variant: str, row: Row) -> None:
        """Keep a turn of ours."""
        self._keep(OURS, variant, row.timing, row.facts)

    def _keep(self, name: str, variant: str, one: Timing, facts: Mapping[str, Fact]) -> None:
        self._timings.setdefault((name, variant), []).append(one)
        self._facts.setdefault((name, variant), []).append(facts)

    def peers(self, said: Callable[[str], None]) -> None:
        """Give every peer a turn."""
        for peer in list(self._pythons):
            said(peer)
            run = self._run(peer, self._timed)
            if run is None:
                continue
            for variant, course in run.courses.items():
                parts = {f"{part} [µs]": value for part, value in course.parts_us.items()}
                self._keep(peer, variant, course.timing, parts)

    def _run(self, peer: str, variants: Mapping[str, Course]) -> PeerRun | None:
        """Return a run of a peer; one that fails is said, and has no further turns."""
        python = self._pythons[peer]
        torques = {name: one.problem.robot.nu for name, one in variants.items()}
        try:
            return run_peer(peer, python, torques, self._folder, time_limit=self._limit)
        except PeerError as error:
            self._faults.append(str(error))
            del self._pythons[peer]
            return None

    def comparison(self) -> Comparison:
        """Return what came out."""
        return Comparison(
            sides=tuple(
                Side(
                    name=name,
                    variant=variant,
                    rounds=tuple(rounds),
                    facts=_together(self._facts[name, variant]),
                )
                for (name, variant), rounds in self._timings.items()
            ),
            agreements=tuple(self._agreements),
            left_out=tuple(self._left_out),
            versions=self._versions,
            faults=tuple(self._faults),
        )


def _together(rounds: list[Mapping[str, Fact]]) -> dict[str, Fact]:
    """Return facts of all rounds: the largest residual, the median of other numbers."""
    found: dict[str, Fact] = {}
    for name, last in rounds[-1].items():
        numbers = [value for one in rounds if isinstance(value := one[name], float)]
        whole = max if name.endswith("_max") else np.median
        found[name] = float(whole(numbers)) if len(numbers) == len(rounds) else last
    return found
