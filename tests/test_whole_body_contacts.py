"""Contacts of whole bodies: what a report says of them, what holds without them, how they end."""

import functools
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import oracles
import oracles_whole_body as whole
import pinocchio as pin
import pytest
from cases import Given, needs_compiler, planar_2r, tick
from cases_whole_body import (
    BODIES,
    Body,
    Grip,
    bodies,
    body,
    commands,
    limited_controller,
    physics_of,
    unlimited,
)
from scipy.optimize import linprog

from qpctrl import (
    Controller,
    InputError,
    Measurement,
    Mode,
    Pfaffian,
    Robot,
    Status,
    TaskSpace,
    TickReport,
    Weighted,
)
from qpctrl.certificate import KKT_TOLERANCE
from qpctrl.compiled import CompileMode
from qpctrl.constraint import Embedded
from qpctrl.constraint.point_on_plane import PointOnPlane
from qpctrl.contact import Footprint, FrictionCone, MaxForce
from tasks import (
    CentreOfMassReference,
    CentreOfMassTask,
    ForceTask,
    MomentumTask,
    MotionReference,
    MotionTask,
    PostureReference,
    PostureTask,
)

DT = 1e-3
EXACT = 1e-8
"""N, Nm, rad/s², relative to what they are made of: a KKT residual of 1e-9 at most."""

FAR = 1e6  # N, Nm: stands for no bound
HELD = 1e-5
"""rad/s²: what is left of 9.81 m/s² by a fallback that gives up 1e-9 of what contacts carry."""

INSIDE = 1e-9
"""Nm: round-off of a torque that is clipped to its limit."""

DAMPING = 5.0
"""1/s: that of the fallback, times the diagonal of M."""


# What a report says ------------------------------------------------------------------------


def rows_of(name: str, half: tuple[float, float], mu: float, sides: int) -> dict[str, np.ndarray]:
    """Return what each row of cone and footprint leaves, as a row on the wrench (6)."""
    fx, fy, fz, mx, my, _ = np.eye(6)
    found = {}
    for i in range(sides):
        phi = 2 * np.pi * i / sides
        steep = mu * np.cos(np.pi / sides) * fz
        found[f"friction {name}.{360 * i / sides:g}deg"] = (
            steep - np.cos(phi) * fx - np.sin(phi) * fy
        )
    edges = {"-x": half[0] * fz - my, "+x": half[0] * fz + my}
    edges |= {"+y": half[1] * fz - mx, "-y": half[1] * fz + mx}
    return found | {f"footprint {name}.{edge}": row for edge, row in edges.items()}


def test_wrenches_and_margins_in_a_report_are_those_of_the_multipliers() -> None:
    of, rng = bodies()["humanoid"], np.random.default_rng(8)
    controller, bound = limited_controller("humanoid"), 0
    (engine,) = controller.engines.values()
    for _ in range(10):
        q, v = of.state(rng)
        _, report, _ = tick(controller, q, v, commands(of, rng).references(of))
        _, contacts = physics_of(of, q, v)
        said = {contact.name: contact for contact in report.contacts}
        assert list(said) == [
            c.name for space in engine.tick.spaces for c in of.constraints() if c.space == space
        ]
        lam, at = {}, 0
        for name in said:
            k = next(len(grip.held.rows) for grip in of.grips if grip.name == name)
            lam[name], at = report.lam[at : at + k], at + k
        for grip, contact in zip(of.grips, contacts, strict=True):
            F, own = contact.A.T @ lam[grip.name], said[grip.name]
            assert own.wrench == pytest.approx(F, abs=EXACT * max(1, np.abs(F).max()))
            if grip.held.rows != whole.ALL:
                expected = {f"most {grip.name}": 45.0 - F[2]}
            else:
                rows = rows_of(grip.name, (0.04, 0.03), 0.4, 8)
                left = {row: float(W @ F) for row, W in rows.items()}
                expected = {
                    limit: min(value for row, value in left.items() if row.startswith(limit))
                    for limit in (f"friction {grip.name}", f"footprint {grip.name}")
                }
                for row in own.binding:
                    assert left[row] == pytest.approx(0.0, abs=1e-6)
                bound += len(own.binding)
            assert own.margins == pytest.approx(expected, abs=1e-6)
    assert bound > 10


