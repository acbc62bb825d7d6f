"""The folder of a study: study.json, and one Parquet file for each chunk of finished rows.

A file is written under a temporary name, synced and renamed, so what has its final name is
whole, whenever the process ends. A row counts as done when its file has its final name.
"""

import contextlib
import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl
from polars.exceptions import PolarsError

from qpctrl.errors import InputError
from scenarios.study.rollout import row_schema
from scenarios.study.study import Plan, digest

MANIFEST, CHUNKS, LOCK = "study.json", "chunks", ".lock"
UNFINISHED = ".writing-"
"""Start of the name of a file that is being written."""


class Store(NamedTuple):
    """The results of one study, in one folder."""

    folder: Path
    plan: Plan

    def done(self) -> set[str]:
        """Return the identities of the rows that are there.

        Raises:
            InputError: a file cannot be read, or a row is there twice.
        """
        return set(read_identities(self.folder))

    def add(self, rows: Sequence[dict[str, Any]]) -> None:
        """Keep the rows of a chunk; all of them or none.

        Raises:
            InputError: the file cannot be written.
        """
        table = pl.DataFrame(rows, schema=row_schema(self.plan.study), orient="row")
        name = digest([row["identity"] for row in rows])[:24]
        with _written(self.folder / CHUNKS / f"{name}.parquet") as path:
            table.write_parquet(path, compression="zstd", statistics=False)

    def table(self) -> pl.DataFrame:
        """Return all rows that are there, in the order of the plan.

        Raises:
            InputError: a file cannot be read.
        """
        pieces = [_read(path) for path in chunk_files(self.folder)]
        empty = pl.DataFrame(schema=row_schema(self.plan.study))
        order = pl.DataFrame(
            {"identity": [task.identity for task in self.plan.tasks]},
            schema={"identity": pl.String},
        )
        return order.join(pl.concat([empty, *pieces]), on="identity", maintain_order="left")


@contextlib.contextmanager
def open_store(folder: Path, plan: Plan, *, resume: bool) -> Iterator[Store]:
    """Yield the store of ``plan`` in ``folder``, which nobody else can open meanwhile.

    Args:
        folder: made if it is not there.
        plan: whose results it holds or shall hold.
        resume: whether it may hold results already.

    Raises:
        InputError: the folder cannot be written, is in use, or holds something else: another
            study, configuration, seed or code version.
    """
    with _refusing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        strange = any(not path.name.startswith(".") for path in folder.iterdir())
    if strange and not (folder / MANIFEST).exists():
        raise InputError(
            f"folder {str(folder)!r} is not empty and holds no study; give another --out"
        )
    with _locked(folder):
        for left in (*folder.glob(UNFINISHED + "*"), *folder.glob(f"{CHUNKS}/{UNFINISHED}*")):
            left.unlink(missing_ok=True)
        if (folder / MANIFEST).exists():
            _check_same(folder, plan, resume=resume)
        else:
            write_text(folder / MANIFEST, json_text(plan.manifest()))
        with _refusing(folder):
            (folder / CHUNKS).mkdir(exist_ok=True)
        yield Store(folder, plan)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return what study.json of ``folder`` holds.

    Raises:
        InputError: there is none, or it is not that of a study.
    """
    try:
        found = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"folder {str(folder)!r} holds no study: no {MANIFEST}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{str(folder / MANIFEST)!r} cannot be read: {error}") from error
    if not isinstance(found, dict) or not {"study", "code", "rows"} <= found.keys():
        raise InputError(f"{str(folder / MANIFEST)!r} is not that of a study")
    return found


def read_identities(folder: Path) -> list[str]:
    """Return the identities of the rows in ``folder``.

    Raises:
        InputError: a file cannot be read, or a row is there twice.
    """
    found = [x for path in chunk_files(folder) for x in _read(path, ["identity"])["identity"]]
    if len(set(found)) < len(found):
        raise InputError(f"folder {str(folder)!r}: {len(found) - len(set(found))} rows are twice")
    return found


def chunk_files(folder: Path) -> list[Path]:
    """Return the files of finished rows."""
    return sorted(p for p in (folder / CHUNKS).glob("*.parquet") if not p.name.startswith("."))


def write_text(path: Path, text: str) -> None:
    """Write a file in one piece.

    Raises:
        InputError: it cannot be written.
    """
    with _written(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def json_text(value: Any) -> str:
    """Return a value as the text of a JSON file."""
    return json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _check_same(folder: Path, plan: Plan, *, resume: bool) -> None:
    """Refuse a folder whose results are not those of ``plan``, and name the first difference."""
    found, own = read_manifest(folder), json.loads(json_text(plan.manifest()))
    for part in ("study", "configuration", "seed", "code", "rows"):
        theirs, ours = found.get(part), own[part]
        if theirs == ours:
            continue
        name = part
        if isinstance(theirs, dict) and isinstance(ours, dict):
            key = next(k for k in (*ours, *theirs) if theirs.get(k) != ours.get(k))
            name, theirs, ours = f"{part}.{key}", theirs.get(key), ours.get(key)
        raise InputError(
            f"folder {str(folder)!r} holds another study: {name} is {theirs!r} there and {ours!r} "
            "here; give another --out"
        )
    if not resume:
        raise InputError(
            f"folder {str(folder)!r} holds results of this study; go on with --resume, or give "
            "another --out"
        )


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which ends with the process, however that ends."""
    with _refusing(folder):
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"folder {str(folder)!r} is in use by another process") from error
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def _written(path: Path) -> Iterator[Path]:
    """Yield a temporary path; what is written there is synced and gets the name ``path``."""
    unfinished = path.parent / f"{UNFINISHED}{path.name}"
    with _refusing(path):
        try:
            yield unfinished
            _sync(unfinished)
            unfinished.replace(path)
            _sync(path.parent)
        except BaseException:
            with contextlib.suppress(OSError):
                unfinished.unlink(missing_ok=True)
            raise


@contextlib.contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """Turn what the file system says into one line."""
    try:
        yield
    except (OSError, PolarsError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise InputError(f"{str(path)!r} cannot be written: {reason}") from error


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _read(path: Path, columns: list[str] | None = None) -> pl.DataFrame:
    try:
        return pl.read_parquet(path, columns=columns)
    except (OSError, PolarsError) as error:
        said = " ".join(str(error).split())
        raise InputError(
            f"{str(path)!r} cannot be read ({said}); remove it and go on with --resume"
        ) from error
