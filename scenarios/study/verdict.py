"""Verdicts in words: what each controller achieved, and how it compares with the others.

A controller is above or below another in a measure only where the interval of their difference,
rollout by rollout of the same draws, leaves out zero, where that difference matters, where both
have the measure in every rollout, and where there are draws enough; so it is with its share of
failures. Where rollouts are no sample, ranges take the place of intervals, where these overlap
nothing is said, and failures are only counted.

A measure is compared if less of it is better: an error, a loss, a time. One that has a sign, or a
right value, is told as a range.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from scenarios.study.importance import FAILED
from scenarios.study.word import amount

FEWEST = 10
"""Draws below which a bootstrap interval is too narrow to tell controllers apart."""

FEWEST_APART = 6
"""Draws in which two controllers must differ: of fewer, all have the same sign too often, in one
of 2⁴ cases or more."""

NEGLIGIBLE = 0.01
"""Share of the larger of two means below which a difference, however sure, does not matter."""

TOLD = 2
"""Measures that a verdict tells, the first of those that are shown; tables have them all."""

ALIKE = "not distinguishable from"

MOST_NAMES = 3
"""Controllers that a verdict names, where it compares one with others."""

COSTS = {
    *("mae", "rmse", "rms", "p95", "peak", "spread", "error", "accuracy", "repeatability"),
    *("settling", "lost", "loss", "breaks", "saturated", "fallback"),
}
"""Parts of the name of a measure of which less is better."""

FAILURE_WORDS = {"diverged": "diverged", "lost": "lost contact", "chatter": "chattered"}
WORSE = {"saturated": "at a limit", "degraded": "degraded"}
ORDINALS = {2: "second", 3: "third"}
SURE = "95\u00a0%"
NOT_FOUND = {
    "holds up to the end": "nothing gives way up to the end at {}",
    "does not hold at the start": "it does not hold at the start at {}",
}
"""Reasons of a boundary search without a number, in words."""


def verdicts(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return the verdict on each controller.

    Args:
        summary: what summary.json holds.
    """
    found = summary["controllers"]
    return {name: "; ".join(_clauses(summary, name)) for name in found}


def is_cost(summary: Mapping[str, Any], measure: str) -> bool:
    """Return whether less of a measure is better, so that controllers can be compared in it."""
    known = _measured(summary, measure).values()
    return bool(COSTS.intersection(measure.split("_"))) and all(one["min"] >= 0 for one in known)


def is_signed(summary: Mapping[str, Any], measure: str) -> bool:
    """Return whether a measure goes both ways, so that its mean says nothing."""
    known = list(_measured(summary, measure).values())
    return any(one["min"] < 0 for one in known) and any(one["max"] > 0 for one in known)


def standing(summary: Mapping[str, Any], measure: str, controller: str) -> str:
    """Return how a controller compares with the others in a measure; nothing if that is open."""
    known = {n: one for n, one in _measured(summary, measure).items() if _ranked(summary, n, one)}
    if controller not in known or not is_cost(summary, measure):
        return ""
    signs = {n: _sign(summary, measure, known, controller, n) for n in known if n != controller}
    return _compared(summary, signs, "best", "worst")


def failure_standing(summary: Mapping[str, Any], controller: str) -> str:
    """Return how often a controller fails, compared with the others; nothing if none does."""
    rates = {n: one["failed"] for n, one in summary["controllers"].items() if one["rows"]}
    if not summary["sampled"] or not any(one["value"] > 0 for one in rates.values()):
        return ""
    signs = {n: _sign(summary, FAILED, rates, controller, n) for n in rates if n != controller}
    return _compared(summary, signs, "fewest failures", "most failures")


def _sign(
    summary: Mapping[str, Any],
    measure: str,
    known: Mapping[str, Mapping[str, float]],
    name: str,
    other: str,
) -> int:
    """Return 1 where a controller has more than another one, −1 where less, 0 where it is open."""
    if not summary["sampled"]:
        (low, high), (least, most) = _ends(known[name]), _ends(known[other])
        return (low > most) - (high < least)
    apart = summary["controllers"][name]["differences"].get(measure, {}).get(other)
    if apart is None or apart["draws"] < FEWEST_APART:
        return 0
    larger = max(abs(known[name]["value"]), abs(known[other]["value"]))
    if abs(apart["value"]) < NEGLIGIBLE * larger:
        return 0
    return (apart["low"] > 0) - (apart["high"] < 0)


def _compared(summary: Mapping[str, Any], signs: Mapping[str, int], best: str, worst: str) -> str:
    """Return the place of a controller that has more (1) or less than others; less is better."""
    if not signs:
        return ""
    better = [name for name, sign in signs.items() if sign > 0]
    alike = [name for name, sign in signs.items() if sign == 0]
    if not alike:
        place, of = len(better) + 1, len(signs) + 1
        if place in (1, of):
            return f"{best if place == 1 else worst} of {of}"
        return f"{ORDINALS.get(place, f'{place}th')} of {of}"
    behind = f", more than {_few(better)}" if better else ""
    if not summary["sampled"]:
        return behind.removeprefix(", ")
    return f"{ALIKE} {_few(alike)}{behind}"