@functools.cache
def stand() -> Controller:
    """Return a humanoid that stands on both feet, with limits of its contacts and its own."""
    robot, feet = body("humanoid"), bodies()["humanoid"].grips[:2]
    limits = []
    for grip in feet:
        half = (0.11, 0.05)
        limits.append(FrictionCone(space=grip.space, mu=0.6, sides=8, name=f"friction {grip.name}"))
        limits.append(Footprint(space=grip.space, half=half, name=f"footprint {grip.name}"))
        limits.append(MaxForce(space=grip.space, limit=1e4, name=f"most {grip.name}"))
    both = Mode(
        name="both",
        tasks=standing_tasks(robot, feet),
        constraints=Body("humanoid", (), feet).constraints(),
        contact_limits=tuple(limits),
        metric="home",
    )
    left = replace(
        both,
        name="left",
        tasks=standing_tasks(robot, feet[:1]),
        constraints=both.constraints[:1],
        contact_limits=tuple(limits[:3]),
    )
    return Controller(robot, [both, left])


def standing_tasks(robot: Robot, feet: tuple[Grip, ...]) -> tuple[Weighted, ...]:
    """Return the tasks of a humanoid that stands."""
    return (
        Weighted(CentreOfMassTask(), 10.0),
        Weighted(MomentumTask(), 1.0),
        Weighted(MotionTask(space=TaskSpace("torso"), name="torso"), 0.1),
        Weighted(PostureTask(q_ref=robot.home), 0.1),
        *(Weighted(ForceTask(space=g.space, name=f"force {g.name}", ramp=1e9), 1e-3) for g in feet),
    )


def here(q: np.ndarray, shift: np.ndarray | None = None) -> dict[str, Any]:
    """Return references to stay in ``q``, with the centre of mass ``shift`` [m] further on."""
    robot = body("humanoid")
    c = pin.centerOfMass(robot.model, robot.model.createData(), q).copy()
    return {
        "centre of mass": CentreOfMassReference(c_des=c if shift is None else c + shift),
        "torso": MotionReference(X_WD=robot.pose(q, "torso")),
        "posture": PostureReference(q_ref=q),
    }


@pytest.mark.parametrize(
    ("tight", "shift", "rows"),
    [
        ({"friction left_sole": {"mu": 0.01}}, [0.05, 0, 0], {"friction left_sole.180deg"}),
        ({"friction right_sole": {"mu": 0.01}}, [-0.05, 0, 0], {"friction right_sole.0deg"}),
        (
            {"footprint left_sole": {"half": (0.005, 0.005)}},
            [0.1, 0, 0],
            {"footprint left_sole.-x"},
        ),
        (
            {"footprint left_sole": {"half": (0.005, 0.005)}},
            [-0.1, 0, 0],
            {"footprint left_sole.+x"},
        ),
        ({"most right_sole": {"limit": 100.0}}, [0, 0, 0], {"most right_sole.fz"}),
    ],
)
def test_a_limit_that_binds_is_named_with_its_row(
    tight: dict[str, Any], shift: list[float], rows: set[str]
) -> None:
    """Feet push the ground back to move forward; x of a sole is forward, z down.

    Their centre of pressure then is behind.
    """
    controller, robot = stand(), body("humanoid")
    controller.reset()
    tight = {name: Given({k: np.asarray(v) for k, v in u.items()}) for name, u in tight.items()}
    no_rate = {"limits": Given(tau_rate=np.full(robot.nu, 1e9))}
    memory = controller.start("both", robot.home)
    now = Measurement(0.0, robot.home, np.zeros(robot.nv))
    references = {**here(robot.home, np.array(shift)), **tight, **no_rate}
    _, report, _ = controller.step("both", now, references, memory)
    controller.reset()
    assert report.status is Status.OK
    (limit,) = tight
    (own,) = [contact for contact in report.contacts if limit in contact.margins]
    assert rows <= set(own.binding)
    assert own.margins[limit] == pytest.approx(0.0, abs=1e-6)
    assert all(f"contact {row}" in {a.name for a in report.active} for row in rows)
    assert f"contact {next(iter(rows))} at its upper limit" in report.explain()
    said = own.describe()
    assert said.startswith(f"{own.name}: wrench ({own.wrench[0]:.3g}, ")
    assert f"left of friction {own.name} {own.margins[f'friction {own.name}']:.3g} N, " in said
    assert f"footprint {own.name} {own.margins[f'footprint {own.name}']:.3g} Nm" in said
    assert said.endswith(f"; at its limit: {', '.join(own.binding)}")


