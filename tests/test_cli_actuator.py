"""``qpctrl actuator`` as a person types it: data sheet, files, exit codes, one-line refusals."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from scenarios.actuator.catalogue import drive_names, load_drive
from scenarios.actuator.drive import JointDrive
from scenarios.actuator.sheet import CRITERIA, FACTS, data_sheet
from scenarios.actuator.transfer import TransferFunction, torque_transfer
from scenarios.cli import main
from scenarios.cli_actuator import summarise

DRIVE = """
source = "of this test"

[motor]
torque_constant = 0.078
resistance = 0.318
inductance = 2.0e-4
voltage = 48
peak_current = 30
continuous_current = 2.75
inertia = 3.594e-5
current_noise = 0.02
current_resolution = 0.015

[gear]
ratio = 100
inertia = 1.12e-5

[friction]
coulomb = 7.0
viscous = 3.44

[spring]
stiffness = 6000
hard_stop = 0.07
counts = 524288

[loops]
current_bandwidth = 1000
K_p = 5
K_i = 100
damping_ratio = 0.7
cutoff = 1000
"""


def typed(*arguments: str) -> int:
    """Return the exit code of a command."""
    with pytest.raises(SystemExit) as exited:
        main(list(arguments))
    return int(exited.value.code or 0)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder in which commands are typed."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def file_of(folder: Path, old: str = "", new: str = "") -> str:
    """Return the path of a drive file with ``old`` replaced by ``new``, once."""
    assert old in DRIVE
    path = folder / "mine.toml"
    path.write_text(DRIVE.replace(old, new, 1), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("arguments", [[], ["--list"]])
def test_without_a_name_the_drives_are_listed(folder: Path, capsys, arguments) -> None:
    assert typed("actuator", *arguments) == 0
    said = capsys.readouterr().out
    for name in drive_names():
        assert load_drive(name).design in next(
            line for line in said.splitlines() if line.split()[:1] == [name]
        )
    assert "Robonaut2" in said
    assert list(folder.iterdir()) == []


def test_the_list_in_json_has_the_numbers(capsys) -> None:
    assert typed("actuator", "--json") == 0
    rows = {row["drive"]: row for row in json.loads(capsys.readouterr().out)}
    assert set(rows) == set(drive_names())
    row = rows["ilm115-direct"]
    assert row["no_load_speed_rad_s"] == pytest.approx(33.9 / 0.2294)
    assert row["bandwidth_Hz"] == pytest.approx(500.0, rel=1e-5)
    assert row["peak_torque_Nm"] == pytest.approx(load_drive("ilm115-direct").peak_torque)


def test_a_file_of_the_users_is_measured_and_its_sheet_says_what_follows_from_it(
    folder: Path, capsys
) -> None:
    assert typed("actuator", file_of(folder)) == 0
    said = capsys.readouterr().out
    assert "mine, series-elastic PASSED" in said
    assert "of this test" in said
    out = folder / "runs" / "actuator-mine"
    assert str(out.relative_to(folder) / "actuator.html") in said
    assert sorted(file.name for file in out.iterdir()) == ["actuator.html", "summary.json"]
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    metrics = summary["metrics"]
    expected = {
        "reflected_inertia_kgm2": 100**2 * (3.594e-5 + 1.12e-5),
        "apparent_inertia_kgm2": 100**2 * (3.594e-5 + 1.12e-5) / 6,
        "stiffness_Nm_rad": 6000.0,
        "natural_frequency_Hz": 43.98,
        "no_load_speed_rad_s": 48 / 7.8,
        "torque_constant_Nm_A": 7.8,
        "continuous_torque_Nm": 7.8 * 2.75 - 7.0,
        "hard_stop_rad": 0.07,
        "static_Nm": 7.0,
        "reading_step_Nm": 6000 * 2 * math.pi / 524288,
    }
    for key, value in expected.items():
        assert metrics[key] == pytest.approx(value, rel=2e-4), key
    assert metrics["bandwidth_Hz"] == pytest.approx(metrics["bandwidth_model_Hz"], rel=0.02)
    assert metrics["bandwidth_model_Hz"] == pytest.approx(48.9, rel=0.01)
    assert metrics["bandwidth_second_order_Hz"] == pytest.approx(44.4, rel=0.01)
    assert summary["config"]["motor"]["voltage"] == 48
    assert summary["config"]["inner_rate"] == 10000
    assert {c["name"] for c in summary["criteria"]} == set(CRITERIA)
    assert all(c["value"] <= c["limit"] for c in summary["criteria"])


def test_the_page_is_self_contained_and_shows_what_was_measured(folder: Path) -> None:
    assert typed("actuator", "ilm115-direct", "--out", "deep/here") == 0
    page = (folder / "deep" / "here" / "actuator.html").read_text(encoding="utf-8")
    assert "PASSED" in page
    for key in ("speed", "bode", "step"):
        assert f'<div id="{key}"' in page
        assert f'"{key}": {{' in page
    assert "RobotDriveILM" in page
    assert "Bandwidth (−3 dB), measured" in page
    assert "Hard stop" not in page  # it has none
    assert "<link" not in page
    assert 'src="http' not in page


def test_json_output_is_the_summary_and_valid_json(folder: Path, capsys) -> None:
    assert typed("actuator", "ilm115-direct", "--json", "--out", "here") == 0
    said = capsys.readouterr().out
    assert json.loads(said) == json.loads((folder / "here" / "summary.json").read_text())
    summary = json.loads(said)
    assert summary["actuator"] == "ilm115-direct"
    assert summary["passed"]
    assert summary["metrics"]["stiffness_Nm_rad"] is None  # rigid
    assert summary["metrics"]["bandwidth_Hz"] == pytest.approx(500, rel=0.02)
    assert {"name", "value", "limit", "unit", "passed"} == set(summary["criteria"][0])
    facts = {fact.key for group in FACTS.values() for fact in group}
    assert set(summary["metrics"]) == facts
    assert len(summary["sweep"]["frequency_Hz"]) == len(summary["sweep"]["magnitude"]) > 10


def test_an_inner_rate_so_slow_that_the_closed_form_is_missed_fails(folder: Path, capsys) -> None:
    assert typed("actuator", "ilm115-direct", "--inner-rate", "4000") == 1
    said = capsys.readouterr().out
    assert "FAILED" in said
    assert said.count("missed") == 1
    line = next(line for line in said.splitlines() if "missed" in line)
    assert "Bandwidth" in line
    assert typed("actuator", "ilm115-direct", "--inner-rate", "40000") == 0
    capsys.readouterr()


def test_an_unstable_torque_loop_fails_and_still_leaves_its_page(folder: Path, capsys) -> None:
    wild = file_of(folder, "damping_ratio = 0.7\n", "")
    assert typed("actuator", wild, "--out", "wild") == 1
    said = capsys.readouterr().out
    assert "missed" in next(line for line in said.splitlines() if "Growth" in line)
    assert "FAILED" in (folder / "wild" / "actuator.html").read_text(encoding="utf-8")


def test_the_verdict_depends_on_the_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    """A transfer function that is 5 % too slow is not agreed with."""

    def slow(drive: JointDrive, step: float) -> TransferFunction:
        exact = torque_transfer(drive, step)
        return replace(exact, denominator=exact.denominator * [1.05, 1.0])

    drive = load_drive("ilm115-direct")
    assert data_sheet(drive).passed
    monkeypatch.setattr("scenarios.actuator.sheet.torque_transfer", slow)
    sheet = data_sheet(drive)
    assert not sheet.passed
    assert [c.name for c in sheet.criteria if not c.passed] == ["bandwidth_gap"]
    assert summarise(sheet)["passed"] is False


def test_the_same_drive_measured_twice_gives_the_same_numbers() -> None:
    first, again = (summarise(data_sheet(load_drive("planetary-geared"))) for _ in range(2))
    assert first == again


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("ilm115", "did you mean 'ilm115-direct'"),
        ("orange-elastc", "unknown drive 'orange-elastc'; allowed: "),
        ("ilm115-direct --inner-rat 3", "did you mean '--inner-rate'"),
        ("ilm115-direct --inner-rate fast", "--inner-rate: could not convert"),
        ("ilm115-direct --inner-rate 0", "inner_rate: got 0.0, need values > 0"),
        ("ilm115-direct --inner-rate -5", "inner_rate: got -5.0, need values > 0"),
        ("ilm115-direct --inner-rate nan", "inner_rate: got nan, need finite numbers"),
        ("ilm115-direct --inner-rate inf", "inner_rate: got inf, need finite numbers"),
        ("ilm115-direct --inner-rate 1e9", "inner_rate: got 1e+09 Hz, need at most 200000 Hz"),
        ("orange-elastic --inner-rate 3000", "current bandwidth of 1000 Hz; 7000 Hz would do"),
        ("ilm115-direct --inner-rate 2000", "current bandwidth of 500 Hz; 4000 Hz would do"),
        ("ilm115-direct extra", "unexpected argument 'extra'"),
        ("--jsn", "did you mean '--json'"),
        ("absent.toml", "drive file 'absent.toml': No such file or directory"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(folder: Path, capsys, arguments, message) -> None:
    assert typed("actuator", *arguments.split()) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert not list(folder.rglob("*.html"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("torque_constant = 0.078\n", "", "motor: missing torque_constant"),
        ('source = "of this test"\n', "", "missing source"),
        ('source = "of this test"', "source = 3", "source: got 3, need a text"),
        ("hard_stop", "hardstop", "did you mean 'hard_stop'"),
        ("[spring]", "[sprng]", "did you mean 'spring'"),
        ("\nK_p = 5", "\nKp = 5", "did you mean 'K_p'"),
        ("inertia = 3.594e-5", "inertia = 0", "motor: inertia: got 0, need a number > 0"),
        ("inertia = 3.594e-5", "inertia = -1.0", "motor: inertia: got -1.0, need a number > 0"),
        ("ratio = 100", "ratio = 0", "gear: ratio: got 0, need a number > 0"),
        (
            "stiffness = 6000",
            "stiffness = -6000",
            "spring: stiffness: got -6000, need a number > 0",
        ),
        ("stiffness = 6000", "stiffness = nan", "spring: stiffness: got nan, need a number"),
        ("stiffness = 6000", 'stiffness = "stiff"', "stiffness: got 'stiff', need a number"),
        ("stiffness = 6000", "stiffness = true", "stiffness: got True, need a number"),
        ("counts = 524288", "counts = -1", "spring: counts: got -1, need a number >= 0"),
        ("inertia = 1.12e-5", "efficiency = 1.5", "efficiency: got 1.5, need at most 1"),
        ("coulomb = 7.0", "coulomb = 700.0", "friction and the drive's own loops take all"),
        ("counts = 524288", "counts = 0.5", "spring: counts: got 0.5, need 0 or at least 1"),
        ("ratio = 100", "_positive = 3", "unknown key '_positive'; allowed: backlash,"),
        ("\nK_p = 5", "\nfriction_feedforward = 5", "friction_feedforward: got 5, need at most 1"),
        (
            "continuous_current = 2.75",
            "continuous_current = 300",
            "continuous_current: got 300, need at most 30, peak_current",
        ),
        ("inductance = 2.0e-4", "inductance = 2.0e-6", "winding, whose time constant is"),
        ("current_bandwidth = 1000", "current_bandwidth = 9000", "current bandwidth of 9000 Hz"),
        ("voltage = 48", "voltage = inf", "voltage: got inf, need a number from 1e-12 to 1e+12"),
        ("ratio = 100", "ratio = 1e300", "ratio: got 1e+300, need a number from"),
        ("stiffness = 6000", "stiffness = 3", "got a bandwidth of 1.79 Hz, need 2 Hz to a quarter"),
        ("[spring]", "[spring", "drive file"),
        ("[spring]", "spring = 3\n[no]", "drive file"),
        ("[loops]\n", "[strain_gauge]\nstiffness = 3e4\n[loops]\n", "a spring and a strain gauge"),
    ],
)
def test_a_drive_file_that_cannot_be_used_is_refused_in_one_line(
    folder: Path, capsys, old: str, new: str, message: str
) -> None:
    path = file_of(folder, old, new)
    assert typed("actuator", path) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert not list(folder.rglob("*.html"))


def test_files_that_are_no_text_are_refused_in_one_line(folder: Path, capsys) -> None:
    (folder / "binary.toml").write_bytes(b"\xff\xfe\x00\x01")
    (folder / "folder.toml").mkdir()
    for name, why in (("binary.toml", "decode"), ("folder.toml", "Is a directory")):
        assert typed("actuator", name) == 2
        captured = capsys.readouterr()
        assert captured.err.count("\n") == 1
        assert why in captured.err
        assert name in captured.err


def test_an_output_folder_that_cannot_be_written_is_refused_before_the_run(
    folder: Path, capsys
) -> None:
    (folder / "file").write_text("")
    assert typed("actuator", "ilm115-direct", "--out", "file/below") == 2
    assert "output folder" in capsys.readouterr().err
    (folder / "taken" / "actuator.html").mkdir(parents=True)
    assert typed("actuator", "ilm115-direct", "--out", "taken") == 2
    assert "actuator.html is a folder there" in capsys.readouterr().err
    assert [item.name for item in (folder / "taken").iterdir()] == ["actuator.html"]


def test_help_has_units_and_an_example(capsys) -> None:
    assert typed("actuator", "--help") == 0
    said = capsys.readouterr().out
    assert "FILE.toml" in said
    assert "qpctrl actuator orange-elastic" in said
    assert typed("actuator", "orange-elastic", "--help") == 0
    said = capsys.readouterr().out
    assert "[Hz]" in said
    assert "Example: qpctrl actuator orange-elastic" in said
    assert typed("--help") == 0
    assert "actuator NAME" in capsys.readouterr().out


def test_the_installed_command_never_shows_a_traceback(folder: Path) -> None:
    command = [str(Path(sys.executable).parent / "qpctrl"), "actuator", "/"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
