"""Compiled functions: the interpreter's numbers, one compilation, and every way it can fail."""

import errno
import hashlib
import os
import shlex
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest
from cases import ROBOTS, SPACES, draw, given_mode, needs_compiler, states

from qpctrl import InputError, compiler
from qpctrl.compiled import Compiled, compiled
from qpctrl.compiler import COMPILERS
from qpctrl.evaluator import Evaluator
from qpctrl.tick import MATRICES, Tick, build_tick

SAME = 1e-12
"""Promised relative agreement of compiled and interpreted numbers; measured: the same bits."""

ROUND_OFF = 1e-14
"""Two evaluations of a formula with entries of order one."""

SOON = 20.0
"""A compiler that hangs is left long before its own end [s], on a busy machine too."""

CC = next((path for name in COMPILERS if (path := shutil.which(name))), "")


# Functions and compilers -------------------------------------------------------------------


def small(scale: float = 1.0) -> ca.Function:
    """Return a function with a factorisation, a branch, a maximum, and a sparse output."""
    x, y, none = ca.SX.sym("x", 3), ca.SX.sym("y"), ca.SX.sym("none", 0)
    D, L, p = ca.ldl(2 * ca.SX.eye(3) + x @ x.T)
    out = [
        ca.ldl_solve(x, D, L, p) * scale,
        ca.vertcat(ca.if_else(x[0] > y, ca.sin(y), ca.cos(y)), ca.fmax(x[1], y)),
        ca.diag(x),
        ca.if_else(x[2] > 0.5, 1, 0),
    ]
    names = ["solved", "chosen", "D", "above"]
    return ca.Function("small", [x, y, none], out, ["x", "y", "none"], names)


def by_hand(x: np.ndarray, y: float) -> list[np.ndarray]:
    """Return the outputs of `small` by numpy."""
    solved = np.linalg.solve(2 * np.eye(3) + np.outer(x, x), x)
    chosen = np.array([np.sin(y) if x[0] > y else np.cos(y), max(x[1], y)])
    return [solved, chosen, np.diag(x), np.array([float(x[2] > 0.5)])]


def check_small(function: ca.Function) -> None:
    """Assert that a function has the numbers of `small`."""
    for x, y in ((np.array([0.3, -0.7, 0.2]), 0.1), (np.array([-0.4, 0.6, 1.1]), 0.5)):
        for ours, expected in zip(function(x, y, []), by_hand(x, y), strict=True):
            assert np.array(ours).reshape(expected.shape) == pytest.approx(expected, abs=ROUND_OFF)


