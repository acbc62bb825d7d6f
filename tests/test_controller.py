"""The tick as a loop sees it: bad numbers, limits that cannot hold, modes, memory."""

import functools
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from cases import (
    LAW_AGREEMENT,
    SOLVERS,
    SPACES,
    Given,
    board,
    chain,
    given_mode,
    needs_compiler,
    planar_2r,
)

from qpctrl import (
    Command,
    ContactPhase,
    Controller,
    InputError,
    Limits,
    Measurement,
    Memory,
    Mode,
    Pfaffian,
    Robot,
    Status,
    TaskSpace,
    TickReport,
    Weighted,
)
from qpctrl.compiled import CompileMode
from qpctrl.limit import UNBOUNDED
from qpctrl.solver import QpData, Solution, make_solver
from tasks import (
    ForceReference,
    ForceTask,
    MotionReference,
    MotionTask,
    PostureReference,
    PostureTask,
)

INSIDE = 1e-9
"""Nm: round-off of a torque of 100 Nm that is clipped to its limit."""

DT = 1e-3
TAU_MAX, TAU_RATE = 60.0, 5000.0
SPACE = SPACES["arm_7"]


@functools.cache
def arm() -> Robot:
    """Return the 7-joint arm with limits of torque and torque rate."""
    free = chain(7, seed=7)
    limits = Limits(
        q_min=free.limits.q_min,
        q_max=free.limits.q_max,
        v_max=free.limits.v_max,
        tau_max=np.full(7, TAU_MAX),
        tau_rate=np.full(7, TAU_RATE),
    )
    return Robot(model=free.model, limits=limits, home=free.home)


def tasks(robot: Robot) -> tuple[Weighted, ...]:
    """Return motion, force with both integrals, and posture."""
    motion = MotionTask(space=SPACE, K_i=50.0)
    force = ForceTask(space=SPACE, K_fp=0.2, K_fi=5.0, damping=10.0)
    return (Weighted(motion), Weighted(force), Weighted(PostureTask(q_ref=robot.home)))


def make_controller(**options: Any) -> Controller:
    """Return a controller with the modes ``free`` and ``contact``."""
    robot = arm()
    free = Mode(name="free", tasks=tuple(t for t in tasks(robot) if t.task.name != "force"))
    contact = Mode(name="contact", tasks=tasks(robot), constraints=(board(SPACE),))
    return Controller(robot, [contact, free], **options)


class Step(NamedTuple):
    """What one tick was given and gave."""

    command: Command
    report: TickReport
    memory: Memory


def references(t: float) -> dict[str, Any]:
    """Return references that move, push and measure."""
    home = arm().pose(arm().home, "tool")
    push = np.r_[home.rotation.T @ board(SPACE).R_WE[:, 2], np.zeros(3)]
    X_WD = home * pin.exp6(0.01 * np.sin(t + np.arange(6.0)))
    return {
        "motion": MotionReference(X_WD=X_WD, V_des=0.01 * np.cos(t + np.arange(6.0))),
        "force": ForceReference(
            F_ref=20.0 * push, F_meas=15.0 * push + np.array([0.3, 0, 0, 0, 0.1, 0])
        ),
        "posture": PostureReference(q_ref=arm().home),
    }


def measured(i: int, **changes: Any) -> Measurement:
    """Return the measurement of tick ``i``: near home, moving slowly."""
    t = i * DT
    q = arm().home + 0.002 * np.sin(t + np.arange(7.0))
    return Measurement(t, q, 0.02 * np.cos(t + np.arange(7.0)))._replace(**changes)


def run(
    controller: Controller, ticks: int, memory: Memory | None = None, start: int = 0
) -> list[Step]:
    """Run good ticks in contact."""
    memory = memory or controller.start("contact", arm().home)
    steps = []
    for i in range(start, start + ticks):
        steps.append(Step(*controller.step("contact", measured(i), references(i * DT), memory)))
        memory = steps[-1].memory
    return steps