def test_a_single_contact_without_limits_is_all_of_lam_and_not_listed() -> None:
    of, rng = bodies()["mobile arm"], np.random.default_rng(0)
    controller = Controller(unlimited(of.robot), [of.mode()])
    q, v = of.state(rng)
    _, report, _ = tick(controller, q, v, commands(of, rng).references(of))
    assert report.contacts == ()
    assert len(report.lam) == 3


# What holds where there is no solution -----------------------------------------------------


def rigid(of: Body, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return accelerations and multipliers of the plant whose contacts are rigid."""
    physics, _ = physics_of(of, q, v)
    k = len(physics.AJ)
    K = np.block([[physics.M, physics.AJ.T], [physics.AJ, np.zeros((k, k))]])
    found = np.linalg.solve(K, np.r_[physics.B @ tau - physics.h, physics.b])
    return found[: len(physics.M)], found[len(physics.M) :]


@pytest.mark.parametrize("name", BODIES[1:])
def test_the_torque_at_the_start_holds_the_robot_on_its_contacts(name: str) -> None:
    of, rng = bodies()[name], np.random.default_rng(6)
    controller = limited_controller(name)
    for _ in range(5):
        q, v = of.state(rng)
        tau = controller.start(of.model, q).tau
        a, lam = rigid(of, q, 0 * v, tau)
        assert np.abs(a).max() <= HELD
        physics, _ = physics_of(of, q, 0 * v)
        free = ~physics.B.any(axis=1)
        least = np.linalg.lstsq(physics.AJ.T[free], -physics.h[free], rcond=None)[0]
        (_, _, A, b, C, lb, ub), nv = controller.engines[of.model].qp, len(v)
        k = len(lam)
        weight = physics.B @ tau - physics.h
        own, *_ = np.linalg.lstsq(A[:k, :nv].T, weight, rcond=None)  # λ in the order of the tick
        own_least, *_ = np.linalg.lstsq(A[k:, nv:], b[k:], rcond=None)
        on = C[:, nv:].any(axis=1)  # not the limits of accelerations, which are 0
        rows, up, low = C[on, nv:], np.minimum(ub, FAR)[on], np.maximum(lb, -FAR)[on]
        possible = linprog(
            np.zeros(len(lam)),
            *(np.vstack((rows, -rows)), np.concatenate((up, -low))),
            *(A[k:, nv:], b[k:]),
            (None, None),
        )
        at_least = rows @ own_least
        if possible.status == 0 and ((at_least > up) | (at_least < low)).any():
            assert (rows @ own <= up + HELD).all()
            assert (rows @ own >= low - HELD).all()
            assert np.linalg.norm(lam) > np.linalg.norm(least)
        else:  # what is least can be carried, or nothing can
            assert lam == pytest.approx(least, abs=1e-6 * np.abs(least).max())
        assert np.abs(tau).max() > 5
        assert np.abs(least).max() > 5


def test_a_body_that_nothing_touches_is_left_to_fall_and_the_arms_hold() -> None:
    robot = body("two_arms")
    tasks = MotionTask(space=TaskSpace("left_pad")), PostureTask(q_ref=robot.home)
    mode = Mode(name="free", tasks=tuple(map(Weighted, tasks)), metric="home")
    tau = Controller(unlimited(robot), [mode]).start("free", robot.home).tau
    g = oracles.frame_terms(robot.model, robot.home, np.zeros(robot.nv), "box").h
    assert tau == pytest.approx(robot.B.T @ g, abs=EXACT)
    assert np.abs(tau).max() > 10


def standing_hold(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return B⁺ (g + Jᵀ Aᵀ λ − K_d v) with the least λ that carries the base."""
    of = Body("humanoid", (), bodies()["humanoid"].grips[:2])
    physics, _ = physics_of(of, q, 0 * v)
    lam = np.linalg.lstsq(physics.AJ.T[:6], -physics.h[:6], rcond=None)[0]
    brake = DAMPING * np.diag(physics.M) * v
    return of.robot.B.T @ (physics.h + physics.AJ.T @ lam - brake)


def bad_states(q: np.ndarray, v: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray, Status]]:
    """Return measurements that cannot be used, and what each is called."""
    nothing = q.copy()
    nothing[3:7] = 0.0
    return {
        "NaN q": (np.full(len(q), np.nan), v, Status.NOT_FINITE),
        "NaN v": (q, np.full(len(v), np.nan), Status.NOT_FINITE),
        "inf v": (q, np.r_[v[:-1], np.inf], Status.NOT_FINITE),
        "a quaternion of zeros": (nothing, v, Status.DEPENDENT_ROWS),
    }


