"""The report of a run: one self-contained HTML page."""

from collections.abc import Mapping
from typing import Any

import polars as pl

from qpctrl.arrays import Array


def render_report(
    summary: Mapping[str, Any], table: pl.DataFrame, geometry: Mapping[str, Array]
) -> str:
    """Return the page."""
    return f"<html><body><pre>{summary}</pre></body></html>"
