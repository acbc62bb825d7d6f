"""What a study is: a system, what varies in it and how, who controls it, and when it passes."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

import polars as pl

from qpctrl.arrays import Matrix
from qpctrl.errors import InputError, unknown_name
from scenarios.scenario import Criterion
from scenarios.study.design import Design
from scenarios.study.factor import Factor
from scenarios.study.outcome import OutcomeClass
from scenarios.study.search import Boundary, Worst, load_optuna
from scenarios.study.system import Setting, System

Statistic = Literal["max", "mean", "min"]

MOST_REPEATS = 1_000_000

READING = ("summary", "notes", "show", "criteria", "published")
"""Keys of a configuration that say how rows are read; a change of them makes no row anew."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A condition of success: a statistic of a measure over the rollouts is at most ``limit``."""

    measure: str
    """A measure of the rollouts, or a class of outcomes: the share of rollouts that end so."""
    limit: float
    """Largest value, in the unit of the measure."""
    statistic: Statistic = "max"
    """Over all rollouts that have the measure. A gap that is missing where its closed form is
    known is no number, and misses any limit."""
    controllers: tuple[str, ...] = ()
    """Controllers whose rollouts count; none given: all."""

    def __post_init__(self) -> None:
        if self.statistic not in get_args(Statistic):
            raise unknown_name("statistic", self.statistic, get_args(Statistic))
        if self.measure in set(OutcomeClass) and self.statistic != "max":
            raise InputError(f"criterion {self.measure}: a share of rollouts has no statistic")

    @property
    def name(self) -> str:
        """What is judged, in one word each."""
        who = f" of {', '.join(self.controllers)}" if self.controllers else ""
        if self.measure in set(OutcomeClass):
            return f"share {self.measure}{who}"
        return f"{self.statistic} {self.measure}{who}"

    def judge(self, table: pl.DataFrame, *, may_diverge: bool = False) -> Criterion:
        """Return the criterion on the rows of a study.

        Args:
            table: the rows.
            may_diverge: whether rollouts that diverged, and so have no measures, are left out;
                otherwise one of them misses any limit.
        """
        if self.controllers:
            table = table.filter(pl.col("controller").is_in(self.controllers))
        if self.measure in set(OutcomeClass):
            values = (table["outcome"] == self.measure).cast(pl.Float64)
            found = values.mean()
        else:
            values = table[self.measure].drop_nulls()
            diverged = (table["outcome"] == OutcomeClass.DIVERGED).any() and not may_diverge
            missed = diverged or self._unanswered(table)
            found = None if missed else getattr(values, self.statistic)()
        number = float("nan") if found is None else float(found)  # type: ignore[arg-type]
        return Criterion(self.name, number, self.limit, "")

    def _unanswered(self, table: pl.DataFrame) -> bool:
        """Return whether a row has a closed form, but nothing that could be compared with it."""
        closed = self.measure.removesuffix("_gap") + "_closed"
        if not self.measure.endswith("_gap") or closed not in table.columns:
            return False
        return not table.filter(
            pl.col(closed).is_not_null() & pl.col(self.measure).is_null()
        ).is_empty()


@dataclass(frozen=True, kw_only=True)
class Along:
    """What others report of a measure at values of a factor."""

    factor: str
    measure: str
    at: tuple[float, ...]
    """Values of the factor, in its unit."""
    values: tuple[float, ...]
    """Their numbers there, in the unit of the measure; those of ours are means."""

    def __post_init__(self) -> None:
        if len(self.at) != len(self.values) or not self.at:
            raise InputError(
                f"published {self.measure} along {self.factor}: got {len(self.values)} values at "
                f"{len(self.at)} places, need one at each"
            )


