"""The mass on a wall: force, offset, speed, loss of contact and stability against closed forms."""

import cmath
import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import brentq

from qpctrl import InputError
from scenarios.study.study_file import find_study, read_study, study_of
from scenarios.study.system import DivergedError, Measures
from scenarios.study.systems import SYSTEMS

MASS = SYSTEMS["mass-on-wall"]
USUAL = {name: parameter.usual for name, parameter in MASS.parameters.items()}
m, f_d, K_p, g = 2.0, 20.0, 400.0, 9.81  # kg, N, 1/s², m/s²: what the controller believes
RIGID, COMPLIANT = 0.0, 1.0

EXACT = 1e-3  # relative; what is left of the transients of a run is far below
SIDES = (0.998, 1.002)  # of a critical gain: a run settles below and grows above
STUDIES = (
    *("tilt-holding", "tilt-sliding", "tilt-loss", "tilt-compliant", "model-error", "gain-limit"),
    *("proportional-limit", "delay-limit", "stiffness-limit", "integral-limit", "uncertainty"),
)


def run(controller: str = "qp", seed: int = 0, **given: float) -> Measures:
    """Return the measures of one rollout at 500 Hz; what is not given has its usual value."""
    return MASS.run({**USUAL, "rate": 500.0, **given}, controller, seed).measures


def limit(parameter: str, **given: float) -> float:
    """Return the closed form of a limit, which must be known."""
    found = MASS.limit({**USUAL, **given}, "qp", parameter)
    assert found is not None
    return found


def critical(L: object, low: float, high: float) -> float:
    """Return 1/|L(jω)| where the phase of L passes −π, the smallest between two rates ω [1/s]."""
    assert callable(L)
    rates = np.geomspace(low, high, 4000)
    found = []
    for a, b in pairwise(rates):
        if L(a).imag * L(b).imag < 0 and L(a).real < 0:
            omega = brentq(lambda w: L(w).imag, a, b, xtol=1e-12)
            found.append(1 / abs(L(omega)))
    return min(found)


# At rest and at a constant speed -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("k_fp", "k_fi"), [(0.0, 0.0), (0.5, 0.0), (0.5, 100.0)], ids=["FF", "P", "PI"]
)
@pytest.mark.parametrize("tilt", [-20.0, 10.0])
def test_a_wrong_normal_changes_force_and_place_at_rest_alike_for_every_force_law(
    tilt: float, k_fp: float, k_fi: float
) -> None:
    found, alpha = run(tilt=tilt, k_fp=k_fp, k_fi=k_fi, duration=0.7), math.radians(tilt)
    assert found["force_ratio"] == pytest.approx(1 / math.cos(alpha), rel=EXACT)
    offset = 1e3 * f_d * math.sin(alpha) / (m * K_p * math.cos(alpha) ** 2)
    assert found["offset_mm"] == pytest.approx(offset, rel=EXACT)
    assert found["force_ratio_closed"] == pytest.approx(1 / math.cos(alpha), rel=1e-12)
    assert found["offset_mm_closed"] == pytest.approx(offset, rel=1e-12)


def test_the_offset_is_that_of_the_printed_example() -> None:
    found = [run(tilt=tilt, duration=0.7)["offset_mm"] for tilt in (5.0, 10.0, 20.0)]
    assert found == pytest.approx([2.2, 4.5, 9.7], abs=0.05)


@pytest.mark.parametrize(
    ("controller", "tilt", "sigma"),
    [("qp", 15.0, 1), ("hybrid", 15.0, -1), ("textbook", -15.0, 1), ("qp", -15.0, -1)],
)
def test_friction_adds_or_takes_force_with_the_sign_of_tilt_and_motion(
    controller: str, tilt: float, sigma: int
) -> None:
    found = run(controller, tilt=tilt, friction=0.4, speed=0.2 * sigma, k_fp=0.5, duration=0.7)
    alpha = math.radians(tilt)
    ratio = 1 / (math.cos(alpha) + sigma * 0.4 * math.sin(alpha))
    assert found["force_ratio"] == pytest.approx(ratio, rel=EXACT)
    assert found["force_ratio_closed"] == pytest.approx(ratio, rel=1e-12)
    assert found["slide_speed_m_s"] == pytest.approx(0.2 / math.cos(alpha), rel=EXACT)
    assert found["slide_speed_m_s_closed"] == pytest.approx(0.2 / math.cos(alpha), rel=1e-12)
    assert found["force_bias_N"] == pytest.approx((ratio - 1) * f_d, rel=0.05)


