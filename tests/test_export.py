"""Exported controllers: C that needs nothing, and gives the torques of the controller in Python."""

import ctypes
import functools
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from cases import ROBOTS, SPACES, Given, given_mode, needs_compiler, planar_2r

from qpctrl import (
    ContactPhase,
    Controller,
    InputError,
    Limits,
    Measurement,
    Mode,
    Pfaffian,
    Robot,
    Status,
    TaskSpace,
    Weighted,
    from_pinocchio,
)
from qpctrl.constraint import Embedded
from qpctrl.contact import Footprint, FrictionCone, MaxForce
from qpctrl.export import RECORDING, Recording, project_files
from qpctrl.export.tables import OUTCOMES, solver_iwork, solver_work
from qpctrl.export.text import Identifiers, comment, string
from qpctrl.status import BY_CODE
from scenarios.cli_export import export_command
from tasks import (
    ForceReference,
    ForceTask,
    MotionReference,
    MotionTask,
    PostureReference,
    PostureTask,
)

SAME = 1e-10
"""Promised agreement of the torques, relative to the largest; measured below 1e-14."""

DT = 1e-3
SPACE = SPACES["arm_7"]
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O0", "-ffp-contract=off")
"""Without optimisation: the same numbers in a fifth of the time that it takes to compile."""

NO_REFERENCE, UNKNOWN_MODE, NOT_STARTED = len(BY_CODE), len(BY_CODE) + 1, len(BY_CODE) + 2


# A controller with all that can happen -----------------------------------------------------


def arm() -> Robot:
    """Return the 7-joint arm with limits that bind now and then."""
    free = ROBOTS["arm_7"]()
    limits = Limits(
        q_min=free.home - 0.004,
        q_max=free.home + 0.004,
        v_max=np.full(7, 0.05),
        tau_max=np.full(7, 25.0),
        tau_rate=np.full(7, 5e4),
    )
    return Robot(model=free.model, limits=limits, home=free.home)


@functools.cache
def make() -> Controller:
    """Return a controller with a free mode, and one of a point that sticks and may slip.

    Names are such as C does not take.
    """
    robot = arm()
    motion = Weighted(MotionTask(space=SPACE, K_i=50.0))
    force = Weighted(ForceTask(space=SPACE, K_fp=0.2, K_fi=5.0, damping=10.0, name="the force"))
    posture = Weighted(PostureTask(q_ref=robot.home))
    free = Mode(name="free & easy", tasks=(motion, posture))
    touching = Mode(
        name="on the board?",
        tasks=(motion, force, posture),
        constraints=(Pfaffian(space=SPACE, A=np.eye(6)[:3], name="point"),),
        contact_limits=(MaxForce(space=SPACE, limit=8.0), FrictionCone(space=SPACE, mu=0.5)),
    )
    return Controller(robot, [touching, free])


TOUCHING, FREE = "on the board?", "free & easy"


class Course(NamedTuple):
    """What one tick is given."""

    mode: str
    measurement: Measurement
    references: dict[str, Any]


@functools.cache
def course(ticks: int = 260) -> tuple[Course, ...]:
    """Return ticks in both modes: some bad, some at limits, some with changed gains."""
    return tuple(_tick(i, arm()) for i in range(ticks))


def _tick(i: int, robot: Robot) -> Course:
    t, home = i * DT, robot.pose(robot.home, "tool")
    push = np.array([np.sin(20 * t), np.cos(20 * t), 2.0, 0, 0, 0]) / 2
    far = 0.002 + 0.02 * (i % 50 > 40)
    q = robot.home + 0.0035 * np.sin(11 * t + np.arange(7.0))
    v = 0.04 * np.cos(11 * t + np.arange(7.0))
    bad: dict[int, dict[str, Any]] = {
        **{61: {"q": np.full(7, np.nan)}, 62: {"v": np.r_[np.zeros(6), np.inf]}},
        **{63: {"time": 0.001}, 64: {"time": np.nan}, 130: {"v": np.full(7, np.nan)}},
    }
    phase = ContactPhase.LOSS if 80 < i < 90 else ContactPhase.PRESS
    given: dict[str, Any] = {
        "motion": MotionReference(
            X_WD=home * pin.exp6(far * np.sin(20 * t + np.arange(6.0))),
            V_des=0.01 * np.cos(t + np.arange(6.0)),
        ),
        "the force": ForceReference(F_ref=6.0 * push, F_meas=(5.0 + np.sin(30 * t)) * push),
        "posture": PostureReference(q_ref=robot.home),
    }
    if 200 < i < 204:
        given["posture"] = PostureReference(q_ref=np.full(7, np.nan))
    if i in (110, 140):
        given["motion"] = Given(given["motion"].arrays, K_p=np.full(6, 50.0 + i))
    if i in (100, 101):
        given["limits"] = Given(q_max=robot.home + (-5.0 if i == 100 else 0.004))
    mode = FREE if 120 <= i < 150 else TOUCHING
    if mode == FREE or i % 10 == 5:
        del given["the force"]  # where it is given now and then, its last value stays
    return Course(mode, Measurement(t, q, v, phase)._replace(**bad.get(i, {})), given)


