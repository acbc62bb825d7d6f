"""The command ``qpctrl export SCENARIO``."""

import dataclasses
import json
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl
from rich.console import Console
from rich.progress import Progress

from qpctrl.compiler import NotCompiledError, find_compiler, one_line
from qpctrl.errors import InputError
from qpctrl.export import RECORDING, Recording, check_name, identifier, project_files
from qpctrl.memory import Measurement
from scenarios.catalogue import SCENARIOS, scenario_named
from scenarios.command import interactive, merged, parse
from scenarios.console import console
from scenarios.record import Tick
from scenarios.run import all_or_none, writable_folder
from scenarios.scenario import Experiment, Options
from scenarios.simulation import simulate

USAGE = f"""usage: qpctrl export SCENARIO [--help]

scenarios: {", ".join(SCENARIOS)}

example:
  qpctrl export eraser --duration 1 --out controllers/eraser
"""

BUILD_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
"""The same as in the CMake file that is written."""

TIME_LIMIT = 600.0
"""A compiler or a replay that takes longer hangs [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Exporting:
    """Flags of ``export`` that are the same for every scenario."""

    out: Path | None = None
    """Folder for the files; default controllers/NAME."""
    name: str | None = None
    """What the names in C and of the files begin with; default: that of the scenario."""
    no_build: bool = False
    """Write the files without building and running the replay."""
    json: bool = False
    """Print the result as JSON."""


class Replay(NamedTuple):
    """What the test program found."""

    passed: bool
    numbers: dict[str, float]
    """What it printed as ``name=number``."""
    said: str
    """Its verdict, or why it did not come to one."""


class RecordedRun:
    """Keeps of every tick of a run what a replay needs."""

    def __init__(self, experiment: Experiment) -> None:
        start = experiment.start_mode, experiment.q_start
        self.recording = Recording(experiment.controller, *start)

    def add(self, tick: Tick) -> None:
        """Append one tick."""
        directive, state = tick.directive, tick.state
        measurement = Measurement(state.time, state.q, state.v, directive.contact)
        self.recording.add(directive.mode, measurement, tick.command)

    def table(self) -> pl.DataFrame:
        """Return nothing: the recording is what is kept."""
        return pl.DataFrame()


def export_command(arguments: list[str]) -> bool:
    """Write a scenario's controller as C, with a recorded run; return whether it is replayed.

    Raises:
        InputError: no or an unknown scenario, flags that cannot be used, or a folder that
            cannot be written.
    """
    if arguments[:1] in (["-h"], ["--help"]):
        print(USAGE, end="")
        return True
    kind = scenario_named(arguments)
    scenario = arguments[0]
    given: Any = parse(
        merged(f"Export{scenario.title()}", {"scenario": kind, "run": Options}, Exporting),
        arguments[1:],
        prog=f"qpctrl export {scenario}",
        description="Write the controller of a scenario as C99 that needs neither Python nor an "
        "allocation, with a run of the scenario to replay.\n\n"
        f"Example: qpctrl export {scenario} --out controllers/{scenario}",
    )
    name = identifier(scenario) if given.name is None else given.name
    check_name(name)
    folder = given.out or Path("controllers") / name
    experiment = given.scenario.prepare(_options(given.run))
    files = project_files(experiment.controller, name)
    writable_folder(folder, [*files, RECORDING])
    recording = _recorded(experiment, scenario)
    _write({**{n: t.encode() for n, t in files.items()}, RECORDING: recording.data()}, folder)
    replay, note = None, "not asked for"
    if not given.no_build:
        replay, note = _replayed(folder, sorted(n for n in files if n.endswith(".c")))
    _print(given.json, folder, [*files, RECORDING], recording, replay, note)
    return replay is None or replay.passed


def _options(given: Options) -> Options:
    """Return the options of the recorded run, whose solver is the one that is exported."""
    own = "active-set"
    if given.solver != own:
        raise InputError(
            f"solver: got {given.solver!r}, but an exported controller has its own, {own!r}; "
            "leave --solver out"
        )
    return dataclasses.replace(given, solver=own)


def _recorded(experiment: Experiment, name: str) -> Recording:
    run = RecordedRun(experiment)
    if not interactive():
        simulate(experiment, record=run)
        return run.recording
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(name, total=None)

        def watch(time: float, phase: str) -> None:
            progress.update(task, description=f"{name}: {phase}, {time:.1f} s simulated")

        simulate(experiment, record=run, watch=watch)
    return run.recording


def _write(files: Mapping[str, bytes], folder: Path) -> None:
    """Write all files or none."""
    with all_or_none(folder) as staging:
        for name, data in files.items():
            (staging / name).write_bytes(data)


def _replayed(folder: Path, sources: list[str]) -> tuple[Replay | None, str]:
    """Return what the replay found, built by this machine's compiler; or none, and why."""
    try:
        compiler = find_compiler()
    except NotCompiledError as error:
        return None, one_line(error)
    with tempfile.TemporaryDirectory(prefix="qpctrl-", ignore_cleanup_errors=True) as private:
        program = str(Path(private) / "replay")
        command = [*compiler.command, *BUILD_FLAGS, *sources, "-lm", "-o", program]
        for step in (command, [program, RECORDING]):
            try:
                ran = subprocess.run(
                    step, cwd=folder, capture_output=True, text=True, timeout=TIME_LIMIT
                )
            except subprocess.TimeoutExpired:
                late = f"{Path(step[0]).name} had not finished after {TIME_LIMIT:g} s"
                return Replay(False, {}, late), ""
            if ran.returncode and (step is command or not ran.stdout):
                return Replay(False, {}, one_line(ran.stderr, "error")), ""
    numbers, _, verdict = ran.stdout.partition("\n")
    found = dict(pair.split("=") for pair in numbers.split())
    values = {key: float(value) for key, value in found.items()}
    return Replay(ran.returncode == 0, values, verdict.strip()), ""


def _print(
    as_json: bool,
    folder: Path,
    names: list[str],
    recording: Recording,
    replay: Replay | None,
    note: str,
) -> None:
    """Print what was written and what the replay found."""
    run = {"ticks": recording.ticks, "fallback_ticks": recording.fallback_ticks}
    if as_json:
        found = replay and {"passed": replay.passed, "said": replay.said, **replay.numbers}
        result = {"folder": str(folder), "files": sorted(names), "modes": [*recording.modes]}
        print(json.dumps({**result, **run, "replay": found, "note": note}, indent=2))
        return
    out = console()
    out.print(
        f"recorded: {run['ticks']} ticks in {', '.join(recording.modes)}; "
        f"{run['fallback_ticks']} with the fallback torque"
    )
    if replay is None:
        out.print(f"replay: not built, {note}", soft_wrap=True)
    else:
        verdict = "[green]PASSED[/]" if replay.passed else "[red]FAILED[/]"
        out.print(f"replay {verdict}: {replay.said}", highlight=False, soft_wrap=True)
        if replay.numbers:
            out.print(
                f"tick {replay.numbers['tick_us_median']:.1f} µs median, "
                f"{replay.numbers['tick_us_p99']:.1f} µs p99, in C on this machine"
            )
    out.print(f"files: {folder}, begin with README.md", highlight=False, soft_wrap=True)