@pytest.mark.parametrize("what", bad_states(np.zeros(36), np.zeros(35)))
def test_a_bad_state_of_a_floating_robot_is_answered_within_limits(what: str) -> None:
    controller, robot = stand(), body("humanoid")
    v = whole.along_free_directions(0.05 * np.ones(robot.nv), physics_contacts(robot.home))
    limits, memory = robot.limits, controller.start("both", robot.home)
    _, report, memory = controller.step(
        "both", Measurement(0.0, robot.home, v), here(robot.home), memory
    )
    assert report.status is Status.OK
    q_bad, v_bad, status = bad_states(robot.home, v)[what]
    for i in range(1, 4):
        last = memory.tau.copy()
        now = Measurement(i * DT, q_bad, v_bad)
        command, report, memory = controller.step("both", now, {}, memory)
        assert report.status is status
        assert command.fallback
        assert np.isfinite(command.tau).all()
        assert (np.abs(command.tau) <= limits.tau_max + INSIDE).all()
        step = np.abs(command.tau - last)
        assert (step <= limits.tau_rate * DT + INSIDE).all()
        wanted = last if "zeros" in what else standing_hold(robot.home, 0 * v)
        toward = np.clip(wanted, last - limits.tau_rate * DT, last + limits.tau_rate * DT)
        assert command.tau == pytest.approx(toward, abs=1e-6)
        assert report.explain() == fallback_words(report)
    assert memory.fallback_ticks == 3


def fallback_words(report: TickReport) -> str:
    """Return what a report of a tick without a solution says."""
    rows = f": {', '.join(report.dependent_rows)}" if report.dependent_rows else ""
    return f"fallback torque: {report.status.value}{rows}"


def physics_contacts(q: np.ndarray) -> list[whole.Contact]:
    """Return the contacts of both feet."""
    of = Body("humanoid", (), bodies()["humanoid"].grips[:2])
    return physics_of(of, q, np.zeros(of.robot.nv))[1]


