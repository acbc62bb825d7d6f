"""The command ``qpctrl actuator NAME``: the data sheet of a joint drive, measured."""

import dataclasses
import json
import math
import shutil
import tempfile
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Column, Table

from qpctrl.errors import InputError
from scenarios.actuator.catalogue import drive_names, drive_text, load_drive
from scenarios.actuator.inner import INNER_RATE
from scenarios.actuator.page import render_page
from scenarios.actuator.sheet import CRITERIA, DataSheet, data_sheet, model_bandwidth
from scenarios.actuator.transfer import torque_transfer
from scenarios.command import parse
from scenarios.console import console
from scenarios.report_style import number
from scenarios.run import plain, versions, writable_folder

FILES = ("summary.json", "actuator.html")
"""What the command leaves behind."""

WIDTHS = (44, 12, 12)
"""Of the columns of what is printed: words, value, unit or limit."""

USAGE = """usage: qpctrl actuator [NAME] [--help]

NAME: a drive of the list that `qpctrl actuator` prints, or FILE.toml with tables like those of
      scenarios/actuator/drives.toml

example:
  qpctrl actuator orange-elastic --out runs/orange
  qpctrl actuator orange-elastic --toml > mine.toml
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Listing:
    """Flags of ``actuator`` without a name."""

    list: bool = False
    """List the drives, as without any flag."""
    json: bool = False
    """Print JSON."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Measuring:
    """Flags of ``actuator NAME``."""

    out: Path | None = None
    """Folder for the results; default runs/actuator-NAME."""
    inner_rate: float = INNER_RATE
    """Rate of the drive's current and torque loops [Hz]."""
    json: bool = False
    """Print the summary as JSON."""
    toml: bool = False
    """Measure nothing, print the drive as the text of a FILE.toml, to begin one of yours with."""


def actuator_command(arguments: list[str]) -> bool:
    """Measure a drive, leave its page, print its data sheet; return whether its criteria hold.

    Raises:
        InputError: an unknown name, a file or flags that cannot be used.
    """
    if arguments and arguments[0] in ("-h", "--help"):
        print(USAGE, end="")
        return True
    if not arguments or arguments[0].startswith("-"):
        return _list(arguments)
    drive = load_drive(arguments[0])
    given = parse(
        Measuring,
        arguments[1:],
        prog=f"qpctrl actuator {arguments[0]}",
        description="Measure a joint drive on a bench: torque at rest and at speed, its frequency "
        "response against the transfer function, its answer to a step, its limits.\n\n"
        f"Example: qpctrl actuator {drive.name} --out runs/{drive.name}",
    )
    if given.toml:
        print(drive_text(drive), end="")
        return True
    folder = given.out or Path("runs") / f"actuator-{drive.name}"
    _writable(folder)
    sheet = data_sheet(drive, inner_rate=given.inner_rate)
    summary = summarise(sheet)
    _write(folder, summary, sheet)
    if given.json:
        print(json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        _print_sheet(sheet, folder)
    return sheet.passed


def summarise(sheet: DataSheet) -> dict[str, Any]:
    """Return what summary.json holds; what does not exist or is infinite is null."""
    drive = dataclasses.asdict(sheet.drive)
    name, source = drive.pop("name"), drive.pop("source")
    found: dict[str, Any] = {
        "actuator": name,
        "design": sheet.drive.design,
        "source": source,
        "passed": sheet.passed,
        "criteria": [{**c._asdict(), "passed": c.passed} for c in sheet.criteria],
        "metrics": sheet.metrics,
        "sweep": {
            "frequency_Hz": sheet.sweep.frequency.tolist(),
            "magnitude": abs(sheet.sweep.response).tolist(),
            "model_magnitude": abs(sheet.model(sheet.sweep.frequency)).tolist(),
        },
        "config": {"inner_rate": sheet.inner_rate, **drive},
        "versions": versions(),
    }
    return plain(found)


def _list(arguments: list[str]) -> bool:
    listing = parse(
        Listing,
        arguments,
        prog="qpctrl actuator",
        description="List the drives of the catalogue, or measure the one that is named.\n\n"
        "Example: qpctrl actuator orange-elastic",
    )
    drives = [load_drive(name) for name in drive_names()]
    rows = [
        {
            "drive": drive.name,
            "design": drive.design,
            "peak_torque_Nm": drive.peak_torque,
            "no_load_speed_rad_s": drive.no_load_speed,
            "bandwidth_Hz": model_bandwidth(torque_transfer(drive, 1 / INNER_RATE)),
            "source": drive.source,
        }
        for drive in drives
    ]
    if listing.json:
        print(json.dumps(plain(rows), indent=2, ensure_ascii=False))
        return True
    table = Table(
        Column("drive", no_wrap=True),
        Column("design", no_wrap=True),
        *(Column(words, justify="right") for words in ("peak\nNm", "no load\nrad/s", "−3 dB\nHz")),
        "source",
        box=None,
        header_style="bold",
    )
    for row in rows:
        peak, speed, edge = (f"{value:.3g}" for value in list(row.values())[2:5])
        source = str(row["source"]).split(":")[0]
        table.add_row(str(row["drive"]), str(row["design"]), peak, speed, edge, escape(source))
    console().print(table)
    console().print("\nqpctrl actuator NAME measures one of them")
    return True


def _print_sheet(sheet: DataSheet, folder: Path) -> None:
    out, drive = console(), sheet.drive
    verdict = "[green]PASSED[/]" if sheet.passed else "[red]FAILED[/]"
    out.print(f"[bold]{escape(drive.name)}[/], {drive.design} {verdict}")
    out.print(f"{escape(drive.source)}\n")
    for title, group in sheet.facts().items():
        facts = _table(title, "", "")
        for fact, value in group:
            facts.add_row(fact.words, number(value, 4), fact.unit)
        out.print(facts, "", sep="")
    table = _table("criterion", "value", "limit")
    for column in ("unit", ""):
        table.add_column(column)
    for c in sheet.criteria:
        mark = "[green]ok[/]" if c.passed else "[red]missed[/]"
        shown = "none" if math.isnan(c.value) else f"{c.value:.4g}"
        table.add_row(CRITERIA[c.name], shown, f"≤ {c.limit:g}", c.unit, mark)
    out.print(table)
    out.print(f"page: {folder / 'actuator.html'}", highlight=False, soft_wrap=True)


def _table(words: str, value: str, last: str) -> Table:
    first, second, third = WIDTHS
    return Table(
        Column(words, min_width=first),
        Column(value, min_width=second, justify="right"),
        Column(last, min_width=third),
        box=None,
        header_style="bold",
    )


def _writable(folder: Path) -> None:
    writable_folder(folder)
    for name in FILES:
        if (folder / name).is_dir():
            raise InputError(f"output folder {str(folder)!r}: {name} is a folder there")


def _write(folder: Path, summary: dict[str, Any], sheet: DataSheet) -> None:
    """Write both files, or none."""
    text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    contents = dict(zip(FILES, (text, render_page(sheet, summary)), strict=True))
    try:
        staging = Path(tempfile.mkdtemp(dir=folder, prefix=".writing-"))
        try:
            for name, content in contents.items():
                (staging / name).write_text(content, encoding="utf-8")
            for name in FILES:
                (staging / name).replace(folder / name)
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    except OSError as error:
        raise InputError(f"output folder {str(folder)!r}: {error.strerror}") from error
