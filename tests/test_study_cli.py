"""The command ``study`` as a person types it: flags, what it leaves, one-line refusals."""

import errno
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from scripted import Scripted, squares

from scenarios import cli_study
from scenarios.cli import main
from scenarios.study import store
from scenarios.study.machine import Here
from scenarios.study.plan import Plan
from scenarios.study.store import chunk_files
from scenarios.study.study_file import READY, read_study, ready_studies, study_of
from scenarios.study.system import Measures, Setting
from scenarios.study.systems import SYSTEMS

MINE = """
summary = "squares of some numbers"
system = "scripted"
controllers = ["one"]
show = ["value_N"]

[factors.x]
low = -10.0
high = 10.0
distribution = "normal"

[fixed]
y = 0.5

[design]
size = 5

[[criteria]]
measure = "value_N"
limit = 99.0
"""
WORST = '\n[worst]\nmeasure = "value_N"\ntrials = 8\n'

Typed = Callable[..., int]


def loses_above_five(setting: Setting, controller: str, seed: int) -> Measures:
    """Lose contact where x is large."""
    return {**squares(setting, controller, seed), "longest_loss_ms": 9.0 * setting["x"]}


@pytest.fixture
def typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Typed:
    """Return what types a command in a folder with two studies of a scripted system."""
    monkeypatch.setitem(SYSTEMS, "scripted", Scripted())
    monkeypatch.setattr(cli_study, "ProcessPool", Here)
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(MINE, encoding="utf-8")
    search = MINE.replace("[design]\nsize = 5\n", WORST).replace("value_N", "worst_value_N")
    search = search.replace('measure = "worst_value_N"\ntrials', 'measure = "value_N"\ntrials')
    Path("worst.toml").write_text(search, encoding="utf-8")

    def command(*arguments: str) -> int:
        with pytest.raises(SystemExit) as exited:
            main(["study", *arguments])
        return int(exited.value.code or 0)

    return command


def rows_in(folder: str) -> pl.DataFrame:
    """Return the rows that a command left, in the order of the design."""
    rows = pl.read_parquet(Path(folder) / "chunks" / "*.parquet")
    return rows.sort("row", "repeat", "controller")


def configured(folder: str) -> dict[str, Any]:
    """Return the configuration of the study in a folder."""
    return json.loads((Path(folder) / "study.json").read_text(encoding="utf-8"))["configuration"]


