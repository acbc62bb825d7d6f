"""Searches: what a study seeks at each point of its design, by many rollouts of the same system.

A row of such a study is one search, made in one place from one seed, so it is as repeatable as
a rollout.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias, get_args

from qpctrl.errors import InputError, unknown_name
from scenarios.bisection import boundary
from scenarios.study.factor import Factor
from scenarios.study.outcome import OutcomeClass
from scenarios.study.system import Measures, Setting, System

FINEST = 1e-9
"""Smallest tolerance of a bisection over its range; rounding is far below."""
WORST_OF_ALL = (OutcomeClass.DIVERGED, OutcomeClass.LOST)
"""Outcomes that no number is worse than."""

Scale = Literal["linear", "log"]


class Trial(NamedTuple):
    """What became of one rollout, or of a search."""

    outcome: OutcomeClass
    reason: str
    measures: Measures


Attempt: TypeAlias = Callable[[Setting], Trial]
"""Makes one rollout."""


class Place(NamedTuple):
    """Where a search is made."""

    system: System
    factors: tuple[Factor, ...]
    """Those of the study."""
    setting: Setting
    """Value of every parameter that is not sought."""
    controller: str
    seed: int


@dataclass(frozen=True, kw_only=True)
class Boundary:
    """Bisection: up to which value of a parameter a measure stays within its limit.

    The measure holds at ``low`` and not at ``high``; a rollout without it, such as one that
    diverged, does not hold. Where it turns several times, one of the turns is found.
    """

    kind: ClassVar[str] = "boundary"

    parameter: str
    """What is raised from ``low`` to ``high``."""
    low: float
    high: float
    measure: str
    """What shall be at most ``limit``."""
    limit: float
    scale: Scale = "linear"
    """Where the middle of an interval is."""
    tolerance: float = 0.01
    """Width of the last interval; linear: in the parameter's unit, log: relative."""

    def check(self, system: System, factors: Sequence[str], fixed: Setting) -> None:
        """Refuse what the system does not have, and ends that cannot be used.

        Raises:
            InputError: it names the key.
        """
        name = self.parameter
        if name not in system.parameters:
            raise unknown_name("parameter", name, system.parameters)
        if name in (*factors, *fixed):
            raise InputError(f"boundary: parameter {name!r} is a factor or fixed too")
        if system.parameters[name].whole:
            raise InputError(f"boundary: parameter {name!r} takes whole numbers; vary it instead")
        if self.measure not in system.measures:
            raise unknown_name("measure", self.measure, system.measures)
        if self.scale not in get_args(Scale):
            raise unknown_name("boundary scale", self.scale, get_args(Scale))
        for value in (self.low, self.high):
            system.parameters[name].value(value, name)
        if not self.low < self.high:
            raise InputError(
                f"boundary: got low {self.low:g} and high {self.high:g}, need low < high"
            )
        if self.scale == "log" and self.low <= 0:
            raise InputError(f"boundary: got low {self.low:g}, need more than 0 on a log scale")
        low, high, width = self._interval()
        if not FINEST * (high - low) <= width < high - low:
            raise InputError(
                f"boundary: got tolerance {self.tolerance:g}, need less than the range and at "
                f"least {FINEST:g} of it"
            )

    def measures(self, system: System, factors: Sequence[Factor]) -> Mapping[str, str]:
        """Return the words of what a search finds."""
        unit = system.parameters[self.parameter].unit
        name = f"{self.parameter}_limit"
        words = f"value of {self.parameter} up to which {self.measure} ≤ {self.limit:g} [{unit}]"
        return {
            name: words,
            f"{name}_closed": f"closed form of {name}",
            f"{name}_gap": f"relative distance of {name} from its closed form",
            "rollouts": "rollouts that the search took",
        }

    def find(self, place: Place, attempt: Attempt) -> Trial:
        """Return where the measure leaves its limit; no number where it does not."""
        log, count = self.scale == "log", 0

        def holds(at: float) -> bool:
            nonlocal count
            count += 1
            value = min(max(math.exp(at) if log else at, self.low), self.high)
            trial = attempt({**place.setting, self.parameter: value})
            found = trial.measures.get(self.measure)
            return found is not None and found <= self.limit

        low, high, width = self._interval()
        name, value, reason = f"{self.parameter}_limit", None, ""
        if not holds(low):
            reason = "does not hold at the start"
        elif holds(high):
            reason = "holds up to the end"
        else:
            at = boundary(holds, low, high, width)
            value = math.exp(at) if log else at
        closed = place.system.limit(place.setting, place.controller, self.parameter)
        found = {
            name: value,
            f"{name}_closed": closed,
            f"{name}_gap": abs(value / closed - 1) if value is not None and closed else None,
            "rollouts": float(count),
        }
        return Trial(OutcomeClass.OK, reason, found)

    def _interval(self) -> tuple[float, float, float]:
        """Return both ends and the last width, as the scale has them."""
        if self.scale == "log":
            return math.log(self.low), math.log(self.high), math.log1p(max(self.tolerance, 0.0))
        return self.low, self.high, self.tolerance


