"""Joint drives by name, from the catalogue or from a file of the user's."""

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from qpctrl.arrays import Vector
from qpctrl.errors import InputError, unknown_name
from scenarios.actuator.drive import Design, JointDrive
from scenarios.actuator.parts import Friction, Gear, Loops, Motor, Part, Spring, StrainGauge

FILE = Path(__file__).with_name("drives.toml")
PARTS: dict[str, type[Part]] = {
    "motor": Motor,
    "loops": Loops,
    "gear": Gear,
    "friction": Friction,
    "spring": Spring,
    "strain_gauge": StrainGauge,
}
NEEDED = ("source", "motor", "loops")


@cache
def _catalogue() -> dict[str, Any]:
    return tomllib.loads(FILE.read_text(encoding="utf-8"))


def drive_names() -> tuple[str, ...]:
    """Return the names of the catalogue."""
    return tuple(_catalogue()["drives"])


def load_drive(name: str) -> JointDrive:
    """Return a drive of the catalogue, or of a user's TOML file (a name that ends in .toml).

    Raises:
        InputError: unknown name; a file that cannot be read, or whose keys or numbers are wrong.
    """
    if name.endswith(".toml"):
        return read_drive(Path(name))
    if name not in drive_names():
        raise unknown_name("drive", name, drive_names())
    return _drive(name, _catalogue()["drives"][name])


def read_drive(path: Path) -> JointDrive:
    """Return the drive that a TOML file describes, with the tables of the catalogue's entries.

    Raises:
        InputError: it cannot be read, or a key or number in it is wrong.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"drive file {str(path)!r}: {error.strerror}") from error
    except ValueError as error:  # not UTF-8, or not TOML
        raise InputError(f"drive file {str(path)!r}: {' '.join(str(error).split())}") from error
    try:
        return _drive(path.stem, content)
    except InputError as error:
        raise InputError(f"drive file {str(path)!r}: {error}") from error


def drive_text(drive: JointDrive) -> str:
    """Return the TOML file that describes a drive, without what is as by default."""
    lines = [f"source = {json.dumps(drive.source, ensure_ascii=False)}"]
    for key in PARTS:
        part = getattr(drive, key)
        if part is None:
            continue
        given = [(field.name, getattr(part, field.name), field.default) for field in fields(part)]
        said = [f"{name} = {value!r}" for name, value, default in given if value != default]
        lines += ["", f"[{key}]", *said] if said else []
    return "\n".join(lines) + "\n"


def default_drives(design: Design, tau_max: Vector) -> tuple[JointDrive, ...]:
    """Return the first drive of the design whose motor makes each joint's ``tau_max`` [Nm].

    The largest one where none does, the smallest one for a joint without a limit. What its loops
    and friction take of that torque is not counted.
    """
    family = [load_drive(name) for name in _catalogue()["defaults"][design]]
    return tuple(
        next((drive for drive in family if drive.motor_torque >= most), family[-1])
        for most in np.where(np.isfinite(tau_max), tau_max, 0.0).tolist()
    )


def _drive(name: str, table: Mapping[str, Any]) -> JointDrive:
    _check_keys("", table, ("source", *PARTS), NEEDED)
    if not isinstance(table["source"], str):
        raise InputError(f"source: got {table['source']!r}, need a text")
    parts = {key: _part(key, table[key]) for key in PARTS if key in table}
    return JointDrive(name=name, source=table["source"], **parts).check()  # type: ignore[arg-type]


def _part(key: str, table: Any) -> Part:
    kind = PARTS[key]
    if not isinstance(table, dict):
        raise InputError(f"{key}: got {table!r}, need a table of numbers")
    known = fields(kind)  # type: ignore[arg-type]
    needed = [field.name for field in known if field.default is MISSING]
    _check_keys(f"{key}: ", table, [field.name for field in known], needed)
    try:
        return kind(**table)
    except InputError as error:
        raise InputError(f"{key}: {error}") from error


def _check_keys(
    where: str, table: Mapping[str, Any], allowed: Sequence[str], needed: Sequence[str]
) -> None:
    for key in table:
        if key not in allowed:
            raise InputError(where + str(unknown_name("key", key, allowed)))
    missing = [key for key in needed if key not in table]
    if missing:
        raise InputError(f"{where}missing {', '.join(missing)}")
