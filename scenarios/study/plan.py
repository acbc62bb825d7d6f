"""The plan of a study: every rollout it consists of, each with its identity."""

import functools
import hashlib
import json
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import qpctrl
import scenarios
import tasks
from qpctrl.arrays import Matrix
from qpctrl.errors import InputError
from scenarios.run import versions
from scenarios.study.search import Worst
from scenarios.study.study import Study

SEEDS = 2**32
"""Number of seeds that every library takes."""
SOURCES = (".py", ".xml", ".toml")
"""Files that results depend on: code, models and tables of drives."""


class Task(NamedTuple):
    """One rollout to make, or one search."""

    identity: str
    """SHA-256 of all that its result depends on, and of its place in the plan."""
    row: int
    """Row of the design."""
    repeat: int
    point: tuple[float, ...]
    """Value of each factor, in its unit."""
    controller: str
    seed: int
    """Common to all controllers, and to all rows of one `Design.group`."""


class Plan:
    """All rollouts of a study, and what their results depend on.

    Attributes:
        study: the study.
        seed: of the design and of every random number.
        code: versions that results depend on; ``source`` is that of this code.
    """

    def __init__(self, study: Study, seed: int) -> None:
        """Plan ``study``: each point of its design with each controller, ``repeats`` times.

        Raises:
            InputError: a negative seed, or a design that cannot be made.
        """
        if not 0 <= seed < SEEDS:
            raise InputError(f"seed: got {seed}, need a number >= 0 and < {SEEDS}")
        self.study, self.seed = study, seed
        self._points: Matrix = study.points(seed)
        self.code = {**code_version(), **_design_versions(study)}

    def __len__(self) -> int:
        return len(self._points) * self.study.repeats * len(self.study.controllers)

    def __iter__(self) -> Iterator[Task]:
        """Make the tasks one by one: a large study never holds all of them."""
        shared = canonical({"inputs": self.study.inputs(), "code": self.code})
        shared_hash = hashlib.sha256(shared.encode())
        design, count = self.study.design, len(self.study.columns)
        for row, values in enumerate(self._points):
            group = design.group(row, count)
            point = tuple(values.tolist())
            for repeat in range(self.study.repeats):
                own = int(np.random.SeedSequence([self.seed, group, repeat]).generate_state(1)[0])
                for controller in self.study.controllers:
                    hashed = shared_hash.copy()
                    hashed.update(canonical([row, repeat, point, controller, own]).encode())
                    yield Task(hashed.hexdigest(), row, repeat, point, controller, own)

    def manifest(self) -> dict[str, Any]:
        """Return what study.json holds."""
        return {
            "study": self.study.name,
            "configuration": self.study.configuration(),
            "seed": self.seed,
            "code": self.code,
            "rows": len(self),
        }


def canonical(value: Any) -> str:
    """Return a value in its one spelling."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def code_version() -> dict[str, str]:
    """Return the versions that results depend on: of packages, and of this code's own files.

    Ready-made studies are left out: what one of them says is in its configuration.
    """
    seen = hashlib.sha256()
    for package in (qpctrl, tasks, scenarios):
        root = Path(package.__path__[0])
        for path in sorted(p for p in root.rglob("*") if p.suffix in SOURCES):
            if path.parent.name != "ready":
                seen.update(f"{package.__name__}/{path.relative_to(root).as_posix()}\0".encode())
                seen.update(hashlib.sha256(path.read_bytes()).digest())
    return {"source": seen.hexdigest()[:16], **versions(), "scipy": metadata.version("scipy")}


@functools.cache
def loaded_code() -> dict[str, str]:
    """Return the versions that results depend on, as this process has loaded them."""
    return code_version()


def _design_versions(study: Study) -> dict[str, str]:
    """Return the versions that decide which points are visited, of packages that need not be."""
    salib = bool(study.columns) and study.design.needs_salib
    needed = {"optuna": isinstance(study.search, Worst), "SALib": salib}
    return {name: metadata.version(name) for name, so in needed.items() if so}
