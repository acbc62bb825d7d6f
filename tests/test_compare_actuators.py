"""One job with five actuators: what is compared, and why they differ."""

import json
import math
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from runs import ran

from scenarios import actuator_comparison
from scenarios.actuator.ablation import ABLATIONS, without
from scenarios.actuator.catalogue import load_drive
from scenarios.actuator.drive import JointDrive
from scenarios.actuator.transfer import torque_transfer
from scenarios.actuator_comparison import ACTUATORS, Comparison, Row, compare_actuators
from scenarios.actuator_comparison_page import render_comparison
from scenarios.actuator_reason import WORDS, Study
from scenarios.catalogue import SCENARIOS
from scenarios.cli import main
from scenarios.cli_compare_actuators import WITH_FORCE, summarise
from scenarios.eraser import Eraser
from scenarios.force_error import find_force_error
from scenarios.job import Finding, Job
from scenarios.scenario import Options

QPCTRL = Path(sys.executable).parent / "qpctrl"
FILES = {"summary.json", "ticks.parquet", "report.html"}
NAN = math.nan


@pytest.fixture(scope="module")
def compared(tmp_path_factory) -> tuple[subprocess.CompletedProcess[str], Path]:
    """Return what a short comparison says, and where its files are."""
    out = tmp_path_factory.mktemp("compared")
    flags = ("--duration", "2", "--no-ablations", "--out", out)
    command = [QPCTRL, "compare-actuators", "eraser", *flags]
    return subprocess.run(command, capture_output=True, text=True, check=False), out


def summary_of(out: Path) -> dict:
    return json.loads((out / "summary.json").read_text(encoding="utf-8"))


def test_five_actuators_do_the_job_and_all_criteria_hold(compared) -> None:
    done, out = compared
    assert done.returncode == 0, done.stderr
    assert "PASSED" in done.stdout
    assert str(out / "report.html") in done.stdout
    summary = summary_of(out)
    assert summary["passed"]
    assert [c["name"] for c in summary["criteria"]] == [
        *("fallback_ticks", "strain_gauge_share", "motor_limited_ticks"),
    ]
    assert list(summary["actuators"]) == [
        *("ideal", "direct-drive", "geared", "strain-gauge", "series-elastic"),
    ]
    assert {path.name for path in out.iterdir()} == {*ACTUATORS, "summary.json", "report.html"}
    for name in ACTUATORS:
        assert {path.name for path in (out / name).iterdir()} == FILES
        assert summary_of(out / name)["config"]["actuator"] == name


def test_torque_feedback_hides_what_gears_do(compared) -> None:
    """8 Nm of friction at the joints are newtons at the tool; measured torque leaves tenths."""
    found = summary_of(compared[1])["actuators"]
    geared, strain = found["geared"], found["strain-gauge"]
    assert geared["force_rmse_N"] > 1.0
    assert geared["torque_error_rms_Nm"] > 3.0  # Coulomb friction of the drives: 3.45 and 7 Nm
    assert 0.1 < strain["force_rmse_N"] < 0.2 * geared["force_rmse_N"]
    assert found["ideal"]["torque_error_rms_Nm"] == 0.0
    assert 0.001 < found["direct-drive"]["torque_error_rms_Nm"] < 0.05  # noise of the current


def test_the_figures_are_those_of_the_records(compared) -> None:
    out = compared[1]
    assert summary_of(out)["phase"] == "wipe"
    for name, found in summary_of(out)["actuators"].items():
        ticks = pl.read_parquet(out / name / "ticks.parquet")
        wipe = ticks.filter(pl.col("phase") == "wipe")
        error = wipe["wrench_meas.fz"].to_numpy() - 10.0
        assert found["force_mae_N"] == pytest.approx(np.abs(error).mean(), rel=1e-9)
        assert found["force_rmse_N"] == pytest.approx(np.sqrt((error**2).mean()), rel=1e-9)
        gaps = [wipe[f"tau_delivered.joint{i}"] - wipe[f"tau.joint{i}"] for i in range(1, 8)]
        rms = math.sqrt(sum(float((gap**2).mean()) for gap in gaps) / 7)
        assert found["torque_error_rms_Nm"] == pytest.approx(rms, rel=1e-9)
        assert found["saturated_fraction"] == pytest.approx(ticks["saturated"].mean())
        assert found["fallback_ticks_total"] == (ticks["status"] != "OK").sum() == 0
        assert found["realtime_factor"] > 0


