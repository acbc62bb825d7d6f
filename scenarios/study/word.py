"""Words of a study's factors and measures: titles, units, and names of choices."""

import re

from scenarios.report_style import number
from scenarios.scenario import Criterion
from scenarios.study.factor import Factor
from scenarios.study.search import Boundary
from scenarios.study.study import Limit, Study

UNITS = {
    **{"m_s": "m/s", "rad_s": "rad/s", "1_s": "1/s", "1_s2": "1/s²", "m_s2": "m/s²"},
    **{"N_m": "N/m", "N_s": "N/s", "Ns_m": "N s/m", "N_s_m": "N s/m", "Nms_rad": "Nm s/rad"},
    **{"Nm_rad": "Nm/rad", "deg_s": "deg/s", "us": "µs"},
    **{unit: unit for unit in ("N", "Nm", "J", "W", "m", "mm", "um", "s", "ms", "Hz", "kg")},
    **{unit: unit for unit in ("deg", "rad", "ticks")},
}
"""Units as they stand at the end of names, and as they are written."""

ROUND_OFF = 1e-12
"""Numbers below it are told as 0."""
RATIO_DIGITS = 5
"""Of ratios in tables: what matters is how far they are from 1."""

STATISTICS = {"max": "largest", "mean": "mean over the rollouts", "min": "smallest"}


def shown(study: Study) -> tuple[str, ...]:
    """Return the measures to draw: those of ``show``, else the first that the study has."""
    return study.show or tuple(study.measures)[:1]


def unit_of(study: Study, name: str) -> str:
    """Return the unit of a measure, as it is written; none where it is a pure number."""
    plain = name.removesuffix("_closed")
    search = study.search
    if isinstance(search, Boundary) and plain == f"{search.parameter}_limit":
        return unit_text(study.system.parameters[search.parameter].unit)
    parts = plain.split("_")
    for start in range(1, len(parts)):
        if (unit := "_".join(parts[start:])) in UNITS:
            return UNITS[unit]
    return ""


def unit_text(unit: str) -> str:
    """Return a factor's unit as it is written; none for a pure number or a choice."""
    return "" if unit in ("1", "choice") else UNITS.get(unit, unit.replace("_", "/"))


def words_of(study: Study, name: str) -> str:
    """Return what a measure is, without its unit; a gap is that of something."""
    base = name.removesuffix("_gap")
    if base != name and base in study.measures:
        return f"{words_of(study, base)}: relative distance from its closed form"
    return re.sub(r"\s*\[[^]]*\]$", "", study.measures.get(name, name.replace("_", " ")))


def title(study: Study, name: str) -> str:
    """Return the title of a measure's axis, with its unit."""
    return titled(words_of(study, name), unit_of(study, name))


def short_title(study: Study, name: str, room: int = 44) -> str:
    """Return the title of a measure's axis, with its name where its words need more room."""
    words = title(study, name)
    return words if len(words) <= room else titled(name, unit_of(study, name))


def heading(study: Study, name: str) -> str:
    """Return what a measure is, as a heading."""
    words = words_of(study, name)
    return words[:1].upper() + words[1:]


def factor_title(factor: Factor) -> str:
    """Return the title of a factor's axis, with its unit."""
    return titled(factor.name, unit_text(factor.unit))


def level_text(study: Study, factor: Factor, value: float) -> str:
    """Return a value of a factor in words: the name of a choice, else the number."""
    choices = study.system.parameters[factor.name].choices
    return choices[round(value)] if choices else number(value, 4)


def level_title(study: Study, factor: Factor, value: float) -> str:
    """Return a value of a factor with its name and unit: ``delay 5 ticks``."""
    unit = unit_text(factor.unit)
    return f"{factor.name} {level_text(study, factor, value)}{' ' if unit else ''}{unit}"


def limit_words(study: Study, limit: Limit) -> str:
    """Return what a criterion judges."""
    who = f" of {', '.join(limit.controllers)}" if limit.controllers else ""
    if limit.measure not in study.measures:
        return f"share of rollouts{who}: {limit.measure}"
    return f"{words_of(study, limit.measure)}, {STATISTICS[limit.statistic]}{who}"


def paragraphs(text: str) -> list[str]:
    """Return the parts of a text that a blank line separates, each on one line."""
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n", text) if part.strip()]


def amount(value: float, digits: int = 3) -> str:
    """Return a number with ``digits`` significant ones; 0 where it is but round-off."""
    return number(0.0 if abs(value) < ROUND_OFF else value, digits)


def is_nothing(criterion: Criterion) -> bool:
    """Return whether the value of a criterion is but round-off, and 0 would hold as well."""
    return abs(criterion.value) < ROUND_OFF and criterion.passed and criterion.limit >= 0


def entry(name: str, value: float, digits: int = 3) -> str:
    """Return a number of a measure as it stands in tables: a ratio with 5 digits."""
    return amount(value, digits_of(name, digits))


def digits_of(name: str, digits: int = 3) -> int:
    """Return how many digits of a measure stand in tables: of a ratio 5, of others ``digits``."""
    ratio = name.removesuffix("_closed").endswith("_ratio")
    return max(digits, RATIO_DIGITS) if ratio else digits


def titled(words: str, unit: str) -> str:
    """Return words with their unit in brackets, if there is one."""
    return f"{words} [{unit}]" if unit else words