def test_a_known_velocity_is_damped_in_the_joints_that_are_driven() -> None:
    controller, robot = stand(), body("humanoid")
    v = whole.along_free_directions(0.3 * np.cos(np.arange(robot.nv)), physics_contacts(robot.home))
    memory = controller.start("both", robot.home)
    no_way = {"limits": Given(v_max=np.full(robot.nv, 1e-3), tau_rate=np.full(robot.nu, 1e9))}
    now = Measurement(0.0, robot.home, v)
    command, report, _ = controller.step("both", now, {**here(robot.home), **no_way}, memory)
    controller.reset()
    assert report.status is Status.INFEASIBLE
    assert command.tau == pytest.approx(standing_hold(robot.home, v), abs=1e-6)
    assert np.abs(command.tau - standing_hold(robot.home, 0 * v)).max() > 1


def test_a_state_of_the_wrong_length_or_no_orientation_is_refused() -> None:
    controller, robot = stand(), body("humanoid")
    with pytest.raises(InputError, match=r"q: got shape \(35,\), need \(36,\)"):
        controller.start("both", robot.home[:-1])
    turned = robot.home.copy()
    turned[3:7] *= 1.1
    with pytest.raises(InputError, match=r"q: quaternion of 'base' has norm 1\.1, need 1"):
        controller.start("both", turned)
    memory, references = controller.start("both", robot.home), here(robot.home)
    for q, v, said in (
        (robot.home[1:], np.zeros(35), r"q: got shape \(35,\), need \(36,\)"),
        (robot.home, np.zeros(36), r"v: got shape \(36,\), need \(35,\)"),
    ):
        with pytest.raises(InputError, match=said):
            controller.step("both", Measurement(0.0, q, v), references, memory)
    given = {"gone": Given(x=np.zeros(1))}
    with pytest.raises(InputError, match=r"unknown task input 'gone\.x'"):
        controller.step(
            "both", Measurement(0.0, robot.home, np.zeros(35)), given | references, memory
        )


# Rows that depend on each other ------------------------------------------------------------


def three_on_a_foot() -> Mode:
    """Return a mode that holds one foot three times over."""
    robot = body("humanoid")
    sole, foot = TaskSpace("left_sole"), TaskSpace("left_foot")
    ankle = TaskSpace("left_sole", ("vx", "vy", "vz"))
    X = robot.pose(robot.home, "left_sole")
    spaces = {"sole": sole, "foot": foot, "ankle": ankle}
    return Mode(
        name="thrice",
        tasks=(
            Weighted(PostureTask(q_ref=robot.home)),
            *(Weighted(ForceTask(space=s, name=f"force {n}"), 1e-3) for n, s in spaces.items()),
        ),
        constraints=(
            Embedded(space=sole, X_WE=X, name="sole"),
            PointOnPlane(space=foot, X_WE=X, name="foot"),
            Pfaffian(space=ankle, A=np.eye(3)[:1], name="ankle"),
        ),
        metric="home",
    )


def between_walls() -> Mode:
    """Return a mode in which a floor and a ceiling hold the box."""
    robot = body("two_arms")
    poses = {"floor": robot.pose(robot.home, "box_bottom"), "ceiling": pin.SE3.Identity()}
    spaces = {"floor": TaskSpace("box_bottom"), "ceiling": TaskSpace("box")}
    return Mode(
        name="between",
        tasks=(
            Weighted(PostureTask(q_ref=robot.home)),
            *(Weighted(ForceTask(space=s, name=f"force {n}"), 1e-3) for n, s in spaces.items()),
            Weighted(MotionTask(space=spaces["ceiling"], name="box"), 1.0),
        ),
        constraints=tuple(
            PointOnPlane(space=space, X_WE=poses[name], name=name) for name, space in spaces.items()
        ),
        metric="home",
    )