NAN7 = np.full(7, np.nan)
UNSOLVED = (Status.INFEASIBLE, Status.INACCURATE)
"""Proxsuite gives up on some infeasible ticks without a proof."""

BAD: dict[str, tuple[Measurement, dict[str, Any], tuple[Status, ...]]] = {
    "NaN position": (measured(50, q=NAN7), references(0.05), (Status.NOT_FINITE,)),
    "NaN velocity": (measured(50, v=NAN7), references(0.05), (Status.NOT_FINITE,)),
    "inf velocity": (measured(50, v=np.full(7, np.inf)), references(0.05), (Status.NOT_FINITE,)),
    "opposite infs": (
        measured(50, v=np.r_[np.inf, -np.inf, np.zeros(5)]),
        references(0.05),
        (Status.NOT_FINITE,),
    ),
    "NaN time": (measured(50, time=np.nan), references(0.05), (Status.NOT_FINITE,)),
    "stale time": (measured(50, time=29 * DT), references(0.05), (Status.STALE,)),
    "older time": (measured(50, time=0.0), references(0.05), (Status.STALE,)),
    "NaN set-point": (
        measured(50),
        {**references(0.05), "posture": PostureReference(q_ref=NAN7)},
        (Status.NOT_FINITE,),
    ),
    "NaN force": (
        measured(50),
        {"force": ForceReference(F_ref=np.zeros(6), F_meas=np.full(6, np.nan))},
        (Status.NOT_FINITE,),
    ),
    "inf gain": (
        measured(50),
        {**references(0.05), "motion": Given(K_p=np.full(6, np.inf))},
        (Status.NOT_FINITE,),
    ),
    "limits without room": (
        measured(50),
        {**references(0.05), "limits": Given(v_max=np.full(7, 1e-3), tau_max=np.full(7, 0.01))},
        UNSOLVED,
    ),
}


@pytest.mark.parametrize(
    ("solver", "compile"),
    [
        *((s, "no") for s in SOLVERS if s in ("active-set", "proxsuite", "daqp", "piqp")),
        pytest.param("active-set", "yes", marks=needs_compiler),
    ],
)
@pytest.mark.parametrize("what", BAD)
def test_a_bad_tick_sends_a_finite_torque_inside_limits_and_rate_and_is_counted(
    what: str, solver: str, compile: CompileMode
) -> None:
    measurement, given, statuses = BAD[what]
    controller = make_controller(solver=solver, compile=compile)
    before = run(controller, 30)[-1]
    assert before.report.status is Status.OK
    step = Step(*controller.step("contact", measurement, given, before.memory))
    status = step.report.status
    assert status in statuses
    assert step.command.fallback
    assert np.isfinite(step.command.tau).all()
    tau_max = controller.engines["contact"].inputs["limits.tau_max"]  # as given at this tick
    last = np.clip(before.command.tau, -tau_max, tau_max)
    assert (np.abs(step.command.tau) <= tau_max + INSIDE).all()
    assert (np.abs(step.command.tau - last) <= TAU_RATE * DT + INSIDE).all()
    assert step.memory.fallback_ticks == 1
    assert step.report.explain().startswith(f"fallback torque: {status.value}")
    assert np.array_equal(step.memory.x, before.memory.x)
    assert np.array_equal(step.memory.tau, step.command.tau)
    assert step.memory.freeze


@pytest.mark.parametrize("what", [w for w in BAD if w not in ("inf gain", "limits without room")])
def test_the_tick_after_a_bad_one_is_good_again_with_integrators_frozen(what: str) -> None:
    measurement, given, _ = BAD[what]
    controller = make_controller()
    before = run(controller, 30)[-1]
    bad = Step(*controller.step("contact", measurement, given, before.memory))
    good = run(controller, 20, bad.memory, start=60)
    assert [step.report.status for step in good] == [Status.OK] * 20
    assert good[-1].memory.fallback_ticks == 1
    held, frozen, moving = (
        integrals(controller, step.memory) for step in (before, good[0], good[-1])
    )
    assert np.array_equal(held, frozen)
    assert not good[-1].memory.freeze
    assert not np.array_equal(frozen, moving)