def test_the_page_shows_all_five_and_needs_no_other_file(compared) -> None:
    html = (compared[1] / "report.html").read_text(encoding="utf-8")
    own = html.split("<script>")[0]
    assert all(f"<a href='{name}/report.html'>{name}</a>" in own for name in ACTUATORS)
    assert "http" not in own
    assert own.count('role="img"') == 2
    assert "Why they differ" not in own  # it was not found out


def test_without_friction_a_geared_arm_presses_nearly_as_well_as_an_ideal_one(compared) -> None:
    found = summary_of(compared[1])["actuators"]
    job = ("eraser", "--duration", "2", "--actuator", "geared")
    free = ran(*job, "--without", "friction")
    assert free.summary["config"]["without"] == ["friction"]
    assert 0.01 < free.metrics["force_rmse_N"] < 0.1 * found["geared"]["force_rmse_N"]
    assert free.metrics["force_rmse_N"] < 2.0 * found["ideal"]["force_rmse_N"]


STRAIN, ELASTIC = load_drive("orange-strain"), load_drive("orange-elastic")
HARMONIC, PLANETARY = load_drive("harmonic-geared"), load_drive("planetary-geared")


def test_what_is_taken_away_is_gone_and_the_rest_stays() -> None:
    loops = replace(STRAIN.loops, K_p=0.0, K_i=0.0)
    assert without(STRAIN, "torque-loop") == replace(STRAIN, loops=loops)
    assert without(PLANETARY, "backlash").gear == replace(PLANETARY.gear, backlash=0.0)
    slick = without(HARMONIC, "friction")
    assert (slick.friction.coulomb, slick.friction.static, slick.friction.viscous) == (0, 0, 0)
    assert slick.gear == replace(HARMONIC.gear, efficiency=1.0)
    quiet = without(STRAIN, "noise")
    assert (quiet.strain_gauge.noise, quiet.strain_gauge.resolution) == (0, 0)
    assert (quiet.motor.current_noise, quiet.motor.current_resolution) == (0, 0)
    assert quiet.limits() == STRAIN.limits()
    assert without(ELASTIC, "noise").spring.counts == 0
    strong = without(ELASTIC, "limits")
    assert strong.limits().peak > 5 * ELASTIC.limits().peak
    assert strong.no_load_speed == pytest.approx(10 * ELASTIC.no_load_speed)


@pytest.mark.parametrize("drive", [STRAIN, ELASTIC, HARMONIC], ids=lambda drive: drive.name)
def test_a_stiffer_drive_is_the_same_but_faster(drive: JointDrive) -> None:
    """Ten times the stiffness and √10 times the rates: the same transfer function of f / √10."""
    slick = without(drive, "friction")
    stiff = without(slick, "compliance")
    assert stiff.stiffness == pytest.approx(10 * slick.stiffness)
    f = np.geomspace(0.1, 1000, 40)
    slow, fast = torque_transfer(slick)(f), torque_transfer(stiff)(f * math.sqrt(10))
    assert np.abs(slow).min() < 0.9 < np.abs(slow).max()  # all of it is seen
    assert fast == pytest.approx(slow, rel=1e-9)
    assert stiff.limits().peak == pytest.approx(slick.limits().peak)
    if drive.spring:
        springs = [one.spring for one in (slick, stiff)]
        step = [spring.stiffness / spring.counts for spring in springs]
        stop = [spring.stiffness * spring.hard_stop for spring in springs]
        assert step[1] == pytest.approx(step[0])
        assert stop[1] == pytest.approx(stop[0])


