"""What a tick of a humanoid costs TSID: 38 velocities, two feet; no problem that we state."""

import json
import tempfile
from pathlib import Path

import numpy as np

from scenarios.bench.peers.run import SCRIPTS, TIME_LIMIT, run_peer
from scenarios.bench.row import Row

NAME = "tsid, humanoid"
JOINTS, TORQUES, FORCES = 38, 32, 12
"""Velocities, driven joints, and rows of two feet that rest."""


def humanoid(
    python: Path, *, ticks: int = 2000, core: int | None = None, time_limit: float = TIME_LIMIT
) -> Row:
    """Return the figures of TSID's ticks on TALOS.

    Args:
        python: of TSID's environment, with the robot that ``make peers-humanoid`` installs.
        ticks: samples, and the length of its motion.
        core: on which it shall run; none leaves that open.
        time_limit: after which it is ended [s].

    Raises:
        PeerError: no robot there, or it fails, hangs, or says what makes no sense.
    """
    with tempfile.TemporaryDirectory(prefix="qpctrl-humanoid-") as name:
        folder = Path(name)
        facts = {"variants": {"humanoid": []}, "ticks": ticks, "core": core}
        (folder / "problem.json").write_text(json.dumps(facts))
        np.savez(folder / "arrays.npz", q=np.zeros((ticks, 1)))
        run = run_peer(
            NAME,
            python,
            {"humanoid": TORQUES},
            folder,
            time_limit=time_limit,
            script=SCRIPTS / "tsid_humanoid.py",
        )
    course = run.courses["humanoid"]
    return Row(
        section="peer",
        name=NAME,
        timing=course.timing,
        joints=JOINTS,
        k=FORCES,
        facts={
            **{f"{part} [µs]": value for part, value in course.parts_us.items()},
            "unsolved": int((~course.solved).sum()),
        },
    )