def integrals(controller: Controller, memory: Memory) -> np.ndarray:
    """Return both integrals of a memory."""
    layout = controller.engines[memory.mode].tick.memory
    views = layout.views(memory.x)
    return np.concatenate([views[key] for key in views if key.endswith("integral")])


def test_the_fallback_holds_the_arm_against_gravity_and_brakes() -> None:
    controller = make_controller()
    model, data = arm().model, arm().model.createData()
    memory = controller.start("contact", arm().home)
    gravity = pin.computeGeneralizedGravity(model, data, arm().home)
    assert memory.tau == pytest.approx(np.clip(gravity, -TAU_MAX, TAU_MAX), abs=1e-10)
    seen = measured(0)
    fast = seen._replace(v=0.1 * seen.v, time=0.0)
    blind = {**references(0), "force": ForceReference(F_ref=np.zeros(6), F_meas=np.full(6, np.nan))}
    command, report, _ = controller.step("contact", fast, blind, memory)
    assert report.status is Status.NOT_FINITE
    braking = command.tau - pin.computeGeneralizedGravity(model, data, fast.q)
    assert braking @ fast.v < 0  # the state is known: damp the motion there is


@pytest.mark.parametrize("what", ["NaN velocity", "stale"])
def test_the_fallback_does_not_push_along_a_velocity_it_no_longer_knows(what: str) -> None:
    controller = make_controller()
    memory, model = run(controller, 30)[-1].memory, arm().model
    for i in range(200):  # long enough for the rate limit not to matter
        bad = measured(29)
        if what == "NaN velocity":  # the arm stands, and its velocity sensor is gone
            bad = bad._replace(time=0.03 + i * DT, v=np.full(7, np.nan))
        command, _, memory = controller.step("contact", bad, references(0.03), memory)
    gravity = pin.computeGeneralizedGravity(model, model.createData(), memory.q)
    assert command.tau == pytest.approx(np.clip(gravity, -TAU_MAX, TAU_MAX), abs=1e-9)


def test_a_mode_is_not_entered_without_a_motion_reference() -> None:
    controller = make_controller()
    memory = controller.start("contact", arm().home)
    with pytest.raises(InputError, match="entered without a reference for task 'motion'"):
        controller.step("contact", measured(0), {}, memory)
    _, _, memory = controller.step("contact", measured(0), references(0), memory)
    controller.step("contact", measured(1), {}, memory)  # later a task keeps its last one


@pytest.mark.parametrize(
    ("name", "value"),
    [("q", np.zeros(1)), ("q", np.zeros(6)), ("v", np.zeros(8)), ("force.F_meas", np.zeros(1))],
)
def test_an_array_of_the_wrong_shape_is_refused_not_spread(name: str, value: np.ndarray) -> None:
    controller = make_controller()
    memory = controller.start("contact", arm().home)
    seen, given = measured(0), dict(references(0))
    if name.startswith("force"):
        given["force"] = Given(F_meas=value)
    else:
        seen = seen._replace(**{name: value})
    with pytest.raises(InputError, match=rf"{re.escape(name)}: got shape"):
        controller.step("contact", seen, given, memory)


def test_tasks_that_leave_motion_undetermined_are_refused() -> None:
    robot, space = arm(), TaskSpace("tool")
    half = TaskSpace("tool", ("vx", "vy", "vz"))
    tasks = (
        Weighted(MotionTask(space=space, name="all")),
        Weighted(MotionTask(space=half, name="again")),
        Weighted(PostureTask(q_ref=robot.home)),
    )
    with pytest.raises(InputError, match="leave motion undetermined"):
        Controller(robot, [Mode(name="double", tasks=tasks)])


