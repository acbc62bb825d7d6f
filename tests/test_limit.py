"""Bounds that never cross, what a supply can drive, and the scale of a singularity."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import oracles
import pinocchio as pin
import pytest
from cases import (
    LAW_AGREEMENT,
    ROBOTS,
    SOLVER_FORMS,
    SPACES,
    Draw,
    Given,
    draw,
    given_mode,
    states,
    tick,
)

from qpctrl import Controller, InputError, Measurement, Robot, Status, from_pinocchio, limit
from qpctrl.fallback import HOLD_DAMPING
from qpctrl.space import _whole_mobility

KKT = 1e-9
"""Promised residual of every accepted tick."""

SOLVER_AGREEMENT = 1e-7
"""Promised relative agreement with another solver where limits are active."""

INSIDE = 1e-9
"""Nm, V: the promised residual of the inequality."""


def numbers(expression: ca.SX) -> np.ndarray:
    """Return a constant expression as an array."""
    return np.asarray(ca.evalf(expression)).ravel()


@pytest.mark.parametrize("last", [-90.0, -10.0, 0.0, 9.5, 90.0])
def test_torque_bounds_keep_room_inside_a_limit_that_was_just_lowered(last: float) -> None:
    u = {"tau_max": ca.SX(10), "tau_rate": ca.SX(1000), "tau_last": ca.SX(last)}
    u |= {"tau_stall": ca.SX(limit.UNBOUNDED), "tau_droop": ca.SX(0)}
    lb, ub = (numbers(side)[0] for side in limit.torque_bounds(u, ca.SX(1e-3), ca.SX(2)))
    inside = np.clip(last, -10, 10)
    assert -10 <= lb <= inside <= ub <= 10
    assert ub - lb >= 1.0  # at least one step of the rate


@pytest.mark.parametrize("q", [-9.0, -2.1, 0.0, 2.1, 9.0])
@pytest.mark.parametrize("v", [-3.0, 0.0, 3.0])
def test_acceleration_bounds_never_cross_however_far_outside(q: float, v: float) -> None:
    u = {
        "q_min": ca.SX(-2),
        "q_max": ca.SX(2),
        "v_max": ca.SX(2.5),
        "rates": ca.SX([limit.POSITION_RATE, limit.VELOCITY_RATE]),
    }
    lb, ub = (numbers(side)[0] for side in limit.acceleration_bounds(u, ca.SX(q), ca.SX(v)))
    assert lb <= ub
    if abs(v) <= 2.5 and abs(q) > 2.5:
        assert ub <= 0 if q > 0 else lb >= 0  # it comes back


def test_each_axis_is_measured_against_the_directions_of_its_own_unit() -> None:
    mobility = ca.SX(np.diag([1.0, 2.0, 3.0, 40.0, 50.0, 60.0]))
    assert numbers(_whole_mobility(mobility)).tolist() == [6.0] * 3 + [150.0] * 3


# Back-EMF: judged by the voltage that a torque takes ----------------------------------------


class Motors(NamedTuple):
    """Motors behind gears, as their data sheet has them: one of each per actuator."""

    R: np.ndarray
    """Winding resistance [Ω]."""
    k_t: np.ndarray
    """Torque constant at the joint, gear included [Nm/A, V s/rad]."""
    U: np.ndarray
    """Supply voltage [V]."""

    def limits(self, **others: np.ndarray) -> Given:
        """Return the limits that the supply sets, and ``others``."""
        line = {"tau_stall": self.k_t * self.U / self.R, "tau_droop": self.k_t**2 / self.R}
        return Given(line | others)

    def voltage(self, tau: np.ndarray, v_a: np.ndarray) -> np.ndarray:
        """Return what the torque takes from the supply [V]: R i + k_t v_a."""
        return self.R * tau / self.k_t + self.k_t * v_a

    def torque(self, U: np.ndarray, v_a: np.ndarray) -> np.ndarray:
        """Return the torque under a voltage [Nm]."""
        return self.k_t * (U - self.k_t * v_a) / self.R


def drawn_motors(rng: np.random.Generator, nu: int) -> Motors:
    """Return motors without a supply: droop of 0.1 to 2 Nm s/rad."""
    return Motors(rng.uniform(0.5, 2.0, nu), rng.uniform(0.5, 1.0, nu), np.zeros(nu))


@pytest.mark.parametrize("last", [-90.0, -9.0, 0.0, 9.0, 90.0])
@pytest.mark.parametrize("v", [-50.0, -9.0, -2.0, 0.0, 2.0, 9.0, 50.0])
def test_torque_bounds_are_what_the_supply_can_drive_and_never_cross(v: float, last: float) -> None:
    motors = Motors(np.array([1.0]), np.array([1.5]), np.array([8.0]))  # 12 Nm, 5.3 rad/s
    u = {name: ca.SX(value) for name, value in motors.limits().items()}
    u |= {"tau_max": ca.SX(10), "tau_rate": ca.SX(1e6), "tau_last": ca.SX(last)}
    lb, ub = (numbers(side) for side in limit.torque_bounds(u, ca.SX(1e-3), ca.SX(v)))
    reached = np.clip(motors.torque(np.array([-8.0, 8.0]), np.array([v, v])), -10, 10)
    assert [lb[0], ub[0]] == pytest.approx(reached)
    u["tau_rate"] = ca.SX(1000)  # a window of ±1 Nm
    lb, ub = (numbers(side) for side in limit.torque_bounds(u, ca.SX(1e-3), ca.SX(v)))
    inside = np.clip(last, *reached)
    assert reached[0] <= lb[0] <= inside <= ub[0] <= reached[1]
    assert [lb[0], ub[0]] == pytest.approx(np.clip([inside - 1, inside + 1], *reached))


@pytest.mark.parametrize("v", [-1e3, 0.0, 1e3])
def test_motors_without_a_stall_torque_have_no_line_whatever_their_droop(v: float) -> None:
    none = limit.UNBOUNDED
    u = {"tau_stall": ca.SX(none), "tau_droop": ca.SX(7.0), "tau_max": ca.SX(none)}
    u |= {"tau_rate": ca.SX(none), "tau_last": ca.SX(3.0)}
    lb, ub = (numbers(side)[0] for side in limit.torque_bounds(u, ca.SX(1e-3), ca.SX(v)))
    assert lb <= -none / 1e4
    assert ub >= none / 1e4
    u["tau_max"] = ca.SX(20.0)
    bounds = [numbers(side)[0] for side in limit.torque_bounds(u, ca.SX(1e-3), ca.SX(v))]
    assert bounds == [-20.0, 20.0]


class Limited(NamedTuple):
    """A state and commands, with motors near the voltage that the hybrid law takes."""

    q: np.ndarray
    v: np.ndarray
    drawn: Draw
    hybrid: np.ndarray
    motors: Motors


def limited_states(name: str, k: int, count: int, room: tuple[float, float]) -> Iterator[Limited]:
    """Yield states whose supply is ``room`` (from, to) times what the hybrid law takes."""
    robot, space = ROBOTS[name](), SPACES[name]
    for q, v, rng in states(robot, space, count, seed=40 + k):
        drawn = draw(rng, k, space.n, robot.nv)
        hybrid = oracles.hybrid(*oracle_terms(name, q, v, drawn))
        motors = drawn_motors(rng, robot.nu)
        takes = np.abs(motors.voltage(hybrid, v))
        U = np.maximum(takes * rng.uniform(*room, robot.nu), 0.1)
        yield Limited(q, v, drawn, hybrid, motors._replace(U=U))


def oracle_terms(
    name: str, q: np.ndarray, v: np.ndarray, drawn: Draw
) -> tuple[oracles.BodyTerms, oracles.Rows, oracles.Wanted]:
    """Return what the oracles need of a state."""
    terms = oracles.body_terms(ROBOTS[name]().model, q, v, "tool", SPACES[name].index)
    rows = oracles.Rows(drawn.A, drawn.A_dot_V, drawn.v_c_dot)
    return terms, rows, oracles.Wanted(drawn.a_cmd, drawn.F_cmd, drawn.F_ext, drawn.a_post)


def make_controller(robot: Robot, k: int, **options: Any) -> Controller:
    """Return a controller of its own, as limits stay in its inputs."""
    space = SPACES["planar_2r" if robot.nv == 2 else "arm_7"]
    return Controller(robot, [given_mode(robot, space, k)], **options)


LIMITED_ROWS = [("planar_2r", 1), ("arm_6", 5), ("arm_7", 0), ("arm_7", 3)]


@pytest.mark.parametrize("form", ["reduced", "full"])
def test_a_moving_arm_at_its_supply_voltage_is_at_the_optimum_on_the_line(form: str) -> None:
    met = set()
    for name, k in LIMITED_ROWS:
        controller = make_controller(ROBOTS[name](), k, form=form)
        joints = controller.robot.joint_names
        for q, v, drawn, _, motors in limited_states(name, k, 12, (0.5, 1.4)):
            given = {**drawn.references(), "limits": motors.limits()}
            command, report, _ = tick(controller, q, v, given)
            assert report.status is Status.OK
            assert report.kkt_residual <= KKT
            lowest, highest = motors.torque(-motors.U, v), motors.torque(motors.U, v)
            assert (command.tau >= lowest - INSIDE).all()
            assert (command.tau <= highest + INSIDE).all()
            for bound in report.active:
                assert bound.name.startswith("torque-speed ")
                i = joints.index(bound.name.removeprefix("torque-speed "))
                line = highest[i] if bound.dual > 0 else lowest[i]
                assert command.tau[i] == pytest.approx(line, rel=0, abs=INSIDE)
                met.add((np.sign(v[i]), np.sign(bound.dual)))
            best = oracles.limited_optimum(
                *oracle_terms(name, q, v, drawn), (1.0, 1.0, 1.0), lowest, highest
            )
            far = np.abs(command.tau - best.tau).max()
            assert far < SOLVER_AGREEMENT * np.abs(best.tau).max()
            assert report.saturated == bool(report.active)
    assert met == {(1, 1), (1, -1), (-1, 1), (-1, -1)}


@pytest.mark.parametrize(("name", "k"), LIMITED_ROWS)
def test_a_moving_arm_with_enough_voltage_follows_the_hybrid_law(name: str, k: int) -> None:
    controller = make_controller(ROBOTS[name](), k)
    for q, v, drawn, hybrid, motors in limited_states(name, k, 12, (1.001, 1.01)):
        given = {**drawn.references(), "limits": motors.limits()}
        command, report, _ = tick(controller, q, v, given)
        assert not report.active
        assert not report.saturated
        assert report.law_gap < LAW_AGREEMENT
        assert np.abs(command.tau - hybrid).max() < LAW_AGREEMENT * np.abs(hybrid).max()


@pytest.mark.parametrize(("solver", "form"), SOLVER_FORMS)
@pytest.mark.parametrize("fast", [(2,), (0, 3, 5), tuple(range(7))])
def test_joints_beyond_their_no_load_speed_keep_the_tick_feasible(
    fast: tuple[int, ...], solver: str, form: str
) -> None:
    robot = ROBOTS["arm_7"]()
    controller = make_controller(robot, 3, solver=solver, form=form)
    joints, wanted = list(fast), 0
    for q, v, rng in states(robot, SPACES["arm_7"], 4, seed=60):
        drawn = draw(rng, 3, 6, 7)
        v[joints] = 10.0 * np.where(v[joints] > 0, 1, -1)
        motors = Motors(np.ones(7), np.full(7, 6.0), np.full(7, 30.0))  # no load: 5 rad/s
        tau_max = np.full(7, 80.0)
        lowest, highest = (np.clip(motors.torque(U, v), -80, 80) for U in (-motors.U, motors.U))
        assert (lowest[joints] == highest[joints]).all()
        given = {**drawn.references(), "limits": motors.limits(tau_max=tau_max)}
        command, report, _ = tick(controller, q, v, given)
        assert report.status is Status.OK
        assert report.kkt_residual <= KKT
        assert command.tau[joints] == pytest.approx(-80 * np.sign(v[joints]), abs=INSIDE)
        assert (lowest - INSIDE <= command.tau).all()
        assert (command.tau <= highest + INSIDE).all()
        names = {(bound.name, np.sign(bound.dual)) for bound in report.active}
        for i in joints:  # held by the supply where it wants to brake less, else by the current
            name, side = robot.joint_names[i], np.sign(v[i])
            assert names & {(f"torque-speed {name}", side), (f"torque {name}", -side)}
            wanted += (f"torque-speed {name}", side) in names
    assert wanted > 0


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("name", "tau_max", "tau_rate", "stall"),
    [
        ("torque elbow", 6.0, 1e9, 50.0),
        ("torque rate elbow", 50.0, 4000.0, 50.0),
        ("torque-speed elbow", 50.0, 1e9, 6.0),
    ],
)
def test_current_rate_and_supply_are_named_apart(
    name: str, tau_max: float, tau_rate: float, stall: float, side: float
) -> None:
    robot = ROBOTS["planar_2r"]()
    q, v, a = robot.home, np.array([0.3, -0.7]), side * np.array([20.0, 30.0])
    terms = oracles.body_terms(robot.model, q, v, "tool", SPACES["planar_2r"].index)
    limits = {"tau_max": tau_max, "tau_rate": tau_rate, "tau_stall": stall, "tau_droop": 2.0}
    given = {
        "motion": Given(a_cmd=terms.J @ a + terms.J_dot_v),
        "limits": Given({key: np.array([1e9, value]) for key, value in limits.items()}),
    }
    given["limits"]["tau_droop"][0] = 0.0
    tau_last = np.array([20.0, 1.0])
    command, report, _ = tick(make_controller(robot, 0), q, v, given, tau_last=tau_last)
    at = {"torque elbow": side * 6, "torque rate elbow": 1 + side * 4}
    assert command.tau[1] == pytest.approx(at.get(name, side * 6 + 2.0 * 0.7), abs=INSIDE)
    assert [bound.name for bound in report.active] == [name]
    assert np.sign(report.active[0].dual) == side
    words = "upper" if side > 0 else "lower"
    assert f"{name} at its {words} limit (dual" in report.explain()
    assert report.saturated


@pytest.mark.parametrize("turn", [1.0, -1.0])
@pytest.mark.parametrize("form", ["reduced", "full"])
def test_the_speed_is_that_of_the_actuator_not_of_the_joint(form: str, turn: float) -> None:
    """The second motor sits on the first link and turns both joints against each other."""
    B = np.array([[1.0, -1.0], [0.0, 1.0]])
    robot = from_pinocchio(
        ROBOTS["planar_2r"]().model, home=np.array([0.4, 0.9]), B=B, tau_rate=1e9
    )
    controller = make_controller(robot, 0, form=form)
    motors = Motors(np.ones(2), np.array([1.5, 1.2]), np.array([1e4, 15.0]))
    v, given = turn * np.array([1.5, -2.0]), {"motion": Given(a_cmd=np.array([-90.0, 60.0]))}
    command, report, _ = tick(controller, robot.home, v, {**given, "limits": motors.limits()})
    assert [bound.name for bound in report.active] == ["torque-speed actuator 1"]
    side = np.sign(report.active[0].dual)
    assert motors.voltage(command.tau, B.T @ v)[1] == pytest.approx(side * 15.0, abs=INSIDE)
    weaker = motors._replace(U=np.array([1e4, 1.5]))
    command, _, _ = tick(controller, robot.home, v, {**BLIND, "limits": weaker.limits()})
    assert command.fallback
    assert weaker.voltage(command.tau, B.T @ v)[1] == pytest.approx(turn * 1.5, abs=INSIDE)


# What else limits a torque ------------------------------------------------------------------

WEAK = Motors(np.ones(2), np.array([2.0, 1.5]), np.array([5.0, 2.0]))
"""Motors that cannot hold the planar arm at home: 10 and 3 Nm of 21 and 2.6 at rest."""

BLIND = {"motion": Given(a_cmd=np.full(2, np.nan))}


def weak_arm() -> Robot:
    """Return the planar arm with weak motors, as its own limits say."""
    free = ROBOTS["planar_2r"]()
    return replace(free, limits=replace(free.limits, **WEAK.limits()))


def test_a_controller_starts_with_what_the_supply_can_hold() -> None:
    robot = weak_arm()
    memory = make_controller(robot, 1).start("contact", robot.home)
    gravity = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.home)
    assert gravity[0] > 20
    assert memory.tau == pytest.approx([10.0, gravity[1]])


@pytest.mark.parametrize("speed", [-4.0, -1.0, 1.0, 4.0])
@pytest.mark.parametrize("law", ["qp", "hybrid", "textbook"])
def test_the_fallback_asks_no_more_than_the_supply_gives(law: Any, speed: float) -> None:
    robot = weak_arm()
    v = np.array([speed, 0.5])
    command, report, _ = tick(make_controller(robot, 1, law=law), robot.home, v, BLIND)
    assert report.status is Status.NOT_FINITE
    assert command.fallback
    data = robot.model.createData()
    M = pin.crba(robot.model, data, robot.home)
    gravity = pin.computeGeneralizedGravity(robot.model, data, robot.home)
    needed = WEAK.voltage(gravity - HOLD_DAMPING * np.diag(M) * v, v)
    assert WEAK.voltage(command.tau, v) == pytest.approx(np.clip(needed, -WEAK.U, WEAK.U))
    sides = {-4.0: 1, -1.0: 1, 1.0: 0, 4.0: -1}  # it holds with all there is, or brakes
    assert np.trunc(needed / WEAK.U).clip(-1, 1).tolist() == [sides[speed], 0]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_the_fallback_is_limited_at_the_speed_it_believes(bad: float) -> None:
    robot = weak_arm()
    controller = make_controller(robot, 1)
    given = {"motion": Given(a_cmd=np.zeros(2))}
    first = Measurement(0.0, robot.home, np.zeros(2))
    memory = controller.start("contact", robot.home)
    _, _, memory = controller.step("contact", first, given, memory)
    moved = Measurement(0.001, robot.home + np.array([-0.001, 0.0]), np.array([bad, 0.0]))
    command, report, memory = controller.step("contact", moved, given, memory)
    assert report.status is Status.NOT_FINITE
    assert WEAK.voltage(command.tau, np.array([-1.0, 0.0]))[0] == pytest.approx(5.0)
    old = moved._replace(v=np.array([-1.0, 0.0]))  # nothing new: taken as at rest
    command, report, _ = controller.step("contact", old, given, memory)
    assert report.status is Status.STALE
    assert WEAK.voltage(command.tau, np.zeros(2))[0] == pytest.approx(5.0)


@pytest.mark.parametrize("push", [1.0, -1.0])
@pytest.mark.parametrize("law", ["hybrid", "textbook"])
def test_a_closed_form_that_is_sent_asks_no_more_than_the_supply_gives(
    law: Any, push: float
) -> None:
    robot = weak_arm()
    given = {"motion": Given(a_cmd=push * np.array([80.0, -90.0]))}
    for v in np.array([[0.5, 1.0], [-0.5, 1.0], [0.5, -1.0], [-0.5, -1.0]]):
        command, report, memory = tick(make_controller(robot, 1, law=law), robot.home, v, given)
        assert report.status is Status.OK
        law_torque = {"hybrid": report.tau_hybrid, "textbook": report.tau_textbook}[law]
        needed = WEAK.voltage(law_torque, v)
        assert (np.abs(needed) > WEAK.U).all()
        assert WEAK.voltage(command.tau, v) == pytest.approx(np.sign(needed) * WEAK.U)
        assert np.array_equal(memory.tau, command.tau)


def test_the_line_may_be_changed_between_ticks() -> None:
    robot = ROBOTS["planar_2r"]()
    controller = make_controller(robot, 1)
    inputs, v = controller.engines["contact"].inputs, np.array([1.0, -0.5])
    given = {"motion": Given(a_cmd=np.array([5.0, 5.0]))}
    free, report, _ = tick(controller, robot.home, v, given)
    assert not report.active
    half = WEAK._replace(U=0.5 * WEAK.voltage(free.tau, v))
    assert (half.U > 0).all()
    command, report, _ = tick(controller, robot.home, v, {**given, "limits": half.limits()})
    assert half.voltage(command.tau, v).max() == pytest.approx(half.U.max(), abs=INSIDE)
    assert report.saturated
    inputs["limits.tau_stall"][:] = limit.UNBOUNDED
    command, report, _ = tick(controller, robot.home, v, given)
    assert command.tau == pytest.approx(free.tau, rel=LAW_AGREEMENT)
    assert not report.active
    inputs["limits.tau_stall"][:] = half.limits()["tau_stall"]
    inputs["limits.tau_droop"][:] = 0.0
    command, report, _ = tick(controller, robot.home, v, given)
    reached = np.isclose(command.tau, half.limits()["tau_stall"], rtol=0, atol=INSIDE)
    assert [bound.name for bound in report.active] == [
        f"torque-speed {robot.joint_names[i]}" for i in np.flatnonzero(reached)
    ]
    assert reached.any()


@pytest.mark.parametrize("name", limit.TORQUE_INPUTS[:-1])
def test_a_limit_that_is_no_number_leaves_the_fallback_the_robots_own(name: str) -> None:
    free = ROBOTS["planar_2r"]()
    own = WEAK.limits(tau_max=np.array([9.0, 9.0]), tau_rate=np.array([500.0, 500.0]))
    robot = replace(free, limits=replace(free.limits, **own))
    v = np.array([-1.0, 0.5])
    expected, _, _ = tick(make_controller(robot, 1), robot.home, v, BLIND)
    given = {**BLIND, "limits": Given({name: np.full(2, np.nan)})}
    command, report, _ = tick(make_controller(robot, 1), robot.home, v, given)
    assert report.status is Status.NOT_FINITE
    assert command.tau == pytest.approx(expected.tau)


def test_limits_have_no_line_unless_one_is_given() -> None:
    limits = ROBOTS["arm_7"]().limits
    assert limits.tau_stall.tolist() == [np.inf] * 7
    assert limits.tau_droop.tolist() == [0.0] * 7
    given = replace(limits, tau_stall=np.full(7, 50.0), tau_droop=np.full(7, 2.0))
    robot = replace(ROBOTS["arm_7"](), limits=given)
    inputs = make_controller(robot, 0).engines["contact"].inputs
    assert inputs["limits.tau_stall"].tolist() == [50.0] * 7
    assert inputs["limits.tau_droop"].tolist() == [2.0] * 7


@pytest.mark.parametrize(
    ("name", "bad", "says"),
    [
        ("tau_stall", [1.0, 0.0], "need values > 0"),
        ("tau_stall", [1.0, -2.0], "need values > 0"),
        ("tau_stall", [1.0, np.nan], "need finite numbers"),
        ("tau_stall", [1.0, -np.inf], "need finite numbers"),
        ("tau_stall", [1.0, 1.0, 1.0], r"got shape \(3,\), need \(2,\)"),
        ("tau_droop", [1.0, -1e-3], "need values >= 0"),
        ("tau_droop", [1.0, np.inf], "need finite numbers"),
        ("tau_droop", [1.0, np.nan], "need finite numbers"),
        ("tau_droop", [1.0], r"got shape \(1,\), need \(2,\)"),
        ("v_max", [1.0, -np.inf], "need finite numbers"),
    ],
)
def test_a_line_that_cannot_be_is_refused(name: str, bad: list[float], says: str) -> None:
    with pytest.raises(InputError, match=rf"{name}: .*{says}|{name}: {says}"):
        replace(ROBOTS["planar_2r"]().limits, **{name: np.array(bad)})