@pytest.mark.parametrize(
    ("tilt", "speed", "k_fp"), [(12.0, 0.2, 0.5), (12.0, -0.2, 0.5), (-12.0, 0.2, 0.0)]
)
def test_damping_on_a_compliant_wall_changes_the_force_unless_an_integral_takes_it_away(
    tilt: float, speed: float, k_fp: float
) -> None:
    given = {"wall": COMPLIANT, "tilt": tilt, "speed": speed, "k_fp": k_fp, "damping": 50.0}
    alpha, D = math.radians(tilt), 50.0 * m
    wanted = ((1 + k_fp) * f_d - D * speed * math.tan(alpha)) / ((1 + k_fp) * math.cos(alpha))
    assert run(**given)["force_ratio"] == pytest.approx(wanted / f_d, rel=EXACT)
    kept = run(**given, k_fi=30.0)["force_ratio"]
    assert kept == pytest.approx(1 / math.cos(alpha), rel=EXACT)


def test_an_integral_follows_the_bias_of_the_sensor() -> None:
    found = run(tilt=10.0, sensor_bias=3.0, k_fp=0.3, k_fi=100.0, duration=0.7)
    wanted = (f_d - 3.0) / math.cos(math.radians(10.0))
    assert found["force_ratio"] == pytest.approx(wanted / f_d, rel=EXACT)
    assert found["force_ratio_closed"] == pytest.approx(wanted / f_d, rel=1e-12)


@pytest.mark.parametrize("error", ["mass_error", "gravity_error"])
def test_a_wrong_weight_stays_with_ff_is_divided_by_p_and_removed_by_pi(error: str) -> None:
    for k_fp, k_fi, share in ((0.0, 0.0, 1.0), (0.5, 0.0, 1 / 1.5), (0.5, 200.0, 0.0)):
        found = run(k_fp=k_fp, k_fi=k_fi, duration=0.4, **{error: 0.25})["force_ratio"]
        assert found is not None
        assert f_d * (found - 1) == pytest.approx(share * 0.25 * m * g, rel=EXACT, abs=1e-3)


@pytest.mark.parametrize("wall", [RIGID, COMPLIANT])
@pytest.mark.parametrize("speed", [0.0, -0.15])
def test_all_errors_together_leave_what_two_balances_of_force_say(
    wall: float, speed: float
) -> None:
    found = run(
        **{"wall": wall, "tilt": 10.0, "speed": speed, "friction": 0.3 if speed else 0.0},
        **{"offset": 1e-3, "mass_error": 0.1, "gravity_error": 0.05, "k_fp": 0.4, "damping": 30.0},
        **{"delay": 3, "sensor_gain": 1.1, "sensor_bias": 1.0, "torque_gain": 0.9},
        torque_bias=1.5,
    )
    alpha, sigma = math.radians(10.0), np.sign(speed)
    # F_x = 0.9 (F_cmd − m g) + 1.5 + m_true g_true;  F_cmd + 0.4 (1.1 F_x + 1) = 1.4 f_d − D v_x
    rows = np.array([[1.0, -0.9], [0.4 * 1.1, 1.0]])
    weight = 1.1 * 1.05 * m * g - 0.9 * m * g + 1.5
    sides = [weight, 1.4 * f_d - 0.4 - 30 * m * speed * math.tan(alpha)]
    F_x = np.linalg.solve(rows, sides)[0]
    lam = F_x / (math.cos(alpha) + 0.3 * sigma * math.sin(alpha))
    assert found["force_ratio"] == pytest.approx(lam / f_d, rel=EXACT)
    if speed == 0:
        y, depth = lam * math.sin(alpha) / (0.9 * m * K_p), wall * (1e-3 + lam / 1e4)
        along = (y + depth * math.sin(alpha)) / math.cos(alpha)
        assert found["offset_mm"] == pytest.approx(1e3 * along, rel=EXACT)
        assert found["offset_mm_closed"] == pytest.approx(1e3 * along, rel=1e-9)


def test_feeding_the_other_force_forward_brings_the_mass_back_to_its_place() -> None:
    found = run(tilt=10.0, cutoff=50.0)
    assert found["force_ratio"] == pytest.approx(1 / math.cos(math.radians(10.0)), rel=EXACT)
    assert abs(found["offset_mm"] or 0.0) < 1e-3
    assert run(tilt=10.0)["offset_mm"] == pytest.approx(4.4762, rel=EXACT)


def test_a_mass_that_would_jam_or_does_not_reach_its_speed_has_no_closed_form() -> None:
    jammed = {"tilt": -45.0, "friction": 1.0, "speed": 0.1, "duration": 0.1}
    assert run(**jammed, acceleration=10.0)["force_ratio_closed"] is None
    assert run(speed=5.0, acceleration=10.0, duration=0.1)["slide_speed_m_s_closed"] is None


# Loss of contact ---------------------------------------------------------------------------------