def test_integrators_hold_where_contact_is_lost() -> None:
    controller = make_controller()
    before = run(controller, 30)[-1]
    lost = Step(
        *controller.step(
            "contact", measured(30, contact=ContactPhase.LOSS), references(0.03), before.memory
        )
    )
    assert lost.report.status is Status.OK
    assert lost.memory.freeze
    after = Step(*controller.step("contact", measured(31), references(0.031), lost.memory))
    assert np.array_equal(integrals(controller, lost.memory), integrals(controller, after.memory))
    assert not after.memory.freeze


def test_integrators_hold_while_a_limit_binds() -> None:
    controller = make_controller()
    before = run(controller, 30)[-1]
    tight = {
        **references(0.03),
        "limits": Given(tau_max=np.full(7, 0.9 * np.abs(before.command.tau).max())),
    }
    bound = Step(*controller.step("contact", measured(30), tight, before.memory))
    assert bound.report.saturated
    assert bound.memory.freeze
    wide = {**references(0.031), "limits": Given(tau_max=np.full(7, TAU_MAX))}
    after = Step(*controller.step("contact", measured(31), wide, bound.memory))
    assert np.array_equal(integrals(controller, bound.memory), integrals(controller, after.memory))


def test_torque_stays_inside_its_limits_and_rate_on_every_tick() -> None:
    controller = make_controller()
    memory = controller.start("contact", arm().home)
    rng = np.random.default_rng(0)
    last, saturated = memory.tau, 0
    for i in range(60):
        far = arm().pose(arm().home, "tool") * pin.exp6(rng.normal(size=6))
        given = {**references(i * DT), "motion": MotionReference(X_WD=far)}
        command, report, memory = controller.step("contact", measured(i), given, memory)
        assert (np.abs(command.tau) <= TAU_MAX + INSIDE).all()
        assert (np.abs(command.tau - last) <= TAU_RATE * DT + INSIDE).all()
        last, saturated = command.tau, saturated + report.saturated
    assert saturated > 20


@pytest.mark.parametrize("law", ["hybrid", "textbook"])
def test_a_closed_form_that_is_sent_stays_inside_limits_and_rate(law: Any) -> None:
    controller = make_controller(law=law)
    memory = controller.start("contact", arm().home)
    last = memory.tau
    for i in range(20):
        far = arm().pose(arm().home, "tool") * pin.exp6(np.full(6, 0.5))
        given = {**references(i * DT), "motion": MotionReference(X_WD=far)}
        command, report, memory = controller.step("contact", measured(i), given, memory)
        assert report.status is Status.OK
        assert (np.abs(command.tau) <= TAU_MAX + INSIDE).all()
        assert (np.abs(command.tau - last) <= TAU_RATE * DT + INSIDE).all()
        last = command.tau


@pytest.mark.parametrize("law", ["qp", "hybrid", "textbook"])
def test_the_torque_that_is_sent_is_that_of_the_law(law: Any) -> None:
    steps = run(make_controller(law=law), 40)
    sent, report = steps[-1].command.tau, steps[-1].report
    torques = {"qp": report.tau_qp, "hybrid": report.tau_hybrid, "textbook": report.tau_textbook}
    assert np.allclose(sent, torques[law], rtol=0, atol=1e-7)
    assert np.abs(report.tau_hybrid - report.tau_textbook).max() > 1e-6


def test_two_controllers_with_proxsuite_agree_to_its_accuracy() -> None:
    """Its kernels sum in an order that depends on where their memory lies: no identical bits."""
    one, other = (run(make_controller(solver="proxsuite"), 40) for _ in range(2))
    for a, b in zip(one, other, strict=True):
        assert a.command.tau == pytest.approx(b.command.tau, rel=LAW_AGREEMENT)
        assert a.memory.x.tobytes() == b.memory.x.tobytes()


