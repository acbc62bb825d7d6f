"""The command line: ``qpctrl COMMAND``, one module for each command.

Exit codes: 0 all of the command's own criteria hold, 1 they do not, 2 bad input (one line).
"""

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence

from rich.table import Table

from qpctrl.errors import InputError, QpctrlError, unknown_name
from scenarios.catalogue import SCENARIOS
from scenarios.cli_actuator import actuator_command
from scenarios.cli_bench import bench_command
from scenarios.cli_compare import compare_command
from scenarios.cli_compare_actuators import compare_actuators_command
from scenarios.cli_constraints import constraints_command
from scenarios.cli_export import export_command
from scenarios.cli_report import report_command
from scenarios.cli_run import run_command
from scenarios.cli_study import study_command
from scenarios.command import parse
from scenarios.console import console

USAGE = """usage: qpctrl COMMAND [--help]

commands:
  list                        scenarios that can be run
  run SCENARIO                run one and write summary.json, ticks.parquet and report.html
  compare                     QP against the closed-form laws over random states
  compare-actuators SCENARIO  one job with five actuators, and why they differ
  constraints NAME            natural and artificial constraints of a contact
  actuator NAME               data sheet of a joint drive, against its transfer function
  study NAME                  what a wrong constraint costs, over a range of errors
  report DIR                  the report of a study once more, finished or not
  export SCENARIO             its controller as C99, with a recorded run to replay
  bench                       where the time of a control tick goes, beside its peers

examples:
  qpctrl run eraser --force 15 --speed 0.1 --out runs/slow
  qpctrl run eraser --robot arm.urdf --tool tool0 --home 0 -1.2 1.5 0 1.2 0
  qpctrl compare --states 200
  qpctrl compare-actuators eraser
  qpctrl constraints hinge
  qpctrl actuator orange-elastic
  qpctrl study tilt
  qpctrl report runs/study-tilt
  qpctrl export eraser --duration 1
  qpctrl bench --quick --out runs/bench
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Listing:
    """Flags of ``list``."""

    json: bool = False
    """Print JSON."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        passed = _dispatch(list(arguments))
    except QpctrlError as error:
        print(f"qpctrl: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        sys.exit(1)
    except KeyboardInterrupt:
        print("qpctrl: interrupted, nothing written", file=sys.stderr)
        sys.exit(130)
    sys.exit(0 if passed else 1)


def _dispatch(arguments: list[str]) -> bool:
    commands: dict[str, Callable[[list[str]], bool]] = {
        "list": _list,
        "run": run_command,
        "compare": compare_command,
        "compare-actuators": compare_actuators_command,
        "constraints": constraints_command,
        "actuator": actuator_command,
        "study": study_command,
        "report": report_command,
        "export": export_command,
        "bench": bench_command,
    }
    if not arguments:
        raise InputError(f"missing COMMAND; allowed: {', '.join(commands)}, --help")
    if arguments[0] in ("-h", "--help"):
        print(USAGE, end="")
        return True
    if arguments[0] not in commands:
        raise unknown_name("command", arguments[0], commands)
    return commands[arguments[0]](arguments[1:])


def _list(arguments: list[str]) -> bool:
    listing = parse(
        Listing,
        arguments,
        prog="qpctrl list",
        description="List the scenarios.\n\nExample: qpctrl list --json",
    )
    found = {name: str(scenario.summary) for name, scenario in SCENARIOS.items()}
    if listing.json:
        print(json.dumps(found, indent=2))
        return True
    table = Table("scenario", "what happens", box=None, header_style="bold")
    for name, summary in found.items():
        table.add_row(name, summary)
    console().print(table)
    return True
