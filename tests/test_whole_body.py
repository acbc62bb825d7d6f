"""Whole bodies: a tick against two answers that share no code with it, and against the plant."""

import functools
from typing import NamedTuple

import numpy as np
import oracles_whole_body as whole
import pytest
from cases import LAW_AGREEMENT, SOLVER_FORMS, Given, needs_compiler, tick
from cases_whole_body import (
    BODIES,
    Body,
    Commands,
    bodies,
    commands,
    costs_of,
    free_controller,
    inequalities,
    limited_controller,
    physics_of,
    unlimited,
)

from qpctrl import Controller, Measurement, Status, TickReport
from qpctrl.certificate import KKT_TOLERANCE

COUNT = 10
STEP = 1e-5
"""s, of a central difference."""

DIFFERENCE = 1e-6
"""m/s², rad/s²: a central difference of velocities of order 1 that change within 0.01 s."""

SOLVED = 1e-8
"""Relative to the largest torque: a tick whose KKT residual is 1e-9 at most."""


COMPILED = 1e-10
"""Relative: the same steps in C, with sums in another order."""


class Answer(NamedTuple):
    """A solution in the order of the bodies' contacts."""

    a: np.ndarray
    tau: np.ndarray
    lam: np.ndarray


def of_tick(controller: Controller, of: Body, report: TickReport) -> Answer:
    """Return the solution of the last tick, its multipliers in the order of the contacts."""
    (engine,) = controller.engines.values()
    starts, at = {}, 0
    for space in engine.tick.spaces:
        starts[space], at = at, at + sum(len(g.held.rows) for g in of.grips if g.space == space)
    parts = [
        report.lam[starts[grip.space] : starts[grip.space] + len(grip.held.rows)]
        for grip in of.grips
    ]
    a = engine.parts.point[0][: of.robot.nv].copy()
    return Answer(a, report.tau_qp, np.concatenate(parts))


def of_oracle(of: Body, z: np.ndarray) -> Answer:
    """Return z = (a, τ, λ) in its parts."""
    return Answer(*np.split(z, [of.robot.nv, of.robot.nv + of.robot.nu]))


