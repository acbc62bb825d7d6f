"""Systems of an arm on exact constraints, against formulas that are written again here."""

import functools
import math
from collections.abc import Mapping

import numpy as np
import oracles
import pinocchio as pin
import polars as pl
import pytest

from qpctrl.arrays import Vector
from scenarios.robot_file import load_robot
from scenarios.study.study_file import READY, read_study, study_of
from scenarios.study.system import Rollout
from scenarios.study.systems import SYSTEMS
from scenarios.study.systems.arm.scene import arm

CLOSED_FORM = 1e-3  # relative, what the studies promise on the exact plant
SMALL_MOTION = 2e-3  # mobility at home in the place of that at rest, some mm away
EXACT = 1e-9
TURNED = 1e-6  # of a wrench that is one period older than the axes it is seen in

ASIDE: tuple[dict[str, float], ...] = (
    {"offset_y": 0.03, "radius": 0.35, "force": 8.0, "angle": 1e-3},
    {"offset_y": -0.05, "radius": 0.45, "force": 20.0, "angle": 1e-3},
)
"""Doors that stay closed, hinged aside."""

STUDIES = ("hinge-axis", "hinge-offset", "rank", "tilt", "tilt-friction", "tilt-mujoco")


@functools.lru_cache(maxsize=64)
def _rolled(system: str, controller: str, given: tuple[tuple[str, float], ...]) -> Rollout:
    usual = {name: p.usual for name, p in SYSTEMS[system].parameters.items()}
    return SYSTEMS[system].run({**usual, **dict(given)}, controller, 0)


def rolled(system: str, controller: str = "qp", **changes: float) -> Rollout:
    """Return a rollout, made once; the table of another controller's is not shared."""
    return _rolled(system, controller, tuple(changes.items()))


def measured(system: str, controller: str = "qp", **changes: float) -> Mapping[str, float]:
    """Return the measures of a rollout that has all it was asked for."""
    found = rolled(system, controller, **changes).measures
    assert set(found) == set(SYSTEMS[system].measures)
    return {name: math.nan if value is None else value for name, value in found.items()}


def last(table: pl.DataFrame, robot, prefix: str) -> Vector:
    """Return the joints' values at the last tick."""
    return np.array([table[f"{prefix}.{name}"][-1] for name in robot.joint_names])


def wrench(table: pl.DataFrame, tick: int = -1) -> Vector:
    """Return the true wrench (6) of a tick."""
    return np.array([table[f"wrench.{x}"][tick] for x in ("fx", "fy", "fz", "mx", "my", "mz")])


@pytest.mark.parametrize("name", STUDIES)
def test_ready_studies_judge_every_closed_form_that_they_show(name: str) -> None:
    study = study_of(read_study(READY / f"{name}.toml"))
    judged = {limit.measure: limit.limit for limit in study.criteria}
    assert judged["fallback_ticks"] == judged["diverged"] == 0.0
    if name != "tilt-mujoco":
        for shown in study.show:
            if f"{shown}_gap" in study.measures:
                assert judged[f"{shown}_gap"] == CLOSED_FORM


@pytest.mark.parametrize(
    ("system", "one", "other"),
    [
        ("hinge", ASIDE[0], ASIDE[1]),
        ("rows", {"rank_error": -1.0, "turn": 0.5}, {"rank_error": -1.0, "cutoff": 1.0}),
        ("arm-on-plane", {"sensor_bias": 2.0, "tilt": 10.0}, {"sensor_bias": 2.0, "k_fi": 0.0}),
    ],
)
def test_a_rollout_does_not_depend_on_those_before_it(
    system: str, one: dict[str, float], other: dict[str, float]
) -> None:
    first = rolled(system, **one)
    assert not rolled(system, **other).table.equals(first.table)
    assert _rolled.__wrapped__(system, "qp", tuple(one.items())).table.equals(first.table)


# A wrong hinge -------------------------------------------------------------------------------


