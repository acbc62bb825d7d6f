"""Runs of the command line, each made once, in a process of its own.

There no annotations are checked at every call, so a run takes a fraction of the time.
"""

import functools
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl


class Ran(NamedTuple):
    """What a run left behind."""

    code: int
    """Exit code."""
    summary: dict[str, Any]
    table: pl.DataFrame
    page: str

    @property
    def passed(self) -> bool:
        """Whether the command says that all its criteria hold."""
        return self.code == 0 and not self.missed

    @property
    def metrics(self) -> dict[str, float]:
        """Metrics of the summary."""
        return self.summary["metrics"]

    @property
    def missed(self) -> list[dict[str, Any]]:
        """Criteria that do not hold."""
        return [c for c in self.summary["criteria"] if not c["passed"]]


def flags(**parameters: object) -> tuple[str, ...]:
    """Return parameters as flags: ``k_fp=0.5`` is ``--k-fp 0.5``."""
    pairs = ((f"--{name.replace('_', '-')}", str(value)) for name, value in parameters.items())
    return tuple(word for pair in pairs for word in pair)


@functools.cache
def ran(*arguments: str) -> Ran:
    """Return what ``qpctrl run ARGUMENTS`` leaves behind."""
    with tempfile.TemporaryDirectory() as out:
        command = [Path(sys.executable).parent / "qpctrl", "run", *arguments, "--out", out]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode in (0, 1), done.stderr
        folder = Path(out)
        return Ran(
            done.returncode,
            json.loads((folder / "summary.json").read_text(encoding="utf-8")),
            pl.read_parquet(folder / "ticks.parquet"),
            (folder / "report.html").read_text(encoding="utf-8"),
        )
