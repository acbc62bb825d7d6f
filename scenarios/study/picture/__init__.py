"""Pictures of a study: what is drawn follows from its design, search and measures."""

from collections.abc import Mapping
from typing import Any

import polars as pl

from scenarios.panel import Panel
from scenarios.study.picture.cloud import cloud_panels
from scenarios.study.picture.front import front_panel
from scenarios.study.picture.heat import heat_panels
from scenarios.study.picture.index import index_panels
from scenarios.study.picture.level import level_panels
from scenarios.study.picture.limit import limit_panels
from scenarios.study.search import Boundary
from scenarios.study.study import Study


def study_panels(study: Study, table: pl.DataFrame, summary: Mapping[str, Any]) -> list[Panel]:
    """Return the pictures of a study; one without a figure has something to say in words.

    Args:
        study: what was studied.
        table: its rows; some may be missing.
        summary: what summary.json holds.
    """
    found = [] if table.is_empty() else _of_design(study, table)
    if matters := summary.get("sensitivity"):
        found = [*index_panels(study, matters), *found]
    front = front_panel(study, table, summary)
    return [front, *found] if front else found


def _of_design(study: Study, table: pl.DataFrame) -> list[Panel]:
    kind, factors = study.design.kind, len(study.columns)
    if not factors:
        return []
    if kind == "levels" or (kind == "map" and factors == 1):
        return level_panels(study, table)
    if kind == "map" and isinstance(study.search, Boundary):
        return limit_panels(study, table, study.search)
    if kind == "map":
        return heat_panels(study, table)
    return [] if kind == "morris" else cloud_panels(study, table)