@pytest.mark.parametrize("aside", ASIDE)
def test_a_hinge_aside_turns_the_wrench_by_what_the_true_one_cannot_hold(
    aside: dict[str, float],
) -> None:
    """Closed: n_b = (v_b, 1) = (r, 1) across, n_t · F_d = −f o, so W − F_d = f o / (1 + r²) n_b."""
    found, (offset, radius, force, _) = measured("hinge", **aside), aside.values()
    beta = force * offset / (1 + radius**2)
    assert found["moment_Nm"] == pytest.approx(beta, rel=CLOSED_FORM)
    assert found["across_N"] == pytest.approx(beta * radius, rel=CLOSED_FORM)
    way = math.atan2(offset, radius)  # the radial force is that of F_d and of the one across
    radial = math.cos(way) + beta * radius / force * math.sin(way)
    assert found["force_ratio"] == pytest.approx(radial, rel=CLOSED_FORM)


@pytest.mark.parametrize(("k_fi", "k_fp"), [(0.0, 0.0), (0.0, 0.5), (100.0, 0.5)])
def test_the_wrench_in_an_open_door_is_what_the_law_commands_there(
    k_fi: float, k_fp: float
) -> None:
    """W = P Λ K_p X_free + (I − P) F_cmd, written out at the pose in which the arm rests."""
    tilted = {"offset_x": 0.02, "offset_y": -0.03, "tilt_x": 6.0, "tilt_y": -4.0, "angle": 10.0}
    rollout, k_fp = rolled("hinge", k_fi=k_fi, **tilted), 0.5
    robot, table = load_robot("fr3"), rollout.table
    q, W = last(table, robot, "q"), wrench(table)
    terms = oracles.body_terms(robot.model, q, np.zeros(7), "flange", list(range(6)))
    X_W0 = robot.pose(robot.home, "flange")
    side = np.cross([0, 0, 1.0], X_W0.rotation[:, 2])
    z, hinge_at = np.array([0, 0, 1.0]), X_W0.translation + 0.35 * side / np.linalg.norm(side)
    asked = pin.SE3(pin.exp3(-np.radians(10.0) * z), np.zeros(3))
    about = pin.SE3(np.eye(3), hinge_at)
    X_e = pin.log6(terms.X_WF.actInv(about * asked * about.inverse() * X_W0)).vector
    R, arm_W = terms.X_WF.rotation, terms.X_WF.translation - hinge_at
    n_b = np.r_[R.T @ np.cross(-z, arm_W), R.T @ -z]
    A = np.linalg.svd(n_b[np.newaxis])[2][1:]  # any five rows across the believed freedom
    carried, P = A.T @ A, oracles.projector(A, terms.Lambda_inv)
    out = R.T @ np.array([arm_W[0], arm_W[1], 0.0])
    F_d = np.r_[8.0 * out / np.linalg.norm(out), 0, 0, 0]
    moving = P @ terms.Lambda @ (2500.0 * (X_e - carried @ X_e))
    error = float(np.linalg.norm(W - F_d))
    assert error > 0.1
    if k_fi > 0:
        assert carried @ W == pytest.approx(carried @ F_d, abs=CLOSED_FORM * error)
        assert np.abs(P @ (W - moving)).max() < CLOSED_FORM * error
    else:
        F_cmd = F_d + k_fp * (F_d - carried @ W)
        commanded = moving + (np.eye(6) - P) @ F_cmd
        assert commanded == pytest.approx(W, abs=CLOSED_FORM * error)
    for name in ("force_ratio", "across_N", "moment_Nm", "lag_deg", "normal_error_deg"):
        assert (rollout.measures[f"{name}_gap"] or 0.0) < CLOSED_FORM


