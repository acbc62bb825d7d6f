"""Why one actuator's force error differs from that of ideal joints: a sentence from measurements.

Each figure is the force error of the same job with one thing taken away from the drives.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from scenarios.report_style import number

NEAR = 0.2
"""Relative difference from ideal joints that needs no explanation."""

EXPLAINS, WHOLLY = 0.5, 0.9
"""Share of the difference that goes with what explains most of it, or all of it."""

TIE = 0.05
"""Difference of two shares that says nothing: the simpler one is named then."""

TORQUE_LOOP = "torque-loop"
"""No imperfection: it is taken away to see what it is good for."""


class Words(NamedTuple):
    """How a change of the drives is spoken of."""

    changed: str
    """What they are like then."""
    cause: str
    """What the change took away."""


WORDS = {
    "friction": Words("without friction of motor and gear", "friction"),
    "backlash": Words("without backlash", "backlash"),
    "noise": Words("without noise and steps of its readings", "noise"),
    "limits": Words("without limits of current, voltage, gear and spring", "a limit of the drive"),
    "sampling": Words("in inner steps a quarter as long", "the length of the inner step"),
    "compliance": Words("with drives ten times as stiff", "compliance"),
    TORQUE_LOOP: Words("without its torque loop", "the torque loop"),
}
"""All changes, the simplest first."""


@dataclass(frozen=True, kw_only=True)
class Study:
    """Force errors of one actuator with one thing taken away at a time; NaN: the job failed."""

    whole: float
    """RMS with everything in place [N]."""
    ideal: float
    """RMS with ideal joints [N]."""
    without: Mapping[str, float]
    """RMS [N] without each key of `WORDS` that the drives have."""
    together: float | None = None
    """RMS without all imperfections at once [N]; none: not measured."""

    @property
    def needs_reason(self) -> bool:
        """Whether the error is so much larger than with ideal joints that one asks why."""
        return not self.whole <= (1 + NEAR) * self.ideal

    @property
    def shares(self) -> dict[str, float]:
        """Share of the difference from ideal joints that goes with each imperfection.

        What fails when it is taken away explains nothing.
        """
        gap = self.whole - self.ideal
        found = {name: self.without[name] for name in self.imperfections}
        gone = {name: (self.whole - rmse) / gap for name, rmse in found.items() if gap}
        return {name: share for name, share in gone.items() if math.isfinite(share)}

    @property
    def best(self) -> str | None:
        """What takes most of the difference with it; none: nothing takes any."""
        shares = self.shares
        most = max(shares.values(), default=0.0)
        return next((n for n, share in shares.items() if share >= most - TIE and share > 0), None)

    @property
    def cause(self) -> str | None:
        """What explains the difference, most of which goes with it; none: no single thing does."""
        best = self.best
        explains = self.needs_reason and best is not None and self.shares[best] >= EXPLAINS
        return best if explains else None

    def sentence(self) -> str:
        """Return the reason in words, with the figures that it is built from."""
        if not self.needs_reason:
            return f"{self._figures()}: nothing needs explaining."
        said = f"{self._reason()}."
        worse = [n for n in self.imperfections if self.without[n] > (1 + NEAR) * self.whole]
        if worse:
            said += f" Worse: {self._listed(worse)}."
        if TORQUE_LOOP in self.without:
            loop = self._listed([TORQUE_LOOP])
            said += f" {loop[0].upper()}{loop[1:]}."
        return said

    @property
    def imperfections(self) -> list[str]:
        """All that was taken away but the torque loop, the simplest first."""
        return [name for name in WORDS if name in self.without and name != TORQUE_LOOP]

    def _figures(self) -> str:
        return f"{_newton(self.whole)} RMS, ideal joints {_newton(self.ideal)}"

    def _reason(self) -> str:
        if not math.isfinite(self.whole):
            done = [name for name in self.imperfections if math.isfinite(self.without[name])]
            return f"the job fails{'; not so ' if done else ''}{self._listed(done)}"
        best = self.best
        if best is None:
            return f"{self._figures()}; nothing that is taken away makes it smaller{self._rest()}"
        cause, share = WORDS[best].cause, self.shares[best]
        if share >= EXPLAINS:
            much = "it" if share >= WHOLLY else "most of it"
            return f"{self._figures()}; {self._listed([best])}: {cause} explains {much}"
        most = f"no single thing explains it, at best {self._listed([best])}"
        return f"{self._figures()}; {most}{self._rest()}"

    def _rest(self) -> str:
        if self.together is None:
            return ""
        gone = (self.whole - self.together) / (self.whole - self.ideal)
        verdict = "together they explain it" if gone >= EXPLAINS else "not even together"
        return f"; without all of them {_newton(self.together)}: {verdict}"

    def _listed(self, names: list[str]) -> str:
        return ", ".join(f"{WORDS[name].changed} {_newton(self.without[name])}" for name in names)


def _newton(force: float) -> str:
    return f"{number(force)} N" if math.isfinite(force) else "the job fails"