def gap(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Return the largest difference over the largest entry."""
    return float(np.abs(ours - theirs).max() / np.abs(theirs).max())


class Case(NamedTuple):
    """One state with its commands and its independent physics and costs."""

    q: np.ndarray
    v: np.ndarray
    wanted: Commands
    physics: whole.Physics
    contacts: list[whole.Contact]
    moving: list[whole.Cost]
    pressing: list[whole.Cost]

    @property
    def costs(self) -> list[whole.Cost]:
        """All of them."""
        return [*self.moving, *self.pressing]


def case(of: Body, rng: np.random.Generator) -> Case:
    """Return a random one."""
    q, v = of.state(rng)
    wanted = commands(of, rng)
    physics, contacts = physics_of(of, q, v)
    costs = costs_of(of, q, v, wanted, physics, contacts)
    return Case(q, v, wanted, physics, contacts, *costs)


def without_pulling(name: str, count: int = COUNT) -> list[Case]:
    """Return random cases whose solution pulls on no contact that can only be pushed."""
    of, rng, found = bodies()[name], np.random.default_rng(5), []
    none = np.full(of.robot.nu, np.inf)
    while len(found) < count:
        one = case(of, rng)
        z = whole.null_space_optimum(one.costs, one.physics)
        G, d = inequalities(of, one.contacts, one.physics, none)
        pushes = np.isfinite(d) & ((G != 0).sum(axis=1) == 1) & (G.min(axis=1) == -1)
        if (G[pushes] @ z < 0).all():
            found.append(one)
    return found


@pytest.mark.parametrize("name", BODIES)
def test_a_tick_is_the_solution_of_the_constrained_least_squares(name: str) -> None:
    of, controller = bodies()[name], free_controller(name)
    for one in without_pulling(name):
        command, report, _ = tick(controller, one.q, one.v, one.wanted.references(of))
        assert (report.status, report.limited) == (Status.OK, False)
        expected = of_oracle(of, whole.null_space_optimum(one.costs, one.physics))
        for ours, theirs in zip(of_tick(controller, of, report), expected, strict=True):
            assert np.abs(theirs).max() > 0.5
            assert gap(ours, theirs) <= LAW_AGREEMENT
        assert np.array_equal(command.tau, report.tau_qp)
        assert report.kkt_residual <= KKT_TOLERANCE


@pytest.mark.parametrize("name", BODIES[1:])
def test_torque_and_contact_forces_are_those_of_projected_inverse_dynamics(name: str) -> None:
    of, controller = bodies()[name], free_controller(name)
    for one in without_pulling(name):
        _, report, _ = tick(controller, one.q, one.v, one.wanted.references(of))
        ours = of_tick(controller, of, report)
        tau, lam = whole.projected_inverse_dynamics(one.physics, ours.a, one.pressing)
        assert gap(ours.tau, tau) <= LAW_AGREEMENT
        assert gap(ours.lam, lam) <= LAW_AGREEMENT


def test_two_spaces_of_a_driven_robot_follow_the_operational_space_law_at_any_weights() -> None:
    of = bodies()["mobile arm"]
    controller = Controller(unlimited(of.robot), [of.mode(metric="inertia")])
    for one in without_pulling("mobile arm"):
        wishes = [
            whole.Wish(
                whole.motion_of(of.robot.model, one.q, one.v, space.frame), space.index, a_cmd
            )
            for space, a_cmd in zip(of.motions, one.wanted.motions, strict=True)
        ]
        law = whole.operational_space_law(
            one.physics, one.contacts[0], one.wanted.forces[0], wishes, one.wanted.a_post
        )
        for weights in ({}, dict.fromkeys(one.wanted.weights, 1.0)):
            wanted = one.wanted._replace(weights={**one.wanted.weights, **weights})
            _, report, _ = tick(controller, one.q, one.v, wanted.references(of))
            assert not report.limited
            assert gap(report.tau_qp, law) <= LAW_AGREEMENT


@pytest.mark.parametrize("name", BODIES)
def test_the_plant_does_what_the_tick_says_and_no_contact_moves(name: str) -> None:
    """ABA under torque and wrenches; the twist along A's rows by differences of the motion."""
    of, controller = bodies()[name], free_controller(name)
    model = of.robot.model
    for one in without_pulling(name, 5):
        _, report, _ = tick(controller, one.q, one.v, one.wanted.references(of))
        ours = of_tick(controller, of, report)
        lams = np.split(ours.lam, np.cumsum([len(c.A) for c in one.contacts])[:-1])
        pushes = [(c, c.A.T @ lam) for c, lam in zip(one.contacts, lams, strict=True)]
        force = of.robot.B @ ours.tau
        a = whole.accelerations(model, one.q, one.v, force, pushes)
        assert gap(ours.a, a) <= LAW_AGREEMENT
        left_alone = whole.accelerations(model, one.q, one.v, force, [])

        def rates(a: np.ndarray, one: Case = one) -> np.ndarray:
            found = []
            for side in (1, -1):
                q, v = whole.moved(model, one.q, one.v, a, side * STEP)
                now = [whole.contact_of(model, q, v, grip.held) for grip in of.grips]
                found.append(np.concatenate([c.A @ c.motion.V for c in now]))
            return (found[0] - found[1]) / (2 * STEP)

        assert np.abs(rates(a)).max() <= DIFFERENCE
        assert np.abs(rates(left_alone)).max() > 1


class Bounded(NamedTuple):
    """A case with limits that bind, and its solution within them."""

    case: Case
    tau_max: np.ndarray
    z: np.ndarray

    def references(self, of: Body) -> dict[str, Given]:
        """Return commands and limits."""
        limits = {"limits": Given(tau_max=self.tau_max)}
        return {**self.case.wanted.references(of), **limits}


@functools.cache
def bounded(name: str, count: int) -> list[Bounded]:
    """Return random cases with limits that some torque keeps, and others that bind."""
    of, rng, found = bodies()[name], np.random.default_rng(3), []
    while len(found) < count:
        one = case(of, rng)
        free = of_oracle(of, whole.null_space_optimum(one.costs, one.physics))
        tau_max = np.maximum(rng.uniform(0.5, 1.5, of.robot.nu) * np.abs(free.tau), 5.0)
        rows = inequalities(of, one.contacts, one.physics, tau_max)
        try:
            z = whole.null_space_optimum(one.costs, one.physics, *rows)
        except ValueError:  # quadprog: no torque keeps these
            continue
        assert gap(of_oracle(of, z).tau, free.tau) > 0.01
        found.append(Bounded(one, tau_max, z))
    return found


@pytest.mark.parametrize(
    ("name", "solver", "form"),
    [
        *(("grasp", *how) for how in SOLVER_FORMS),
        *(("mobile arm", "active-set", form) for form in ("reduced", "full")),
        *(("two arms", "active-set", form) for form in ("reduced", "full")),
        *(("humanoid", how, "reduced") for how in ("active-set", "proxsuite", "quadprog")),
        ("humanoid", "active-set", "full"),
    ],
)
def test_every_solver_finds_the_optimum_within_limits_in_both_forms(
    name: str, solver: str, form: str
) -> None:
    of = bodies()[name]
    controller = limited_controller(name, solver=solver, form=form)
    for one in bounded(name, 8):
        _, report, _ = tick(controller, one.case.q, one.case.v, one.references(of))
        assert report.status is Status.OK
        assert len(report.active) >= 2
        assert report.kkt_residual <= KKT_TOLERANCE
        assert gap(report.tau_qp, of_oracle(of, one.z).tau) <= SOLVED


def cannot_stop(of: Body) -> dict[str, Given]:
    """Return limits that ask all joints to stop within 5 ms, with 3 Nm."""
    slow = np.where(of.robot.B.any(axis=1), 0.05, 1e20)
    return {"limits": Given(tau_max=np.full(of.robot.nu, 3.0), v_max=slow)}


def test_limits_that_no_torque_can_keep_are_said_to_be_infeasible() -> None:
    of, controller = bodies()["humanoid"], limited_controller("humanoid")
    (one,) = bounded("humanoid", 1)
    references = {**one.references(of), **cannot_stop(of)}
    command, report, _ = tick(controller, one.case.q, one.case.v, references)
    assert report.status is Status.INFEASIBLE
    assert command.fallback
    assert np.abs(command.tau).max() == 3.0


@needs_compiler
def test_a_compiled_tick_of_a_floating_robot_is_the_interpreted_one() -> None:
    of = bodies()["grasp"]
    made, plain = (limited_controller("grasp", compile=how) for how in ("yes", "no"))
    cases = bounded("grasp", 30)
    states = [(one.case.q, one.case.v, one.references(of)) for one in cases]
    q, v, references = states[0]
    states += [(np.full(len(q), np.nan), v, references), (q, np.full(len(v), np.inf), references)]
    states += [(q, v, {**references, **cannot_stop(of)})]
    seen, same_rows = [], 0
    memories = [controller.start("two_arms", of.robot.home) for controller in (made, plain)]
    for i, (q, v, given) in enumerate(states):
        found = [
            controller.step("two_arms", Measurement(i * 1e-3, q, v), given, memory)
            for controller, memory in zip((made, plain), memories, strict=True)
        ]
        memories = [memory for _, _, memory in found]
        (one, ours, _), (other, theirs, _) = found
        assert (ours.status, one.fallback) == (theirs.status, other.fallback)
        assert gap(one.tau, other.tau) <= COMPILED
        if all(contact.wrench[2] > 1.0 for contact in theirs.contacts):  # N; else duals are many
            assert [row.name for row in ours.active] == [row.name for row in theirs.active]
            same_rows += 1
        for said, expected in zip(ours.contacts, theirs.contacts, strict=True):
            assert said.wrench == pytest.approx(expected.wrench, abs=SOLVED, nan_ok=True)
            assert said.margins == pytest.approx(expected.margins, abs=SOLVED, nan_ok=True)
        seen.append(ours.status)
    assert seen[-3:] == [Status.NOT_FINITE, Status.NOT_FINITE, Status.INFEASIBLE]
    assert set(seen[:-3]) == {Status.OK}
    assert same_rows > 10
