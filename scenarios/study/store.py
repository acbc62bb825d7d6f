"""The folder of a study: study.json, and one Parquet file for each chunk of finished rows.

A file is written under a temporary name, synced and renamed, so what has its final name is
whole, whenever the process ends. A row counts as done when its file has its final name.
"""

import contextlib
import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl
from polars.exceptions import PolarsError

from qpctrl.errors import InputError, reason_of
from scenarios.study.plan import Plan
from scenarios.study.rollout import Made, row_schema
from scenarios.study.study import Study, without_reading

MANIFEST, CHUNKS, TRACES, LOCK = "study.json", "chunks", "traces", ".lock"
UNFINISHED = ".writing-"
"""Start of the name of a file that is being written."""


class Store(NamedTuple):
    """The results of one study, in one folder."""

    folder: Path
    plan: Plan

    def done(self) -> pl.DataFrame:
        """Return identity and outcome of each row that is there.

        Raises:
            InputError: a file cannot be read, or a row is there twice.
        """
        return read_done(self.folder)

    def add(self, made: Sequence[Made]) -> None:
        """Keep the rows of a chunk, all of them or none, and the traces that belong to them.

        Raises:
            InputError: a file cannot be written.
        """
        for rollout in made:
            if rollout.trace is not None:
                _make(self.folder / TRACES)
                name = f"{rollout.row['identity'][:24]}.parquet"
                with _written(self.folder / TRACES / name) as unfinished:
                    unfinished.write_bytes(rollout.trace)
        rows = [rollout.row for rollout in made]
        table = pl.DataFrame(rows, schema=row_schema(self.plan.study), orient="row")
        name = hashlib.sha256("".join(table["identity"]).encode()).hexdigest()[:24]
        with _written(self.folder / CHUNKS / f"{name}.parquet") as unfinished:
            table.write_parquet(unfinished, compression="zstd", statistics=False)

    def table(self) -> pl.DataFrame:
        """Return the rows of the finished study, in the order of the plan.

        Raises:
            InputError: a file cannot be read, or there are other rows than those of the plan.
        """
        table = read_rows(self.folder, self.plan.study)
        if len(table) != len(self.plan):
            raise InputError(
                f"folder {str(self.folder)!r} holds {len(table)} rows, need the {len(self.plan)} "
                "of this study and no others"
            )
        return table


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
        for place in (folder, folder / CHUNKS, folder / TRACES):
            for left in place.glob(UNFINISHED + "*"):
                with _refusing(left):
                    left.unlink(missing_ok=True)
        if (folder / MANIFEST).exists():
            _check_same(folder, plan, resume=resume)
        write_text(folder / MANIFEST, json_text(plan.manifest()))
        _make(folder / CHUNKS)
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
    rows = found.get("rows") if isinstance(found, dict) else None
    whole = isinstance(rows, int) and {"study", "configuration", "code"} <= found.keys()
    said = found["configuration"] if whole else None
    if not isinstance(said, dict) or not {"name", "system", "controllers"} <= said.keys():
        raise InputError(f"{str(folder / MANIFEST)!r} is not that of a study")
    return found


def read_done(folder: Path) -> pl.DataFrame:
    """Return ``identity`` and ``outcome`` of each row in ``folder``.

    Raises:
        InputError: a file cannot be read, or a row is there twice.
    """
    schema = dict.fromkeys(("identity", "outcome"), pl.String)
    found = pl.concat([pl.DataFrame(schema=schema), *_pieces(folder, schema)])
    twice = len(found) - found["identity"].n_unique()
    if twice:
        raise InputError(f"folder {str(folder)!r}: {twice} rows are twice")
    return found


def read_rows(folder: Path, study: Study) -> pl.DataFrame:
    """Return the rows of ``study`` in ``folder``: by point, repeat and controller, in its order.

    Raises:
        InputError: a file cannot be read.
    """
    schema = row_schema(study)
    table = pl.concat([pl.DataFrame(schema=schema), *_pieces(folder, schema)])
    place = {name: i for i, name in enumerate(study.controllers)}
    order = pl.col("controller").replace_strict(place, return_dtype=pl.Int64)
    return table.sort("row", "repeat", order)


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
    theirs: Any = _inputs(read_manifest(folder))
    ours: Any = _inputs(json.loads(json_text(plan.manifest())))
    name = ""
    while theirs != ours and isinstance(theirs, dict) and isinstance(ours, dict):
        key = next(k for k in (*ours, *theirs) if theirs.get(k) != ours.get(k))
        name, theirs, ours = f"{name}.{key}", theirs.get(key), ours.get(key)
    if theirs != ours:
        raise InputError(
            f"folder {str(folder)!r} holds another study: {name[1:]} is {theirs!r} there and "
            f"{ours!r} here; give another --out"
        )
    if not resume:
        raise InputError(
            f"folder {str(folder)!r} holds results of this study; go on with --resume, or give "
            "another --out"
        )


def _inputs(manifest: dict[str, Any]) -> dict[str, Any]:
    """Return what rows depend on."""
    return {**manifest, "configuration": without_reading(manifest["configuration"])}


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which ends with the process, however that ends."""
    try:
        import fcntl
    except ImportError as error:
        raise InputError(
            "studies lock their folder as POSIX systems do: need Linux or macOS"
        ) from error
    with _refusing(folder / LOCK):
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(f"folder {str(folder)!r} is in use by another process") from error
        except OSError as error:
            said = f"folder {str(folder)!r} cannot be locked: {error.strerror}"
            raise InputError(said) from error
        yield
    finally:
        os.close(handle)


def _make(folder: Path) -> None:
    """Make a folder that is there after a crash of the machine, too."""
    with _refusing(folder):
        if not folder.is_dir():
            folder.mkdir()
            _sync(folder.parent)


@contextlib.contextmanager
def _written(path: Path) -> Iterator[Path]:
    """Yield a temporary path; what is written there is synced and gets the name ``path``."""
    unfinished = path.parent / f"{UNFINISHED}{os.getpid()}-{path.name}"
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
        reason = reason_of(error)
        raise InputError(f"{str(path)!r} cannot be written: {reason}") from error


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _pieces(folder: Path, schema: Mapping[str, Any]) -> Iterator[pl.DataFrame]:
    """Yield some columns of each file of finished rows."""
    for path in chunk_files(folder):
        try:
            yield pl.read_parquet(path, columns=list(schema)).match_to_schema(schema)
        except (OSError, PolarsError) as error:
            said = " ".join(str(error).split())
            raise InputError(
                f"{str(path)!r} cannot be read ({said}); remove it and go on with --resume"
            ) from error
