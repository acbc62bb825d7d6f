"""The command ``qpctrl report DIR``: the report of a study once more, finished or not."""

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import polars as pl
from polars.exceptions import PolarsError

from qpctrl.errors import InputError
from scenarios.cli_study_print import print_conclusion
from scenarios.command import parse
from scenarios.study.page import render_study
from scenarios.study.store import MANIFEST, json_text, read_manifest, read_rows, write_text
from scenarios.study.study import Study
from scenarios.study.study_file import study_of
from scenarios.study.summary import conclude

USAGE = """usage: qpctrl report DIR [--json]

Write report.html and summary.json of a study again, from the rows that are in its folder, and
print its verdict. The study may be unfinished, or still running. Exit code 1 while rows are
missing or a criterion is missed.

  DIR     folder of a study, runs/study-NAME by default
  --json  print the summary as JSON

examples:
  qpctrl report runs/study-tilt
  qpctrl report runs/study-tilt --json
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Reporting:
    """Flags of ``report``."""

    json: bool = False
    """Print the summary as JSON."""


def report_command(arguments: list[str]) -> bool:
    """Write the report of a study again; return whether it is complete and its criteria hold.

    Raises:
        InputError: no folder of a study, or one that cannot be read or written.
    """
    if not arguments or arguments[0].startswith("-"):
        if arguments[:1] in (["-h"], ["--help"]):
            print(USAGE, end="")
            sys.exit(0)
        raise InputError("report: missing DIR, the folder of a study; see qpctrl report --help")
    folder = Path(arguments[0])
    given = parse(Reporting, arguments[1:], prog="qpctrl report DIR", description=USAGE)
    _check_folder(folder)
    manifest = read_manifest(folder)
    study = study_of(manifest["configuration"])
    table = _rows(folder, study)
    criteria, summary = conclude(study, manifest, table, _timing(folder))
    write_text(folder / "summary.json", json_text(summary))
    write_text(folder / "report.html", render_study(study, table, criteria, summary))
    if given.json:
        print(json_text(summary), end="")
    else:
        print_conclusion(study, table, criteria, summary, folder)
    return bool(summary["passed"])


def _check_folder(folder: Path) -> None:
    """Refuse what is no folder of a study, and say what it is instead."""
    if not folder.is_dir():
        raise InputError(f"report: got {str(folder)!r}, which is no folder; need that of a study")
    if (folder / MANIFEST).exists():
        return
    if (folder / "ticks.parquet").exists() and (folder / "report.html").exists():
        raise InputError(
            f"folder {str(folder)!r} is that of a run, whose report is there already: "
            f"{folder / 'report.html'}; qpctrl report takes the folder of a study"
        )
    raise InputError(f"folder {str(folder)!r} holds no study: no {MANIFEST}")


def _rows(folder: Path, study: Study) -> pl.DataFrame:
    try:
        table = read_rows(folder, study)
    except PolarsError as error:
        said = str(error).splitlines()[0]
        raise InputError(
            f"folder {str(folder)!r}: its rows are not those of this version's study ({said}); "
            "its report.html is of the version that made them"
        ) from error
    if table.is_empty():
        raise InputError(f"folder {str(folder)!r} holds no rows yet")
    return table


def _timing(folder: Path) -> dict[str, Any] | None:
    """Return how long the rows took, as the summary that is there says."""
    try:
        found = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["timing"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return found if isinstance(found, dict) else None
