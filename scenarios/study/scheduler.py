"""A dask scheduler that is asked: chunks go to it, results come back, and it may be lost.

Scheduler, workers and this process need the same version of this code; it is compared where a
chunk runs. A worker process runs one chunk at a time, however many threads it has, so start one
for each core: ``dask worker ADDRESS --nworkers 8 --nthreads 1``.
"""

import asyncio
import contextlib
import importlib
import logging
import math
import os
import pickle
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from qpctrl.errors import InputError
from scenarios.study.machine import WINDOW, MachineError

C = TypeVar("C")
R = TypeVar("R")

CONNECT = 8.0
"""Time to reach a scheduler [s]."""
ANSWER = 30.0
"""Time in which a scheduler answers [s]; one that takes longer is lost."""
TRANSFER = 5.0
"""Time in which a result arrives [s], unless its worker has died meanwhile."""
LOOK = 1.0
"""Time between two looks at the scheduler [s]."""
TRIES = 2
"""Times that a chunk goes to the scheduler, which tries it on a few workers each time."""
KEPT = "finished rows are kept, go on with --resume"

PINNED = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that are 1 in a worker: numbers must not hang on how many threads add them up."""


# Chunks and results --------------------------------------------------------------------------


class UnfinishedError(Exception):
    """A chunk that can be tried again, and why."""


class LateError(Exception):
    """A result that is not there any more: the scheduler has it made again."""


class Scheduler:
    """A scheduler that is asked, and may not answer."""

    def __init__(self, client: Any, where: str, patience: float) -> None:
        self.client, self.where, self.patience = client, where, patience
        self.workers, self.looked, self.alone = 0, -math.inf, math.inf

    def count(self) -> int:
        """Return the number of worker processes, at most `LOOK` old.

        Raises:
            MachineError: there have been none for too long, or the scheduler is lost.
        """
        now = time.monotonic()
        if now - self.looked > LOOK or self.client.status != "running":
            with self.answering():
                self.workers = len(self.client.nthreads(callback_timeout=ANSWER))
            self.looked = now
            self.alone = math.inf if self.workers else min(self.alone, now)
        if now - self.alone > self.patience:
            raise MachineError(f"{self.where} has no workers for {self.patience:g} s; {KEPT}")
        return self.workers

    def result(self, future: Any) -> Any:
        """Return the result of a chunk.

        Raises:
            UnfinishedError: its workers died.
            LateError: it is lost, and made again.
            MachineError: the scheduler is lost.
            InputError: a worker cannot do this work.
            Exception: whatever the work itself raised.
        """
        if future.status == "error":
            raise self._failure(future.exception())
        with self.answering():
            try:
                return future.result(timeout=TRANSFER)
            except TimeoutError:
                raise LateError from None

    @contextlib.contextmanager
    def answering(self) -> Iterator[None]:
        """Turn what a lost connection brings about into one line."""
        try:
            if self.client.status != "running":
                raise ConnectionError
            yield
        except (Exception, asyncio.CancelledError) as error:
            lost = isinstance(error, OSError | asyncio.CancelledError)
            if lost or self.client.status != "running":
                raise MachineError(f"{self.where} is lost; {KEPT}") from error
            raise

    def _failure(self, error: Exception) -> Exception:
        if type(error).__name__ == "KilledWorker":
            return UnfinishedError(
                f"workers died {TRIES} times over on one chunk (too little memory?)"
            )
        if isinstance(error, ImportError):
            return InputError(f"{self.where}: a worker lacks what it needs to run this: {error}")
        return error


def results(asked: Scheduler, work: Callable[[C], R], chunks: Iterable[C]) -> Iterator[R]:
    """Yield the results; the scheduler never has more than a few chunks for each worker."""
    source, done = iter(chunks), queue.SimpleQueue[Any]()
    flight: dict[Any, tuple[bytes, int]] = {}
    code, dumps = _code(), load("cloudpickle").dumps

    def errand(packed: bytes, code: dict[str, str]) -> Any:
        from scenarios.study.scheduler import work_on  # local: a scheduler may lack this code

        return work_on(packed, code)

    def submit(packed: bytes, tries: int) -> None:
        with asked.answering():
            await_result(asked.client.submit(errand, packed, code, pure=False), packed, tries)

    def await_result(future: Any, packed: bytes, tries: int) -> None:
        flight[future] = packed, tries
        future.add_done_callback(done.put)

    while True:
        room = WINDOW * max(asked.count(), 1)
        while len(flight) < room and (chunk := next(source, None)) is not None:
            submit(dumps((work, chunk)), 1)
        if not flight:
            return
        try:
            future = done.get(timeout=LOOK)
        except queue.Empty:
            continue
        packed, tries = flight.pop(future)
        try:
            result = asked.result(future)
        except LateError:
            await_result(future, packed, tries)
        except UnfinishedError as unfinished:
            if tries == TRIES:
                raise MachineError(f"{unfinished}; {KEPT}") from None
            submit(packed, tries + 1)
        else:
            future.release()
            yield result


def work_on(packed: bytes, code: dict[str, str]) -> Any:
    """Return the result of a chunk, in the process of a worker.

    Raises:
        InputError: this worker would not compute what the process that asks would.
    """
    with _one_at_a_time:
        host = socket.gethostname()
        for name in PINNED:
            if os.environ.get(name) != "1":
                raise InputError(
                    f"worker on {host}: {name} is {os.environ.get(name)}, need 1; start it with "
                    f"its nanny, or with {'=1 '.join(PINNED)}=1"
                )
        for name, version in _code().items():
            if version != code.get(name):
                raise InputError(
                    f"worker on {host} has other code: {name} is {version} there and "
                    f"{code.get(name)} here"
                )
        work, chunk = pickle.loads(packed)
        return work(chunk)


_one_at_a_time = threading.Lock()


def _code() -> dict[str, str]:
    from scenarios.study.plan import loaded_code

    return loaded_code()


# Connections ---------------------------------------------------------------------------------


@contextlib.contextmanager
def connected(scheduler: Any, where: str) -> Iterator[Any]:
    """Yield a client of a scheduler, given by its address or as a cluster; nothing is logged."""
    distributed = load("distributed")
    with quiet():
        try:
            if isinstance(scheduler, str):
                asyncio.run(_greet(scheduler))
            client = distributed.Client(scheduler, timeout=CONNECT, set_as_default=False)
        except Exception as error:  # anything: who answers there may speak HTTP
            told = isinstance(error, OSError | ValueError | TypeError | ImportError)
            said = " ".join(str(error).split()) if told else "no scheduler answers there"
            raise InputError(
                f"{where} cannot be reached: {said or f'no answer in {CONNECT:g} s'}; "
                "need HOST:PORT or tcp://HOST:PORT"
            ) from error
        try:
            yield client
        finally:
            with contextlib.suppress(Exception):  # it may be lost: all is said by then
                client.close(timeout=CONNECT)


async def _greet(address: str) -> None:
    """Connect once, in bounded time; the client itself would wait for ever for a greeting."""
    security = load("distributed").Security().get_connection_args("client")
    connect = load("distributed.comm").connect
    async with asyncio.timeout(CONNECT + 1.0):
        comm = await connect(address, timeout=CONNECT, **security)
        await comm.close()


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep what dask logs, with its tracebacks, from the terminal."""
    with load("distributed.utils").silence_logging_cmgr(logging.CRITICAL + 1):
        yield


def load(module: str) -> Any:
    """Return a module of the extra ``cluster``.

    Raises:
        InputError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError("a cluster needs the extra: pip install 'qpctrl[cluster]'") from error
