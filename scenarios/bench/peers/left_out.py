"""What the peers' problems leave out, in words, with the figures that back them."""

from collections.abc import Mapping

from scenarios.bench.peers.agreement import Agreement
from scenarios.bench.peers.folder import MET, SATURATED, UNSATURATED
from scenarios.bench.peers.problem import FORCE
from scenarios.bench.peers.run import PeerRun

WHO = {"tsid": "TSID", "placo": "placo"}
"""How the peers write themselves."""

ALL_LEAVE_OUT = (
    "the measured force (no PI, no damping, no wrench outside the contact), ramps and integrators; "
    "limits on torque rate, joint position and speed; the reference's transport into the turning "
    "tool, which they are handed; the closed forms beside the QP, the certificate, the named "
    "limits and the reasons of a tick; damping near a singularity, rank, and a fallback torque"
)
"""What is in every tick of ours and in none of theirs."""

OWN_WORDS = {
    "tsid": "its posture is weighted in the joints, 1e-4 beside the orientation, not in M_N",
    "placo": "as TSID, and: no set-point of the force – it is a known wrench, and what the contact "
    "carries beyond it is kept small – so neither friction pyramid nor bounds on the force, which "
    "would hold for that rest alone; its robots float, so six accelerations of the base and the "
    "six of the known wrench are variables that equalities hold",
}
"""What else a peer does otherwise."""


def left_out(peer: str, run: PeerRun, found: Mapping[str, Agreement]) -> tuple[str, ...]:
    """Return what one peer's problem leaves out, and how far its answers are from ours.

    Args:
        peer: its name.
        run: the run whose answers were compared.
        found: what the comparison gave, by variant.
    """
    who = WHO.get(peer, peer)
    free, limited, met = (found[variant] for variant in (UNSATURATED, SATURATED, MET))
    return (
        f"{who} leaves out {ALL_LEAVE_OUT}.",
        f"{who}: {OWN_WORDS.get(peer, 'nothing else is known')}.",
        f"{who}, same model: M differs by {run.M_gap:.1e} kg m², h by {run.h_gap:.1e} Nm, armature "
        "included.",
        f"{who}, same problem: where every task can be met its torque differs by at most "
        f"{met.torque_Nm:.1e} Nm, its force by {met.force_N:.1e} of {FORCE:g} N.",
        f"{who}, no limit: torque differs by up to {free.torque_Nm:.2g} Nm, of which all but "
        f"{free.torque_beyond_elbow_Nm:.1e} Nm moves the elbow alone, which its posture weighs "
        f"otherwise; force by {free.force_N:.1e} N, the tool's turning by {free.turn:.1e} rad/s².",
        f"{who}, torque limits: {100 * limited.limited:.0f} % of the ticks have a joint on its "
        f"limit, ours {100 * limited.ours_limited:.0f} %; none is beyond it by more than "
        f"{limited.beyond_limit_Nm:.1e} Nm. Who gives way differs: force by up to "
        f"{limited.force_N:.2g} N, torque by {limited.torque_Nm:.2g} Nm, without the elbow "
        f"{limited.torque_beyond_elbow_Nm:.2g} Nm; in our QP its answer costs "
        f"{limited.dearer_least:.1e} to {limited.dearer_most:.2g} N²/kg more than ours.",
        *_unsolved(who, found),
    )


def _unsolved(who: str, found: Mapping[str, Agreement]) -> tuple[str, ...]:
    bad = {name: one.unsolved for name, one in found.items() if one.unsolved}
    return tuple(f"{who}: {count} ticks without a solution, {name}." for name, count in bad.items())
