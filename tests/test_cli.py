"""The command line as a person types it: results, exit codes, one-line refusals."""

import json
import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest

from scenarios.cli import main

RUN = ["run", "eraser", "--duration", "2.0"]


def typed(*arguments: str) -> int:
    """Return the exit code of a command."""
    with pytest.raises(SystemExit) as exited:
        main(list(arguments))
    return int(exited.value.code or 0)


def test_list_names_every_scenario(capsys) -> None:
    assert typed("list") == 0
    assert "eraser" in capsys.readouterr().out
    assert typed("list", "--json") == 0
    assert "eraser" in json.loads(capsys.readouterr().out)


def test_a_run_leaves_three_files_and_says_where(tmp_path: Path, capsys) -> None:
    out = tmp_path / "deep" / "folder"
    assert typed(*RUN, "--out", str(out)) == 0
    said = capsys.readouterr().out
    assert "PASSED" in said
    assert str(out / "report.html") in said.replace("\n", "")
    assert sorted(file.name for file in out.iterdir()) == [
        "report.html",
        "summary.json",
        "ticks.parquet",
    ]
    summary = json.loads((out / "summary.json").read_text())
    assert summary["passed"]
    assert summary["config"]["duration"] == 2.0
    assert {"name", "value", "limit", "unit", "passed"} == set(summary["criteria"][0])
    promised = (
        "force_rmse_N force_bias_N force_peak_N position_rmse_mm orientation_rmse_deg "
        "contact_loss_fraction qp_law_gap_max qp_textbook_gap_max curvature_term_max "
        "saturated_fraction fallback_ticks tick_us_median tick_us_p99 tick_us_p999 realtime_factor"
    )
    assert set(promised.split()) <= set(summary["metrics"])
    ticks = pl.read_parquet(out / "ticks.parquet")
    assert ticks["time"].is_sorted()
    for column in ("q.joint1", "tau_qp.joint7", "tau_hybrid.joint1", "tau_textbook.joint1"):
        assert ticks[column].is_not_null().all()


def test_json_output_is_the_summary(tmp_path: Path, capsys) -> None:
    assert typed(*RUN, "--json", "--out", str(tmp_path)) == 0
    assert json.loads(capsys.readouterr().out)["scenario"] == "eraser"


def test_missed_criteria_exit_with_1(tmp_path: Path, capsys) -> None:
    weak = ["--k-p", "0", "--k-d", "0", "--out", str(tmp_path)]
    assert typed(*RUN, *weak) == 1
    assert "FAILED" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "missing COMMAND"),
        ("rn", "did you mean 'run'"),
        ("run", "missing SCENARIO"),
        ("run earser", "did you mean 'eraser'"),
        ("run eraser --forc 3", "did you mean '--force'"),
        ("run eraser --force -3", "force: got -3.0, need values > 0"),
        ("run eraser --force nan", "force: got nan, need finite"),
        ("run eraser --force ten", "--force: could not convert"),
        ("run eraser --force", "--force: needs a value"),
        ("run eraser 7", "unexpected argument '7'"),
        ("run eraser --duration 0", "duration: got 0.0"),
        ("run eraser --duration inf", "duration: got inf"),
        ("run eraser --duration 1e12", "need at most 3600 s"),
        ("run eraser --speed 60", "need at most 5 m/s"),
        ("run eraser --solver quadprog --form full", "cannot solve the full form"),
        ("compare --solver quadprog --form full", "cannot solve the full form"),
        ("run eraser --home 5 -1.1 0 -2.4 0 2.87 0", "joint 'joint1' at 5"),
        ("run eraser --robot " + "a" * 300, "unknown robot"),
        ("run eraser --k-fp -1", "k_fp: got -1.0"),
        ("run eraser --friction nan", "friction: got nan"),
        ("run eraser --law textbok", "did you mean 'textbook'"),
        ("run eraser --form ful", "did you mean 'full'"),
        ("run eraser --plant mujco", "did you mean 'mujoco'"),
        ("run eraser --solver proxsuit", "did you mean 'proxsuite'"),
        ("run eraser --robot fr4", "did you mean 'fr3'"),
        ("run eraser --robot absent.urdf", "does not exist"),
        ("run eraser --robot planar_2r", "six directions"),
        ("run eraser --tool flang", "did you mean 'flange'"),
        ("run eraser --home 1 2", "need 7 finite numbers"),
        ("run eraser --seed 1.5", "--seed: invalid"),
        ("run eraser --seed -1", "seed: got -1"),
        ("compare --states 0", "states: got 0"),
        ("compare --second dapq", "did you mean 'daqp'"),
        ("list --jsn", "did you mean '--json'"),
        ("constraint hinge", "did you mean 'constraints'"),
        ("constraints hing", "did you mean 'hinge'"),
        ("constraints face-on-plane", "did you mean 'face_on_plane'"),
        ("constraints --jsn", "did you mean '--json'"),
        ("constraints hinge --jsn", "did you mean '--json'"),
        ("constraints hinge screw", "unexpected argument 'screw'"),
        ("constraints --json hinge", "unexpected argument 'hinge'"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert typed(*arguments.split()) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert list(tmp_path.iterdir()) == []  # nothing half-written left behind


def test_an_output_folder_that_cannot_be_written_is_refused_before_the_run(tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("")
    assert typed("run", "eraser", "--out", str(file / "below")) == 2
    assert "output folder" in capsys.readouterr().err


def test_a_folder_in_the_place_of_a_file_is_refused_and_nothing_is_written(tmp_path, capsys):
    (tmp_path / "ticks.parquet").mkdir()
    assert typed(*RUN, "--out", str(tmp_path)) == 2
    assert "ticks.parquet is a folder" in capsys.readouterr().err
    assert [item.name for item in tmp_path.iterdir()] == ["ticks.parquet"]


def test_an_interrupted_run_says_so_and_leaves_nothing(tmp_path, capsys, monkeypatch):
    def interrupt(*_args, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("scenarios.run.simulate", interrupt)
    assert typed(*RUN, "--out", str(tmp_path / "out")) == 130
    assert "interrupted" in capsys.readouterr().err
    assert list((tmp_path / "out").iterdir()) == []


def test_help_has_units_and_an_example(capsys) -> None:
    assert typed("run", "eraser", "--help") == 0
    said = capsys.readouterr().out
    assert "[m/s]" in said
    assert "Example: qpctrl run eraser" in said
    assert typed("--help") == 0
    assert "qpctrl compare --states 200" in capsys.readouterr().out
    assert typed("constraints", "hinge", "--help") == 0
    assert "Example: qpctrl constraints hinge" in capsys.readouterr().out


def test_compare_prints_the_table_and_passes(capsys) -> None:
    assert typed("compare", "--states", "15") == 0
    said = capsys.readouterr().out
    assert "PASSED" in said
    assert said.count("fr3") == 5
    assert "QP − hybrid" in said


def test_the_installed_command_never_shows_a_traceback() -> None:
    command = [Path(sys.executable).parent / "qpctrl", "run", "eraser", "--robot", "/"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