def test_two_controllers_give_identical_bits() -> None:
    one, other = (run(make_controller(solver="daqp"), 40) for _ in range(2))
    for a, b in zip(one, other, strict=True):
        assert a.command.tau.tobytes() == b.command.tau.tobytes()
        assert a.memory.x.tobytes() == b.memory.x.tobytes()
        assert a.report.lam.tobytes() == b.report.lam.tobytes()
        assert a.report.signals.tobytes() == b.report.signals.tobytes()


def pushed_to_its_limits(controller: Controller, ticks: int = 60) -> list[Step]:
    """Run towards poses out of reach, with the gains and limits that the controller has."""
    memory, steps = controller.start("contact", arm().home), []
    rng = np.random.default_rng(0)
    for i in range(ticks):
        far = arm().pose(arm().home, "tool") * pin.exp6(rng.normal(size=6))
        given = {**references(i * DT), "motion": MotionReference(X_WD=far)}
        steps.append(Step(*controller.step("contact", measured(i), given, memory)))
        memory = steps[-1].memory
    return steps


def with_other_inputs(controller: Controller) -> None:
    """Run ticks, good and bad, that change gains, weights, limits and the period."""
    hopeless = {**references(0.0), "limits": Given(q_max=arm().home - 5.0)}
    _, report, _ = controller.step(
        "contact", measured(0), hopeless, controller.start("contact", arm().home)
    )
    assert report.status is Status.INFEASIBLE
    controller.engines["contact"].inputs["dt"][...] = DT
    changed = {
        "motion": Given(K_p=np.full(6, 30.0), weight=np.array(7.0), V_des=np.full(6, 0.1)),
        "force": Given(K_fi=np.full(6, 1.0)),
        "limits": Given(tau_max=np.full(7, 0.7 * TAU_MAX), q_max=np.full(7, UNBOUNDED)),
    }
    memory = controller.start("contact", arm().home)
    for i in range(20):
        given = {**references(i * DT), **changed}
        _, report, memory = controller.step("contact", measured(i), given, memory)
        assert report.status is Status.OK


def bits(step: Step) -> list[bytes]:
    """Return all numbers of a step but the solver's own torque, which proxsuite does not repeat."""
    report = step.report
    named = [(limit.name, limit.dual) for limit in report.active]
    lost = [lost.amount.tobytes() for lost in report.yields]
    unsaid = {"tau_solver", "kind", "give"}  # of the last two only what binds has a meaning
    said = [
        report.format.layout.view(report.numbers, name).tobytes()
        for name in report.format.layout.names
        if name not in unsaid
    ]
    remembered = step.memory.tau, step.memory.q, step.memory.x
    numbers = [np.asarray(x).tobytes() for x in (*step.command, *remembered, *step.memory[2:])]
    return [*numbers, *said, repr((report.status, report.contact, named)).encode(), *lost]


@pytest.mark.parametrize("solver", ["active-set", "proxsuite", "daqp"])
def test_a_controller_that_is_reset_gives_the_bits_of_a_new_one(solver: str) -> None:
    controller = make_controller(solver=solver, dt=2 * DT)
    first = pushed_to_its_limits(controller)
    assert sum(step.report.saturated for step in first) > 20
    moved = first[1].command.tau - first[0].command.tau
    assert np.abs(moved).max() == pytest.approx(TAU_RATE * 2 * DT)
    with_other_inputs(controller)
    controller.reset()
    again = pushed_to_its_limits(controller)
    new = pushed_to_its_limits(make_controller(solver=solver, dt=2 * DT))
    for one, two, three in zip(first, again, new, strict=True):
        assert bits(one) == bits(two) == bits(three)


