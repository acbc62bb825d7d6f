"""Processes that work side by side, one thread each."""

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "POLARS_MAX_THREADS")


def end_with_interrupt() -> None:
    """Let an interrupt end a worker without a word; who started it says what is to be said."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextlib.contextmanager
def worker_pool(
    workers: int, begin: Callable[[], None] = end_with_interrupt
) -> Iterator[ProcessPoolExecutor]:
    """Yield processes that wait for work; they end with the block.

    Args:
        workers: how many.
        begin: what each of them calls first.
    """
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read when a worker starts
    try:
        pool = ProcessPoolExecutor(
            workers, mp_context=multiprocessing.get_context("spawn"), initializer=begin
        )
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
