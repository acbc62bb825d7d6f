"""Study files: what they say, what they are refused for, and that nothing of them is lost."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from scripted import Scripted

from qpctrl import InputError
from scenarios.study import study_file
from scenarios.study.factor import Factor
from scenarios.study.search import Boundary, Worst
from scenarios.study.study import Limit, Published, Study
from scenarios.study.study_file import find_study, read_study, ready_studies, study_of
from scenarios.study.systems import SYSTEMS

FULL = """
summary = "everything that a file can say"
system = "scripted"
controllers = ["two", "one"]
repeats = 3
show = ["value_N"]

[factors.x]
low = -3
high = 4.5
distribution = "normal"

[factors.count]
values = [0, 5]

[factors.colour]

[fixed]
y = 2

[design]
kind = "map"
size = 4

[[criteria]]
measure = "value_N"
limit = 30
statistic = "mean"
controllers = ["one"]

[[criteria]]
measure = "lost"
limit = 0.0

[[published]]
name = "theirs"
source = "Someone2020"
note = "another arm"
measures = {value_N = 12}
"""

SHORT = """
system = "scripted"
[factors.x]
low = -1.0
high = 1.0
"""

BOUNDARY = {"parameter": "y", "low": 0.1, "high": 10.0, "measure": "value_N", "limit": 1.0}


@pytest.fixture(autouse=True)
def scripted_system(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the scripted system known by name."""
    monkeypatch.setitem(SYSTEMS, "scripted", Scripted())


def study_in(text: str, folder: Path) -> Study:
    """Return the study that a file with ``text`` describes."""
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return study_of(read_study(path))


def test_a_file_says_all_of_a_study(tmp_path: Path) -> None:
    study = study_in(FULL, tmp_path)
    assert (study.name, study.summary) == ("mine", "everything that a file can say")
    assert study.system is SYSTEMS["scripted"]
    assert (study.controllers, study.repeats, study.show) == (("two", "one"), 3, ("value_N",))
    assert study.factors == (
        Factor("x", "1", -3.0, 4.5, "normal"),
        Factor("count", "1", 0.0, 5.0, whole=True, values=(0.0, 5.0)),
        Factor("colour", "choice", 0.0, 2.0, whole=True, values=(0.0, 1.0, 2.0)),
    )
    assert study.fixed == {"y": 2.0}
    assert (study.design.kind, study.design.size) == ("map", 4)
    assert study.criteria == (
        Limit(measure="value_N", limit=30.0, statistic="mean", controllers=("one",)),
        Limit(measure="lost", limit=0.0),
    )
    theirs = Published(
        name="theirs", source="Someone2020", note="another arm", measures={"value_N": 12.0}
    )
    assert study.published == (theirs,)


def test_what_a_file_leaves_out_is_usual(tmp_path: Path) -> None:
    study = study_in(SHORT, tmp_path)
    assert (study.controllers, study.repeats, study.search) == (("one",), 1, None)
    assert (study.design.kind, study.design.size) == ("levels", 9)


@pytest.mark.parametrize(
    ("text", "search"),
    [
        (SHORT + '[worst]\nmeasure = "value_N"\ntrials = 9', Worst(measure="value_N", trials=9)),
        (
            SHORT + '[boundary]\nparameter = "y"\nlow = 0.1\nhigh = 10\nmeasure = "value_N"\n'
            'limit = 1\nscale = "log"',
            Boundary(**BOUNDARY, scale="log"),
        ),
    ],
)
def test_a_file_says_what_is_sought(text: str, search: Any, tmp_path: Path) -> None:
    assert study_in(text, tmp_path).search == search


@pytest.mark.parametrize(
    "text", [FULL, SHORT, SHORT + '[worst]\nmeasure = "value_N"', SHORT + "[design]\nsize = 3"]
)
def test_a_configuration_is_a_study_file_and_says_the_same(text: str, tmp_path: Path) -> None:
    said = study_in(text, tmp_path).configuration()
    assert study_of(said).configuration() == said


@pytest.mark.parametrize("name", ready_studies())
def test_every_ready_made_study_can_be_read_and_says_what_it_asks(name: str) -> None:
    study = study_of(read_study(find_study(name)))
    assert study.name == name
    assert 20 < len(study.summary) < 100
    assert study_of(study.configuration()).configuration() == study.configuration()


def said(**changes: Any) -> dict[str, Any]:
    """Return what a good file says, with some keys changed."""
    good = {"name": "mine", "system": "scripted", "factors": {"x": {"low": -1, "high": 1}}}
    return {**good, **changes}


def factor(name: str = "x", **of: Any) -> dict[str, Any]:
    """Return what a file with one factor says."""
    return said(factors={name: of})


