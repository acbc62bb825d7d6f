"""The command ``qpctrl study NAME | FILE.toml | list | system | status DIR | query DIR SQL``."""

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

from rich.table import Table

from qpctrl.errors import InputError
from scenarios.cli_study_print import print_campaign, print_rows
from scenarios.cli_study_progress import outcomes_text, study_progress
from scenarios.cli_study_system import system_command
from scenarios.command import parse
from scenarios.console import console
from scenarios.study.campaign import run_study, status
from scenarios.study.cluster import dask_machine, jobqueue_machine
from scenarios.study.machine import Machine, ProcessPool
from scenarios.study.plan import Plan
from scenarios.study.query import query
from scenarios.study.rollout import Tracing
from scenarios.study.store import json_text
from scenarios.study.study import Study
from scenarios.study.study_file import find_study, read_study, ready_studies, study_of

USAGE = f"""usage: qpctrl study NAME|FILE.toml [--help]
       qpctrl study list
       qpctrl study system [NAME]
       qpctrl study status DIR
       qpctrl study query DIR "SQL"

studies: {", ".join(ready_studies())}

examples:
  qpctrl study tilt --size 21 --range tilt=-10:10 --controllers qp textbook
  qpctrl study tilt --out runs/tilt --resume
  qpctrl study system wipe         # what can be set, varied and measured
  qpctrl study tilt --toml > mine.toml
  qpctrl study mine.toml --workers 4
  qpctrl study query runs/tilt "SELECT controller, max(force_ratio) FROM rows GROUP BY controller"
"""


