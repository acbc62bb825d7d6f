"""Study files: a study as TOML, the ready-made ones and a user's own.

system = "arm-on-plane"
notes = "what differs"           # what a reader must know, printed with the results
controllers = ["qp", "textbook"]
repeats = 1                      # rollouts at each point, default 1
show = ["force_ratio"]           # measures that are printed and drawn

[factors.tilt]
low = -10.0                      # in the unit of the parameter; or values = [-6, 0, 6]
high = 10.0
distribution = "uniform"         # uniform, log-uniform, normal

[fixed]                          # other parameters; those left out keep their usual value
force = 20.0

[design]
kind = "levels"                  # levels, map, sobol, indices, morris
size = 9

[boundary]                       # what is sought at each point: see `Boundary`; or nothing
parameter = "k_fp"
# ...

[worst]                          # or this, in place of design and boundary: see `Worst`
measure = "force_peak_N"

[[criteria]]
measure = "force_ratio_gap"
limit = 1e-3
"""

import dataclasses
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from qpctrl.errors import InputError, reason_of, unknown_name
from scenarios.study.design import Design
from scenarios.study.factor import Factor
from scenarios.study.parameter import Parameter, number
from scenarios.study.search import Boundary, Worst
from scenarios.study.study import Along, Limit, Published, Study
from scenarios.study.system import System
from scenarios.study.systems import SYSTEMS

T = TypeVar("T")

READY = Path(__file__).parent / "ready"
"""Files of the studies that come with the package."""

TABLES, LISTS = ("factors", "fixed", "design", "boundary", "worst"), ("criteria", "published")
KEYS = ("summary", "notes", "system", "controllers", "repeats", "show", *TABLES, *LISTS)
FACTOR_KEYS = ("low", "high", "values", "distribution")


def ready_studies() -> tuple[str, ...]:
    """Return the names of the studies that come with the package."""
    return tuple(sorted(path.stem for path in READY.glob("*.toml")))


def find_study(name: str) -> Path:
    """Return the file of a ready-made study, or of a user's own, which ends in ``.toml``.

    Raises:
        InputError: no such study or file.
    """
    if name.endswith(".toml"):
        if not Path(name).is_file():
            raise InputError(f"study file {name!r}: there is none")
        return Path(name)
    if name not in ready_studies():
        raise unknown_name("study", name, (*ready_studies(), "list", "system", "status", "query"))
    return READY / f"{name}.toml"


def read_study(path: Path) -> dict[str, Any]:
    """Return what a study file says, and its name; only that its tables are tables is checked.

    Raises:
        InputError: it cannot be read, or a key is unknown or of a wrong type.
    """
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        said = reason_of(error)
        raise InputError(f"study file {str(path)!r}: {said}") from error
    _check_keys(found, f"study {path.stem!r}")
    return {"name": path.stem, **found}


def study_of(said: Mapping[str, Any]) -> Study:
    """Return the study that a file, or study.json, describes.

    Args:
        said: the keys of a study file, and ``name``.

    Raises:
        InputError: an unknown key or name, or a value that does not fit; it names the place.
    """
    where = f"study {said['name']!r}"
    _check_keys({key: value for key, value in said.items() if key != "name"}, where)
    try:
        system = _system(said)
        return Study(
            name=str(said["name"]),
            summary=_fitting(str, said.get("summary", ""), "summary"),
            system=system,
            controllers=_names(said, "controllers", list(system.controllers)[:1]),
            factors=tuple(_factor(system, n, f) for n, f in said.get("factors", {}).items()),
            fixed={n: _value(system, n, v) for n, v in said.get("fixed", {}).items()},
            design=_filled(Design, said.get("design", {}), "design"),
            repeats=_fitting(int, said.get("repeats", 1), "repeats"),
            search=_search(said),
            show=_names(said, "show", []),
            criteria=tuple(_filled(Limit, one, "criteria") for one in said.get("criteria", ())),
            published=tuple(_published(one) for one in said.get("published", ())),
            notes=_fitting(str, said.get("notes", ""), "notes").strip(),
        )
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _check_keys(said: Mapping[str, Any], where: str) -> None:
    """Refuse an unknown key, and what is no table where one is needed."""
    for key, value in said.items():
        if key not in KEYS:
            raise InputError(f"{where}: {unknown_name('key', key, KEYS)}")
        if key in TABLES and not isinstance(value, dict):
            raise InputError(f"{where}: {key}: got {value!r}, need a table")
        if key in LISTS and not isinstance(value, list):
            raise InputError(f"{where}: {key}: got {value!r}, need a list of tables")
    for name, factor in said.get("factors", {}).items():
        if not isinstance(factor, dict):
            raise InputError(f"{where}: factor {name!r}: got {factor!r}, need a table")


def _system(said: Mapping[str, Any]) -> System:
    if "system" not in said:
        raise InputError(f"missing system; allowed: {', '.join(SYSTEMS)}")
    name: str = _fitting(str, said["system"], "system")
    if name not in SYSTEMS:
        raise unknown_name("system", name, SYSTEMS)
    return SYSTEMS[name]