Install = Callable[..., Path]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Return a function that makes a shell script the compiler; it lists its calls in a file."""

    def make(body: str, version: str = "a compiler 1.0", mode: int = 0o755) -> Path:
        calls, script = tmp_path / "calls", tmp_path / "fake-cc"
        calls.touch()
        script.write_text(
            "#!/bin/sh\n"
            f'case "$*" in *--version) echo {shlex.quote(version)}; exit;; esac\n'
            f'echo "$*" >> {shlex.quote(str(calls))}\n'
            f"{body}\n"
        )
        script.chmod(mode)
        monkeypatch.setenv("CC", shlex.quote(str(script)))
        return calls

    return make


COMPILE = f'exec {shlex.quote(CC)} "$@"'


def called(calls: Path) -> int:
    """Return how often the compiler compiled."""
    return len(calls.read_text().splitlines())


def only_library(cache: Path) -> Path:
    """Return the one file of a cache, after a check that its name is true."""
    (library,) = cache.iterdir()
    assert library.name.split(".")[1:] == [hashlib.sha256(library.read_bytes()).hexdigest(), "so"]
    return library


# The same numbers --------------------------------------------------------------------------


class Ticks(NamedTuple):
    """The tick of a 7-joint arm with three constraint rows, and what became of it."""

    tick: Tick
    interpreted: Evaluator
    compiled: Evaluator
    note: str


@pytest.fixture(scope="module")
def ticks(tmp_path_factory: pytest.TempPathFactory) -> Ticks:
    tick = build_tick(ROBOTS["arm_7"](), given_mode(ROBOTS["arm_7"](), SPACES["arm_7"], 3))
    made = compiled(tick.function, compile="yes", cache=tmp_path_factory.mktemp("cache"))
    assert made.is_compiled
    both = [Evaluator(function, matrices=MATRICES) for function in (tick.function, made.function)]
    return Ticks(tick, *both, made.note)


def load_state(ticks: Ticks, evaluate: Evaluator, seed: int = 1) -> None:
    """Write a random state with random commands and rows into the inputs."""
    robot, space = ROBOTS["arm_7"](), SPACES["arm_7"]
    (state,) = states(robot, space, 1, seed=seed)
    u = ticks.tick.inputs.vector()
    named = ticks.tick.inputs.views(u)
    drawn = draw(state.rng, 3, space.n, robot.nv)
    for task, reference in drawn.references().items():
        for key, value in reference.items():
            named[f"{task}.{key}"][...] = value
    named["dt"][...] = 1e-3
    for name, value in (("q", state.q), ("v", state.v), ("u", u)):
        evaluate.inputs[name][:] = value


@needs_compiler
def test_the_compiled_tick_has_the_interpreters_names_and_numbers(ticks: Ticks) -> None:
    assert list(ticks.compiled.inputs) == ["q", "v", "u", "x"]
    assert list(ticks.compiled.outputs) == list(ticks.interpreted.outputs)
    for seed in range(20):
        for evaluate in (ticks.interpreted, ticks.compiled):
            load_state(ticks, evaluate, seed)
            evaluate()
        for name, expected in ticks.interpreted.outputs.items():
            found = ticks.compiled.outputs[name]
            assert found.shape == expected.shape
            largest = np.abs(expected).max(initial=0.0)
            assert np.abs(found - expected).max(initial=0.0) <= SAME * largest, name
        assert np.abs(ticks.compiled.outputs["tau_hybrid"]).max() > 1


@needs_compiler
def test_what_is_not_a_number_spreads_alike(ticks: Ticks) -> None:
    sizes = {name: len(ticks.interpreted.inputs[name]) for name in ("q", "v", "u")}
    spread = set()
    for name, i in ((name, i) for name, size in sizes.items() for i in range(size)):
        outputs = []
        for evaluate in (ticks.interpreted, ticks.compiled):
            load_state(ticks, evaluate)
            evaluate.inputs[name][i] = np.nan
            evaluate()
            outputs.append(np.concatenate([out.ravel() for out in evaluate.outputs.values()]))
        expected, found = outputs
        spread.add(int(np.isnan(expected).sum()))
        largest = np.nanmax(np.abs(expected))
        assert np.allclose(found, expected, rtol=0, atol=SAME * largest, equal_nan=True), (name, i)
    assert len(spread) > 3  # from none to most outputs


@needs_compiler
def test_a_compiled_function_has_the_numbers_found_by_hand(tmp_path: Path) -> None:
    made = compiled(small(), compile="yes", cache=tmp_path)
    assert made.is_compiled
    assert made.function.name_in() == ["x", "y", "none"]
    assert made.function.name_out() == ["solved", "chosen", "D", "above"]
    assert made.function.sparsity_out(2).nnz() == 3
    check_small(made.function)


@needs_compiler
def test_products_are_rounded_before_they_are_added(tmp_path: Path) -> None:
    """A fused multiply-add would return what rounding takes from x y, here 2⁻⁶⁰."""
    x, y, z = (ca.SX.sym(name) for name in "xyz")
    function = ca.Function("rest", [x, y, z], [x + y + z, x * y - z])
    point = 1 + 2.0**-30
    made = compiled(function, compile="yes", cache=tmp_path)
    total, rest = (float(out) for out in made.function(point, point, 1 + 2.0**-29))
    assert (total, rest) == (3 + 2.0**-28, 0.0)


def test_a_function_is_interpreted_where_that_is_asked_for(install: Install) -> None:
    calls, function = install(COMPILE), small()
    made = compiled(function, compile="no")
    assert (made.function is function, made.is_compiled) == (True, False)
    assert called(calls) == 0
    check_small(made.function)


# Kept libraries ----------------------------------------------------------------------------


@needs_compiler
def test_a_kept_library_is_not_compiled_again(tmp_path: Path, install: Install) -> None:
    calls, cache = install(COMPILE, version="a compiler 1.0"), tmp_path / "a" / "cache"
    first = compiled(small(), compile="yes", cache=cache)
    second = compiled(small(), compile="yes", cache=cache)
    assert called(calls) == 1
    assert "compiled by a compiler 1.0" in first.note
    assert f"kept in {cache}" in second.note
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    only_library(cache)
    for made in (first, second):
        check_small(made.function)


@needs_compiler
def test_whatever_a_library_depends_on_makes_another(
    tmp_path: Path, install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, cache = install(COMPILE), tmp_path / "cache"
    compiled(small(), compile="yes", cache=cache)
    other = compiled(small(scale=2.0), compile="yes", cache=cache)
    x = np.array([0.3, -0.7, 0.2])
    solved = other.function(x, 0, [])[0].nonzeros()
    assert solved == pytest.approx(2 * by_hand(x, 0)[0])
    install(COMPILE, version="a compiler 1.1")
    compiled(small(), compile="yes", cache=cache)
    monkeypatch.setenv("CC", f"{os.environ['CC']} -g")
    compiled(small(), compile="yes", cache=cache)
    monkeypatch.setattr(compiler, "FLAGS", (*compiler.FLAGS, "-O1"))
    compiled(small(), compile="yes", cache=cache)
    assert called(calls) == len(list(cache.iterdir())) == 5
    install(COMPILE, version="a compiler 1.0")
    compiled(small(), compile="yes", cache=cache)
    assert called(calls) == 6


def test_code_for_one_processor_is_not_found_on_another(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    install("exit 1")
    found = []
    for cpu in ("a processor: avx2", "a processor: avx2 avx512f", ""):
        monkeypatch.setattr(compiler, "_cpu", lambda cpu=cpu: cpu)
        found.append(compiler.find_compiler())
    assert ["-march=native" in one.flags for one in found] == [True, True, False]
    assert len({one.key("int x;") for one in found}) == 3
    monkeypatch.undo()
    about = Path("/proc/cpuinfo")
    if about.exists() and "\nflags" in about.read_text():
        assert "sse2" in compiler._cpu()


@needs_compiler
@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({"QPCTRL_CACHE": "own", "XDG_CACHE_HOME": "xdg"}, "own"),
        ({"QPCTRL_CACHE": "~/own"}, "home/own"),
        ({"QPCTRL_CACHE": "", "XDG_CACHE_HOME": "{}/xdg"}, "xdg/qpctrl"),
        ({"XDG_CACHE_HOME": "relative"}, "home/.cache/qpctrl"),
        ({}, "home/.cache/qpctrl"),
    ],
)
def test_libraries_are_kept_where_the_environment_says(
    variables: dict[str, str], folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for name in ("QPCTRL_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value.format(tmp_path))
    compiled(small(), compile="yes")
    only_library(tmp_path / folder)


def truncate(library: Path) -> None:
    """Leave the first half of a library."""
    library.write_bytes(library.read_bytes()[: library.stat().st_size // 2])


def change(library: Path) -> None:
    """Change the last byte."""
    content = library.read_bytes()
    library.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))


def replace_by(content: bytes, library: Path) -> None:
    """Put another file under a name that is true."""
    library.unlink()
    key = library.name.split(".")[0]
    library.with_name(f"{key}.{hashlib.sha256(content).hexdigest()}.so").write_bytes(content)


def other_machine(library: Path) -> None:
    """Say in the header that the code is for another processor (bytes 18, 19 of an ELF file)."""
    content = library.read_bytes()
    replace_by(content[:18] + b"\xf3\x01" + content[20:], library)


def other_function(library: Path) -> None:
    """Put the library of another function in the place."""
    other = compiled(small(scale=1.001), compile="yes", cache=library.parent / "other")
    assert other.is_compiled
    (content,) = [path.read_bytes() for path in (library.parent / "other").iterdir()]
    shutil.rmtree(library.parent / "other")
    replace_by(content, library)


@needs_compiler
@pytest.mark.parametrize("damage", [truncate, change, other_machine, other_function])
def test_a_library_that_cannot_be_trusted_is_removed_and_compiled_again(
    damage: Callable[[Path], None], tmp_path: Path, install: Install
) -> None:
    calls, cache = install(COMPILE), tmp_path / "cache"
    made: Compiled | None = compiled(small(), compile="yes", cache=cache)
    library = only_library(cache)
    copy = library.read_bytes()
    made = None  # let go of the mapped file before it changes
    library.unlink()
    library.write_bytes(copy)
    damage(library)
    before = called(calls)
    made = compiled(small(), compile="yes", cache=cache)
    assert made.is_compiled
    assert called(calls) == before + 1
    assert only_library(cache).read_bytes() == copy
    check_small(made.function)


@needs_compiler
def test_half_written_libraries_are_never_looked_at(tmp_path: Path, install: Install) -> None:
    calls, cache = install(COMPILE), tmp_path / "cache"
    cache.mkdir()
    (cache / "half-written-abc").write_bytes(b"\x7fELF")
    assert compiled(small(), compile="yes", cache=cache).is_compiled
    assert compiled(small(), compile="yes", cache=cache).is_compiled
    assert called(calls) == 1


def a_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder is a file."""
    folder.write_text("")