def design(**of: Any) -> dict[str, Any]:
    """Return what a file with a design says."""
    return said(design=of)


def bound(**changes: Any) -> dict[str, Any]:
    """Return what a file with a bisection says, with some of its keys changed."""
    return said(boundary={**BOUNDARY, **changes})


BAD: list[tuple[dict[str, Any], str]] = [
    (said(facters={}), "unknown key 'facters'; allowed: .*; did you mean 'factors'"),
    (said(system="script"), "unknown system 'script'.*did you mean 'scripted'"),
    (said(system=["scripted"]), r"system: got \['scripted'\], need a name"),
    (said(summary=3), "summary: got 3, need a name"),
    (said(controllers=["three"]), "unknown controller 'three'"),
    (said(controllers=["one", "one"]), "controllers: got one, one, need each once"),
    (said(controllers=[]), "controllers: got none"),
    (said(controllers="one"), "controllers: got 'one', need a list of names"),
    (said(controllers=[1]), r"controllers: got \[1\], need a list of names"),
    (said(repeats=0), "repeats: got 0, need 1 to"),
    (said(repeats=1.5), "repeats: got 1.5, need a whole number"),
    (said(repeats=True), "repeats: got True, need a whole number"),
    (said(show=["valu_N"]), "unknown measure 'valu_N'.*did you mean 'value_N'"),
    (said(factors={}), "nothing varies"),
    (said(factors=[1]), r"factors: got \[1\], need a table"),
    (said(factors={"x": 5}), "factor 'x': got 5, need a table"),
    (factor("z", low=0, high=1), "unknown parameter of system 'scripted' 'z'"),
    (factor(low=0, high=11), "parameter 'x': got 11, need -10 to 10 1"),
    (factor(low=1, high=-1), "factor 'x': got low 1 and high -1 1, need low < high"),
    (factor(low=1, high=1), "need low < high"),
    (factor(low=0), "factor 'x': missing high, need low and high, or values"),
    (factor(), "factor 'x': missing low"),
    (factor(low="0", high=1), "factor 'x': low: got '0', need a number"),
    (factor(low=float("nan"), high=1), "factor 'x': low: got nan, need a finite number"),
    (factor(low=0, high=10**400), "factor 'x': high: got inf"),
    (factor(low=0, high=1, mean=0), "unknown key of factor 'x' 'mean'"),
    (factor(low=0, high=1, distribution=3), "factor 'x': got 3, need a name"),
    (factor(low=0, high=1, distribution="log-uniform"), "need more than 0"),
    (factor(values=[]), r"factor 'x': got values \[\], need a list of some"),
    (factor(values=3), "factor 'x': got values 3, need a list of some"),
    (factor(values=[1, 1]), "the same value twice"),
    (factor(values=[1], low=0), "got values beside low or high"),
    (factor("count", low=0.5, high=2), "parameter 'count': got 0.5, need a whole number"),
    (factor("colour", low=0, high=1), "'colour' is a choice and has no range, need values of red"),
    (factor("colour", values=["pink"]), "unknown value of 'colour' 'pink'.*red"),
    (said(fixed={"x": 1}), "parameter 'x' is fixed and a factor"),
    (said(fixed={"z": 1}), "unknown parameter of system 'scripted' 'z'"),
    (said(fixed={"y": 0.001}), "parameter 'y': got 0.001, need 0.01 to 100 m"),
    (said(fixed={"y": "1"}), "parameter 'y': got '1', need a number"),
    (said(fixed={"colour": "pink"}), "unknown value of 'colour' 'pink'"),
    (design(kind="grid"), "unknown design 'grid'"),
    (design(kind=1), "design.kind: got 1, need a name"),
    (design(size=1), "got size 1, need at least 2"),
    (design(size=4.0), "design.size: got 4.0, need a whole number"),
    (design(sise=4), "unknown key of design 'sise'.*did you mean 'size'"),
    (said(design=4), "design: got 4, need a table"),
    (said(criteria={"measure": "value_N"}), "criteria: got .*, need a list of tables"),
    (said(criteria=[3]), "criteria: got 3, need a table"),
    (said(criteria=[{"limit": 1}]), "criteria: missing measure"),
    (said(criteria=[{"measure": "value_N", "limit": "1"}]), "criteria.limit: got '1'"),
    (said(criteria=[{"measure": "value_N", "limit": float("inf")}]), "criteria.limit: got inf"),
    (said(criteria=[{"measure": "value", "limit": 1}]), "unknown measure 'value'"),
    (
        said(criteria=[{"measure": "value_N", "limit": 1, "statistic": "median"}]),
        "unknown statistic 'median'",
    ),
    (
        said(criteria=[{"measure": "lost", "limit": 0, "statistic": "mean"}]),
        "criterion lost: a share of rollouts has no statistic",
    ),
    (
        said(criteria=[{"measure": "value_N", "limit": 1, "controllers": ["two"]}]),
        "unknown controller 'two'",  # it is none of this study
    ),
    (said(published=[{"name": "a", "source": "b"}]), "published: got .*, need a table with name"),
    (
        said(published=[{"name": "a", "source": "b", "measures": {"force": 1}}]),
        "unknown measure 'force'",
    ),
    (
        said(published=[{"name": "a", "source": "b", "measures": {"value_N": "1"}}]),
        "published.value_N: got '1', need a number",
    ),
    (bound(parameter="x"), "boundary: parameter 'x' is a factor or fixed too"),
    ({**bound(), "fixed": {"y": 1.0}}, "boundary: parameter 'y' is a factor or fixed too"),
    (bound(parameter="z"), "unknown parameter 'z'"),
    (bound(parameter="count"), "'count' takes whole numbers"),
    (bound(measure="value"), "unknown measure 'value'"),
    (bound(scale="log10"), "unknown boundary scale 'log10'"),
    (bound(low=20.0), "boundary: got low 20 and high 10, need low < high"),
    (bound(high=1000.0), "parameter 'y': got 1000, need 0.01 to 100 m"),
    (bound(tolerance=0.0), "boundary: got tolerance 0, need less than the range and at least"),
    (bound(tolerance=1e-12), "boundary: got tolerance 1e-12"),
    (bound(tolerance=20), "boundary: got tolerance 20"),
    (said(boundary={"parameter": "y"}), "boundary: missing low"),
    (said(worst={"measure": "value"}), "unknown measure 'value'"),
    (said(worst={"measure": "value_N", "trials": 0}), "worst: got 0 trials, need at least 1"),
    (said(worst={"measure": "value_N", "starts": 3}), "unknown key of worst 'starts'"),
    ({**said(worst={"measure": "value_N"}), "factors": {}}, "worst: no factors to search"),
    ({**bound(), "worst": {"measure": "value_N"}}, "got boundary and worst, need at most one"),
    ({**design(size=3), "worst": {"measure": "value_N"}}, "got design and worst.*repeats"),
]