class OneShot:
    """A solver that remembers: after one QP it finds no solution until it is reset."""

    def __init__(self) -> None:
        self._used = False

    def solve(self, qp: QpData) -> Solution:
        """Return the solution of the first QP."""
        found = make_solver("daqp").solve(qp)._replace(feasible=not self._used)
        self._used = True
        return found

    def reset(self) -> None:
        """Forget the first QP."""
        self._used = False


def test_a_reset_reaches_the_solver_of_every_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("qpctrl.controller.make_solver", lambda name: OneShot())
    controller = make_controller()

    def outcomes() -> list[Status]:
        starts = [(mode, controller.start(mode, arm().home)) for mode in ("contact", "free")]
        return [
            controller.step(mode, measured(0), {"motion": references(0.0)["motion"]}, start)[
                1
            ].status
            for mode, start in starts
        ]

    assert outcomes() == [Status.OK, Status.OK]
    assert outcomes() == [Status.INFEASIBLE, Status.INFEASIBLE]
    controller.reset()
    assert outcomes() == [Status.OK, Status.OK]


def test_without_a_reset_changed_inputs_stay() -> None:
    controller = make_controller()
    first = pushed_to_its_limits(controller)[-1]
    with_other_inputs(controller)
    again = pushed_to_its_limits(controller)[-1]
    assert np.abs(first.command.tau - again.command.tau).max() > 1.0


def test_a_step_leaves_its_arguments_and_earlier_results_alone() -> None:
    controller = make_controller()
    first = run(controller, 1)[0]
    kept = [x.copy() for x in (first.command.tau, first.memory.x, first.report.lam)]
    seen, before = measured(1), first.memory.x.copy()
    arrays = seen.q.copy(), seen.v.copy()
    controller.step("contact", seen, references(DT), first.memory)
    assert np.array_equal(first.memory.x, before)
    assert np.array_equal(seen.q, arrays[0])
    assert np.array_equal(seen.v, arrays[1])
    for old, new in zip(kept, (first.command.tau, first.memory.x, first.report.lam), strict=True):
        assert np.array_equal(old, new)


def test_a_mode_switch_takes_over_what_both_modes_remember() -> None:
    controller = make_controller()
    before = run(controller, 30)[-1].memory
    free = {key: ref for key, ref in references(0.03).items() if key != "force"}
    _, report, after = controller.step("free", measured(30), free, before)
    assert report.status is Status.OK
    assert report.mode == after.mode == "free"
    views = {
        memory.mode: controller.engines[memory.mode].tick.memory.views(memory.x)
        for memory in (before, after)
    }
    carried = views["free"]["motion.integral"] - views["contact"]["motion.integral"]
    size = np.abs(views["contact"]["motion.integral"]).max()
    assert size > 1e-6
    assert 0 < np.abs(carried).max() < 0.5 * size  # one tick further, not from zero
    back = Step(*controller.step("contact", measured(31), references(0.031), after))
    views = controller.engines["contact"].tick.memory.views(back.memory.x)
    assert np.abs(views["force.F_des"]).max() <= 0.1 + INSIDE  # its ramp starts again


def test_a_mode_switch_does_not_jump_beyond_the_torque_rate() -> None:
    controller = make_controller()
    before = run(controller, 30)[-1]
    free = {key: ref for key, ref in references(0.03).items() if key != "force"}
    command, _, _ = controller.step("free", measured(30), free, before.memory)
    assert (np.abs(command.tau - before.command.tau) <= TAU_RATE * DT + INSIDE).all()


# Singular postures -------------------------------------------------------------------------