@pytest.mark.parametrize("acceleration", [20.0, 60.0])
def test_contact_is_lost_where_the_wall_recedes_faster_than_the_force_can_follow(
    acceleration: float,
) -> None:
    given = {"acceleration": acceleration, "speed": 20.0, "duration": 0.15}
    tilt = math.degrees(math.atan(f_d / (m * acceleration)))
    below, above = (run(tilt=x * tilt, **given)["contact_lost_fraction"] for x in SIDES)
    assert (below, above) == (0.0, 1.0)
    assert limit("tilt", **given) == pytest.approx(tilt, rel=1e-12)
    assert MASS.limit({**USUAL, **given, "k_fp": 0.5}, "qp", "tilt") is None


# Stability ---------------------------------------------------------------------------------------

RIGID_LOOPS = [
    *(("k_fp", d, 0.0, 1.0) for d in (1, 3)),
    *(("k_fi", 1, k_fp, 2e3 * (1 - k_fp)) for k_fp in (0.0, 0.6)),
    *(("k_fi", d, 0.0, 2e3 * math.sin(math.pi / (2 * (2 * d - 1)))) for d in (2, 3, 5, 10)),
]
"""Gain that is raised, delay [ticks], K_fp [1], critical value [1, 1/s] at 1 kHz."""


@pytest.mark.parametrize(("gain", "delay", "k_fp", "wanted"), RIGID_LOOPS)
def test_the_loop_on_a_rigid_wall_settles_below_its_critical_gain_and_grows_above(
    gain: str, delay: int, k_fp: float, wanted: float
) -> None:
    given = {"delay": delay, "k_fp": k_fp, "rate": 1e3, "duration": 0.5}
    below, above = (run(**{**given, gain: x * wanted})["growth"] or 0.0 for x in SIDES)
    assert below < 1 < above
    assert limit(gain, **given) == pytest.approx(wanted, rel=1e-9)


COMPLIANT_LOOPS = [
    {"delay": 1, "wall_damping": 5.0, "stiffness": 2e4},
    {"delay": 4, "wall_damping": 5.0, "mass_error": 0.5, "damping": 10.0},
    {"delay": 2, "sensor_gain": 1.2, "torque_gain": 0.9, "sensor_cutoff": 100.0},
]


@pytest.mark.parametrize("given", COMPLIANT_LOOPS)
def test_the_loop_on_a_compliant_wall_is_critical_where_its_phase_says(
    given: dict[str, float],
) -> None:
    given = {"wall": COMPLIANT, "rate": 2e3, "pressed": 0.999, "duration": 0.4, **given}
    given = {"wall_damping": 20.0, "stiffness": 1e4, **given}
    wanted = critical(lambda w: open_loop(w, {**USUAL, **given}), 10.0, 3e3)
    assert limit("k_fp", **given) == pytest.approx(wanted, rel=EXACT)
    below, above = (run(**given, k_fp=x * wanted)["growth"] or 0.0 for x in (0.995, 1.005))
    assert below < 1 < above


def open_loop(w: float, given: dict[str, float]) -> complex:
    """Return the frequency response of force read over force commanded by K_fp = 1, negative."""
    T, s = 1 / given["rate"], 1j * w
    mass, d, D = (1 + given["mass_error"]) * m, given["wall_damping"], given["damping"] * m
    k, gain = given["stiffness"], given["torque_gain"]
    held = cmath.exp(-s * T / 2) * math.sin(w * T / 2) / (w * T / 2)
    push = gain * held / (mass * s**2 + (d + gain * held * D) * s + k)
    follow = 1 - math.exp(-2 * math.pi * given["sensor_cutoff"] * T)
    low_pass = follow / (1 - (1 - follow) * cmath.exp(-s * T)) if given["sensor_cutoff"] else 1.0
    late = cmath.exp(-s * given["delay"] * T)
    return given["sensor_gain"] * low_pass * late * (k + d * s) * push


def test_the_worst_delay_allows_the_gain_that_the_resonance_does() -> None:
    k, zeta = 2e4, 0.1
    given = {"wall": COMPLIANT, "wall_damping": 2 * zeta * math.sqrt(k * m), "stiffness": k}
    found = [limit("k_fp", delay=float(ticks), **given) for ticks in range(9, 20)]
    r = np.linspace(0.5, 1.5, 4001)  # rate over that of the undamped oscillation
    peak = np.max(np.hypot(1, 2 * zeta * r) / np.hypot(1 - r**2, 2 * zeta * r))
    assert min(found) == pytest.approx(1 / peak, rel=0.01)
    assert min(found) == pytest.approx(2 * zeta * math.sqrt(1 - zeta**2), rel=0.05)
    assert limit("k_fp", delay=1.0, **given) > 5 * min(found)


