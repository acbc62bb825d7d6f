"""Rollouts on a cluster: dask workers that run already, or jobs of a batch system.

Scheduler, workers and this process need the same version of this code; it is compared where a
chunk runs. A worker process runs one chunk at a time, however many threads it has, so start one
for each core: ``dask worker ADDRESS --nworkers 8 --nthreads 1``.

A batch system is described in a TOML file:

    system = "slurm"          # slurm, pbs, sge, lsf, oar, htcondor or moab
    jobs = 10                 # how many jobs to submit, all the same
    patience_s = 7200         # how long to wait while none of them runs [s]; default 3600

    [options]                 # arguments of the class, here dask_jobqueue.SLURMCluster
    cores = 8                 # of each job; needed
    memory = "16 GB"          # of each job; needed
    queue = "short"
    walltime = "02:00:00"

A job has one process for each core, unless ``processes`` says otherwise. A job that ends, as at its
walltime, is not submitted again: when all have ended, the study ends too and can be resumed.
"""

import contextlib
import inspect
import math
import shutil
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from qpctrl.errors import InputError, reason_of, unknown_name
from scenarios.study.machine import Machine
from scenarios.study.scheduler import (
    ANSWER,
    LOOK,
    Scheduler,
    connected,
    load,
    quiet,
    results,
)

C = TypeVar("C")
R = TypeVar("R")

PATIENCE = 30.0
"""Time without any worker that ends a study [s]."""
QUEUE_PATIENCE = 3600.0
"""Time while no job runs that ends a study [s]; they wait in a queue."""
SYSTEMS = {
    "slurm": "SLURMCluster",
    "pbs": "PBSCluster",
    "sge": "SGECluster",
    "lsf": "LSFCluster",
    "oar": "OARCluster",
    "htcondor": "HTCondorCluster",
    "moab": "MoabCluster",
}
"""Classes of dask_jobqueue."""
FIELDS = ("system", "jobs", "patience_s", "options")
CLUSTER_OPTIONS = ("security", "shared_temp_directory", "scheduler_options")
NO_OPTIONS = (
    *("self", "scheduler", "name", "config_name", "kwargs", "base_class_kwargs"),
    *("extra", "job_extra", "env_extra", "header_skip"),
)
"""Arguments of a job that are set here, or are old spellings of others."""


@dataclass(frozen=True)
class DaskCluster:
    """The workers of a dask scheduler that runs already."""

    address: str
    """Of the scheduler, HOST:PORT or tcp://HOST:PORT."""
    workers: int
    """Worker processes when they were counted; `run` follows how many there are."""
    patience: float = PATIENCE
    """Time without any worker that ends a study [s]."""

    def run(self, work: Callable[[C], R], chunks: Iterable[C]) -> Iterator[R]:
        """Yield the results as they come.

        Raises:
            InputError: the scheduler cannot be reached, or a worker cannot do this work.
            MachineError: the scheduler is lost, no worker is left, or one chunk kills them.
        """
        where = f"dask scheduler {self.address!r}"
        with connected(self.address, where) as client:
            yield from results(Scheduler(client, where, self.patience), work, chunks)


@dataclass(frozen=True)
class JobQueue:
    """Jobs of a batch system, which are submitted for a study and end with it."""

    system: str
    """Key of `SYSTEMS`."""
    jobs: int
    options: Mapping[str, Any]
    """Arguments of the class."""
    patience: float = QUEUE_PATIENCE
    """Time while no job runs that ends a study [s]."""

    @property
    def workers(self) -> int:
        """Worker processes when all jobs run."""
        return self.jobs * int(self.options["processes"])

    def run(self, work: Callable[[C], R], chunks: Iterable[C]) -> Iterator[R]:
        """Yield the results as they come.

        Raises:
            InputError: jobs cannot be submitted, or a worker cannot do this work.
            MachineError: no job runs for too long, or one chunk kills its workers.
        """
        where = f"{self.system} queue"
        with _submitted(self) as cluster, connected(cluster, where) as client:
            yield from results(Scheduler(client, where, self.patience), work, chunks)