def test_the_command_writes_what_it_promises_and_says_whether_the_criteria_hold(
    typed: Typed, capsys: pytest.CaptureFixture[str]
) -> None:
    assert typed("mine.toml") == 1  # 10² is more than 99
    said = capsys.readouterr().out
    assert "FAILED" in said
    assert "runs/study-mine/report.html" in said
    assert typed("mine.toml", "--range", "x=-9:9", "--out", "narrow", "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary == json.loads(Path("narrow/summary.json").read_text(encoding="utf-8"))
    assert (summary["study"], summary["passed"], summary["seed"]) == ("mine", True, 0)
    assert summary["criteria"][0]["value"] == 81
    assert summary["outcomes"]["ok"] == summary["rows"] == 5
    assert summary["timing"]["rows_made"] == 5
    assert "squares of some numbers" in Path("narrow/report.html").read_text(encoding="utf-8")
    names = {path.name for path in Path("narrow").iterdir()}
    assert names == {".lock", "study.json", "chunks", "summary.json", "report.html"}


def test_flags_change_what_is_run(typed: Typed) -> None:
    flags = "--controllers two one --size 3 --repeats 2 --set y=0.25 colour=blue --seed 7"
    typed("mine.toml", *flags.split(), "--range", "x=1:5", "--out", "out")
    assert configured("out")["controllers"] == ["two", "one"]
    assert configured("out")["design"]["size"] == 3
    assert configured("out")["fixed"] == {"y": 0.25, "colour": 2.0}
    assert configured("out")["factors"] == {
        "x": {"low": 1.0, "high": 5.0, "distribution": "normal"}
    }
    rows = rows_in("out")
    assert rows["x_1"].to_list() == [1.0] * 4 + [3.0] * 4 + [5.0] * 4
    assert rows["repeat"].to_list() == [0, 0, 1, 1] * 3
    assert sorted(set(rows["controller"])) == ["one", "two"]


def test_a_parameter_can_become_a_factor_and_a_factor_can_be_set(typed: Typed) -> None:
    typed("mine.toml", "--range", "y=0.1:1", "--set", "x=3", "--out", "out")
    assert set(configured("out")["factors"]) == {"y"}
    assert configured("out")["fixed"] == {"x": 3.0}
    assert rows_in("out")["value_N"].to_list() == [9.0] * 5


def test_a_worst_case_search_runs_from_the_command_line(
    typed: Typed, capsys: pytest.CaptureFixture[str]
) -> None:
    typed("worst.toml", "--repeats", "3", "--out", "out", "--json")
    rows = rows_in("out")
    assert json.loads(capsys.readouterr().out)["rows"] == len(rows) == 3
    assert (rows["worst_value_N"] == rows["worst_x_1"] ** 2).all()
    assert rows["worst_value_N"].n_unique() == 3


def test_the_file_of_a_study_is_where_ones_own_starts(
    typed: Typed, capsys: pytest.CaptureFixture[str]
) -> None:
    assert typed("tilt", "--toml") == 0
    text = capsys.readouterr().out
    assert text == (READY / "tilt.toml").read_text(encoding="utf-8")
    Path("own.toml").write_text(text, encoding="utf-8")
    own, theirs = (
        study_of(read_study(path)).configuration()
        for path in (Path("own.toml"), READY / "tilt.toml")
    )
    assert {**own, "name": "tilt"} == theirs
    assert typed("mine.toml", "--toml") == 0
    assert capsys.readouterr().out == MINE


def test_list_says_what_each_study_asks_and_how_many_rows_it_has(
    typed: Typed, capsys: pytest.CaptureFixture[str]
) -> None:
    assert typed("list", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert tuple(found) == ready_studies()
    assert all(found.values())
    assert typed("list") == 0
    said = capsys.readouterr().out
    for name in ready_studies():
        rows = len(Plan(study_of(read_study(READY / f"{name}.toml")), 0))
        assert re.search(rf"^ {name} +{rows} ", said, re.MULTILINE), (name, rows)


def test_status_counts_rows_and_says_by_its_exit_code_whether_some_are_missing(
    typed: Typed, capsys: pytest.CaptureFixture[str]
) -> None:
    typed("mine.toml", "--out", "out")
    capsys.readouterr()
    assert typed("status", "out") == 0
    assert capsys.readouterr().out == "study mine: 5 of 5 rows (5 ok)\n"
    for path in chunk_files(Path("out"))[:2]:
        path.unlink()
    assert typed("status", "out") == 1
    assert capsys.readouterr().out == "study mine: 3 of 5 rows (3 ok)\n"
    assert typed("status", "out", "--json") == 1
    assert json.loads(capsys.readouterr().out) == {
        **{"study": "mine", "done": 3, "rows": 5, "outcomes": {"ok": 3}, "complete": False}
    }
    assert typed("mine.toml", "--out", "out", "--resume") == 1  # by its criterion
    assert typed("status", "out") == 0


def test_a_query_prints_the_rows_that_it_finds(
    typed: Typed, capsys: pytest.CaptureFixture[str]
) -> None:
    typed("mine.toml", "--out", "out")
    capsys.readouterr()
    sql = "SELECT x_1, value_N FROM rows WHERE x_1 >= 5"
    assert typed("query", "out", sql) == 0
    assert capsys.readouterr().out.split() == ["x_1", "value_N", "5", "25", "10", "100"]
    assert typed("query", "out", sql, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found == [{"x_1": 5.0, "value_N": 25.0}, {"x_1": 10.0, "value_N": 100.0}]


def test_traces_hold_every_tick_of_as_many_rows_as_asked(typed: Typed) -> None:
    typed("mine.toml", "--traces", "2", "--controllers", "one", "two", "--out", "out")
    kept = [pl.read_parquet(path) for path in Path("out/traces").iterdir()]
    assert len(kept) == 4
    assert sorted({table["x"][0] for table in kept}) == [0.0, 10.0]
    typed("mine.toml", "--out", "none")
    assert not Path("none/traces").exists()  # all is well


def test_traces_hold_every_tick_of_what_failed_unless_they_are_not_wanted(typed: Typed) -> None:
    SYSTEMS["scripted"] = Scripted(script=loses_above_five)  # the fixture puts the old one back
    typed("mine.toml", "--out", "out")
    rows = rows_in("out").filter(pl.col("outcome") == "lost")
    assert rows["x_1"].to_list() == [10.0]
    kept = [path.stem for path in Path("out/traces").iterdir()]
    assert kept == [identity[:24] for identity in rows["identity"]]
    typed("mine.toml", "--no-failure-traces", "--out", "bare")
    assert not Path("bare/traces").exists()


def test_a_system_says_what_can_be_set_varied_and_measured(
    typed: Typed, capsys: pytest.CaptureFixture[str]
) -> None:
    assert typed("system") == 0
    assert {"scripted", "wipe"} <= set(capsys.readouterr().out.split())
    assert typed("system", "scripted") == 0
    said = capsys.readouterr().out
    assert all(name in said for name in (*Scripted.parameters, *Scripted.controllers, "value_N"))
    assert typed("system", "scripted", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["parameters"]["x"]["unit"] == Scripted.parameters["x"].unit


def test_a_full_disk_is_one_line_and_what_is_finished_stays(
    typed: Typed, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[Path] = []

    def sync(path: Path) -> None:
        synced.append(path)
        if len(synced) == 8:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(store, "_sync", sync)
    assert typed("mine.toml", "--out", "out") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("cannot be written: No space left on device")
    # study.json and two chunks were synced with their folders, and the folder of chunks with its
    assert len(chunk_files(Path("out"))) == len(list(Path("out/chunks").iterdir())) == 2


REFUSED = [
    ("mine.toml --set y=1 --set x=2", "--set: got it twice; give all its values after one --set"),
    ("mine.toml --range x=1:2 --seed 1 --range=x=1:3", "--range: got it twice"),
    ("mine.toml --controllers", "--controllers: needs a value"),
    ("mine.toml --size 3.5", "--size: got '3.5', need a whole number"),
    ("system scriptd", "unknown system 'scriptd'.*did you mean 'scripted'"),
    ("system scripted --jsn", "did you mean '--json'"),
    ("", "missing NAME; allowed: .*tilt.*, FILE.toml, list, system, status, query"),
    ("tlit", "unknown study 'tlit'.*did you mean 'tilt'"),
    ("none.toml", "study file 'none.toml': there is none"),
    ("mine.toml --range x=5:-5", "factor 'x': got low 5 and high -5 1, need low < high"),
    ("mine.toml --range x=nan:5", "factor 'x': low: got nan, need a finite number"),
    ("mine.toml --range x=0:80", "parameter 'x': got 80, need -10 to 10 1"),
    ("mine.toml --range x=3", "--range: got 'x=3', need NAME=LOW:HIGH"),
    ("mine.toml --range x", "--range: got 'x', need NAME=LOW:HIGH"),
    ("mine.toml --range z=0:1", "unknown parameter of system 'scripted' 'z'"),
    ("mine.toml --range colour=0:1", "factor 'colour' is a choice and has no range"),
    ("mine.toml --set y", "--set: got 'y', need NAME=VALUE"),
    ("mine.toml --set y=", "--set: got 'y=', need NAME=VALUE"),
    ("mine.toml --set y=long", "parameter 'y': got 'long', need a number"),
    ("mine.toml --set y=1000", "parameter 'y': got 1000, need 0.01 to 100 m"),
    ("mine.toml --set z=1", "unknown parameter of system 'scripted' 'z'"),
    ("mine.toml --set colour=pink", "unknown value of 'colour' 'pink'; allowed: blue, green, red"),
    ("mine.toml --set x=1", "nothing varies: need a factor"),
    ("mine.toml --size 1", "design levels: got size 1, need at least 2"),
    ("mine.toml --size x", "--size: .*"),
    ("mine.toml --repeats 0", "repeats: got 0, need 1 to"),
    ("mine.toml --controllers three", "unknown controller 'three'; allowed: one, two"),
    ("mine.toml --controllers one one", "controllers: got one, one, need each once"),
    ("tilt --workers 0", "workers: got 0, need at least 1"),
    ("mine.toml --seed -1", "seed: got -1, need a number >= 0"),
    ("mine.toml --traces -1", "traces: got -1, need a number >= 0"),
    ("mine.toml --friction 1", "unknown flag '--friction'"),
    ("mine.toml --toml --size 3", "got --toml beside other flags"),
    ("mine.toml --dask a:1 --dask-jobqueue b", "got --dask and --dask-jobqueue"),
    ("mine.toml --out /proc/nowhere", "'/proc/nowhere' cannot be written: No such file"),
    ("mine.toml --out mine.toml", "'mine.toml' cannot be written: File exists"),
    ("mine.toml --out .", "folder '.' is not empty and holds no study; give another --out"),
    ("worst.toml --size 4", "--size: a worst-case search has no design"),
    ("worst.toml --traces 1", "traces: study 'worst' searches, and keeps no ticks"),
    ("list --rows", "unknown flag '--rows'"),
    ("status", "study status: missing DIR"),
    ("status /nowhere", "'/nowhere' holds no study"),
    ("status . --jason", "unknown flag '--jason'.*did you mean '--json'"),
    ("query", 'study query: missing DIR and "SQL"'),
    ("query /nowhere", 'study query: missing "SQL"'),
    ("query /nowhere SELECT", "'/nowhere' holds no study"),
]


@pytest.mark.parametrize(("arguments", "said"), REFUSED, ids=[a for a, _ in REFUSED])
def test_bad_input_is_refused_in_one_line_and_leaves_nothing(
    arguments: str,
    said: str,
    typed: Typed,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if "--workers" in arguments:
        monkeypatch.undo()
        monkeypatch.chdir(tmp_path)
    assert typed(*arguments.split()) == 2
    printed, complained = capsys.readouterr()
    (line,) = complained.splitlines()
    assert printed == ""
    assert re.search(f"^qpctrl: .*{said}", line), line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.toml", "worst.toml"]


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("", "holds results of this study; go on with --resume"),
        ("--size 4 --resume", "configuration.design.size is 5 there and 4 here"),
        ("--seed 1 --resume", "seed is 0 there and 1 here"),
        ("--set y=1 --resume", "configuration.fixed.y is 0.5 there and 1.0 here"),
        ("--range x=-10:9 --resume", "configuration.factors.x.high is 10.0 there and 9.0 here"),
    ],
)
def test_a_folder_that_holds_something_else_is_refused_and_left_as_it_is(
    flags: str, said: str, typed: Typed, capsys: pytest.CaptureFixture[str]
) -> None:
    typed("mine.toml", "--out", "out")
    before = {path: path.read_bytes() for path in Path("out").rglob("*") if path.is_file()}
    capsys.readouterr()
    assert typed("mine.toml", "--out", "out", *flags.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert {p: p.read_bytes() for p in Path("out").rglob("*") if p.is_file()} == before
    shutil.rmtree("out")


@pytest.mark.parametrize(
    "command", ["", "tilt ", "list ", "system ", "status ", "status out ", "query "]
)
def test_every_command_explains_itself(
    command: str, typed: Typed, capsys: pytest.CaptureFixture[str]
) -> None:
    assert typed(*f"{command}--help".split()) == 0
    said = capsys.readouterr().out
    assert "qpctrl study" in said
    assert re.search("example|Example|List the studies", said)