def measure_text(summary: Mapping[str, Any], measure: str, one: Mapping[str, float]) -> str:
    """Return a measure of a controller in words: its mean and interval, or its range."""
    words, unit = (summary["measures"][measure][key] for key in ("words", "unit"))
    unit = f" {unit}" if unit else ""
    words += ":" if words[-1:].isdigit() else ""
    if one["rollouts"] == 1:
        return f"{words} {amount(one['value'])}{unit}"
    if not is_cost(summary, measure) or "low" not in one:
        return f"{words.removesuffix(':')}: {span(one['min'], one['max'])}{unit}"
    interval = f"{SURE}: {amount(one['low'])} … {amount(one['high'])}"
    return f"{words} {amount(one['value'])}{unit} ({interval})"


def percent(rate: Mapping[str, float]) -> str:
    """Return a share with its interval, if it has one: ``4.3 %, 95 %: 1.5 … 11.9 %``."""
    if "low" not in rate:
        return f"{amount(100 * rate['value'])}\u00a0%"
    value, low, high = (amount(100 * rate[key]) for key in ("value", "low", "high"))
    return f"{value}\u00a0%, {SURE}: {low} … {high}\u00a0%"


def span(low: float, high: float, digits: int = 3) -> str:
    """Return a range, or its one value where the two are written the same."""
    ends = amount(low, digits), amount(high, digits)
    return ends[0] if ends[0] == ends[1] else " … ".join(ends)


def _clauses(summary: Mapping[str, Any], name: str) -> list[str]:
    one = summary["controllers"][name]
    if not one["rows"]:
        return ["no rollouts yet"]
    boundary = "boundary" in summary["configuration"]
    found = [_search(one)] if boundary else _outcomes(summary, name)
    compared = False
    for measure, values in one["measures"].items():
        if measure not in _told(summary):
            continue
        place = standing(summary, measure, name)
        said = [measure_text(summary, measure, values), place]
        if gap := one["measures"].get(f"{measure}_gap"):
            said.append(f"within {amount(gap['max'])} of its closed form")
        found.append(", ".join(words for words in said if words))
        compared |= is_cost(summary, measure)
    if compared and len(summary["controllers"]) > 1:
        found += _unranked(summary, one)
    return found


def _outcomes(summary: Mapping[str, Any], name: str) -> list[str]:
    """Return in how many rollouts the contact was kept, or how the others ended."""
    one = summary["controllers"][name]
    rows, counts = one["rows"], one["outcomes"]
    kind = "searches" if "worst" in summary["configuration"] else "rollouts"
    standing = failure_standing(summary, name)
    bad = {words: counts[kind] for kind, words in FAILURE_WORDS.items() if counts[kind]}
    if bad:
        found = [f"{_listed(bad)} of {rows} {kind} ({percent(one['failed'])})"]
    elif summary["contact"]:
        found = [f"keeps contact in all {rows} rollouts" if rows > 1 else "keeps contact"]
    else:
        found = [f"none of {rows} {kind} failed" if rows > 1 else "did not fail"]
    if standing and (bad or not standing.startswith(ALIKE)):
        found[0] += f", {standing}"
    if worse := {words: counts[kind] for kind, words in WORSE.items() if counts[kind]}:
        found.append(", ".join(f"{words} in {count}" for words, count in worse.items()))
    return found


def _search(one: Mapping[str, Any]) -> str:
    """Return at how many points a search found what it sought."""
    reasons, rows = dict(one["reasons"]), one["rows"]
    found = [f"found at {reasons.pop('', 0)} of {rows} points"]
    found += [NOT_FOUND[why].format(reasons.pop(why)) for why in NOT_FOUND if why in reasons]
    if other := sum(reasons.values()):
        found.append(f"failed at {other}")
    return ", ".join(found)


def _unranked(summary: Mapping[str, Any], one: Mapping[str, Any]) -> list[str]:
    rows, draws = one["rows"], one["draws"]
    if missing := one["outcomes"]["diverged"]:
        return [f"its numbers are of the other {rows - missing}, so it is not ranked"]
    if _enough(summary, one):
        return []
    of = "rollout" if draws == rows else "draw"
    return [f"{draws} {of}{'s are' if draws > 1 else ' is'} too few to rank it"]


def _ranked(summary: Mapping[str, Any], name: str, one: Mapping[str, float]) -> bool:
    whole = summary["controllers"][name]
    return one["rollouts"] == whole["rows"] and _enough(summary, whole)


def _enough(summary: Mapping[str, Any], one: Mapping[str, Any]) -> bool:
    return not summary["sampled"] or one["draws"] >= FEWEST


def _ends(one: Mapping[str, float]) -> tuple[float, float]:
    """Return the ends of an interval; without one of the range, or of the value alone."""
    low, high = ("low", "high") if "low" in one else ("min", "max")
    return one.get(low, one["value"]), one.get(high, one["value"])


def _measured(summary: Mapping[str, Any], measure: str) -> dict[str, Mapping[str, float]]:
    found = {name: one["measures"].get(measure) for name, one in summary["controllers"].items()}
    return {name: one for name, one in found.items() if one is not None}


def _told(summary: Mapping[str, Any]) -> Sequence[str]:
    return summary["configuration"]["show"][:TOLD] or tuple(summary["measures"])[:1]


def _listed(counts: Mapping[str, int]) -> str:
    return _and([f"{words} in {count}" for words, count in counts.items()])


def _few(names: Sequence[str]) -> str:
    """Return names, or how many there are where they would fill a line."""
    return _and(names) if len(names) <= MOST_NAMES else f"{len(names)} others"


def _and(names: Sequence[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]