@pytest.mark.parametrize(
    ("model", "make", "first", "kept"),
    [
        ("humanoid", three_on_a_foot, "foot.vz", 6),
        ("two_arms", between_walls, "ceiling.vz", 1),
    ],
)
def test_contacts_that_depend_on_each_other_are_refused_by_name_or_dropped(
    model: str, make: Any, first: str, kept: int
) -> None:
    robot, mode = body(model), make()
    with pytest.raises(InputError, match=f"constraint row {first} depends on the rows before it"):
        Controller(robot, [mode])
    controller = Controller(robot, [mode], dependent_rows="drop")
    engine = controller.engines[mode.name]
    assert len(engine.tick.rows.constraint) == kept
    memory = controller.start(mode.name, robot.home)
    at_home = {"box": "box"} if model == "two_arms" else {}
    given = {t: MotionReference(X_WD=robot.pose(robot.home, f)) for t, f in at_home.items()}
    now = Measurement(0.0, robot.home, np.zeros(robot.nv))
    _, report, _ = controller.step(mode.name, now, given, memory)
    assert report.status is Status.OK
    if model == "two_arms":
        assert report.lam[0] == pytest.approx(2 * 9.81, abs=1e-6)  # N: the box on the floor


def straight_arms() -> tuple[Controller, np.ndarray]:
    """Return arms that hold a box held itself, and a configuration with the left one straight."""
    of = bodies()["two arms"]
    robot, bottom = unlimited(of.robot), TaskSpace("box_bottom")
    held = Embedded(space=bottom, X_WE=of.robot.pose(of.robot.home, "box_bottom"), name="table")
    mode = of.mode()
    mode = replace(
        mode,
        tasks=(*mode.tasks, Weighted(ForceTask(space=bottom, name="force table"))),
        constraints=(held, *mode.constraints),
    )
    q = robot.home.copy()
    left = [i for i, name in enumerate(robot.configuration_names) if name.startswith("left_")]
    q[left] = 0.0
    return Controller(robot, [mode]), q


def test_a_closed_chain_that_becomes_singular_says_which_row_it_lost() -> None:
    controller, q = straight_arms()
    robot, v = controller.robot, np.cos(np.arange(20.0))
    memory, still = controller.start("two_arms", robot.home), np.zeros(robot.nv)
    statuses = []
    for i, (q_now, v_now) in enumerate([(robot.home, still), (q, v), (robot.home, still)]):
        now = Measurement(i * DT, q_now, v_now)
        command, report, memory = controller.step("two_arms", now, {}, memory)
        statuses.append(report.status)
        assert np.isfinite(command.tau).all()
        if i == 1:
            (row,) = report.dependent_rows
            assert row.startswith("table.")  # its rows come last
            assert report.explain() == fallback_words(report)
    assert statuses == [Status.OK, Status.DEPENDENT_ROWS, Status.OK]


@pytest.mark.parametrize("compile", ["no", pytest.param("yes", marks=needs_compiler)])
def test_a_straight_arm_that_is_held_says_which_row_it_lost(compile: CompileMode) -> None:
    """Straight, it cannot move along itself: the row along x of the tool is zero."""
    robot = planar_2r()
    space = TaskSpace("tool", ("vx", "vy"))
    mode = Mode(
        name="held",
        tasks=(Weighted(PostureTask(q_ref=robot.home)), Weighted(ForceTask(space=space))),
        constraints=(Pfaffian(space=space, A=np.eye(2), name="pin"),),
        metric="home",
    )
    controller = Controller(robot, [mode], compile=compile)
    memory, straight = controller.start("held", robot.home), np.array([0.3, 0.0])
    for i, q in enumerate((robot.home, straight, robot.home)):
        now = Measurement(i * DT, q, np.ones(2))
        command, report, memory = controller.step("held", now, {}, memory)
        assert report.status is (Status.DEPENDENT_ROWS if i == 1 else Status.OK)
        assert report.dependent_rows == (("pin.row0",) if i == 1 else ())
        assert np.isfinite(command.tau).all()


# A contact that fades ----------------------------------------------------------------------


