"""SQL over the rows of a study."""

import re
from pathlib import Path

import polars as pl
from polars.exceptions import PolarsError

from qpctrl.errors import InputError
from scenarios.study.store import chunk_files, read_manifest


def query(folder: Path, sql: str) -> pl.DataFrame:
    """Return what ``sql`` selects from the table ``rows``, the finished rows in ``folder``.

    They are in the order of the design; no statement changes them.

    Raises:
        InputError: the folder holds no study or no rows, or the query cannot be run.
    """
    if not re.match(r"\s*(select|with|show|explain)\b", sql, re.IGNORECASE):
        raise InputError(f"query: got {sql!r}, need a SELECT; rows are never changed")
    if found := re.search(r"\bread_\w+\s*\(", sql, re.IGNORECASE):
        raise InputError(f"query: got {found[0]}…), but only the table rows can be read")
    read_manifest(folder)
    files = chunk_files(folder)
    if not files:
        raise InputError(f"folder {str(folder)!r} holds no rows yet")
    try:
        rows = pl.scan_parquet(files).sort("row", "repeat", "controller")
        with pl.SQLContext(rows=rows) as context:
            return context.execute(sql, eager=True)
    except (OSError, PolarsError) as error:
        said = str(error).strip().splitlines()[0]  # the rest is the plan of the query
        raise InputError(f"query: {said}") from error