LOOKS = ("list", "system", "status", "query")
"""What looks at studies and runs none."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Running:
    """Flags of ``study NAME``."""

    controllers: tuple[str, ...] = ()
    """Controllers that run side by side; default: those of the study."""
    size: int | None = None
    """Size of the design: levels, points or trajectories; default: that of the study."""
    repeats: int | None = None
    """Rollouts at each point with other random numbers; default: that of the study."""
    set: tuple[str, ...] = ()
    """Parameters with another value, each NAME=VALUE."""
    range: tuple[str, ...] = ()
    """Ranges of factors, each NAME=LOW:HIGH; a parameter that did not vary becomes a factor."""
    out: Path | None = None
    """Folder for the results; default runs/study-NAME."""
    resume: bool = False
    """Go on in a folder that holds results of this study: what is missing is made."""
    workers: int = 2
    """Processes that run at once, on this computer."""
    dask: str | None = None
    """Address of a dask scheduler whose workers run the study, tcp://HOST:PORT."""
    dask_jobqueue: Path | None = None
    """TOML file of a batch system's cluster that is started for the study."""
    traces: int = 0
    """Keep every tick of so many rows of the design, of those that are made in this run."""
    no_failure_traces: bool = False
    """Do not keep every tick of the rollouts that diverged, lost contact or chattered."""
    seed: int = 0
    """Seed of the design and of every random number."""
    toml: bool = False
    """Print the study's file as it is, to start one's own from, and run nothing."""
    json: bool = False
    """Print the summary as JSON."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Looking:
    """Flags of ``study list``, ``status`` and ``query``."""

    json: bool = False
    """Print JSON."""


def study_command(arguments: list[str]) -> bool:
    """Run a study, or look at one; return whether its criteria hold, or it is complete.

    Raises:
        InputError: an unknown study, or flags or a folder that cannot be used.
    """
    if not arguments:
        names = ", ".join((*ready_studies(), "FILE.toml", *LOOKS))
        raise InputError(f"missing NAME; allowed: {names}, --help")
    if arguments[0] in ("-h", "--help"):
        print(USAGE, end="")
        return True
    looks = {"list": _list, "system": system_command, "status": _status, "query": _query}
    return looks.get(arguments[0], _run)(arguments)


def _run(arguments: list[str]) -> bool:
    path = find_study(arguments[0])
    said = read_study(path)
    given = parse(
        Running,
        arguments[1:],
        prog=f"qpctrl study {arguments[0]}",
        description=f"Study {said['name']}: {said.get('summary', '')}.\n\n"
        f"Example: qpctrl study {arguments[0]} --out runs/{said['name']}",
    )
    if given.toml:
        others = dataclasses.replace(given, toml=False)
        if others != Running():
            raise InputError("got --toml beside other flags; it prints the file as it is")
        print(path.read_text(encoding="utf-8"), end="")
        return True
    study = study_of(_changed(said, given))
    plan, folder = Plan(study, given.seed), given.out or Path("runs") / f"study-{study.name}"
    machine, tracing = _machine(given), _tracing(given, plan)
    try:
        with study_progress(study.name) as watch:
            campaign = run_study(
                plan, machine, folder, resume=given.resume, tracing=tracing, watch=watch
            )
    except KeyboardInterrupt:
        print("qpctrl: interrupted; finished rows are kept, go on with --resume", file=sys.stderr)
        sys.exit(130)
    if given.json:
        print(json_text(campaign.summary), end="")
    else:
        print_campaign(campaign, folder)
    return campaign.passed


def _changed(said: dict[str, Any], given: Running) -> dict[str, Any]:
    """Return what a study file says with what the command line says in its place."""
    said = {**said, "factors": dict(said.get("factors", {})), "fixed": dict(said.get("fixed", {}))}
    if given.controllers:
        said["controllers"] = list(given.controllers)
    if given.size is not None:
        if "worst" in said:
            raise InputError("--size: a worst-case search has no design; --repeats makes more")
        said["design"] = {**said.get("design", {}), "size": given.size}
    if given.repeats is not None:
        said["repeats"] = given.repeats
    for text in given.set:
        name, value = _pair("set", text, "NAME=VALUE")
        said["factors"].pop(name, None)
        said["fixed"][name] = _number_or_name(value)
    for text in given.range:
        name, ends = _pair("range", text, "NAME=LOW:HIGH")
        low, _, high = ends.partition(":")
        try:
            limits = {"low": float(low), "high": float(high)}
        except ValueError as error:
            raise InputError(f"--range: got {text!r}, need NAME=LOW:HIGH") from error
        kept = {k: v for k, v in said["factors"].get(name, {}).items() if k == "distribution"}
        said["factors"][name] = {**kept, **limits}
        said["fixed"].pop(name, None)
    return said


def _pair(flag: str, text: str, form: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise InputError(f"--{flag}: got {text!r}, need {form}")
    return name, value


def _number_or_name(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _machine(given: Running) -> Machine:
    if given.dask is not None and given.dask_jobqueue is not None:
        raise InputError("got --dask and --dask-jobqueue, need at most one of them")
    if given.dask is not None:
        return dask_machine(given.dask)
    if given.dask_jobqueue is not None:
        return jobqueue_machine(given.dask_jobqueue)
    return ProcessPool(given.workers)


def _tracing(given: Running, plan: Plan) -> Tracing:
    if given.traces < 0:
        raise InputError(f"traces: got {given.traces}, need a number >= 0")
    if plan.study.search is not None and given.traces:
        raise InputError(f"traces: study {plan.study.name!r} searches, and keeps no ticks of that")
    rows = len(plan) // (plan.study.repeats * len(plan.study.controllers))
    return Tracing(given.traces, rows, failures=not given.no_failure_traces)


def _list(arguments: list[str]) -> bool:
    given = parse(Looking, arguments[1:], prog="qpctrl study list", description="List the studies.")
    studies: dict[str, Study] = {n: study_of(read_study(find_study(n))) for n in ready_studies()}
    if given.json:
        print(json.dumps({name: study.summary for name, study in studies.items()}, indent=2))
        return True
    table = Table("study", "rows", "system", "what it asks", box=None, header_style="bold")
    for name, study in studies.items():
        table.add_row(name, _rows(study), study.system.name, study.summary)
    console().print(table)
    return True


def _rows(study: Study) -> str:
    try:
        return str(len(Plan(study, 0)))
    except InputError:  # the package that makes its design is not installed
        return "–"


def _folder(arguments: list[str], form: str) -> Path:
    if len(arguments) < 2 or arguments[1].startswith("-"):
        if arguments[1:2] in (["-h"], ["--help"]):
            print(USAGE, end="")
            sys.exit(0)
        raise InputError(f"study {arguments[0]}: missing {form}")
    return Path(arguments[1])


def _status(arguments: list[str]) -> bool:
    folder = _folder(arguments, "DIR, the folder of a study")
    flags = parse(
        Looking,
        arguments[2:],
        prog="qpctrl study status DIR",
        description="Say how many rows of a study are there; exit code 1 while some are missing."
        "\n\nExample: qpctrl study status runs/tilt",
    )
    found = status(folder)
    if flags.json:
        print(json.dumps({**found._asdict(), "complete": found.done == found.rows}))
    else:
        print(f"study {found.study}: {found.done} of {found.rows} rows{outcomes_text(found)}")
    return found.done == found.rows


def _query(arguments: list[str]) -> bool:
    folder = _folder(arguments, 'DIR and "SQL"')
    if len(arguments) < 3 or arguments[2].startswith("-"):
        raise InputError('study query: missing "SQL", a query of the table rows')
    flags = parse(
        Looking,
        arguments[3:],
        prog='qpctrl study query DIR "SQL"',
        description="Ask the rows of a study in SQL; the table is called rows.\n\nExample: "
        'qpctrl study query runs/tilt "SELECT tilt_deg, force_ratio FROM rows"',
    )
    table = query(folder, arguments[2])
    if flags.json:
        print(table.write_json())
    else:
        print_rows(table)
    return True
