"""TSID and placo beside ours: the one place that calls `scenarios.bench.peers`."""

from collections.abc import Callable
from typing import NamedTuple

from qpctrl.errors import InputError
from scenarios.bench.peers import courses, our_loops, our_round, peer_rounds, pose_problem, pythons
from scenarios.bench.peers.humanoid import humanoid
from scenarios.bench.peers.run import PeerError
from scenarios.bench.plan import Plan
from scenarios.bench.row import Row
from scenarios.bench.serial import TOOL
from scenarios.robot_file import load_robot


class Beside(NamedTuple):
    """What a comparison gives to the results."""

    rows: tuple[Row, ...] = ()
    left_out: tuple[str, ...] = ()
    """What each peer's problem leaves out."""
    notes: tuple[str, ...] = ()
    """Peers that could not be measured."""


def need_peers() -> None:
    """Refuse to go on where no peer has an environment.

    Raises:
        InputError: none has.
    """
    found, faults = pythons()
    if not found:
        raise InputError("; ".join(faults))


def beside_peers(
    plan: Plan, *, compiled: bool, core: int | None, watch: Callable[[str], None]
) -> Beside:
    """Return ours and every peer that has an environment, on one problem, in turns.

    Args:
        plan: how many turns and ticks.
        compiled: whether ours runs as generated C.
        core: on which all of them run.
        watch: called with whose turn it is.
    """
    found, faults = pythons()
    robot = load_robot("fr3")
    variants = courses(pose_problem(robot, TOOL))
    compared = peer_rounds(
        our_round(our_loops(variants, compiled=compiled)),
        variants,
        found,
        rounds=plan.peer_rounds,
        ticks=plan.peer_ticks,
        core=core,
        watch=watch,
    )
    rows, notes = compared.rows(joints=robot.nv, compiled=compiled), (*faults, *compared.faults)
    try:
        rows = (*rows, *((humanoid(found["tsid"], core=core),) if "tsid" in found else ()))
    except PeerError as error:  # its robot is an extra
        notes = (*notes, str(error))
    return Beside(rows=tuple(rows), left_out=compared.left_out, notes=notes)
