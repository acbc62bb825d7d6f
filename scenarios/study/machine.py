"""Where rollouts run: one interface, and two machines behind it."""

import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import connection
from typing import Protocol, TypeVar

from qpctrl.errors import InputError, QpctrlError
from scenarios.processes import end_with_interrupt, worker_pool

C = TypeVar("C")
R = TypeVar("R")

WINDOW = 2
"""Chunks for each worker that are handed out at once: one to run, one to wait."""
GIVE_UP = 5
"""Deaths of workers in a row, with no chunk finished between them, that end a study."""


class MachineError(QpctrlError):
    """Workers that die again and again."""


class Machine(Protocol):
    """Applies a function to chunks, somewhere, and gives the results back as they come."""

    @property
    def workers(self) -> int:
        """How many chunks run at once."""

    def run(self, work: Callable[[C], R], chunks: Iterable[C]) -> Iterator[R]:
        """Yield the result of each chunk once, in any order.

        Args:
            work: can be pickled, and depends on the chunk alone: one that a dying worker leaves
                unfinished runs again.
            chunks: taken one by one, no more than are needed to keep the workers busy.
        """


@dataclass(frozen=True)
class Here:
    """This process itself, one chunk after the other."""

    workers: int = 1

    def run(self, work: Callable[[C], R], chunks: Iterable[C]) -> Iterator[R]:
        """Yield the results in order."""
        yield from map(work, chunks)


@dataclass(frozen=True)
class ProcessPool:
    """Processes of this computer, one thread each, which end with this one."""

    workers: int = 2

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise InputError(f"workers: got {self.workers}, need at least 1")

    def run(self, work: Callable[[C], R], chunks: Iterable[C]) -> Iterator[R]:
        """Yield the results as they come.

        Raises:
            MachineError: workers die, time after time.
        """
        source, again = iter(chunks), deque[C]()
        deaths = 0
        while deaths < GIVE_UP:
            running: dict[Future[R], C] = {}
            try:
                with worker_pool(self.workers, _begin) as pool:
                    while True:
                        while len(running) < WINDOW * self.workers:
                            chunk = again.popleft() if again else next(source, None)
                            if chunk is None:
                                break
                            again.appendleft(chunk)  # so that a broken pool does not lose it
                            running[pool.submit(work, chunk)] = chunk
                            again.popleft()
                        if not running:
                            return
                        for future in wait(running, return_when=FIRST_COMPLETED).done:
                            result = future.result()
                            del running[future]
                            deaths = 0
                            yield result
            except BrokenProcessPool:
                deaths += 1
                again.extend(running.values())
        raise MachineError(f"workers died {GIVE_UP} times in a row; is there too little memory?")


def _begin() -> None:
    """Let a worker end without a word with an interrupt, and with the process that started it."""
    end_with_interrupt()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