@pytest.mark.parametrize(("keys", "message"), BAD, ids=[message for _, message in BAD])
def test_a_study_that_cannot_be_made_is_refused_with_the_place(
    keys: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError) as refused:
        study_of(keys)
    line = " ".join(str(refused.value).split())
    assert re.search(f"^study 'mine': .*{message}", line), line


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"system = ", r"study file '.*mine.toml': Invalid value \(at end of document\)"),
        (b"a = 1\na = 2", "study file '.*mine.toml': Cannot overwrite a value"),
        (b"\xff\xfe", "study file '.*mine.toml': 'utf-8' codec can't decode"),
        (b"name = 'yours'", "study 'mine': unknown key 'name'"),
        (b"factors = 3", "study 'mine': factors: got 3, need a table"),
        (b"", "study 'mine': missing system; allowed: .*scripted"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused(
    content: bytes, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        study_of(read_study(find_study(str(path))))


def test_a_factor_whose_column_is_a_measure_too_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Scripted, "measures", {"x_1": "a measure with the name of a column"})
    with pytest.raises(InputError, match="column 'x_1' would be both factor and measure"):
        study_of(said())
    assert study_of(said(worst={"measure": "x_1"})).columns == ()


def test_a_study_is_found_by_name_and_a_file_by_its_ending(tmp_path: Path) -> None:
    assert find_study("tilt") == study_file.READY / "tilt.toml"
    with pytest.raises(InputError, match=r"unknown study 'tlit'.*did you mean 'tilt'"):
        find_study("tlit")
    with pytest.raises(InputError, match=r"unknown study 'statis'.*did you mean 'status'"):
        find_study("statis")
    with pytest.raises(InputError, match=r"study file '.*none.toml': there is none"):
        find_study(str(tmp_path / "none.toml"))


def test_the_files_that_the_docs_show_are_studies() -> None:
    page = (Path(__file__).parents[1] / "docs" / "studies.md").read_text(encoding="utf-8")
    whole, *searches = (
        tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", page, re.S)
    )
    shown = study_of({"name": "mine", **whole})
    assert (shown.system.name, len(shown.factors), shown.criteria[0].limit) == (
        "mass-on-wall",
        2,
        1e-3,
    )
    plain = {key: whole[key] for key in ("system", "controllers", "fixed")}
    factors = {"factors": {"tilt": whole["factors"]["tilt"]}}
    kinds = [study_of({"name": "mine", **plain, **factors, **one}).search for one in searches]
    assert [one and one.kind for one in kinds] == ["boundary", "worst"]