def test_drives_that_have_it_not_refuse_to_lose_it(tmp_path: Path, capsys) -> None:
    run = ("run", "eraser", "--out", str(tmp_path))
    assert typed(*run, "--actuator", "geared", "--without", "backlash") == 2
    assert "without: got backlash, which none of the drives has" in capsys.readouterr().err
    assert typed(*run, "--without", "friction") == 2
    assert "with actuator 'ideal', need none" in capsys.readouterr().err


EXPLAINED = Study(whole=7.6, ideal=0.05, without={"friction": 0.06, "noise": 7.5})
LOOPED = Study(
    whole=0.6, ideal=0.1, without={"friction": 0.9, "compliance": 0.3, "torque-loop": 3.0}
)
OPEN = Study(whole=1.0, ideal=0.1, without={"friction": 0.8, "noise": 0.9}, together=0.2)
HOPELESS = Study(whole=1.0, ideal=0.1, without={"friction": 1.1, "noise": NAN}, together=0.9)
EQUAL = Study(whole=1.0, ideal=0.1, without={"compliance": 0.2, "sampling": 0.22})
FAILED = Study(whole=NAN, ideal=0.1, without={"friction": 0.2, "noise": NAN})
NEAR = Study(whole=0.119, ideal=0.1, without={"noise": 0.01})


@pytest.mark.parametrize(
    ("study", "cause", "words"),
    [
        (
            EXPLAINED,
            "friction",
            "7.6 N RMS, ideal joints 0.05 N; "
            "without friction of motor and gear 0.06 N: friction explains it.",
        ),
        (
            LOOPED,
            "compliance",
            "0.6 N RMS, ideal joints 0.1 N; with drives ten times as stiff 0.3 N: compliance "
            "explains most of it. Worse: without friction of motor and gear 0.9 N. "
            "Without its torque loop 3 N.",
        ),
        (
            OPEN,
            None,
            "1 N RMS, ideal joints 0.1 N; no single thing explains it, at best without friction of "
            "motor and gear 0.8 N; without all of them 0.2 N: together they explain it.",
        ),
        (
            HOPELESS,
            None,
            "1 N RMS, ideal joints 0.1 N; nothing that is taken away makes it smaller; "
            "without all of them 0.9 N: not even together.",
        ),
        (
            EQUAL,
            "sampling",
            "1 N RMS, ideal joints 0.1 N; in inner steps a quarter as long 0.22 N: the length of "
            "the inner step explains most of it.",
        ),
        (FAILED, None, "the job fails; not so without friction of motor and gear 0.2 N."),
        (NEAR, None, "0.119 N RMS, ideal joints 0.1 N: nothing needs explaining."),
    ],
)
def test_the_reason_follows_from_the_figures(study: Study, cause: str | None, words: str) -> None:
    assert study.cause == cause
    assert study.sentence() == words


def record(force: Sequence[float], across: float = 0.0) -> pl.DataFrame:
    """Return a record that presses along z after an approach, with friction ``across`` it."""
    n = len(force)
    wanted = [np.full(n, value) for value in (0.0, 0.0, 10.0)]
    return pl.DataFrame(
        {
            "time": 1e-3 * np.arange(n + 1),
            "phase": ["approach", *["wipe"] * n],
            "tau.joint1": np.zeros(n + 1),
            "tau_delivered.joint1": np.full(n + 1, 0.5),
            "wrench_meas.fx": np.full(n + 1, across),
            "wrench_meas.fy": np.zeros(n + 1),
            "wrench_meas.fz": [0.0, *force],
            **{f"force.F_des.{i}": [NAN, *wanted[i]] for i in range(3)},
        }
    )


