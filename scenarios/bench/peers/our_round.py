"""Our turn in the comparison with the peers: the same ticks, in this process."""

import time
from collections.abc import Mapping

from qpctrl import Controller
from scenarios.bench.peers.folder import UNSATURATED, Course
from scenarios.bench.peers.ours import contact_mode, moments
from scenarios.bench.peers.problem import DT
from scenarios.bench.peers.rounds import OurRound
from scenarios.bench.row import Row
from scenarios.bench.tick_trial import CODE, Loop, TickTrial
from scenarios.bench.timing import without_garbage_collection


def our_loops(variants: Mapping[str, Course], *, compiled: bool) -> dict[str, Loop]:
    """Return our controller on each variant; it is one controller, whose limits change.

    Raises:
        InputError: it shall be compiled, and cannot be.
    """
    problem = variants[UNSATURATED].problem
    mode = contact_mode(problem)
    started = time.perf_counter()
    controller = Controller(problem.robot, [mode], dt=DT, compile=CODE[compiled])
    loop = Loop(
        controller=controller,
        moments=moments(problem),
        k=3,
        compiled=compiled,
        ready_s=time.perf_counter() - started,
    )
    limits = {name: one.problem.robot.limits.tau_max for name, one in variants.items()}
    return {name: loop.limited(tau_max) for name, tau_max in limits.items()}


def our_round(loops: Mapping[str, Loop]) -> OurRound:
    """Return what times so many ticks of a variant, from home on."""

    def run(variant: str, ticks: int) -> Row:
        trial = TickTrial("peer", variant, loops[variant], ticks)
        with without_garbage_collection():
            trial.run(ticks)
        return trial.row()

    return run