def dask_machine(address: str, patience: float = PATIENCE) -> Machine:
    """Return the workers of the dask scheduler at ``address``.

    Args:
        address: HOST:PORT or tcp://HOST:PORT.
        patience: time without any worker that is accepted, now and later [s].

    Raises:
        InputError: dask is not installed, or the scheduler cannot be reached or has no workers.
    """
    where, end = f"dask scheduler {address!r}", time.monotonic() + patience
    with connected(address, where) as client:
        asked = Scheduler(client, where, math.inf)
        while not (count := asked.count()):
            if time.monotonic() > end:
                raise InputError(
                    f"{where} has no workers within {patience:g} s; start some: "
                    f"dask worker {address} --nthreads 1"
                )
            time.sleep(LOOK / 4)
    return DaskCluster(address, count, patience)


def jobqueue_machine(path: Path) -> Machine:
    """Return the jobs that a TOML file describes; nothing is submitted yet.

    Raises:
        InputError: dask-jobqueue is not installed, the file cannot be used as it is, or this
            computer has no such batch system.
    """
    where, found = f"file {str(path)!r}", _read(path)
    system, jobs = str(found.get("system")), found.get("jobs")
    patience, given = found.get("patience_s", QUEUE_PATIENCE), found.get("options")
    if system not in SYSTEMS:
        raise unknown_name(f"system in {where}:", system, SYSTEMS)
    if not isinstance(patience, int | float) or not 0 < patience < math.inf:
        raise InputError(f"{where}: patience_s is {patience!r}, need a time > 0 in s")
    if not isinstance(given, dict) or not {"cores", "memory"} <= given.keys():
        raise InputError(f"{where}: [options] needs cores and memory, those of one job")
    options = {"processes": given["cores"], **given}
    numbers = {"jobs": jobs, "cores": options["cores"], "processes": options["processes"]}
    for name, number in numbers.items():
        if type(number) is not int or number < 1:
            raise InputError(f"{where}: {name} is {number!r}, need a whole number >= 1")
    _check_options(where, load("dask_jobqueue"), system, options)
    return JobQueue(system, numbers["jobs"], options, float(patience))


@contextlib.contextmanager
def _submitted(jobs: JobQueue) -> Iterator[Any]:
    """Yield a scheduler in this process whose workers are jobs."""
    kind = getattr(load("dask_jobqueue"), SYSTEMS[jobs.system])
    options = {**jobs.options, "silence_logs": False}
    quietly = {"dashboard": False, "dashboard_address": ":0"}
    options["scheduler_options"] = {**quietly, **options.get("scheduler_options", {})}

    async def submit(cluster: Any) -> None:
        while len(cluster.worker_spec) < jobs.jobs:
            cluster.worker_spec.update(cluster.new_worker_spec())
        await cluster

    with quiet():
        try:
            cluster = kind(**options)
        except Exception as error:
            raise _refused(jobs.system, error) from error
        try:
            try:
                cluster.sync(submit, cluster)
            except Exception as error:
                for job in cluster.workers.values():
                    job.status = load("distributed").Status.failed  # or it refuses to close
                raise _refused(jobs.system, error) from error
            yield cluster
        finally:
            with contextlib.suppress(Exception):
                cluster.close(timeout=ANSWER)


# The file of a batch system ------------------------------------------------------------------


def _read(path: Path) -> dict[str, Any]:
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = reason_of(error)
        raise InputError(f"file {str(path)!r} cannot be read: {reason}") from error
    for name in found:
        if name not in FIELDS:
            raise unknown_name(f"field in file {str(path)!r}:", name, FIELDS)
    return found


def _check_options(where: str, jobqueue: Any, system: str, options: dict[str, Any]) -> None:
    """Refuse options that the class does not know or cannot use, and a system that is not here."""
    job = getattr(jobqueue, SYSTEMS[system]).job_cls
    known = {*inspect.signature(jobqueue.core.Job.__init__).parameters, *CLUSTER_OPTIONS}
    known = (known | set(inspect.signature(job.__init__).parameters)) - set(NO_OPTIONS)
    for name in options:
        if name not in known:
            raise unknown_name(f"option in {where}:", name, known)
    command = job.submit_command.split()[0]
    if shutil.which(command) is None:
        raise InputError(
            f"{where}: this computer has no {system}: the command {command!r} is not there"
        )
    own = {name: value for name, value in options.items() if name not in CLUSTER_OPTIONS}
    try:
        job("tcp://127.0.0.1:0", name="check", **own).job_script()
    except Exception as error:
        raise _refused(where, error) from error


def _refused(where: str, error: Exception) -> InputError:
    return InputError(f"{where} refuses these jobs: {' '.join(str(error).split())}")