def below_a_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder cannot be made."""
    folder.parent.rmdir()
    folder.parent.write_text("")


def open_to_all(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Anyone may put a library there."""
    folder.mkdir()
    folder.chmod(0o777)


def read_only(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder is there and cannot be written to."""
    if os.geteuid() == 0:
        pytest.skip("root may write to every folder")
    folder.mkdir(mode=0o500)


def full(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is full before the library is on it."""

    def fsync(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fsync)


def no_loading(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Code from that disk is not run."""
    external = ca.external

    def refuse(name: str, path: str) -> ca.Function:
        if Path(path).parent == folder:
            raise RuntimeError("failed to map segment from shared object")
        return external(name, path)

    monkeypatch.setattr(ca, "external", refuse)


@needs_compiler
@pytest.mark.parametrize("mode", ["auto", "yes"])
@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (a_file, "exists"),
        (below_a_file, "Not a directory"),
        (open_to_all, "anyone may write there"),
        (read_only, "Permission denied"),
        (full, "No space left"),
        (no_loading, "cannot be loaded from there"),
    ],
)
def test_without_a_cache_a_function_is_compiled_all_the_same(
    spoil: Callable[[Path, pytest.MonkeyPatch], None],
    says: str,
    mode: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cache, temporary = tmp_path / "parent" / "cache", tmp_path / "temporary"
    cache.parent.mkdir()
    temporary.mkdir()
    spoil(cache, monkeypatch)
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    made = compiled(small(), compile=mode, cache=cache)
    assert made.is_compiled
    assert "not kept: " in made.note
    assert says in made.note
    check_small(made.function)
    assert not list(temporary.iterdir())
    assert not cache.is_dir() or not list(cache.iterdir())


TWO = """
import sys
from pathlib import Path
from test_compiled import check_small, small
from qpctrl.compiled import compiled

made = compiled(small(), compile="yes", cache=Path(sys.argv[1]))
check_small(made.function)
print(made.note)
"""


@needs_compiler
def test_two_processes_that_compile_at_once_both_get_a_good_library(
    tmp_path: Path, install: Install
) -> None:
    """The compiler waits until both have called it."""
    calls, cache = tmp_path / "calls", tmp_path / "cache"
    both = f'while [ "$(wc -l < {shlex.quote(str(calls))})" -lt 2 ]; do sleep 0.05; done'
    install(f"{both}\n{COMPILE}")
    tests = Path(__file__).parent
    command = [sys.executable, "-c", TWO, str(cache)]
    env = {**os.environ, "PYTHONPATH": f"{tests.parent}:{tests}"}
    runs = [
        subprocess.Popen(command, env=env, text=True, stdout=-1, stderr=subprocess.STDOUT)
        for _ in range(2)
    ]
    for run in runs:
        said, _ = run.communicate(timeout=60)
        assert run.returncode == 0, said
        assert f"kept in {cache}" in said
    assert called(calls) == 2
    assert compiled(small(), compile="yes", cache=cache).is_compiled
    assert called(calls) == 2
    for library in cache.iterdir():
        assert library.name.split(".")[1] == hashlib.sha256(library.read_bytes()).hexdigest()


# Compilers that do not work ----------------------------------------------------------------


def assert_interpreted(function: ca.Function, cache: Path, says: str) -> None:
    """Assert that ``auto`` falls back, and ``yes`` refuses in one line, for the same reason."""
    made = compiled(function, cache=cache)
    assert made.function is function
    assert not made.is_compiled
    assert made.note.startswith("interpreted: ")
    assert says in made.note
    assert "\n" not in made.note
    with pytest.raises(InputError) as refused:
        compiled(function, compile="yes", cache=cache)
    assert f"{function.name()!r} cannot be compiled: " in str(refused.value)
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_without_a_compiler_functions_are_interpreted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    function = small()
    assert_interpreted(function, tmp_path / "cache", "none of cc, gcc, clang is on PATH")
    check_small(compiled(function, cache=tmp_path / "cache").function)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ("no-such-compiler -m64", "'no-such-compiler -m64', which is no program"),
        ('"cc', "No closing quotation"),
        ("{}/note.txt", "which is no program that can be run"),
        ("{}/no_interpreter", "cannot be run: No such file"),
    ],
)
def test_a_compiler_that_cannot_be_run_is_named(
    asked: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "note.txt").write_text("not executable")
    (tmp_path / "no_interpreter").write_text("#!/no/such/shell\n")
    (tmp_path / "no_interpreter").chmod(0o755)
    monkeypatch.setenv("CC", asked.format(tmp_path))
    assert_interpreted(small(), tmp_path / "cache", says)


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("echo warning: old; echo error: no licence; exit 3", "code 3: error: no licence"),
        ("echo out of memory >&2; exit 1", "failed with code 1: out of memory"),
        ("kill -9 $$", "failed with code -9"),
        ("exit 0", "wrote no library"),
        ("echo hello > code.so", "the library cannot be loaded: "),
        ("mkdir code.so", "wrote no library"),
    ],
)
def test_a_compiler_that_fails_leaves_the_interpreter(
    body: str, says: str, tmp_path: Path, install: Install
) -> None:
    install(body)
    assert_interpreted(small(), tmp_path / "cache", says)
    assert not list((tmp_path / "cache").iterdir())


@needs_compiler
@pytest.mark.parametrize(
    ("edit", "says"),
    [
        ("s/sin(/cosh(/", "gives other numbers"),
        (r"s/=(\(a[0-9]*\)<\(a[0-9]*\));/=!(\1>=\2);/", "gives other numbers"),  # for NaN alone
        ('s/return "chosen"/return "taken"/', "other inputs or outputs"),
        ("s/=sin(/=no_such_function(/", "undefined symbol"),
    ],
)
def test_a_library_with_other_numbers_is_not_used(
    edit: str, says: str, tmp_path: Path, install: Install
) -> None:
    install(f"sed -i {shlex.quote(edit)} code.c\n{COMPILE} -Wno-implicit-function-declaration")
    assert_interpreted(small(), tmp_path / "cache", says)
    assert not list((tmp_path / "cache").iterdir())


def test_a_compiler_that_hangs_is_ended_with_its_children(
    tmp_path: Path, install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "TIME_LIMIT", 0.5)
    alive = tmp_path / "alive"
    install(f"(sleep 2; touch {shlex.quote(str(alive))}; sleep 600) &\nwait")
    started = time.monotonic()
    assert_interpreted(small(), tmp_path / "cache", "had not finished after 0.5 s")
    assert time.monotonic() - started < SOON
    time.sleep(2.5)
    assert not alive.exists()


def test_what_has_no_c_code_is_interpreted(tmp_path: Path, install: Install) -> None:
    install(COMPILE)
    function = small()
    x = ca.MX.sym("x", 3)

    class Outside(ca.Callback):
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.construct("outside", {})

        def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
            return [2 * arguments[0]]

    outside = Outside()
    wrapped = ca.Function("wrapped", [x], [function(x, 0, [])[1][1] + outside(x[0])])
    made = compiled(wrapped, cache=tmp_path / "cache")
    assert made.function is wrapped
    assert not made.is_compiled
    assert float(made.function([1, 3, 0])) == pytest.approx(5.0)


def test_an_unknown_choice_is_refused_where_nobody_checks_types() -> None:
    code = "from test_compiled import *\ncompiled(small(), compile='maybe')"
    tests = Path(__file__).parent
    ran = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": f"{tests.parent}:{tests}"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "qpctrl.errors.InputError" in ran.stderr
    assert "unknown compile 'maybe'; allowed: auto, no, yes" in ran.stderr
