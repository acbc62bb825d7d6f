"""What a study is, and its plan: every rollout it consists of, each with its identity."""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
import polars as pl

import qpctrl
import scenarios
import tasks
from qpctrl.arrays import Matrix
from qpctrl.errors import InputError
from scenarios.panel import Panel
from scenarios.run import versions
from scenarios.scenario import Criterion
from scenarios.study.factor import Factor

Measures: TypeAlias = Mapping[str, float | None]
"""Numbers of one rollout by name; none where the rollout has no such quantity."""


class Study(Protocol):
    """Frozen parameters of one study; a dataclass that can be sent to another process."""

    @property
    def name(self) -> str:
        """Name on the command line."""

    @property
    def summary(self) -> str:
        """One line for the list of studies."""

    @property
    def controllers(self) -> tuple[str, ...]:
        """Controllers that run side by side on every point of the design."""

    @property
    def factors(self) -> tuple[Factor, ...]:
        """What varies."""

    @property
    def measures(self) -> tuple[str, ...]:
        """Names of the numbers that `run` returns."""

    @property
    def shown(self) -> Mapping[str, str]:
        """Heads of the printed table by name of the measure."""

    def design(self, seed: int) -> Matrix:
        """Return the points (points × factors), in the factors' units."""

    def run(self, point: Mapping[str, float], controller: str, seed: int) -> Measures:
        """Return the measures of one rollout; it may raise, and its numbers may be anything.

        Args:
            point: value of each factor by name.
            controller: one of `controllers`.
            seed: of every random number of the rollout, the same for all controllers.
        """

    def judge(self, table: pl.DataFrame) -> tuple[Criterion, ...]:
        """Return the study's own criteria on its rows."""

    def panels(self, table: pl.DataFrame) -> tuple[Panel, ...]:
        """Return the pictures of the study."""


class Task(NamedTuple):
    """One rollout to make."""

    identity: str
    """SHA-256 of study, point, controller, seed and code version."""
    row: int
    """Row of the design."""
    point: tuple[float, ...]
    """Value of each factor, in its unit."""
    controller: str
    seed: int
    """Common to all controllers at this point."""


class Plan(NamedTuple):
    """All rollouts of a study, and what their results depend on."""

    study: Study
    seed: int
    code: dict[str, str]
    """Versions that results depend on; ``source`` is that of this code."""
    tasks: tuple[Task, ...]

    def manifest(self) -> dict[str, Any]:
        """Return what study.json holds."""
        return {
            "study": self.study.name,
            "configuration": configuration(self.study),
            "seed": self.seed,
            "code": self.code,
            "rows": len(self.tasks),
        }


def plan_study(study: Study, seed: int) -> Plan:
    """Return every rollout of ``study``: each point of its design with each controller.

    Raises:
        InputError: a negative seed, or a design that cannot be made.
    """
    if seed < 0:
        raise InputError(f"seed: got {seed}, need a number >= 0")
    code = code_version()
    shared = {"study": study.name, "configuration": configuration(study), "code": code}
    tasks = []
    for index, row in enumerate(study.design(seed)):
        point = tuple(float(x) for x in row)
        own = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
        for controller in study.controllers:
            identity = digest({**shared, "point": point, "controller": controller, "seed": own})
            tasks.append(Task(identity, index, point, controller, own))
    return Plan(study, seed, code, tuple(tasks))


def configuration(study: Study) -> dict[str, Any]:
    """Return the parameters of a study as JSON knows them."""
    plain = dataclasses.asdict(study)  # type: ignore[call-overload]
    return dict(json.loads(json.dumps(plain, allow_nan=False)))


def digest(value: Any) -> str:
    """Return the SHA-256 of a value in its one canonical spelling."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def code_version() -> dict[str, str]:
    """Return the versions that results depend on: of packages, and of this code's own files."""
    seen = hashlib.sha256()
    for package in (qpctrl, tasks, scenarios):
        root = Path(package.__path__[0])
        for path in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".xml")):
            seen.update(f"{package.__name__}/{path.relative_to(root).as_posix()}\0".encode())
            seen.update(path.read_bytes())
    return {"source": seen.hexdigest()[:16], **versions()}