def test_the_error_that_a_scenario_judges_is_found_by_its_rms() -> None:
    table = record([9.0, 11.0, 13.0], across=3.0)
    along = find_force_error(table, math.sqrt(11 / 3))  # 1, 1, 3 along z
    assert along is not None
    assert along.phase == "wipe"
    assert along.set_point == pytest.approx([0, 0, 10])
    assert along.magnitude(along.judged(table)) == pytest.approx([1, 1, 3])
    whole = find_force_error(table, math.sqrt((11 + 27) / 3))  # with 3 N across
    assert whole is not None
    assert whole.set_point is None
    assert whole.magnitude(whole.judged(table)) == pytest.approx(np.sqrt([10, 10, 18]))
    assert find_force_error(table, 5.0) is None
    assert find_force_error(table, NAN) is None


def finding(rmse: float, torque_limited: bool = False) -> Finding:
    metrics = {"force_rmse_N": rmse, "realtime_factor": 2.0}
    return Finding(metrics, 0.25, 0, torque_limited, 0)


def studied(
    tmp_path: Path, monkeypatch, force_rmse: Callable[[Job], float]
) -> tuple[Comparison, list[Job]]:
    """Return a comparison of 8 s jobs whose force errors are made up, and its jobs."""
    jobs: list[Job] = []

    def run_jobs(pool: None, given: Sequence[Job], watch: Callable[[], None]) -> list:
        jobs.extend(given)
        for job in given:
            if job.out is not None:
                job.out.mkdir()
                record([9.0, 11.0, 13.0]).write_parquet(job.out / "ticks.parquet")
            watch()
        geared = [job.options.actuator == "geared" for job in given]
        return [finding(force_rmse(j), g) for j, g in zip(given, geared, strict=True)]

    @contextmanager
    def nobody():
        yield None

    monkeypatch.setattr(actuator_comparison, "run_jobs", run_jobs)
    monkeypatch.setattr(actuator_comparison, "workers", nobody)
    seen: list[tuple[int, int]] = []
    found = compare_actuators(
        Eraser(), Options(), out=tmp_path, watch=lambda done, known: seen.append((done, known))
    )
    assert seen[-1] == (len(jobs), len(jobs))
    return found, jobs


def test_the_study_takes_one_thing_away_at_a_time(tmp_path: Path, monkeypatch) -> None:
    def force_rmse(job: Job) -> float:
        if job.options.actuator == "ideal":
            return math.sqrt(11 / 3)
        return 2.0 if "friction" in job.options.without else 9.0

    comparison, jobs = studied(tmp_path, monkeypatch, force_rmse)
    main_runs, study = jobs[:5], jobs[5:]
    assert [job.scenario.duration for job in main_runs] == [8.0] * 5
    assert {job.scenario.duration for job in study} == {2.0}
    geared = [job.options for job in study if job.options.actuator == "geared"]
    assert sorted(o.without for o in geared) == [
        *((), ()),  # the whole drive, and the same in shorter steps
        *(("backlash",), ("compliance",), ("friction",), ("limits",), ("noise",)),
        ("torque-loop",),
    ]
    rates = {o.without: o.inner_rate for o in geared if o.without}
    assert rates == {(n,): 40e3 if n == "compliance" else 10e3 for n in ABLATIONS}
    assert [o.inner_rate for o in geared if not o.without] == [10e3, 40e3]
    strain = [job.options for job in study if job.options.actuator == "strain-gauge"]
    assert ("limits",) not in [o.without for o in strain]  # no limit of torque was met
    causes = {name: study.cause for name, study in comparison.studies.items()}
    assert causes == dict.fromkeys(ACTUATORS[1:], "friction")
    assert all(study.together is None for study in comparison.studies.values())
    summary = summarise(comparison)
    assert summary["actuators"]["geared"]["study"]["without"]["friction"] == 2.0
    html = render_comparison(comparison, summary).split("<script>")[0]
    assert html.count('<td class="n good">2</td>') == 4
    assert "a shorter job, 2 s" in html
    assert comparison.rows["geared"].force_mae == pytest.approx(5 / 3)
    assert comparison.rows["geared"].torque_error == pytest.approx(0.5)
    assert math.isnan(comparison.rows["geared"].position_rmse)
    assert '<td class="n">–</td>' in html