@pytest.mark.parametrize("k", [1e5, 2e5])
def test_a_small_delay_allows_a_gain_that_falls_with_stiffness_and_delay(k: float) -> None:
    d, late = 2.0, (4 + 0.5) * 1e-4  # age of the force, and half a period of its hold
    given = {"wall": COMPLIANT, "wall_damping": d, "stiffness": k, "rate": 1e4, "delay": 4.0}
    assert limit("k_fp", **given) == pytest.approx(d / (k * late - d), rel=0.01)


@pytest.mark.parametrize("k_fp", [0.0, 0.5])
@pytest.mark.parametrize("d", [0.0, 4.0])
def test_an_integral_on_a_compliant_wall_needs_damping(d: float, k_fp: float) -> None:
    k, D = 1e3, 3.0 * m
    total = (1 + k_fp) * d + D  # Routh; without damping of the wall K_fi < D (1 + K_fp) / m
    wanted = total * (1 + k_fp) / (m - d * total / k)
    given = {"wall": COMPLIANT, "wall_damping": d, "damping": 3.0, "stiffness": k, "rate": 1e4}
    late = 1.5e-4 * k * k_fp / total  # share of the damping that the age of the force takes
    assert limit("k_fi", **given, k_fp=k_fp) == pytest.approx(wanted * (1 - late), rel=2e-3)
    bare = {"wall": COMPLIANT, "wall_damping": 0.0, "k_fp": k_fp}
    assert MASS.limit({**USUAL, **bare}, "qp", "k_fi") is None


def test_a_loop_that_bounces_does_not_settle_and_one_that_runs_away_has_diverged() -> None:
    bouncing = run(wall=COMPLIANT, k_fp=5.0, delay=10.0, stiffness=1e5, pressed=0.999)
    assert (bouncing["growth"] or 0.0) >= 2.0
    assert (bouncing["contact_lost_fraction"] or 0.0) > 0.1
    with pytest.raises(DivergedError, match=r"above 10000 × set-point at 0\.0\d\d s"):
        run(k_fp=3.0)
    assert MASS.limit({**USUAL, "tilt": 1.0}, "qp", "k_fp") is None


# Rollouts ----------------------------------------------------------------------------------------


def test_a_rollout_does_not_depend_on_what_ran_before_and_hears_its_seed() -> None:
    given = {"wall": COMPLIANT, "tilt": 5.0, "k_fp": 0.3, "k_fi": 50.0, "sensor_noise": 0.5}
    first = run(seed=3, duration=0.2, **given)
    run(seed=4, duration=0.1, tilt=-30.0, k_fp=0.9, speed=1.0)
    assert run(seed=3, duration=0.2, **given) == first
    assert run(seed=4, duration=0.2, **given)["force_rmse_N"] != first["force_rmse_N"]
    # 0.15 N of the tilt's 0.076 N and of the noise, which K_fp lets through to the wall
    assert 0.05 < (first["force_rmse_N"] or 0.0) < 0.5


@pytest.mark.parametrize("name", STUDIES)
def test_a_ready_study_of_the_mass_knows_the_answer_at_its_corners(name: str) -> None:
    study = study_of(read_study(find_study(name)))
    points = study.points(0)
    assert study.system is MASS
    for values in (points[0], points[-1]):
        point = dict(zip((f.name for f in study.factors), values.tolist(), strict=True))
        setting = study.setting(point)
        if study.search is None:
            continue
        closed = MASS.limit(setting, "qp", study.search.parameter)  # type: ignore[union-attr]
        assert closed is not None
        assert study.search.low < closed < study.search.high  # type: ignore[union-attr]
    if study.search is None:
        assert any(limit.measure == "qp_law_gap_max" for limit in study.criteria)


def test_a_setting_out_of_bounds_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"'tilt': got 50, need -45 to 45 deg"):
        MASS.parameters["tilt"].value(50.0, "tilt")


def test_a_rigid_wall_that_pulled_once_has_let_go_for_good() -> None:
    """λ turns negative while the mass is accelerated, and is positive again afterwards."""
    pulled = run(tilt=20.0, speed=1.0, acceleration=50.0, duration=1.0)
    assert pulled["contact_lost_fraction"] == 1.0
    assert run(tilt=20.0, speed=1.0, acceleration=5.0)["contact_lost_fraction"] == 0.0


def test_a_wall_that_rubs_has_no_closed_form_where_the_mass_creeps() -> None:
    slow = run(tilt=10.0, friction=0.5, speed=0.003, duration=1.0)
    assert slow["force_ratio_closed"] is None
    assert run(tilt=10.0, friction=0.5, speed=0.05)["force_ratio_gap"] < 1e-3