def test_the_way_of_the_handle_is_wrong_by_the_angle_between_both_radii() -> None:
    offset, radius, angle = complex(0.05, 0.04), 0.35, 12.0
    found = measured("hinge", offset_x=offset.real, offset_y=offset.imag, angle=angle)
    turn = np.exp(-1j * np.radians(np.linspace(0.0, angle, 1000)))
    handle = offset + turn * (radius - offset)
    error = np.abs(np.angle(handle / (handle - offset)))
    bound = math.atan(abs(offset) / radius)
    assert found["normal_error_share"] == pytest.approx(error.max() / bound, rel=0.02)
    assert math.sin(error.max()) <= abs(offset) / abs(radius - offset)
    assert error.min() < np.radians(found["normal_error_deg"]) < error.max()


def test_a_hinge_without_friction_takes_no_energy_and_a_right_one_makes_no_error() -> None:
    wrong, right = measured("hinge", **ASIDE[0]), measured("hinge", **{**ASIDE[0], "offset_y": 0.0})
    assert abs(wrong["energy_J"]) < EXACT < 0.1 < abs(wrong["moment_Nm"])
    assert abs(right["moment_Nm"]) < EXACT
    assert right["force_ratio"] == pytest.approx(1.0, abs=EXACT)
    assert wrong["constraint_peak_N"] > right["constraint_peak_N"] > 8.0 * (1 - CLOSED_FORM)


# Wrong rows ----------------------------------------------------------------------------------


def mobility() -> np.ndarray:
    """Return Λ⁻¹ (6×6) of the FR3's flange at home, along the axes of the plane there."""
    robot = load_robot("fr3")
    terms = oracles.body_terms(robot.model, robot.home, np.zeros(7), "flange", list(range(6)))
    return terms.Lambda_inv


@pytest.mark.parametrize("controller", ["qp", "textbook"])
@pytest.mark.parametrize(("rank_error", "turn"), [(-1.0, 0.5), (-2.0, -0.25)])
def test_a_forgotten_row_is_pushed_by_the_stiffness_of_the_motion(
    controller: str, rank_error: float, turn: float
) -> None:
    """Moment Λ_eff K_p e, Λ_eff⁻¹ the mobility of the tips while what is believed held is held."""
    believed, forgotten = ([2, 3], [4]) if rank_error == -1 else ([2], [3, 4])
    S = mobility()
    held = S - S[:, believed] @ np.linalg.solve(S[np.ix_(believed, believed)], S[believed])
    effective = np.linalg.inv(held[np.ix_(forgotten, forgotten)])[-1, -1]
    found = measured("rows", controller, rank_error=rank_error, turn=turn)
    moment = effective * 900.0 * np.radians(turn)
    assert abs(moment) > 0.5
    assert found["moment_Nm"] == pytest.approx(moment, rel=SMALL_MOTION)
    assert abs(found["force_ratio"] - 1) > 0.1  # inertia couples it into the force
    for name in ("force_ratio", "moment_Nm", "offset_mm"):
        assert found[f"{name}_gap"] < 1e-5


def test_an_integral_restores_the_force_and_leaves_the_moment() -> None:
    without, found = (measured("rows", rank_error=-2.0, k_fi=k_fi) for k_fi in (0.0, 100.0))
    assert found["force_ratio"] == pytest.approx(1.0, abs=1e-6)
    assert found["moment_Nm"] == pytest.approx(without["moment_Nm"], rel=1e-4)
    assert found["pressure_mm"] == pytest.approx(1e3 * abs(found["moment_Nm"]) / 20.0, rel=1e-3)


def test_what_is_fed_forward_of_a_forgotten_row_feeds_itself() -> None:
    calm = measured("rows", rank_error=-1.0)["moment_Nm"]
    table = rolled("rows", rank_error=-1.0, cutoff=1.0).table
    growth = (wrench(table)[4] - wrench(table, -101)[4]) / 0.1 / calm
    assert growth == pytest.approx(2 * math.pi, rel=4e-3)  # 1 − exp(−2π f_c dt) is 0.3 % less
    assert measured("rows", rank_error=-1.0, cutoff=1.0)["growth_1_s_gap"] < 1e-5