@dataclass(frozen=True, kw_only=True)
class Published:
    """What others report of the same job."""

    name: str
    """Their controller."""
    source: str
    """Key into docs/references.md, or an address."""
    note: str = ""
    """What differs from ours."""
    measures: Mapping[str, float] = field(default_factory=dict)
    """Their numbers, by the name of our measure."""
    largest: tuple[str, ...] = ()
    """Measures whose number is the largest over their rollouts; of the others it is the mean."""
    deviations: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation over their rollouts, where they give it."""
    along: tuple[Along, ...] = ()
    """Their numbers along a factor."""

    def __post_init__(self) -> None:
        for name in (*self.largest, *self.deviations):
            if name not in self.measures:
                raise unknown_name(f"measure published by {self.name!r}", name, self.measures)


@dataclass(frozen=True, kw_only=True, eq=False)
class Study:
    """Frozen description of a study; it can be sent to another process, and said in a file."""

    name: str
    summary: str
    system: System
    controllers: tuple[str, ...]
    """They run side by side on every point of the design."""
    factors: tuple[Factor, ...] = ()
    """What varies."""
    fixed: Setting = field(default_factory=dict)
    """Parameters with a value of their own; the rest keep their usual one."""
    design: Design = field(default_factory=Design)
    repeats: int = 1
    """Rollouts at each point, with other random numbers."""
    search: Boundary | Worst | None = None
    """What is sought at each point, by many rollouts; none: a point is one rollout. The worst is
    sought over all factors at once, so there is one point and no design."""
    show: tuple[str, ...] = ()
    """Measures that are printed and drawn, the most telling first."""
    criteria: tuple[Limit, ...] = ()
    published: tuple[Published, ...] = ()
    notes: str = ""
    """What a reader must know: what differs, and why it departs; paragraphs, a blank line apart."""

    def __post_init__(self) -> None:
        self._check_inputs()
        self._check_outputs()

    def _check_inputs(self) -> None:
        parameters, names = self.system.parameters, [factor.name for factor in self.factors]
        _check_names("controller", self.controllers, self.system.controllers)
        _check_names("factor", names, parameters, empty=True)
        for name, value in self.fixed.items():
            if name not in parameters:
                raise unknown_name("parameter", name, parameters)
            if name in names:
                raise InputError(f"parameter {name!r} is fixed and a factor, need one of them")
            parameters[name].value(value, name)
        for factor in self.factors:
            for value in (factor.low, factor.high, *factor.values):
                parameters[factor.name].value(value, factor.name)
        if not 1 <= self.repeats <= MOST_REPEATS:
            raise InputError(f"repeats: got {self.repeats}, need 1 to {MOST_REPEATS}")
        if self.search is not None:
            self.search.check(self.system, names, self.fixed)
        elif not self.factors and self.repeats == 1:
            raise InputError(
                "nothing varies: need a factor (NAME with low and high) or repeats > 1"
            )

    def _check_outputs(self) -> None:
        published = [name for one in self.published for name in one.measures]
        along = [one for other in self.published for one in other.along]
        for name in (*self.show, *published, *(one.measure for one in along)):
            if name not in self.measures:
                raise unknown_name("measure", name, self.measures)
        factors = [factor.name for factor in self.columns]
        for one in along:
            if one.factor not in factors:
                raise unknown_name("factor", one.factor, factors)
        for limit in self.criteria:
            if limit.measure not in (*self.measures, *OutcomeClass):
                raise unknown_name("measure", limit.measure, (*self.measures, *OutcomeClass))
            if limit.controllers:
                _check_names("controller", limit.controllers, self.controllers)
        for factor in self.columns:
            if factor.column in self.measures:
                raise InputError(
                    f"column {factor.column!r} would be both factor and measure of system "
                    f"{self.system.name!r}; the measure needs another name there"
                )

    @property
    def measures(self) -> Mapping[str, str]:
        """Words of each number of a row, by name."""
        if self.search is None:
            return self.system.measures
        return self.search.measures(self.system, self.factors)

    @property
    def columns(self) -> tuple[Factor, ...]:
        """Factors that have a column of their own; those that are searched have a measure."""
        return () if isinstance(self.search, Worst) else self.factors

    def points(self, seed: int) -> Matrix:
        """Return the points of the design (points × columns), in the factors' units.

        Raises:
            InputError: a design that cannot be made, or whose package is not installed.
        """
        if isinstance(self.search, Worst):
            load_optuna()
        usual = {name: p.usual for name, p in self.system.parameters.items()} | dict(self.fixed)
        return self.design.points(self.columns, usual, seed)

    def setting(self, point: Mapping[str, float]) -> Setting:
        """Return the value of every parameter of the system at a point."""
        usual = {name: p.usual for name, p in self.system.parameters.items()}
        return {**usual, **self.fixed, **point}

    def judge(self, table: pl.DataFrame) -> tuple[Criterion, ...]:
        """Return the study's criteria on its rows.

        Rollouts that diverged miss every other criterion, unless one says how many may.
        """
        allowed = [one for one in self.criteria if one.measure == OutcomeClass.DIVERGED]
        may_diverge = any(one.limit > 0 for one in allowed)
        return tuple(limit.judge(table, may_diverge=may_diverge) for limit in self.criteria)

    def configuration(self) -> dict[str, Any]:
        """Return the study as its file would say it, with every default filled in."""
        factors = {
            f.name: {"values": f.values}
            if f.values
            else {"low": f.low, "high": f.high, "distribution": f.distribution}
            for f in self.factors
        }
        plain = {
            **{"name": self.name, "summary": self.summary, "notes": self.notes},
            "system": self.system.name,
            **{"controllers": self.controllers, "repeats": self.repeats, "show": self.show},
            **{"factors": factors, "fixed": dict(self.fixed)},
            **({} if isinstance(self.search, Worst) else {"design": asdict(self.design)}),
            **({self.search.kind: asdict(self.search)} if self.search else {}),
            "criteria": [asdict(limit) for limit in self.criteria],
            "published": [asdict(one) for one in self.published],
        }
        return dict(json.loads(json.dumps(plain, allow_nan=False)))

    def inputs(self) -> dict[str, Any]:
        """Return what its rows depend on: the configuration without what is read from them."""
        return without_reading(self.configuration())


def without_reading(configuration: Mapping[str, Any]) -> dict[str, Any]:
    """Return a configuration without what says only how its rows are read."""
    return {key: value for key, value in configuration.items() if key not in READING}


def _check_names(
    kind: str, given: tuple[str, ...] | list[str], known: Any, *, empty: bool = False
) -> None:
    if not given and not empty:
        raise InputError(f"{kind}s: got none, need at least one of {', '.join(known)}")
    for name in given:
        if name not in known:
            raise unknown_name(kind, name, known)
    if len(set(given)) < len(given):
        raise InputError(f"{kind}s: got {', '.join(given)}, need each once")
