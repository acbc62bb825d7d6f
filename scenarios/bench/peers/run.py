"""A peer's script, run in the peer's own environment, and what it says as frozen data."""

import json
import os
import subprocess
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from qpctrl.arrays import Array
from qpctrl.errors import QpctrlError
from scenarios.bench.peers.ours import Answer
from scenarios.bench.timing import Timing, timing
from scenarios.processes import THREADS

TIME_LIMIT = 120.0
"""Time [s] after which a script counts as hung; it takes a few."""

SCRIPTS = Path(__file__).parent

_OF_OURS = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "LD_LIBRARY_PATH")
"""What must not leak into another environment."""


class PeerError(QpctrlError):
    """A peer cannot be measured; the message is one line that names it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PeerCourse:
    """One variant, as a peer answered it."""

    timing: Timing
    """Of whole ticks."""
    parts_us: Mapping[str, float]
    """Median of each step of a tick [µs], timed apart from whole ticks."""
    answer: Answer
    solved: Array
    """Whether each tick has a solution (ticks)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PeerRun:
    """What one run of a peer's script says."""

    versions: Mapping[str, str]
    """Of the peer and what it builds on, by package."""
    M_gap: float
    """Largest difference of its mass matrix from ours [kg m²]."""
    h_gap: float
    """Largest difference of its bias from ours [Nm]."""
    courses: Mapping[str, PeerCourse]
    """By name of the variant."""


def run_peer(
    peer: str,
    python: Path,
    torques: Mapping[str, int],
    folder: Path,
    *,
    time_limit: float = TIME_LIMIT,
    script: Path | None = None,
) -> PeerRun:
    """Return what a peer says to the problem in a folder.

    Args:
        peer: its name.
        python: of its environment.
        torques: how many its answer has, for each variant that was written into the folder.
        folder: of the problem; the answers are written there too.
        time_limit: after which it is ended [s].
        script: to run; default: the peer's own.

    Raises:
        PeerError: it cannot be started, fails, hangs, or says what makes no sense.
    """
    out = folder / f"{peer}.npz"
    out.unlink(missing_ok=True)
    command = [str(python), "-E", "-s", str(script or SCRIPTS / f"{peer}_tick.py")]
    said = _run(peer, [*command, str(folder), str(out)], time_limit)
    try:
        return _read(said, out, torques)
    except _UNREADABLE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PeerError(f"peer {peer!r}: its answer makes no sense: {reason}") from error


_UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile)


def _run(peer: str, command: list[str], time_limit: float) -> str:
    """Return what a command prints.

    Raises:
        PeerError: it cannot be started, fails, or hangs.
    """
    env = {name: value for name, value in os.environ.items() if name not in _OF_OURS}
    env |= dict.fromkeys(THREADS, "1")
    try:
        done = subprocess.run(
            command, capture_output=True, timeout=time_limit, env=env, stdin=subprocess.DEVNULL
        )
    except subprocess.TimeoutExpired as error:
        raise PeerError(f"peer {peer!r}: no answer within {time_limit:g} s") from error
    except OSError as error:
        raise PeerError(f"peer {peer!r}: cannot be started ({error.strerror})") from error
    if done.returncode != 0:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["nothing said"]
        raise PeerError(f"peer {peer!r}: ended with code {done.returncode}: {last[0].strip()}")
    return done.stdout.decode(errors="replace")


def _read(said: str, out: Path, torques: Mapping[str, int]) -> PeerRun:
    """Return what a script said, checked."""
    about = _about(said)
    if not out.exists():
        raise ValueError("it wrote no times")
    with np.load(out) as file:
        arrays = dict(file)
    return PeerRun(
        versions={str(name): str(version) for name, version in about["versions"].items()},
        M_gap=_number(about["gaps"]["M"]),
        h_gap=_number(about["gaps"]["h"]),
        courses={
            name: _course(name, arrays, [str(part) for part in about["parts"]], nu)
            for name, nu in torques.items()
        },
    )


def _about(said: str) -> dict[str, Any]:
    last = said.strip().splitlines()[-1:]
    try:
        about = json.loads(last[0] if last else "")
    except ValueError as error:
        raise ValueError(f"it printed {(last or [''])[0][:60]!r}, need one line of JSON") from error
    if not isinstance(about, dict) or not {"versions", "gaps", "parts"} <= set(about):
        raise ValueError(f"it printed {last[0][:60]!r}, need versions, gaps and parts")
    return about


def _number(value: object) -> float:
    number = float(value) if isinstance(value, int | float) else np.nan
    if not np.isfinite(number):
        raise ValueError(f"got {value!r}, need a finite number")
    return number


def _course(name: str, arrays: Mapping[str, Array], parts: list[str], nu: int) -> PeerCourse:
    """Return one variant's times and answers, with the shapes that they must have."""
    samples = _array(arrays, f"{name} samples", (None,))
    ticks = len(samples)
    if not (ticks and (samples > 0).all()):
        raise ValueError(f"{name} samples: need times above zero")
    solved = _array(arrays, f"{name} solved", (ticks,)).astype(bool)
    tau = _array(arrays, f"{name} tau", (ticks, nu))
    force = _array(arrays, f"{name} force", (ticks, 3))
    if not (np.isfinite(tau[solved]).all() and np.isfinite(force[solved]).all()):
        raise ValueError(f"{name}: it says that a tick is solved whose answer is not finite")
    steps = _array(arrays, f"{name} parts", (ticks, len(parts)))
    known = f"{name} lost" in arrays
    lost = _array(arrays, f"{name} lost", (ticks,)).astype(bool).tolist() if known else None
    return PeerCourse(
        timing=timing(samples, lost),
        parts_us=dict(zip(parts, (np.median(steps, axis=0) / 1e3).tolist(), strict=True)),
        answer=Answer(tau, -force),
        solved=solved,
    )


def _array(arrays: Mapping[str, Array], name: str, shape: tuple[int | None, ...]) -> Array:
    """Return a numeric array of a shape; None stands for any length."""
    if name not in arrays:
        raise ValueError(f"{name} is missing")
    found = arrays[name]
    fits = len(found.shape) == len(shape) and all(
        wanted in (None, got) for got, wanted in zip(found.shape, shape, strict=True)
    )
    if not fits or found.dtype.kind not in "bif":
        raise ValueError(f"{name}: got {found.dtype} of shape {found.shape}, need {shape}")
    return found