def test_the_right_rows_ask_nothing_of_a_pose_that_the_plane_does_not_allow() -> None:
    found = measured("rows", turn=1.0, cutoff=1.0, side_force=9.0)
    assert found["force_ratio"] == pytest.approx(1.0, abs=EXACT)
    assert found["pressure_mm"] < EXACT


def free_inertia() -> float:
    """Return Λ [kg] along x while the plane holds the face, from M and the rows of both."""
    robot = load_robot("fr3")
    terms = oracles.body_terms(robot.model, robot.home, np.zeros(7), "flange", list(range(6)))
    AJ = terms.J[[2, 3, 4]]
    kkt = np.block([[terms.M, AJ.T], [AJ, np.zeros((3, 3))]])
    a = np.linalg.solve(kkt, np.r_[terms.J[0], np.zeros(3)])[:7]
    return 1 / float(terms.J[0] @ a)


def test_a_row_too_many_lets_the_tool_drift_with_the_square_of_time() -> None:
    """½ (f / Λ) t² and f t / Λ, with feedback (1 + K_fp) of it."""
    force, t, Lambda = 0.05, 0.199, free_inertia()
    for k_fp in (0.0, 0.5):
        found = measured("rows", rank_error=1.0, side_force=force, k_fp=k_fp)
        a = (1 + k_fp) * force / Lambda
        assert found["drift_mm"] == pytest.approx(1e3 * a * t**2 / 2, rel=CLOSED_FORM)
        assert found["drift_speed_m_s"] == pytest.approx(a * t, rel=CLOSED_FORM)


def test_damping_ends_the_drift_at_the_force_over_the_damping() -> None:
    found = measured("rows", rank_error=1.0, side_force=0.2, damping=50.0, duration=0.4)
    assert found["drift_speed_m_s"] == pytest.approx(
        1.5 * 0.2 / (50.0 * free_inertia()), rel=CLOSED_FORM
    )
    assert found["drift_speed_m_s_gap"] < CLOSED_FORM
    assert found["force_ratio_gap"] < 1e-5


# A plane that rubs, a sensor that is biased, and MuJoCo ----------------------------------------


@pytest.mark.parametrize(
    ("tilt", "mu", "direction"), [(10.0, 0.3, 0.0), (10.0, 0.3, 1.0), (-5.0, 0.5, 1.0)]
)
def test_friction_adds_or_takes_force_with_the_way_of_the_slide(
    tilt: float, mu: float, direction: float
) -> None:
    slow = {"speed": 0.05, "k_fi": 300.0}
    found = measured("arm-on-plane", tilt=tilt, friction=mu, direction=direction, **slow)
    a, sigma = math.radians(tilt), 1 - 2 * direction
    answer = 1 / (math.cos(a) + sigma * mu * math.sin(a))
    assert found["slide_ratio"] == pytest.approx(answer, rel=CLOSED_FORM)
    assert found["friction_ratio"] == pytest.approx(mu, rel=TURNED)
    assert found["speed_m_s"] == pytest.approx(0.05 / math.cos(a), rel=CLOSED_FORM)
    assert math.isnan(found["offset_mm_closed"])  # friction decides where it rests


def test_a_biased_sensor_takes_its_share_of_the_set_point() -> None:
    """(f_d − b) / cos α with an integral; the reading's share K_fp / (1 + K_fp) of it without."""
    flat, tilted = (measured("arm-on-plane", sensor_bias=2.0, tilt=tilt) for tilt in (0.0, 10.0))
    proportional = measured("arm-on-plane", sensor_bias=2.0, k_fi=0.0)
    assert flat["force_ratio"] == pytest.approx(0.8, rel=1e-4)
    assert tilted["force_ratio"] == pytest.approx(0.8 / math.cos(math.radians(10)), rel=1e-4)
    assert proportional["force_ratio"] == pytest.approx(1 - 0.2 / 3, rel=1e-4)
    assert proportional["slide_ratio"] == pytest.approx(1 - 0.2 / 3, rel=CLOSED_FORM)