@functools.cache
def over_the_left_foot() -> np.ndarray:
    """Return a configuration with both feet at home and the mass over the left one."""
    robot = body("humanoid")
    model, data = robot.model, robot.model.createData()
    q, soles = robot.home.copy(), ("left_sole", "right_sole")
    goals = [robot.pose(robot.home, sole) for sole in soles]
    for _ in range(30):
        J, error = [], []
        for sole, goal in zip(soles, goals, strict=True):
            terms = oracles.frame_terms(model, q, np.zeros(robot.nv), sole)
            J.append(terms.J)
            error.append(pin.log6(terms.X_WF.actInv(goal)).vector)
        c = pin.centerOfMass(model, data, q)[:2]
        J.append(pin.jacobianCenterOfMass(model, data, q)[:2])
        error.append(goals[0].translation[:2] - c)
        q = robot.integrate(q, np.linalg.pinv(np.vstack(J)) @ np.concatenate(error))
    assert np.abs(np.concatenate(error)).max() < 1e-9
    return q


class Fade(NamedTuple):
    """What happened while the right foot gave up its force, stayed without, and was let go."""

    torques: np.ndarray
    reports: list[TickReport]
    start: int
    """Tick at which its force begins to fade."""
    switch: int
    """Tick at which it is let go."""

    @property
    def change(self) -> np.ndarray:
        """Largest change of a torque from each tick to the next [Nm]."""
        return np.abs(np.diff(self.torques, axis=0))


def fade(ticks: int, start: int = 20, wait: int = 5) -> Fade:
    """Let the right foot of `over_the_left_foot` give up its force, then the constraint on it."""
    controller, robot, q = stand(), body("humanoid"), over_the_left_foot()
    controller.reset()
    weight, own = 9.81 * pin.computeTotalMass(robot.model), 150.0
    memory, v, carried = controller.start("both", q), np.zeros(robot.nv), 0.0
    torques, reports, switch = [], [], start + ticks + wait
    for i in range(switch + 20):
        rate = robot.limits.tau_rate if i else np.full(robot.nu, 1e9)  # nobody walks at tick 0
        left = min(max(1 - (i - start) / ticks, 0.0), 1.0) if ticks else 1.0
        push = [np.array([0.0, 0, f, 0, 0, 0]) for f in (weight - own * left, own * left)]
        given = {"limits": Given(tau_rate=rate), "force left_sole": Given(F_ref=push[0])}
        if i < switch:
            given["force right_sole"] = Given(F_ref=push[1])
        if start <= i < switch:
            given["most right_sole"] = Given(limit=np.array(carried * left))
        now = Measurement(i * DT, q, v)
        mode = "both" if i < switch else "left"
        command, report, memory = controller.step(mode, now, {**here(q), **given}, memory)
        carried = report.contacts[1].wrench[2] if i < start else carried
        torques.append(command.tau)
        reports.append(report)
    controller.reset()
    return Fade(np.array(torques), reports, start, switch)


def test_a_foot_whose_force_fades_is_let_go_without_a_jump() -> None:
    done, robot = fade(100), body("humanoid")
    assert {report.status for report in done.reports} == {Status.OK}
    assert max(report.kkt_residual for report in done.reports) <= KKT_TOLERANCE
    wrenches = [r.contacts[1].wrench for r in done.reports[: done.switch]]
    assert wrenches[done.start - 1][2] > 30  # N
    assert np.abs(wrenches[-1]).max() <= 1e-3
    share = done.change[done.start :] / (robot.limits.tau_rate * DT)
    assert 0.005 < share.max() < 0.5
    largest = np.abs(done.torques).max()
    assert np.abs(done.torques[-1] - done.torques[done.start]).max() > 0.05 * largest
    assert done.change[done.switch - 1].max() < 1e-6 * largest


def test_a_foot_that_is_let_go_under_load_makes_the_torque_jump_as_far_as_its_rate_lets_it() -> (
    None
):
    done, robot = fade(0), body("humanoid")
    assert done.reports[done.switch - 1].contacts[1].wrench[2] > 30  # N
    step = done.change[done.switch - 1]
    assert step.max() > 0.01 * np.abs(done.torques).max()
    assert (step <= robot.limits.tau_rate * DT + INSIDE).all()
