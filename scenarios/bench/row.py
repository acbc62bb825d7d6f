"""One line of the results."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from scenarios.bench.timing import Timing

Section = Literal["part", "tick", "solver", "saturated", "paced", "simulation", "peer"]
"""What a line belongs to."""

Fact = float | int | str | None


@dataclass(frozen=True, kw_only=True)
class Row:
    """What was timed, on what, and what came out."""

    section: Section
    name: str
    timing: Timing
    joints: int = 0
    """Number of joints."""
    k: int = 0
    """Rows of the contact."""
    compiled: bool | None = None
    """Whether ticks ran as generated C; none where that is no question."""
    facts: Mapping[str, Fact] = field(default_factory=dict)
    """What else is known of it, by name."""

    @property
    def median_us(self) -> float:
        """Median [µs]."""
        return self.timing.median_us

    def plain(self) -> dict[str, Any]:
        """Return the line as JSON knows it."""
        return {
            **{"section": self.section, "name": self.name, "joints": self.joints, "k": self.k},
            **{"compiled": self.compiled, **self.timing._asdict(), **self.facts},
        }