def test_a_singular_posture_is_damped_and_said() -> None:
    robot, space = planar_2r(), SPACES["planar_2r"]
    controller = Controller(robot, [given_mode(robot, space, 0)])
    given = {"motion": Given(a_cmd=np.array([1.0, 1.0]))}
    torques = {}
    for elbow in (0.0, 1e-9, 1e-4, 1e-3, 0.5):
        memory = controller.start("contact", np.array([0.3, elbow]))
        seen = Measurement(0.0, np.array([0.3, elbow]), np.zeros(2))
        command, report, _ = controller.step("contact", seen, given, memory)
        assert report.status is Status.OK
        assert np.isfinite(command.tau).all()
        assert (report.damping > 0) == (elbow < 1e-2)
        assert ("no equality claimed" in report.explain()) == (report.damping > 0)
        torques[elbow] = command.tau
    assert np.abs(torques[0.0] - torques[1e-9]).max() < 1e-3
    assert max(np.abs(tau).max() for tau in torques.values()) < 1e3


def test_a_mode_can_be_built_at_a_singular_home() -> None:
    robot, space = planar_2r(), SPACES["planar_2r"]
    straight = Robot(model=robot.model, limits=robot.limits, home=np.zeros(2))
    controller = Controller(straight, [given_mode(straight, space, 1)])  # row along the arm
    memory = controller.start("contact", np.zeros(2))
    seen = Measurement(0.0, np.zeros(2), np.zeros(2))
    command, report, _ = controller.step("contact", seen, {}, memory)
    assert report.damping > 0
    assert np.isfinite(command.tau).all()


# Names and numbers that are refused at once ------------------------------------------------


