"""What a tick says about each contact: its wrench, and how far that is from what it can carry."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca

from qpctrl.arrays import Vector
from qpctrl.model import ModeModel
from qpctrl.spatial import SX


class ContactPlace(NamedTuple):
    """Where the numbers of one contact are."""

    constraints: tuple[str, ...]
    """Names of its constraints."""
    axes: tuple[str, ...]
    """Of its task space."""
    A: str
    """Output of the tick that holds its rows (k×n)."""
    lam: slice
    """Its multipliers among all."""
    wrench: slice
    """Its wrench among all."""
    limits: tuple[str, ...]
    """Names of its limits, in the order of their margins."""
    margins: slice
    """What is left of them among all."""
    units: Mapping[str, str]
    """Unit of each limit."""

    @property
    def name(self) -> str:
        """Names of its constraints, joined by +."""
        return "+".join(self.constraints)

    @property
    def owners(self) -> tuple[str, ...]:
        """Names in front of its rows: its constraints and its limits."""
        return *self.constraints, *self.limits


class ContactReport(NamedTuple):
    """One contact at one tick."""

    name: str
    """Names of its constraints, joined by +."""
    axes: tuple[str, ...]
    """Axes of its task space."""
    wrench: Vector
    """Wrench of robot on environment (n) [N, Nm] along them."""
    margins: Mapping[str, float]
    """For each limit how much of it is left, in its unit: 0 where it binds."""
    units: Mapping[str, str]
    """Unit of each margin."""
    binding: tuple[str, ...]
    """Rows of its limits that bind: ``LIMIT.ROW``, or the row of A that can only push."""

    def describe(self) -> str:
        """Return wrench and margins in one line."""
        parts = [f"{value:.3g}" for value in self.wrench]
        said = f"{self.name}: wrench ({', '.join(parts)})"
        left = [f"{name} {left:.3g} {self.units[name]}" for name, left in self.margins.items()]
        said += f", left of {', '.join(left)}" if left else ""
        return f"{said}; at its limit: {', '.join(self.binding)}" if self.binding else said


def contact_places(model: ModeModel) -> tuple[ContactPlace, ...]:
    """Return the contacts of a mode; none for a single one without limits, which is all of λ."""
    mode = model.mode
    held = [space for space, split in model.splits.items() if split.k]
    if not mode.contact_limits and len(held) < 2:
        return ()
    places, lam, wrench, margin = [], 0, 0, 0
    for i, (space, split) in enumerate(model.splits.items()):
        if split.k:
            limits = {part.name: part.unit for part in mode.contact_limits if part.space == space}
            places.append(
                ContactPlace(
                    tuple(c.name for c in mode.constraints if c.space == space),
                    space.axes,
                    f"A{i}",
                    slice(lam, lam := lam + split.k),
                    slice(wrench, wrench := wrench + space.n),
                    tuple(limits),
                    slice(margin, margin := margin + len(limits)),
                    limits,
                )
            )
    return tuple(places)


def margins(rows: Sequence[str], places: tuple[ContactPlace, ...], left: SX) -> SX:
    """Return the least that is left of each limit, limit by limit.

    Args:
        rows: names of the inequalities of the QP.
        places: the contacts.
        left: upper bound less value of each inequality (r).
    """
    found = []
    for limit in (name for place in places for name in place.limits):
        own = [i for i, row in enumerate(rows) if row.rpartition(".")[0] == f"contact {limit}"]
        found.append(ca.mmin(left[own]))
    return ca.densify(ca.vertcat(ca.SX(0, 1), *found))


def wrenches(places: tuple[ContactPlace, ...], A: Mapping[str, SX], lam: SX) -> SX:
    """Return the wrenches Aᵀ λ of all contacts, one after the other."""
    parts = (A[place.A].T @ lam[place.lam] for place in places)
    return ca.densify(ca.vertcat(ca.SX(0, 1), *parts))
