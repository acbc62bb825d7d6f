"""Where the peers live: one virtual environment each, built by ``make peers``.

Their wheels are made for different versions of pinocchio, so none can share ours. What is
installed there is listed in ``tsid.txt`` and ``placo.txt`` beside this file.
"""

from collections.abc import Sequence
from pathlib import Path

from qpctrl.errors import InputError, unknown_name

PEERS = ("tsid", "placo")
"""Controllers that are measured beside ours."""

FOLDER = Path(".peers")
"""Where ``make peers`` builds the environments, from the folder it runs in."""

STAMP = ".installed"
"""File that says that an environment is complete."""


def python_of(peer: str, folder: Path = FOLDER) -> Path:
    """Return the Python of a peer's environment.

    Raises:
        InputError: unknown peer, or no complete environment.
    """
    if peer not in PEERS:
        raise unknown_name("peer", peer, PEERS)
    home = folder / peer
    python = home / "bin" / "python"
    if not (home / STAMP).is_file() or not python.exists():
        raise InputError(f"peer {peer!r}: no complete environment in {home}; run make peers")
    return python.absolute()  # not resolved: the link is what tells Python its environment


def pythons(
    peers: Sequence[str] = PEERS, folder: Path = FOLDER
) -> tuple[dict[str, Path], tuple[str, ...]]:
    """Return the Python of every peer that has an environment, and one line for each other.

    Raises:
        InputError: unknown peer.
    """
    found, faults = {}, []
    for peer in peers:
        if peer not in PEERS:
            raise unknown_name("peer", peer, PEERS)
        try:
            found[peer] = python_of(peer, folder)
        except InputError as error:
            faults.append(str(error))
    return found, tuple(faults)