def test_unknown_names_are_refused_with_the_nearest_one() -> None:
    controller = make_controller()
    memory = controller.start("contact", arm().home)
    with pytest.raises(InputError, match=r"unknown mode 'contcat'.*did you mean 'contact'"):
        controller.start("contcat", arm().home)
    with pytest.raises(InputError, match="unknown mode 'slide'"):
        controller.step("slide", measured(0), {}, memory)
    given = {**references(0), "forse": references(0)["force"]}
    with pytest.raises(InputError, match=r"'forse\.F_ref'.*did you mean 'force\.F_ref'"):
        controller.step("contact", measured(0), given, memory)
    with pytest.raises(InputError, match=r"unknown task input 'motion\.K_q'"):
        controller.step("contact", measured(0), {"motion": Given(K_q=np.zeros(6))}, memory)


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("form", "reduce", "unknown form 'reduce'; allowed: full, reduced"),
        ("solver", "prox", "unknown solver 'prox'"),
        ("dt", 0.0, "dt: got .*need values > 0"),
        ("dt", np.nan, "dt: got .*need finite"),
        ("kkt_tolerance", -1.0, "kkt_tolerance: got .*need values > 0"),
    ],
)
def test_options_that_cannot_be_are_refused_at_construction(
    option: str, value: Any, says: str
) -> None:
    robot = planar_2r()
    with pytest.raises(InputError, match=says):
        Controller(robot, [given_mode(robot, SPACES["planar_2r"], 1)], **{option: value})


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ("law='QP'", "unknown law 'QP'; allowed: hybrid, qp, textbook"),
        ("dependent_rows='remove'", "unknown treatment of dependent rows 'remove'"),
    ],
)
def test_literals_are_refused_where_nobody_checks_types(option: str, says: str) -> None:
    code = (
        "from cases import *\n"
        "robot = planar_2r()\n"
        "modes = [given_mode(robot, SPACES['planar_2r'], 1)]\n"
        f"Controller(robot, modes, {option})\n"
    )
    tests = Path(__file__).parent
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=tests,
        env={**os.environ, "PYTHONPATH": f"{tests.parent}"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "qpctrl.errors.InputError" in ran.stderr
    assert says in ran.stderr


def test_modes_that_cannot_be_are_refused() -> None:
    robot = arm()
    motion, force, posture = tasks(robot)
    with pytest.raises(InputError, match="need at least one mode"):
        Controller(robot, [])
    with pytest.raises(InputError, match="need at least one task"):
        Mode(name="idle", tasks=())
    with pytest.raises(InputError, match="names must differ, got motion, motion"):
        Mode(name="twice", tasks=(motion, motion))
    with pytest.raises(InputError, match="weight of task 'motion': got -1"):
        Mode(name="negative", tasks=(Weighted(motion.task, -1.0),))
    with pytest.raises(InputError, match="weight of task 'motion': got nan"):
        Mode(name="nan", tasks=(Weighted(motion.task, float("nan")),))
    with pytest.raises(InputError, match=r"motion tasks fix 6 of 7.*add a posture"):
        Controller(robot, [Mode(name="loose", tasks=(motion, force))])
    unforced = Mode(name="unforced", tasks=(motion, posture), constraints=(board(SPACE),))
    with pytest.raises(InputError, match="constraint 'plane' has no force task"):
        Controller(robot, [unforced])
    other = Weighted(ForceTask(space=SPACE, name="more"))
    with pytest.raises(InputError, match="two force tasks on one task space"):
        Controller(robot, [Mode(name="both", tasks=(motion, force, other, posture))])


def test_two_modes_of_one_name_are_refused() -> None:
    robot = planar_2r()
    mode = given_mode(robot, SPACES["planar_2r"], 1)
    with pytest.raises(InputError, match="contact"):
        Controller(robot, [mode, mode])


# Modes without a textbook law ---------------------------------------------------------------


def with_elbow() -> Robot:
    """Return the arm with a second frame, half-way."""
    model = chain(7, seed=7).model
    model.addFrame(pin.Frame("elbow", 4, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return Robot(model=model, limits=arm().limits, home=arm().home)


def test_two_task_spaces_are_compared_with_the_kkt_solution() -> None:
    """Elbow and tool of the 7-joint arm, three axes each: no textbook law, but one optimum."""
    robot, POINT = with_elbow(), ("vx", "vy", "vz")
    first, second = TaskSpace("tool", POINT), TaskSpace("elbow", POINT)
    motions = tuple(
        Weighted(MotionTask(space=space, name=name), weight)
        for space, name, weight in ((first, "tool", 2.0), (second, "elbow", 0.3))
    )
    posture = Weighted(PostureTask(q_ref=robot.home))
    row = Pfaffian(space=first, A=np.array([[0.0, 0.0, 1.0]]))
    tasks = (*motions, Weighted(ForceTask(space=first)), posture)
    mode = Mode(name="two", tasks=tasks, constraints=(row,))
    controller = Controller(robot, [mode])
    seen = measured(0)
    memory = controller.start("two", seen.q)
    given = {
        "tool": MotionReference(X_WD=robot.pose(robot.home, "tool")),
        "elbow": MotionReference(X_WD=robot.pose(robot.home, "elbow")),
        "limits": Given(tau_rate=np.full(robot.nu, 1e9)),
    }
    command, report, _ = controller.step("two", seen, given, memory)
    assert report.status is Status.OK
    assert not report.active
    assert report.law_gap < LAW_AGREEMENT
    assert np.allclose(command.tau, report.tau_hybrid, rtol=0, atol=1e-6)
    assert np.isnan([report.textbook_gap, report.unexplained_gap, report.curvature]).all()
    assert "KKT solution" in report.explain()
    with pytest.raises(InputError, match="no textbook law"):
        Controller(robot, [mode], law="textbook")


@pytest.mark.parametrize("mode", ["free", "contact"])
def test_a_bad_tick_at_a_switch_leaves_the_memory_of_the_new_mode(mode: str) -> None:
    controller = make_controller()
    other = "contact" if mode == "free" else "free"
    given = {"motion": references(0.0)["motion"]}
    _, _, memory = controller.step(other, measured(0), given, controller.start(other, arm().home))
    bad = measured(1, v=np.full(7, np.nan))
    command, report, memory = controller.step(mode, bad, given, memory)
    assert report.status is Status.NOT_FINITE
    assert command.fallback
    assert len(memory.x) == controller.engines[mode].tick.memory.size
    command, report, memory = controller.step(mode, measured(2), given, memory)
    assert report.status is Status.OK