def test_damping_gives_way_to_a_plane_that_comes_nearer() -> None:
    """Without integral λ / g = f_d − d v tan α / (S (1 + K_fp)), for g cos α near 1."""
    damped, free = (measured("arm-on-plane", tilt=10.0, k_fi=0.0, damping=d) for d in (20.0, 0.0))
    S = mobility()[2, 2]
    less = 20.0 * 0.1 * math.tan(math.radians(10)) / S / (1.5 * 10.0)
    assert less > 0.1
    assert free["slide_ratio"] - damped["slide_ratio"] == pytest.approx(less, rel=0.03)
    assert damped["slide_ratio_gap"] < CLOSED_FORM


def test_a_ball_on_a_soft_board_presses_alike_but_is_pushed_aside_less() -> None:
    """Force 1/cos α in any world; the offset knows that the ball touches beside its end."""
    settings = {"plant": 1.0, "tilt": 10.0, "k_fi": 100.0}
    rollout = rolled("arm-on-plane", **settings)
    found, a = measured("arm-on-plane", **settings), math.radians(10.0)
    assert found["force_ratio"] == pytest.approx(1 / math.cos(a), rel=1e-4)
    assert found["speed_m_s"] == pytest.approx(0.1 / math.cos(a), rel=CLOSED_FORM)
    held, rest = arm("fr3", "mujoco"), 399
    q = np.array([rollout.table[f"q.{name}"][rest] for name in held.robot.joint_names])
    terms = oracles.body_terms(held.robot.model, q, np.zeros(7), held.frame, list(range(6)))
    R_FE = terms.X_WF.rotation.T @ held.X_WE.rotation
    n = R_FE @ [0.0, -math.sin(a), math.cos(a)]
    A_b = np.r_[R_FE[:, 2], 0, 0, 0]
    P = oracles.projector(A_b[np.newaxis], terms.Lambda_inv)
    offsets = []
    for r in (0.0, 0.01):  # a point, the ball
        W = 10.0 / math.cos(a) * np.r_[n, np.cross(r * (n - [0, 0, 1.0]), n)]
        offsets.append(1e3 * float(R_FE[:, 1] @ (terms.Lambda_inv @ P @ W)[:3]) / 2500.0)
    assert found["offset_mm"] == pytest.approx(offsets[1], rel=CLOSED_FORM)
    assert abs(offsets[1] / offsets[0] - 1) > 0.01


def test_mujoco_is_as_stiff_as_its_bodies_are_heavy_in_the_reference_posture() -> None:
    """λ = m d² δ / ((d_max T)² (1 − d)), m not the arm's own mass along the normal."""
    found = measured("arm-on-plane", plant=1.0, tilt=10.0, k_fi=100.0)
    model, depth = arm("fr3", "mujoco").world.model, 1e-3 * found["depth_mm"]
    mass = 1 / model.body("eraser/eraser").invweight0[0]
    d = 0.95 * 2 * (depth / 0.002) ** 2
    force = mass * d**2 * depth / ((0.95 * 0.01) ** 2 * (1 - d))
    assert depth < 0.001
    assert force == pytest.approx(10.0 * found["force_ratio"], rel=CLOSED_FORM)
    assert found["depth_mm_gap"] < CLOSED_FORM
    own = 1 / mobility_of_ball()
    assert abs(mass / own - 1) > 0.1


def mobility_of_ball() -> float:
    """Return the mobility [1/kg] of the ball along the normal at home."""
    held = arm("fr3", "mujoco")
    terms = oracles.body_terms(
        held.robot.model, held.robot.home, np.zeros(7), held.frame, list(range(6))
    )
    return float(terms.Lambda_inv[2, 2])
