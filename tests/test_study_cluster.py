"""A cluster behind a study: whoever is killed, no row is lost, none twice, and none changes."""

import contextlib
import functools
import itertools
import json
import multiprocessing
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import distributed
import numpy as np
import polars as pl
import pytest

from qpctrl import InputError
from scenarios.study import scheduler
from scenarios.study.cluster import DaskCluster, dask_machine, jobqueue_machine
from scenarios.study.design import Design
from scenarios.study.factor import Factor
from scenarios.study.machine import WINDOW, Here, Machine, MachineError
from scenarios.study.parameter import Parameter
from scenarios.study.plan import Plan
from scenarios.study.rollout import TIMING, Tracing, roll_out_all
from scenarios.study.store import chunk_files, open_store
from scenarios.study.study import Study
from scenarios.study.system import Rollout, Setting

TESTS = Path(__file__).parent
ENVIRONMENT = {
    "PYTHONPATH": f"{TESTS.parent}:{TESTS}",
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
    "DASK_DISTRIBUTED__WORKER__MULTIPROCESSING_METHOD": "forkserver",
    **dict.fromkeys(scheduler.PINNED, "1"),
}
ROWS, REPEATS, CHUNK = 320, 10, 2
KILLS = 10
PAUSE = 0.01  # s, of each rollout
PATIENCE = 60.0  # s

forked = multiprocessing.get_context("forkserver")
"""Starts processes from one that has loaded all there is to load, which takes seconds."""


# A study, and the one place that knows the store ------------------------------------------------


@dataclass(frozen=True)
class Squares:
    """A system that sleeps a little, and squares."""

    name: str = "squares"
    summary: str = "squares of numbers"
    parameters: Mapping[str, Parameter] = field(
        default_factory=lambda: {"x": Parameter("1", 0.0, -1.0, 1.0, "a number")}
    )
    controllers: Mapping[str, str] = field(default_factory=lambda: {"qp": "the one"})
    measures: Mapping[str, str] = field(
        default_factory=lambda: {"square": "its square", "noise": "a random number"}
    )

    def run(self, setting: Setting, controller: str, seed: int, *, full: bool = False) -> Rollout:
        """Return the square of x, and a number that hangs on the seed alone."""
        time.sleep(PAUSE)
        noise = float(np.random.default_rng(seed).normal())
        return Rollout({"square": setting["x"] ** 2, "noise": noise}, pl.DataFrame())

    def limit(self, setting: Setting, controller: str, parameter: str) -> None:
        """Return that no limit is known."""
        del setting, controller, parameter