@dataclass(frozen=True, kw_only=True)
class Worst:
    """The largest value of a measure that an optimiser finds in the ranges of the factors.

    The factors have no columns, and the study no design: each of its ``repeats`` is one search,
    from another seed. The distribution of a factor says on which scale it is searched.
    """

    kind: ClassVar[str] = "worst"

    measure: str
    """What is made as large as possible; a rollout that diverged or was lost is the worst of all
    and ends the search."""
    trials: int = 64
    """Rollouts of one search, at most."""

    def check(self, system: System, factors: Sequence[str], fixed: Setting) -> None:
        """Refuse what the system does not have, and a search without factors.

        Raises:
            InputError: it names the key.
        """
        if self.measure not in system.measures:
            raise unknown_name("measure", self.measure, system.measures)
        if not factors:
            raise InputError("worst: no factors to search, need at least one")
        if self.trials < 1:
            raise InputError(f"worst: got {self.trials} trials, need at least 1")

    def measures(self, system: System, factors: Sequence[Factor]) -> Mapping[str, str]:
        """Return the words of what a search finds."""
        return {
            f"worst_{self.measure}": f"worst of: {system.measures[self.measure]}",
            **{f"worst_{f.column}": f"{system.parameters[f.name].words}, there" for f in factors},
            "rollouts": "rollouts that the search took",
        }

    def find(self, place: Place, attempt: Attempt) -> Trial:
        """Return the worst rollout that was found: its class, its measure and where it is.

        Raises:
            InputError: optuna is not installed.

        Source: Bergstra2011, as optuna has it.
        """
        optuna = load_optuna()
        sampler = optuna.samplers.TPESampler(seed=place.seed)
        study = optuna.create_study(direction="maximize", sampler=sampler)
        space = {factor.name: _range(optuna, factor) for factor in place.factors}
        worst = Trial(OutcomeClass.OK, f"no rollout has {self.measure}", {})
        at, highest, count = dict[str, float](), -math.inf, 0
        for _ in range(self.trials):
            count += 1
            asked = study.ask(space)
            point = {name: float(value) for name, value in asked.params.items()}
            trial = attempt({**place.setting, **point})
            if trial.outcome in WORST_OF_ALL:
                worst, at = trial, point
                break
            found = trial.measures.get(self.measure)
            if found is None:
                study.tell(asked, state=optuna.trial.TrialState.FAIL)
                continue
            study.tell(asked, found)
            if found > highest:
                worst, at, highest = trial, point, found
        measures = {
            f"worst_{self.measure}": worst.measures.get(self.measure),
            **{f"worst_{f.column}": at.get(f.name) for f in place.factors},
            "rollouts": float(count),
        }
        return worst._replace(measures=measures)


def load_optuna() -> Any:
    """Return the optimiser's package, which keeps silent.

    Raises:
        InputError: it is not installed.
    """
    try:
        import optuna
    except ImportError as error:
        raise InputError(
            "a worst-case search needs the extra: pip install 'qpctrl[studies]'"
        ) from error
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


def _range(optuna: Any, factor: Factor) -> Any:
    """Return what the optimiser may ask of a factor."""
    of, log = optuna.distributions, factor.distribution == "log-uniform"
    if factor.values:
        return of.CategoricalDistribution(factor.values)
    if factor.whole:
        return of.IntDistribution(int(factor.low), int(factor.high), log=log)
    return of.FloatDistribution(factor.low, factor.high, log=log)