def test_where_nothing_explains_all_is_taken_away_at_once(tmp_path: Path, monkeypatch) -> None:
    def force_rmse(job: Job) -> float:
        ideal = job.options.actuator == "ideal" or len(job.options.without) > 1
        return 1.0 if ideal else 9.0 - 0.1 * len(job.options.without)

    comparison, jobs = studied(tmp_path, monkeypatch, force_rmse)
    last = [job.options for job in jobs[-4:]]
    assert [o.actuator for o in last] == list(ACTUATORS[1:])
    assert set(last[1].without) == set(ABLATIONS) - {"torque-loop"}
    assert "limits" not in last[2].without
    assert {o.inner_rate for o in last} == {40e3}
    assert comparison.studies["geared"].together == 1.0
    assert "together they explain it" in comparison.studies["geared"].sentence()


FINE = Row(0.1, 0.1, 0.1, 0.1, 0.0, 0.0, 0, 0, 2.0)


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({}, set()),
        ({"geared": {"fallback_ticks": 3}}, set()),  # a geared drive may
        ({"series-elastic": {"fallback_ticks": 3}}, {"fallback_ticks"}),
        ({"geared": {"motor_limited_ticks": 1}}, {"motor_limited_ticks"}),
        ({"strain-gauge": {"force_rmse": 0.39}}, set()),
        ({"strain-gauge": {"force_rmse": 0.41}}, {"strain_gauge_share"}),
        ({"strain-gauge": {"force_rmse": NAN}}, {"strain_gauge_share"}),
    ],
)
def test_each_criterion_can_be_missed(changes: dict, missed: set[str]) -> None:
    rows = dict.fromkeys(ACTUATORS, FINE) | {"geared": FINE._replace(force_rmse=2.0)}
    rows |= {name: rows[name]._replace(**change) for name, change in changes.items()}
    comparison = Comparison(
        scenario=Eraser(),
        options=Options(),
        rows=rows,
        tables={},
        error=None,
        short=Eraser(),
        studies={},
    )
    assert {c.name for c in comparison.criteria if not c.passed} == missed
    assert comparison.passed == (not missed)


def typed(*arguments: str) -> int:
    """Return the exit code of a command."""
    with pytest.raises(SystemExit) as exited:
        main(list(arguments))
    return int(exited.value.code or 0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "missing SCENARIO"),
        (("erasr",), "did you mean 'eraser'"),
        (("haptic",), "cannot be compared with drives; those that can: eraser, gap"),
        (("eraser", "--forc", "3"), "did you mean '--force'"),
        (("eraser", "--drives", "orange-geared"), "unknown flag '--drives'"),
        (("eraser", "--duration", "-1"), "duration: got -1.0"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments: tuple[str, ...], said: str, capsys) -> None:
    assert typed("compare-actuators", *arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_rate_that_does_not_fit_is_refused_and_leaves_nothing(tmp_path: Path, capsys) -> None:
    out = tmp_path / "new"
    flags = ("--inner-rate", "1500", "--out", str(out))
    assert typed("compare-actuators", "eraser", *flags) == 2
    assert "actuator 'direct-drive': inner_rate: got 1500 Hz" in capsys.readouterr().err
    assert not out.exists()


def test_the_scenarios_with_a_force_error_are_known() -> None:
    """By their sources: a new one that reports the metric must be named."""
    given = ("force_rmse_N", "guided_metrics(", "wiping_metrics(")

    def reports(name: str) -> bool:
        source = Path(sys.modules[SCENARIOS[name].__module__].__file__ or "").read_text("utf-8")
        return any(words in source for words in given)

    # no series-elastic drive is strong enough for the base of mobile_eraser
    assert {name for name in SCENARIOS if reports(name)} == {*WITH_FORCE, "mobile_eraser"}


def test_every_change_has_its_words() -> None:
    assert set(WORDS) == {*ABLATIONS, "sampling"}