def parameter_of(system: System, name: str) -> Parameter:
    """Return a parameter of a system by name.

    Raises:
        InputError: the system lacks it.
    """
    if name not in system.parameters:
        raise unknown_name(f"parameter of system {system.name!r}", name, system.parameters)
    return system.parameters[name]


def _value(system: System, name: str, given: Any) -> float:
    return parameter_of(system, name).value(given, name)


def _factor(system: System, name: str, said: Mapping[str, Any]) -> Factor:
    parameter = parameter_of(system, name)
    for key in said:
        if key not in FACTOR_KEYS:
            raise unknown_name(f"key of factor {name!r}", key, FACTOR_KEYS)
    values = _given_values(parameter, name, said)
    low, high = (min(values), max(values)) if values else _ends(name, said)
    distribution = _fitting(str, said.get("distribution", "uniform"), f"factor {name!r}")
    return Factor(
        *(name, parameter.unit, low, high, distribution), whole=parameter.whole, values=values
    )


def _given_values(parameter: Parameter, name: str, said: Mapping[str, Any]) -> tuple[float, ...]:
    """Return the values that a factor takes one by one, if they are said; all of a choice."""
    ends = "low" in said or "high" in said
    if parameter.choices and ends:
        names = ", ".join(parameter.choices)
        raise InputError(f"factor {name!r} is a choice and has no range, need values of {names}")
    if "values" in said and ends:
        raise InputError(f"factor {name!r}: got values beside low or high, need one of the two")
    if "values" not in said and not parameter.choices:
        return ()
    given = said.get("values", list(parameter.choices))
    if not given or not isinstance(given, list):
        raise InputError(f"factor {name!r}: got values {given!r}, need a list of some")
    return tuple(parameter.value(value, name) for value in given)


def _ends(name: str, said: Mapping[str, Any]) -> tuple[float, float]:
    for key in ("low", "high"):
        if key not in said:
            raise InputError(f"factor {name!r}: missing {key}, need low and high, or values")
    low, high = (number(said[key], f"factor {name!r}: {key}") for key in ("low", "high"))
    return low, high


def _search(said: Mapping[str, Any]) -> Boundary | Worst | None:
    if "boundary" in said and "worst" in said:
        raise InputError("got boundary and worst, need at most one of them")
    if "worst" in said and "design" in said:
        raise InputError(
            "got design and worst, need one of them; repeats says how many searches are made"
        )
    if "boundary" in said:
        return _filled(Boundary, said["boundary"], "boundary")
    return _filled(Worst, said["worst"], "worst") if "worst" in said else None


def _published(said: Any) -> Published:
    if not isinstance(said, dict) or not isinstance(said.get("measures"), dict):
        raise InputError(f"published: got {said!r}, need a table with name, source and measures")
    inner = ("measures", "deviations", "along")
    words = {k: v for k, v in said.items() if k not in (*inner, "largest")}
    largest = _fitting(tuple[str, ...], said.get("largest", []), "published.largest")
    _filled(Published, words, "published")
    along = said.get("along", [])
    if not isinstance(along, list) or not isinstance(said.get("deviations", {}), dict):
        raise InputError(f"published: got {said!r}, need deviations as a table, along as a list")
    return Published(
        **words,
        largest=largest,
        along=tuple(_filled(Along, one, "published.along") for one in along),
        measures=_numbers(said["measures"]),
        deviations=_numbers(said.get("deviations", {})),
    )


def _numbers(said: Mapping[str, Any]) -> dict[str, float]:
    return {name: number(value, f"published.{name}") for name, value in said.items()}


def _filled(kind: type[T], said: Any, where: str) -> T:
    """Return a dataclass of numbers and names with what is ``said`` in its fields."""
    if not isinstance(said, dict):
        raise InputError(f"{where}: got {said!r}, need a table")
    fields = {f.name: f for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for key in said:
        if key not in fields:
            raise unknown_name(f"key of {where}", key, fields)
    for name, field in fields.items():
        needed = field.default is field.default_factory is dataclasses.MISSING
        if name not in said and needed:
            raise InputError(f"{where}: missing {name}")
    return kind(**{key: _fitting(fields[key].type, v, f"{where}.{key}") for key, v in said.items()})


def _fitting(kind: Any, value: Any, where: str) -> Any:
    """Return a value whose type is that of a field."""
    if kind is float:
        return number(value, where)
    if kind is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise InputError(f"{where}: got {value!r}, need a whole number")
        return value
    if kind == tuple[float, ...]:
        if not isinstance(value, list):
            raise InputError(f"{where}: got {value!r}, need a list of numbers")
        return tuple(number(v, where) for v in value)
    names = kind == tuple[str, ...]
    if names and isinstance(value, list) and all(isinstance(v, str) for v in value):
        return tuple(value)
    if names or not isinstance(value, str):
        raise InputError(f"{where}: got {value!r}, need {'a list of names' if names else 'a name'}")
    return value


def _names(said: Mapping[str, Any], key: str, default: list[str]) -> tuple[str, ...]:
    names: tuple[str, ...] = _fitting(tuple[str, ...], said.get(key, default), key)
    return names