def recorded(controller: Controller) -> tuple[Recording, list[Status]]:
    """Return the recording of the course, and how its ticks ended."""
    controller.reset()
    home, outcomes = controller.robot.home, []
    recording = Recording(controller, TOUCHING, home)
    memory = controller.start(TOUCHING, home)
    for mode, measurement, references in course():
        command, report, memory = controller.step(mode, measurement, references, memory)
        recording.add(mode, measurement, command)
        outcomes.append(report.status)
    return recording, outcomes


# Building ----------------------------------------------------------------------------------


@functools.cache
def scratch() -> Path:
    """Return a folder that goes with this process."""
    folder = tempfile.TemporaryDirectory(prefix="qpctrl-test-")
    scratch.kept = folder  # type: ignore[attr-defined]
    return Path(folder.name)


def call(*command: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    words = [str(word) for word in command]
    return subprocess.run(words, cwd=cwd, capture_output=True, text=True, check=False)


def built(*command: object, cwd: Path) -> None:
    """Run a command that must succeed without a word."""
    done = call(*command, cwd=cwd)
    assert (done.returncode, done.stdout + done.stderr) == (0, ""), done.stderr[:2000]


def write(controller: Controller, name: str) -> Path:
    """Return a new folder with an exported controller."""
    folder = scratch() / name
    folder.mkdir()
    for file, text in project_files(controller, name).items():
        (folder / file).write_text(text, encoding="utf-8")
    return folder


@functools.cache
def written() -> Path:
    """Return a folder with the controller of the course and its recording."""
    folder = write(make(), "wipe")
    recording, outcomes = recorded(make())
    assert set(outcomes) == {Status.OK, Status.NOT_FINITE, Status.STALE, Status.INFEASIBLE}
    (folder / RECORDING).write_bytes(recording.data())
    return folder


@functools.cache
def compiled(folder: Path) -> list[Path]:
    """Return the object files of a controller."""
    sources = sorted(file.name for file in folder.glob("*.c") if file.name != "replay.c")
    built("cc", *STRICT, "-fPIC", "-c", *sources, cwd=folder)
    return [folder / f"{Path(source).stem}.o" for source in sources]


def replayed(folder: Path, recording: Path | None = None) -> tuple[int, dict[str, float]]:
    """Return the exit code of the replay and the numbers that it prints."""
    program = folder / "replay"
    if not program.exists():
        built("cc", *STRICT, "replay.c", *compiled(folder), "-lm", "-o", "replay", cwd=folder)
    done = call(program, recording or folder / RECORDING)
    numbers = dict(pair.split("=") for pair in done.stdout.partition("\n")[0].split())
    return done.returncode, {name: float(value) for name, value in numbers.items()}


EXPORTED = {
    "eraser": ("--duration", "0.2"),  # two modes, MuJoCo
    "virtual_wall": (),  # impedance
    "stiff_wall": ("--form", "full"),  # admittance
}


@functools.cache
def exported() -> Path:
    """Return a folder of what ``qpctrl export`` leaves in a process without checks at each call."""
    flags = ["--no-build", "--compiled", "no", "--out"]
    calls = [[name, *own, *flags, str(scratch() / name)] for name, own in EXPORTED.items()]
    code = (
        "import json, sys; from scenarios.cli_export import export_command; "
        "sys.exit(not all([export_command(call) for call in json.loads(sys.argv[1])]))"
    )
    done = call(sys.executable, "-c", code, json.dumps(calls))
    assert done.returncode == 0, done.stderr
    return scratch()


# Replays -----------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("scenario", EXPORTED)
def test_an_exported_scenario_replays_its_run(scenario: str) -> None:
    code, found = replayed(exported() / scenario)
    assert found["gap"] <= SAME
    assert (code, found["other_outcomes"]) == (0, 0)
    assert found["ticks"] > 900
    assert found["tick_us_median"] > 0


@needs_compiler
def test_mode_switches_bad_ticks_and_limits_are_replayed() -> None:
    code, found = replayed(written())
    assert found["gap"] <= SAME
    assert (code, found["other_outcomes"], found["ticks"]) == (0, 0, len(course()))
    assert found["fallback_ticks"] >= 9  # bad measurements, references, limits


def standing() -> Controller:
    """Return a controller of a body that floats, stands on its one foot and swings two arms."""
    model = pin.Model()
    model.name = "stander"
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    inertia = pin.Inertia(8.0, np.array([0.01, 0.02, 0.3]), np.diag([0.2, 0.2, 0.1]))
    model.appendBodyToJoint(base, inertia, pin.SE3.Identity())
    for name, side in (("left", 0.2), ("right", -0.2)):
        shoulder = pin.SE3(np.eye(3), np.array([0.0, side, 0.6]))
        arm = model.addJoint(base, pin.JointModelRY(), shoulder, name)
        inertia = pin.Inertia(1.5, np.array([0.2, 0.0, 0.0]), np.diag([0.01, 0.02, 0.02]))
        model.appendBodyToJoint(arm, inertia, pin.SE3.Identity())
    down = pin.SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    model.addFrame(pin.Frame("sole", base, 0, down, pin.FrameType.OP_FRAME))
    robot = from_pinocchio(model)
    sole = TaskSpace("sole")
    stand = Mode(
        name="stand",
        tasks=(Weighted(PostureTask(q_ref=robot.home)), Weighted(ForceTask(space=sole), 0.1)),
        constraints=(Embedded(space=sole, X_WE=robot.pose(robot.home, "sole"), name="foot"),),
        contact_limits=(Footprint(space=sole, half=(0.15, 0.1)),),
        metric="home",
    )
    return Controller(robot, [stand])


@needs_compiler
def test_a_robot_that_floats_is_replayed_too() -> None:
    controller = standing()
    robot = controller.robot
    assert (robot.nq, robot.nv, robot.nu) == (9, 8, 2)
    recording = Recording(controller, "stand", robot.home)
    memory, torques = controller.start("stand", robot.home), []
    for i in range(60):
        way = 0.02 * np.sin(0.1 * i + np.arange(robot.nv))
        q = robot.integrate(robot.home, np.concatenate((np.zeros(6), way[6:])))
        measurement = Measurement((i + 1) * DT, q, np.concatenate((np.zeros(6), 50 * way[6:])))
        q_ref = robot.home + np.concatenate((np.zeros(7), [0.5 * (i > 20), 0.3]))
        references = {"posture": PostureReference(q_ref=q_ref)}
        command, report, memory = controller.step("stand", measurement, references, memory)
        recording.add("stand", measurement, command)
        torques.append(command.tau)
        assert report.status is Status.OK
    folder = write(controller, "stander")
    (folder / RECORDING).write_bytes(recording.data())
    code, found = replayed(folder)
    assert (code, found["ticks"], found["fallback_ticks"]) == (0, 60, 0)
    assert np.ptp(torques, axis=0).min() > 1.0


@needs_compiler
def test_a_replay_sees_a_gain_a_measurement_and_a_torque_that_were_changed(tmp_path: Path) -> None:
    folder, numbers = written(), np.fromfile(written() / RECORDING)
    layout = make().engines[TOUCHING].tick.inputs
    first = 8 + layout.size + 7 + 7  # of the first tick: after head, inputs, configuration, torque
    gain = first + 4 + 7 + 7 + 7 + 3 + layout.place("motion.K_p").start + 3
    assert numbers[gain] == MotionTask(space=SPACE).K_p[3]  # around x, which is not constrained
    for changed in (gain, first + 4, first + 4 + 7 + 7):
        other = numbers.copy()
        other[changed] *= 1 + 1e-4
        other.tofile(tmp_path / "other.bin")
        code, found = replayed(folder, tmp_path / "other.bin")
        assert (code, found["gap"] > SAME) == (1, True)


@needs_compiler
@pytest.mark.parametrize(
    "spoil",
    [
        lambda numbers: numbers[:0],
        lambda numbers: numbers[:-1],
        lambda numbers: numbers[:500],
        lambda numbers: np.r_[numbers, 7.0],
        lambda numbers: np.r_[numbers, np.nan],
        lambda numbers: numbers.byteswap(),
        lambda numbers: np.r_[numbers[:2], 8.0, numbers[3:]],
        lambda numbers: np.full(1000, 1e300),
    ],
)
def test_a_recording_that_cannot_be_read_is_refused_in_one_line(spoil: Any, tmp_path: Path) -> None:
    folder = written()
    replayed(folder)
    spoil(np.fromfile(folder / RECORDING)).tofile(tmp_path / "other.bin")
    for recording in (tmp_path / "other.bin", tmp_path / "none.bin"):
        done = call(folder / "replay", recording)
        assert done.returncode == 2
        assert done.stderr.startswith("replay: ")
        assert done.stderr.count("\n") == 1


# The public calls --------------------------------------------------------------------------


class CReport(ctypes.Structure):
    """``NAME_report``."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ("mode", "outcome")),
        *((name, ctypes.POINTER(ctypes.c_double)) for name in ("tau_qp", "hybrid", "textbook")),
        ("rows", ctypes.c_int),
        ("row_names", ctypes.POINTER(ctypes.c_char_p)),
        *((name, ctypes.POINTER(ctypes.c_double)) for name in ("lam", "kkt", "gaps")),
        ("damping", ctypes.c_double),
        ("dependent_row", ctypes.c_char_p),
    )


class CActive(ctypes.Structure):
    """``NAME_active_limit``."""

    _fields_ = (("kind", ctypes.c_char_p), ("owner", ctypes.c_char_p), ("dual", ctypes.c_double))


@functools.cache
def library(folder: Path) -> ctypes.CDLL:
    """Return a controller as a shared library that also says how large its struct is."""
    apart = folder / "shared"
    apart.mkdir()
    text = f'#include "../{folder.name}.h"\nunsigned long size(void)\n'
    (apart / "size.c").write_text(f"{text}{{ return sizeof({folder.name}_controller); }}\n")
    flags = ("-shared", "-fPIC", "-lm", "-o", "all.so")
    built("cc", "size.c", *compiled(folder), *flags, cwd=apart)
    return ctypes.CDLL(str(apart / "all.so"))


class InC:
    """An exported controller as a library, on memory of this process."""

    def __init__(self, controller: Controller, folder: Path) -> None:
        self.library, self._name = library(folder), folder.name
        self.size = self.library.size()
        self.memory = ctypes.create_string_buffer(self.size)
        self.numbers = {mode: i for i, mode in enumerate(controller.engines)}
        self._nu = controller.robot.nu
        self._of("inputs").restype = ctypes.POINTER(ctypes.c_double)
        self._of("tell").restype = CReport
        self._of("outcome_text").restype = ctypes.c_char_p
        self._of("init")(self.memory)

    def _of(self, function: str) -> Any:
        return getattr(self.library, f"{self._name}_{function}")

    def start(self, mode: str, q: np.ndarray) -> int:
        """Hold still."""
        return self._of("start")(self.memory, self.numbers.get(mode, 99), _pointer(q))

    def inputs(self, mode: str) -> np.ndarray:
        """Return the inputs of a mode, to be written."""
        count = self._of("input_count")(self.numbers[mode])
        pointer = self._of("inputs")(self.memory, self.numbers[mode])
        return np.ctypeslib.as_array(pointer, (count,))

    def step(self, mode: str, measurement: Measurement) -> tuple[int, np.ndarray]:
        """Return outcome and torque."""
        time, q, v, contact = measurement
        tau, number = np.full(self._nu, np.nan), self.numbers.get(mode, 99)
        given = number, ctypes.c_double(time), int(contact.closed)
        code = self._of("step")(self.memory, *given, *map(_pointer, (q, v, tau)))
        return code, tau

    def tell(self) -> CReport:
        """Return the report of the last step."""
        return self._of("tell")(self.memory)

    def active(self, most: int = 50) -> list[tuple[str, float]]:
        """Return names and duals of the limits that bind."""
        found = (CActive * max(most, 1))()
        count = self._of("active")(self.memory, found, most)
        shown = found[: min(count, most)]
        assert count <= 50
        return [(f"{a.kind.decode()} {a.owner.decode()}", a.dual) for a in shown]

    def say(self, outcome: int) -> str:
        """Return an outcome in words."""
        return self._of("outcome_text")(outcome).decode()

    def copy(self) -> None:
        """Go on in a copy, and spoil what it was copied from."""
        other = ctypes.create_string_buffer(self.memory.raw, self.size)
        ctypes.memset(self.memory, 0xFF, self.size)
        self.kept, self.memory = self.memory, other


def _pointer(values: np.ndarray) -> Any:
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def in_c() -> InC:
    """Return the controller of the course in C, at its start."""
    made = InC(make(), written())
    assert made.start(TOUCHING, make().robot.home) == 0
    return made


def write_inputs(made: InC, mode: str, references: dict[str, Any]) -> None:
    """Write references as a user would: at the places of the header."""
    layout, u = make().engines[mode].tick.inputs, made.inputs(mode)
    for task, reference in references.items():
        for key, value in reference.arrays.items():
            u[layout.place(f"{task}.{key}")] = np.ravel(value, order="F")
    if "motion" in references:  # a reference in Python sets all of them
        assert np.isfinite(u[layout.place("motion.V_dot_des")]).all()


@needs_compiler
def test_every_step_tells_what_the_report_in_python_tells() -> None:
    made, controller = in_c(), make()
    controller.reset()
    memory, seen = controller.start(TOUCHING, controller.robot.home), set()
    for i, (mode, measurement, references) in enumerate(course()):
        write_inputs(made, mode, references)
        if i % 50 == 7:
            made.copy()
        code, tau = made.step(mode, measurement)
        command, report, memory = controller.step(mode, measurement, references, memory)
        found = made.tell()
        assert tau == pytest.approx(command.tau, rel=SAME, abs=SAME * 25)
        assert (found.mode, found.outcome) == (made.numbers[mode], code)
        assert BY_CODE[code] is report.status
        assert (code == 1) == report.limited
        assert made.say(code) == report.status.value
        names = [found.row_names[j].decode() for j in range(found.rows)]
        assert names == list(controller.engines[mode].tick.rows.constraint)
        k = found.rows
        pairs = (
            *((found.lam[:k], report.lam), (found.tau_qp[:7], report.tau_qp)),
            *((found.hybrid[:7], report.tau_hybrid), (found.textbook[:7], report.tau_textbook)),
        )
        for ours, theirs in pairs:
            assert ours == pytest.approx(theirs, rel=SAME, abs=25 * SAME, nan_ok=True)
        assert (max(found.kkt[:4]) <= 1e-9) == (report.status is Status.OK)
        gaps = [report.law_gap, report.textbook_gap, report.unexplained_gap, report.curvature]
        assert found.gaps[:4] == pytest.approx(gaps, abs=SAME, nan_ok=True)
        active = made.active()
        if k and not np.abs(report.lam).max() > 1e-6:
            continue  # at the tip of the friction cone it is open which of its rows bind
        assert [name for name, _ in active] == [limit.name for limit in report.active]
        duals = [limit.dual for limit in report.active]
        assert [dual for _, dual in active] == pytest.approx(duals, rel=1e-6, abs=1e-8)
        assert made.active(1) == active[:1]
        seen |= {name.partition(" ")[0] for name, _ in active}
    assert seen >= {"torque", "velocity", "position", "contact"}
    assert memory.fallback_ticks >= 9


@needs_compiler
def test_a_row_that_depends_on_others_is_named() -> None:
    made, controller = in_c(), make()
    controller.reset()
    memory = controller.start(TOUCHING, controller.robot.home)
    mode, measurement, references = course()[0]
    rows = {"point": Given(A=np.eye(6)[[0, 1, 0]])}
    write_inputs(made, mode, {**references, **rows})
    code, tau = made.step(mode, measurement)
    command, report, _ = controller.step(mode, measurement, {**references, **rows}, memory)
    assert BY_CODE[code] is report.status is Status.DEPENDENT_ROWS
    assert (made.tell().dependent_row.decode(),) == report.dependent_rows
    assert tau == pytest.approx(command.tau, rel=SAME, abs=SAME)
    controller.reset()


@needs_compiler
def test_a_mode_is_not_entered_without_references_and_the_arm_is_held_meanwhile() -> None:
    made, robot = in_c(), make().robot
    good = {i: course()[i] for i in (0, 1, 2, 3, 4, 150)}

    def step(i: int, mode: str, *, given: bool) -> tuple[int, np.ndarray]:
        if given:
            write_inputs(made, mode, good[i].references)
        return made.step(mode, good[i].measurement)

    gravity = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.home)
    code, tau = step(0, TOUCHING, given=False)
    assert made.say(code) == OUTCOMES[NO_REFERENCE]
    assert code == NO_REFERENCE
    assert tau == pytest.approx(np.clip(gravity, -25, 25), abs=2.0)  # it brakes a little
    assert step(1, TOUCHING, given=True)[0] < 2
    assert step(2, TOUCHING, given=False)[0] < 2  # later the last one stays
    assert step(3, FREE, given=False)[0] == NO_REFERENCE
    assert made.tell().mode == made.numbers[TOUCHING]
    assert step(4, TOUCHING, given=False)[0] < 2  # it was not left
    assert step(150, FREE, given=False)[0] == NO_REFERENCE


@needs_compiler
def test_references_are_forgotten_when_a_mode_is_left_and_at_the_start() -> None:
    made = in_c()
    for i, mode in ((0, TOUCHING), (1, FREE)):
        write_inputs(made, mode, {"motion": course()[i].references["motion"]})
        assert made.step(mode, course()[i].measurement)[0] < 2
    assert made.step(TOUCHING, course()[2].measurement)[0] == NO_REFERENCE
    place = make().engines[TOUCHING].tick.inputs.place
    assert np.isnan(made.inputs(TOUCHING)[place("motion.X_WD")]).all()
    assert np.isfinite(made.inputs(TOUCHING)[place("motion.K_p")]).all()
    write_inputs(made, TOUCHING, {"motion": course()[2].references["motion"]})
    assert made.start(TOUCHING, make().robot.home) == 0
    assert made.step(TOUCHING, course()[3].measurement)[0] == NO_REFERENCE


@needs_compiler
def test_calls_that_are_wrong_are_answered_and_change_nothing() -> None:
    controller, home = make(), make().robot.home
    made = InC(controller, written())
    code, tau = made.step(TOUCHING, course()[0].measurement)
    assert (code, tau.tolist()) == (NOT_STARTED, [0.0] * 7)
    assert made.start("none", home) == UNKNOWN_MODE
    assert made.start(TOUCHING, np.full(7, np.nan)) == BY_CODE.index(Status.NOT_FINITE)
    assert made.step(TOUCHING, course()[0].measurement)[0] == NOT_STARTED
    assert made.start(TOUCHING, home) == 0
    write_inputs(made, TOUCHING, course()[0].references)
    assert made.step("none", course()[0].measurement)[0] == UNKNOWN_MODE
    assert made.step(TOUCHING, course()[1].measurement)[0] < 2
    for outcome in (*range(len(OUTCOMES)), -1, 99):
        assert made.say(outcome)


# The files as C ----------------------------------------------------------------------------


@functools.cache
def small() -> Controller:
    """Return a controller of two joints, of which one is driven, with names to stumble over."""
    model = planar_2r().model.copy()
    model.names[1], model.names[2] = 'shoul"der\\\n', "*/ é ??/ /*"
    robot = from_pinocchio(model, home=np.array([0.4, 0.9]), B=np.array([[1.0], [0.5]]))
    space = SPACES["planar_2r"]
    names = ("Tick", "tick", "int", "qp", "1 */ ü")
    modes = [given_mode(robot, space, i % 2, name=name) for i, name in enumerate(names)]
    return Controller(robot, modes, form="full", law="hybrid")


@functools.cache
def other() -> Path:
    """Return a folder with another exported controller, whose recording ends stretched out."""
    folder, controller = write(small(), "wipe_other"), small()
    home, mode = controller.robot.home, "tick"
    recording, memory = Recording(controller, mode, home), controller.start(mode, home)
    for i in range(40):
        mode = [*controller.engines][i // 3 % 5 if i < 30 else i % 2 * 2]
        given = {
            "motion": Given(a_cmd=np.array([np.sin(i), 1.0])),
            "force": Given(F_cmd=np.ones(2)),
        }
        q = home + 1e-3 * i if i < 30 else np.array([0.4, 1e-5 * i])
        measurement = Measurement(i * DT, q, np.cos([i, 2.0 * i]))
        command, report, memory = controller.step(mode, measurement, given, memory)
        assert report.status is Status.OK
        assert (report.damping > 0) == (i >= 30)
        recording.add(mode, measurement, command)
    (folder / RECORDING).write_bytes(recording.data())
    return folder


@needs_compiler
def test_an_underactuated_robot_with_names_that_are_no_identifiers_is_replayed() -> None:
    code, found = replayed(other())
    assert (code, found["ticks"], found["fallback_ticks"]) == (0, 40, 0)
    assert found["gap"] <= SAME
    header = (other() / "wipe_other_modes.h").read_text(encoding="utf-8")
    for word in (
        "MODE_TICK",
        "MODE_TICK_2",
        "MODE_INT",
        "MODE_QP",
        "MODE_N1",
        "TICK_2_MOTION_A_CMD",
    ):
        assert f"WIPE_OTHER_{word} =" in header


TWO_IN_C = """
#include "wipe.h"
#include "wipe_other.h"
#include <stdio.h>
int main(void)
{
    static wipe_controller a;
    static wipe_other_controller b;
    const double q[WIPE_NQ] = {0}, home[WIPE_OTHER_NQ] = {0.4, 0.9};
    double tau[WIPE_NU], tau_other[WIPE_OTHER_NU];
    wipe_init(&a);
    wipe_other_init(&b);
    wipe_start(&a, WIPE_MODE_FREE_EASY, q);
    wipe_other_start(&b, WIPE_OTHER_MODE_TICK, home);
    printf("%d ", wipe_step(&a, WIPE_MODE_FREE_EASY, 0.0, 0, q, q, tau) == WIPE_NO_REFERENCE);
    const int outcome = wipe_other_step(&b, WIPE_OTHER_MODE_TICK, 0.0, 1, home, q, tau_other);
    printf("%d\\n", outcome <= WIPE_OTHER_LIMITED);
    return wipe_inputs(&a, WIPE_MODE_ON_THE_BOARD)[WIPE_ON_THE_BOARD_DT] != 1e-3;
}
"""


@needs_compiler
@pytest.mark.parametrize("language", ["c", "c++"])
def test_two_controllers_go_into_one_program_in_c_and_in_cpp(language: str, tmp_path: Path) -> None:
    if language == "c++" and shutil.which("g++") is None:
        pytest.skip("needs a C++ compiler")
    (tmp_path / "main.c").write_text(TWO_IN_C, encoding="utf-8")
    include = [f"-I{written()}", f"-I{other()}"]
    strict = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")
    compiler = ("g++", "-x", "c++", "-std=c++11") if language == "c++" else ("cc", "-std=c99")
    built(*compiler, *strict, *include, "-c", "main.c", "-o", "main.o", cwd=tmp_path)
    objects = [*compiled(written()), *compiled(other())]
    built(compiler[0], "main.o", *objects, "-lm", "-o", "both", cwd=tmp_path)
    done = call(tmp_path / "both")
    assert (done.returncode, done.stdout) == (0, "1 1\n")


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs a C++ compiler")
def test_the_loop_in_the_readme_is_cpp_that_compiles(tmp_path: Path) -> None:
    for name, text in project_files(make(), "wipe").items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    loop = (tmp_path / "README.md").read_text(encoding="utf-8").split("```cpp")[1].split("```")[0]
    given = re.findall(r"copy_n\((\w+), (\d+)", loop)
    assert ("motion_X_WD", "12") in given
    declared = "".join(f"extern const double {name}[{size}];\n" for name, size in given)
    (tmp_path / "loop.cpp").write_text(declared + loop, encoding="utf-8")
    strict = ("-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only")
    built("g++", *strict, "loop.cpp", cwd=tmp_path)


MATHEMATICS = {"sin", "cos", "sincos", "tan", "atan2", "asin", "acos", "sqrt", "exp", "log", "pow"}


@needs_compiler
@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm")
def test_objects_allocate_nothing_hold_no_state_and_name_nothing_without_their_prefix() -> None:
    defined: list[str] = []
    needed: set[str] = set()
    for file in compiled(written()):
        for line in call("nm", "-P", file).stdout.splitlines():
            name, kind = line.split()[:2]
            if kind == "U":
                needed.add(name)
            elif kind.isupper():
                defined.append(name)
        sections = call("size", "-A", file).stdout.splitlines()
        sized = {line.split()[0]: int(line.split()[1]) for line in sections if line.startswith(".")}
        assert sized[".data"] == sized[".bss"] == 0
    assert len(defined) > 50
    assert all(name.startswith("wipe_") for name in defined)
    outside = needed - set(defined) - {"_GLOBAL_OFFSET_TABLE_"}
    assert outside <= MATHEMATICS | {"memcpy", "memset", "fmax", "fmin", "fabs"}


@needs_compiler
def test_the_solver_has_the_room_that_it_asks_for() -> None:
    made = in_c()
    for n in range(0, 40, 3):
        for m in range(0, n + 1, 4):
            for r in (0, 1, 7, 33):
                asked = made.library.wipe_qp_work(n, m, r)
                assert asked <= solver_work(n, m, r) - 3  # to align it to four doubles
                assert made.library.wipe_qp_iwork(n, m, r) <= solver_iwork(n, m, r)


@needs_compiler
@pytest.mark.skipif(shutil.which("cmake") is None, reason="needs CMake")
def test_cmake_builds_tests_and_installs_it(tmp_path: Path) -> None:
    build, installed = tmp_path / "build", tmp_path / "installed"
    steps: Sequence[tuple[object, ...]] = (
        ("cmake", "-S", other(), "-B", build, "-DCMAKE_BUILD_TYPE=Debug"),
        ("cmake", "--build", build),
        ("ctest", "--test-dir", build, "--no-tests=error"),
        ("cmake", "--install", build, "--prefix", installed),
    )
    for step in steps:
        done = call(*step)
        assert done.returncode == 0, done.stdout + done.stderr
    (tmp_path / "main.cpp").write_text(
        '#include "wipe_other.h"\nstatic wipe_other_controller c;\n'
        "int main() { wipe_other_init(&c); return c.mode != -1; }\n"
    )
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.15)\nproject(loop CXX)\n"
        "find_package(wipe_other REQUIRED)\nadd_executable(loop main.cpp)\n"
        "target_link_libraries(loop PRIVATE wipe_other::controller)\n"
    )
    loop = tmp_path / "loop"
    for step in (
        ("cmake", "-S", tmp_path, "-B", loop, f"-DCMAKE_PREFIX_PATH={installed}"),
        ("cmake", "--build", loop),
        (loop / "loop",),
    ):
        done = call(*step)
        assert done.returncode == 0, done.stdout + done.stderr


# Names and numbers -------------------------------------------------------------------------


def test_identifiers_are_such_and_differ() -> None:
    names = ("Free", "free", "free!", "2 free", "é", "", "a--b__c")
    made = Identifiers({"free_3"})
    words = [made.add(name) for name in names]
    assert words == ["Free", "free_2", "free_4", "n2_free", "n", "n_2", "a_b_c"]
    assert all(word.isidentifier() and word.isascii() for word in words)


def test_texts_cannot_leave_their_string_or_comment() -> None:
    assert string('a"\\\n?é') == r'"a\042\134\012\077\303\251"'
    assert comment("a */ b\n/* c") == "/* a * / b / * c */"


def test_the_header_says_what_every_input_is() -> None:
    header = project_files(make(), "wipe")["wipe_modes.h"]
    inputs = [line for line in header.splitlines() if ") */" not in line and "/* " in line]
    lines = [line for line in inputs if line.startswith("    WIPE_")]
    layouts = [engine.tick.inputs for engine in make().engines.values()]
    assert len(lines) == sum(len(layout.names) - 3 for layout in layouts)
    place = layouts[0].place("motion.X_WD").start
    assert f"WIPE_ON_THE_BOARD_MOTION_X_WD = {place}, /* ! (3x4) desired pose in W" in header
    assert not [line for line in lines if line.endswith(") */")]


def test_exports_of_one_controller_are_the_same_bytes() -> None:
    first, second = (project_files(small(), "twice") for _ in range(2))
    assert first == second


@pytest.mark.parametrize("name", ["", "1st", "a b", "math", "Replay", "../up", "é", "a" * 42])
def test_a_name_that_cannot_stand_in_c_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="name: "):
        project_files(small(), name)


# The command -------------------------------------------------------------------------------


@needs_compiler
def test_the_command_builds_and_runs_the_replay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "folder"
    flags = ["--duration", "0.05", "--compiled", "no", "--out", str(out)]
    assert export_command(["force_loop", *flags, "--name", "mine", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["replay"]["passed"]
    assert found["replay"]["gap"] <= SAME
    assert found["ticks"] == found["replay"]["ticks"] == 50
    assert found["modes"] == ["pressing"]
    assert sorted(file.name for file in out.iterdir()) == found["files"]
    assert {"mine.h", "mine.c", "CMakeLists.txt", "README.md", RECORDING} <= set(found["files"])
    (out / "notes.txt").write_text("a user's own", encoding="utf-8")
    assert export_command(["force_loop", *flags, "--name", "mine"])  # in the place of the first
    assert "PASSED" in capsys.readouterr().out
    assert (out / "notes.txt").read_text(encoding="utf-8") == "a user's own"


def test_without_a_compiler_the_files_are_written_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    flags = ["--duration", "0.02", "--compiled", "no", "--out", str(tmp_path)]
    assert export_command(["force_loop", *flags])
    assert "replay: not built, no C compiler" in capsys.readouterr().out
    assert (tmp_path / RECORDING).is_file()


@needs_compiler
def test_a_compiler_that_fails_is_no_success(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "broken"
    broken.write_text('#!/bin/sh\n[ "$1" = --version ] && exit 0\necho error: no >&2; exit 1\n')
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    out = tmp_path / "out"
    flags = ["--duration", "0.02", "--compiled", "no", "--out", str(out)]
    assert not export_command(["force_loop", *flags])
    assert "FAILED: error: no" in capsys.readouterr().out
    assert (out / RECORDING).is_file()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "missing SCENARIO"),
        (["erasr"], "did you mean 'eraser'"),
        (["force_loop", "--solver", "proxsuite"], "has its own, 'active-set'"),
        (["force_loop", "--name", "no name"], "name: got 'no name'"),
        (["force_loop", "--durration", "1"], "did you mean '--duration'"),
        (["force_loop", "--out", "/proc/none"], "output folder '/proc/none'"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments: list[str], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        export_command(arguments)
    assert "\n" not in str(caught.value)


def test_a_folder_in_the_place_of_a_file_is_refused_before_the_run(tmp_path: Path) -> None:
    (tmp_path / "replay.c").mkdir()
    with pytest.raises(InputError, match=r"replay\.c is a folder there"):
        export_command(["force_loop", "--out", str(tmp_path), "--compiled", "no"])
    assert [file.name for file in tmp_path.iterdir()] == ["replay.c"]
