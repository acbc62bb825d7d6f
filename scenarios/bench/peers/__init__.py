"""TSID and placo on the same problem as qpctrl, each in an environment of its own.

`make peers` builds the environments; `pythons` finds them, `courses` states the problem and
`peer_rounds` measures.
"""

from scenarios.bench.peers.environment import PEERS, pythons
from scenarios.bench.peers.folder import Course, courses
from scenarios.bench.peers.our_round import our_loops, our_round
from scenarios.bench.peers.problem import Problem, pose_problem
from scenarios.bench.peers.rounds import Comparison, peer_rounds

__all__ = [
    "PEERS",
    "Comparison",
    "Course",
    "Problem",
    "courses",
    "our_loops",
    "our_round",
    "peer_rounds",
    "pose_problem",
    "pythons",
]