def fill(machine: Machine, folder: Path) -> None:
    """Make what is missing of a study in ``folder``."""
    study = Study(
        name="squares",
        summary="",
        system=Squares(),
        controllers=("qp",),
        factors=(Factor("x", "1", -1.0, 1.0),),
        design=Design(kind="levels", size=ROWS // REPEATS),
        repeats=REPEATS,
    )
    plan = Plan(study, 0)
    with open_store(folder, plan, resume=True) as store:
        done = frozenset(store.done()["identity"])
        missing = iter([task for task in plan if task.identity not in done])
        chunks = iter(lambda: tuple(itertools.islice(missing, CHUNK)), ())
        work = functools.partial(roll_out_all, study, Tracing(), plan.code["source"])
        with contextlib.closing(machine.run(work, chunks)) as made:  # type: ignore[type-var]
            for rollouts in made:
                store.add(rollouts)


def rows_of(folder: Path) -> pl.DataFrame:
    """Return all rows in a folder, those that are twice too, without timing."""
    return pl.read_parquet(chunk_files(folder)).drop(TIMING).sort("identity")


@dataclass(frozen=True)
class Disturbed:
    """A machine at which something happens after some of the results."""

    machine: Machine
    events: Mapping[int, Callable[[], None]]

    @property
    def workers(self) -> int:
        """Return how many the machine has."""
        return self.machine.workers

    def run(self, work: Callable, chunks: Iterable) -> Iterator:
        """Yield what the machine yields."""
        for index, result in enumerate(self.machine.run(work, chunks)):
            yield result
            self.events.get(index, lambda: None)()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> pl.DataFrame:
    folder = tmp_path_factory.mktemp("undisturbed")
    fill(Here(), folder)
    table = rows_of(folder)
    assert len(table) == ROWS
    assert table["square"].sort().to_numpy() == pytest.approx(
        np.repeat(np.sort(np.linspace(-1, 1, ROWS // REPEATS) ** 2), REPEATS)
    )
    assert table["noise"].n_unique() == REPEATS  # common to all levels
    return table


# Clusters -----------------------------------------------------------------------------------------


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until something holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def address_in(file: Path) -> str:
    """Return the address that a scheduler writes when it is ready."""

    def ready() -> bool:
        with contextlib.suppress(OSError, ValueError):
            return bool(json.loads(file.read_text())["address"])
        return False

    wait_for(ready)
    return str(json.loads(file.read_text())["address"])


def run_dask(kind: str, arguments: list[str], environment: dict[str, str]) -> None:
    """Be a scheduler or a worker, quietly."""
    silent = os.open(os.devnull, os.O_RDWR)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    os.environ.update(environment)
    module = __import__(f"distributed.cli.dask_{kind}", fromlist=["main"])
    module.main(arguments, standalone_mode=False)


@dataclass
class Cluster:
    """Processes of this computer."""

    folder: Path
    processes: list[Any] = field(default_factory=list)

    def start(self, kind: str, *more: str, **environment: str) -> Any:
        """Return a new process of the cluster."""
        place = ["--scheduler-file", str(self.file), "--host", "127.0.0.1", "--no-dashboard", *more]
        process = forked.Process(target=run_dask, args=(kind, place, environment))
        process.start()
        self.processes.append(process)
        return process

    def schedule(self) -> Any:
        """Return a new scheduler."""
        return self.start("scheduler", "--port", "0")

    def work(self, threads: int = 1, **environment: str) -> Any:
        """Return a new worker, which ends with its scheduler and does not come back."""
        own = ("--nthreads", str(threads), "--no-nanny", "--memory-limit", "0")
        return self.start("worker", *own, "--local-directory", str(self.folder), **environment)

    @property
    def file(self) -> Path:
        """Where the scheduler writes its address."""
        return self.folder / "scheduler.json"

    @property
    def address(self) -> str:
        """Where the scheduler is."""
        return address_in(self.file)

    def end(self) -> None:
        """Kill all that still runs."""
        for process in self.processes:
            process.kill()
            process.join()
            process.close()
        self.processes.clear()
        self.file.unlink(missing_ok=True)


@pytest.fixture(scope="module", autouse=True)
def environment() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in ENVIRONMENT.items():
            patch.setenv(name, value)
        forked.set_forkserver_preload([__name__, "distributed.cli.dask_worker"])
        yield


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    made = Cluster(tmp_path)
    yield made
    made.end()


@dataclass
class Nannied:
    """A cluster as users start one, whose workers come back."""

    address: str
    client: distributed.Client

    def workers(self) -> list[int]:
        """Return the processes of workers that answer."""
        found = self.client.run(os.getpid, on_error="ignore")
        return [pid for pid in found.values() if isinstance(pid, int)]


PRELOAD = f"""from distributed.utils import get_mp_context
get_mp_context().set_forkserver_preload(["distributed", {__name__!r}])
"""


@pytest.fixture(scope="module")
def nannied(tmp_path_factory: pytest.TempPathFactory, environment: None) -> Iterator[Nannied]:
    folder = tmp_path_factory.mktemp("cluster")
    place = ["--scheduler-file", folder / "scheduler.json", "--host", "127.0.0.1", "--no-dashboard"]
    (folder / "preload.py").write_text(PRELOAD)
    own = [
        "--preload-nanny",
        folder / "preload.py",
        "--nworkers",
        "2",
        "--nthreads",
        "1",
        "--memory-limit",
        "0",
        "--local-directory",
        folder,
    ]
    commands = [
        [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", *place],
        [sys.executable, "-m", "distributed.cli.dask_worker", *own, *place],
    ]
    with contextlib.ExitStack() as stack:
        for command in commands:
            process = subprocess.Popen(
                command,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            stack.callback(process.wait)
            stack.callback(os.killpg, process.pid, signal.SIGKILL)
        address = address_in(folder / "scheduler.json")
        client = distributed.Client(address, set_as_default=False)
        stack.callback(client.close)
        found = Nannied(address, client)
        wait_for(lambda: len(found.workers()) == 2)
        yield found


# kill -9 ------------------------------------------------------------------------------------------


def test_workers_that_are_killed_ten_times(
    nannied: Nannied, tmp_path: Path, undisturbed: pl.DataFrame
) -> None:
    moment, killed = random.Random(1), []

    def kill() -> None:
        wait_for(nannied.workers)
        time.sleep(moment.uniform(0.0, 2 * CHUNK * PAUSE))
        killed.append(moment.choice(nannied.workers()))
        os.kill(killed[-1], signal.SIGKILL)

    events = dict.fromkeys(moment.sample(range(ROWS // CHUNK - 5), KILLS), kill)
    fill(Disturbed(dask_machine(nannied.address), events), tmp_path)
    assert len(set(killed)) == KILLS
    assert rows_of(tmp_path).equals(undisturbed)


def test_a_driver_that_is_killed_ten_times(
    nannied: Nannied, tmp_path: Path, undisturbed: pl.DataFrame
) -> None:
    moment, seen = random.Random(2), []
    for _ in range(KILLS):
        before = len(chunk_files(tmp_path))
        driver = forked.Process(target=drive, args=(nannied.address, tmp_path))
        driver.start()
        rows = moment.randrange(6)
        wait_for(lambda b=before, r=rows: len(chunk_files(tmp_path)) >= b + r)
        time.sleep(moment.uniform(0.0, 0.1))
        driver.kill()
        driver.join()
        assert driver.exitcode == -signal.SIGKILL
        seen.append(len(chunk_files(tmp_path)))
    assert 0 < seen[2] < seen[-1] < ROWS // CHUNK  # something to lose, and something to do
    drive(nannied.address, tmp_path)
    assert rows_of(tmp_path).equals(undisturbed)


def drive(address: str, folder: Path) -> None:
    fill(DaskCluster(address, 2), folder)


def test_a_scheduler_that_is_killed_ten_times(
    cluster: Cluster, tmp_path: Path, undisturbed: pl.DataFrame
) -> None:
    moment, seen, folder = random.Random(3), [], tmp_path / "study"
    for _ in range(KILLS):
        running = cluster.schedule()
        cluster.work()
        cluster.work()

        def kill(victim: Any = running) -> None:
            time.sleep(moment.uniform(0.0, 2 * CHUNK * PAUSE))
            victim.kill()

        machine = Disturbed(dask_machine(cluster.address), {moment.randrange(8): kill})
        started = time.monotonic()
        with pytest.raises(MachineError, match=r"is lost; finished rows are kept, go on with --re"):
            fill(machine, folder)
        assert time.monotonic() - started < 10.0
        cluster.end()
        seen.append(len(chunk_files(folder)))
    assert seen == sorted(set(seen))  # each time some more
    assert seen[-1] < ROWS // CHUNK
    cluster.schedule()
    cluster.work()
    fill(dask_machine(cluster.address), folder)
    assert rows_of(folder).equals(undisturbed)


def die_at(bad: int, number: int) -> int:
    if number == bad:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_a_chunk_that_kills_its_workers_ends_the_study_in_one_line(nannied: Nannied) -> None:
    machine = dask_machine(nannied.address)
    with pytest.raises(MachineError, match=r"workers died .* on one chunk .*go on with --resume"):
        list(machine.run(functools.partial(die_at, 3), range(20)))


# What a user sees ---------------------------------------------------------------------------------


def test_the_terminal_sees_one_line_when_the_scheduler_is_lost(cluster: Cluster) -> None:
    running = cluster.schedule()
    cluster.work()
    address = cluster.address
    program = (
        "import sys, time; from scenarios.study.cluster import dask_machine\n"
        "from qpctrl.errors import QpctrlError\n"
        "try:\n"
        "    for _ in dask_machine(sys.argv[1]).run(time.sleep, [0.01] * 10_000):\n"
        "        print(flush=True)\n"
        "except QpctrlError as error:\n"
        "    print(error, file=sys.stderr)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-W", "error", "-c", program, address],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as driver:
        assert driver.stdout is not None
        driver.stdout.readline()
        running.kill()
        said = driver.communicate(timeout=PATIENCE)[1]
    line = f"dask scheduler '{address}' is lost; finished rows are kept, go on with --resume\n"
    assert said == line


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("", "missing port number"),
        ("node7", "missing port number"),
        ("tcp://", "missing port number"),
        ("foo://node7:1", "unknown address scheme 'foo'"),
        ("127.0.0.1:1", "Timed out trying to connect"),
        ("tls://127.0.0.1:1", "check your TLS configuration"),
    ],
)
def test_a_scheduler_that_cannot_be_reached(
    address: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert scheduler.CONNECT <= 9.0
    monkeypatch.setattr(scheduler, "CONNECT", 0.3)
    with pytest.raises(InputError, match=f"^dask scheduler '{address}' cannot .*{said}"):
        dask_machine(address)


def test_what_listens_and_says_nothing_is_no_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduler, "CONNECT", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        started = time.monotonic()
        with pytest.raises(InputError, match="cannot be reached: no answer in"):
            dask_machine(address)
        assert time.monotonic() - started < 5.0


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'qpctrl\[cluster\]'"):
        dask_machine("127.0.0.1:1")


def test_no_workers_and_no_answer(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    running = cluster.schedule()
    with pytest.raises(InputError, match=r"has no workers within 0.2 s; start some: dask worker"):
        dask_machine(cluster.address, patience=0.2)
    worker = cluster.work()
    results = dask_machine(cluster.address, patience=1.0).run(abs, range(10**9))
    next(results)
    worker.kill()
    with pytest.raises(MachineError, match="has no workers for 1 s; finished rows are kept"):
        list(results)
    cluster.work()
    monkeypatch.setattr(scheduler, "ANSWER", 1.0)
    monkeypatch.setattr(scheduler, "TRANSFER", 0.5)
    results = dask_machine(cluster.address).run(abs, range(10**9))
    next(results)
    os.kill(running.pid, signal.SIGSTOP)
    with pytest.raises(MachineError, match="is lost; finished rows are kept"):
        list(results)


# Chunks and workers -------------------------------------------------------------------------------


def fail(number: int) -> int:
    raise ArithmeticError(f"got {number}")


def test_what_the_work_raises_comes_through(nannied: Nannied) -> None:
    with pytest.raises(ArithmeticError, match="got 7"):
        list(dask_machine(nannied.address).run(fail, [7]))


def test_other_code_at_the_workers_is_refused(
    nannied: Nannied, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scheduler, "_code", lambda: {"source": "mine"})
    with pytest.raises(InputError, match=r"has other code: source is \w+ there and mine here"):
        list(dask_machine(nannied.address).run(abs, [7]))


def test_workers_whose_threads_are_not_pinned_are_refused(cluster: Cluster) -> None:
    cluster.schedule()
    cluster.work(OMP_NUM_THREADS="4")
    with pytest.raises(InputError, match="OMP_NUM_THREADS is 4, need 1"):
        list(dask_machine(cluster.address).run(abs, [7]))


def span(pause: float) -> tuple[float, float]:
    started = time.monotonic()
    time.sleep(pause)
    return started, time.monotonic()


def test_a_worker_runs_one_chunk_at_a_time_however_many_threads_it_has(cluster: Cluster) -> None:
    cluster.schedule()
    cluster.work(threads=2)
    spans = sorted(dask_machine(cluster.address).run(span, [0.05] * 8))
    assert len(spans) == 8
    assert all(ended <= begun for (_, ended), (begun, _) in itertools.pairwise(spans))


def test_few_chunks_are_under_way_and_new_workers_get_theirs(cluster: Cluster) -> None:
    taken, results, most = 0, 0, 0

    def chunks() -> Iterator[int]:
        nonlocal taken
        while most <= WINDOW:
            taken += 1
            yield -taken

    cluster.schedule()
    cluster.work()
    for result in dask_machine(cluster.address).run(abs, chunks()):
        results += 1
        assert result > 0
        most = max(most, taken - results + 1)
        assert most <= 2 * WINDOW
        if results == 20:
            assert most == WINDOW
            cluster.work()
    assert results == taken


def test_nothing_is_left_at_the_scheduler(nannied: Nannied) -> None:
    def left(dask_scheduler: Any = None) -> int:
        return len(dask_scheduler.tasks)

    machine = dask_machine(nannied.address)
    kept = [nannied.client.run_on_scheduler(left) for _ in machine.run(abs, range(50))]
    assert 0 < max(kept) <= WINDOW * 2 + 1
    results = machine.run(abs, range(10**9))
    next(results)
    results.close()  # type: ignore[attr-defined]
    wait_for(lambda: nannied.client.run_on_scheduler(left) == 0)


# Batch systems ------------------------------------------------------------------------------------

SBATCH = """#!/bin/sh
cp "$1" {folder}/job.sh; sh {folder}/job.sh >/dev/null 2>&1 &
echo $! >> {folder}/jobs
echo Submitted batch job $!
"""
SCANCEL = """#!/bin/sh
echo $1 >> {folder}/cancelled; pkill -P $1; kill $1; exit 0
"""


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a batch system whose jobs start at once, here."""
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / name).write_text(text.format(folder=tmp_path))
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    return tmp_path


GOOD = """system = "slurm"
jobs = 2
[options]
cores = 1
memory = "1 GB"
interface = "lo"
"""


def test_jobs_of_a_batch_system(slurm: Path) -> None:
    file = slurm / "slurm.toml"
    file.write_text(GOOD)
    machine = jobqueue_machine(file)
    assert machine.workers == 2
    assert not (slurm / "jobs").exists()
    results = sorted(machine.run(abs, range(-9, 1)))
    assert results == list(range(10))
    jobs = (slurm / "jobs").read_text().split()
    assert len(jobs) == 2
    assert sorted((slurm / "cancelled").read_text().split()) == sorted(jobs)
    script = (slurm / "job.sh").read_text()
    assert "#SBATCH --cpus-per-task=1" in script
    assert "--nthreads 1" in script


def test_jobs_that_are_refused_are_one_line(slurm: Path) -> None:
    (slurm / "slurm.toml").write_text(GOOD)
    (slurm / "sbatch").write_text("#!/bin/sh\necho invalid partition >&2; exit 1\n")
    with pytest.raises(InputError, match=r"^slurm refuses these jobs: .*invalid partition") as said:
        list(jobqueue_machine(slurm / "slurm.toml").run(abs, [1]))
    assert "\n" not in str(said.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"slurm"', '"slrum"', "unknown system .*'slrum'.* did you mean 'slurm'"),
        ('system = "slurm"', "", "unknown system"),
        ("jobs = 2", "", "jobs is None, need a whole number >= 1"),
        ("jobs = 2", "jobs = 0", "jobs is 0, need a whole number >= 1"),
        ("jobs = 2", "jobs = true", "jobs is True, need a whole number >= 1"),
        ("jobs = 2", "job = 2", "unknown field .*'job'.* did you mean 'jobs'"),
        ("jobs = 2", "jobs = 2\npatience_s = -1", "patience_s is -1, need a time > 0"),
        ("jobs = 2", "jobs 2", "cannot be read: Expected '=' after"),
        ("cores = 1", "", "needs cores and memory"),
        ("cores = 1", "cores = 1.5", "cores is 1.5, need a whole number"),
        ("[options]", "[option]", "unknown field"),
        ("cores = 1", "cores = 1\nwaltime = '1'", "'waltime'.* did you mean 'walltime'"),
        ('"1 GB"', '"much"', "refuses these jobs"),
        ('"slurm"', '"pbs"', "has no pbs: the command 'qsub' is not there"),
    ],
)
def test_a_file_that_cannot_be_used(old: str, new: str, said: str, slurm: Path) -> None:
    (slurm / "jobs.toml").write_text(GOOD.replace(old, new))
    with pytest.raises(InputError, match=said) as found:
        jobqueue_machine(slurm / "jobs.toml")
    assert "jobs.toml" in str(found.value)
    assert "\n" not in str(found.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: No such file"):
        jobqueue_machine(tmp_path / "none.toml")
