"""What is measured, and how much of it."""

from dataclasses import dataclass, field

from qpctrl.errors import InputError, unknown_name
from qpctrl.solver import solver_names
from scenarios.bench.timing import Rounds

QUICK_TICKS, QUICK_ROUNDS = 1000, 10


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much is measured."""

    ticks: int = 10_000
    """Ticks of each case; the headline, 7 joints and k = 3 compiled, has ten times as many."""
    rounds: int = 40
    """Blocks in which each case gets them."""
    codes: tuple[bool, ...] = (True, False)
    """Whether compiled, interpreted, or both."""
    solvers: tuple[str, ...] = field(default_factory=solver_names)
    """Back-ends of the QP."""
    joints: tuple[int, ...] = (14, 28, 38)
    """Of the arms that are larger than an FR3."""
    humanoid: bool = True
    """Whether a humanoid on two feet is measured too, the largest to compile."""
    paced: int = 3000
    """Ticks of each paced case; each takes a period [ms]."""
    runs: int = 3
    """Runs of the eraser."""
    wiping: float = 4.0
    """Time of each run that is spent wiping [s]."""
    rollouts: int = 9
    """Rollouts of a study."""
    rollout: float = 2.2
    """Time of each rollout in motion [s]."""
    peers: bool = False
    """Whether TSID and placo are measured too."""
    peer_rounds: int = 10
    """Turns of ours and of each peer."""
    peer_ticks: int = 4000
    """Ticks of each turn."""
    longest: float = 4.0
    """Time that a case may take [s], back to back; slow ones get fewer ticks then."""

    def __post_init__(self) -> None:
        for name in ("ticks", "rounds"):
            if getattr(self, name) < 1:
                raise InputError(f"{name}: got {getattr(self, name)}, need a number >= 1")
        for name in self.solvers:
            if name not in solver_names():
                raise unknown_name("solver", name, solver_names())

    @property
    def turns(self) -> Rounds:
        """How cases take turns."""
        return Rounds(rounds=self.rounds, longest=self.longest, usual=self.ticks)


def quick(plan: Plan) -> Plan:
    """Return a plan of a few seconds: 7 and 14 joints, no humanoid, a tenth of the ticks."""
    return Plan(
        ticks=min(plan.ticks, QUICK_TICKS),
        rounds=min(plan.rounds, QUICK_ROUNDS),
        codes=plan.codes,
        solvers=plan.solvers,
        joints=(14,),
        humanoid=False,
        paced=500,
        runs=1,
        rollouts=3,
        wiping=1.0,
        peers=plan.peers,
        peer_rounds=2,
        peer_ticks=1000,
        longest=0.4,
    )
