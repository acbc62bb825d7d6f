"""The eraser scenario, judged by its own criteria, and its departures when something breaks."""

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import polars as pl
import pytest
from runs import Ran, flags, ran

from qpctrl import Status
from scenarios.eraser import Eraser
from scenarios.path import glide, glides, wiping_loops
from scenarios.plant import Plant, PlantState
from scenarios.scenario import Options
from scenarios.simulation import simulate
from scenarios.wiping import WipingPlan

SHORT = 3.0  # s of wiping

EXACT = 1e-6
"""N: the exact plant leaves the motion integrator's round-off."""


def short(**parameters) -> Ran:
    """Return a short run."""
    return ran("eraser", *flags(duration=SHORT, **parameters))


def wiping(outcome: Ran) -> pl.DataFrame:
    """Return the ticks spent wiping."""
    return outcome.table.filter(pl.col("phase") == "wipe")


@pytest.mark.parametrize(
    "parameters",
    [
        {"friction": 0.0},
        {"force": 20.0, "speed": 0.1},
        {"force": 2.0},
        {"robot": "ur5"},
        {"plant": "rigid"},
        {"form": "full"},
        {"solver": "daqp"},
    ],
    ids=str,
)
def test_the_eraser_meets_its_criteria(parameters) -> None:
    outcome = short(**parameters)
    missed = [c for c in outcome.summary["criteria"] if not c["passed"]]
    assert not missed


def test_the_default_run_goes_through_every_phase_and_beats_the_floor() -> None:
    outcome = ran("eraser")
    metrics, table = outcome.summary["metrics"], outcome.table
    assert outcome.passed
    phases = table["phase"].unique(maintain_order=True).to_list()
    assert phases == ["approach", "touch", "press", "wipe", "release", "lift"]
    assert metrics["force_rmse_N"] <= 0.1
    assert metrics["position_rmse_mm"] <= 0.2
    assert metrics["touch_peak_ratio"] <= 2.0
    assert metrics["contact_loss_fraction"] == 0.0
    speed = np.hypot(*(wiping(outcome)[f"motion.V.{i}"].to_numpy() for i in range(2)))
    assert speed[700:-700] == pytest.approx(0.2, abs=2e-3)  # it does wipe, at the set speed
    assert not table["touching"][-1]  # lifted off
    bound = table.filter(pl.col("saturated"))  # where the mode changes, far from ±87 Nm
    names = {name for names in bound["active"] for name in names.split(", ")}
    assert "unilateral board.vz" in names
    assert "torque rate joint2" in names
    assert not any(name.startswith("torque joint") for name in names)
    assert any("gave way by" in words for words in bound["explanation"])
    assert all("limit (dual" in words for words in bound["explanation"])


def test_the_measured_force_follows_the_set_point_not_the_command() -> None:
    outcome = short(force=17.0)
    measured = wiping(outcome)["wrench_meas.fz"].mean()
    assert measured == pytest.approx(17.0, abs=0.05)


def test_friction_is_felt_and_does_not_tip_the_eraser() -> None:
    table = wiping(short())
    tangential = np.hypot(*(table[f"wrench_meas.{axis}"].to_numpy() for axis in ("fx", "fy")))
    assert np.median(tangential) == pytest.approx(0.3 * 10.0, rel=0.02)
    tilt = np.hypot(*(table[f"motion.X_e.{i}"].to_numpy() for i in (3, 4)))
    assert np.degrees(tilt.max()) < 0.05


def test_left_out_of_the_law_friction_tips_the_eraser() -> None:
    experiment = Eraser(duration=1.0, k_fp=0.0, k_fi=0.0, damping=0.0).prepare(Options())
    experiment.controller.engines["contact"].inputs["force.cutoff"][...] = 0.0
    table = simulate(experiment).filter(pl.col("phase") == "wipe")
    tilt = np.hypot(*(table[f"motion.X_e.{i}"].to_numpy() for i in (3, 4)))
    assert np.degrees(tilt.max()) > 5.0


def test_on_the_exact_flat_board_all_three_laws_press_exactly() -> None:
    qp, hybrid, textbook = (short(plant="rigid", law=law) for law in ("qp", "hybrid", "textbook"))
    forces = [wiping(outcome)["wrench_meas.fz"].to_numpy() for outcome in (qp, hybrid, textbook)]
    assert np.abs(forces[0] - 10.0).max() < EXACT
    assert np.abs(forces[1] - 10.0).max() < EXACT
    assert np.abs(forces[2] - 10.0).max() < EXACT  # no curvature here: the laws are one
    assert qp.summary["metrics"]["curvature_term_max"] < 1e-9  # a flat tool on a flat board


def test_two_runs_with_one_seed_are_the_same_file_but_for_timing(tmp_path) -> None:
    runs = [short(force_noise=0.05, plant="mujoco").table.drop("tick_us") for _ in range(2)]
    assert runs[0].equals(runs[1], null_equal=True)


@dataclass
class Faulty:
    """A plant whose sensors lie at some ticks."""

    plant: Plant
    fault: str
    ticks: range
    count: int = 0
    last: PlantState | None = None

    def reset(self, q):
        """Return the start."""
        return self.plant.reset(q)

    def step(self, tau):
        """Return what the sensors claim."""
        assert np.isfinite(tau).all()
        state = self.plant.step(tau)
        self.count += 1
        if self.count not in self.ticks:
            self.last = state
            return state
        if self.fault == "stale":
            return self.last
        broken = {
            "nan position": {"q": state.q * np.nan},
            "nan velocity": {"v": state.v * np.nan},
            "nan force": {"wrench_meas": state.wrench_meas * np.nan},
        }
        return state._replace(**broken[self.fault])


@pytest.mark.parametrize("fault", ["nan position", "nan velocity", "nan force", "stale"])
def test_a_broken_measurement_falls_back_is_counted_and_recovers(fault: str) -> None:
    experiment = Eraser(duration=2.5).prepare(Options())
    fine = experiment.plant.reset(experiment.q_start)
    faulty = Faulty(experiment.plant, fault, range(2800, 2806), last=fine)
    table = simulate(replace(experiment, plant=faulty))
    bad = table.filter(pl.col("fallback"))
    expected = Status.STALE if fault == "stale" else Status.NOT_FINITE
    assert bad["status"].to_list() == [expected.name] * 6
    assert bad["phase"].unique().to_list() == ["wipe"]
    recovered = table.filter(pl.col("time").is_between(3.4, 4.2))
    assert recovered["phase"].unique().to_list() == ["wipe"]
    assert (recovered["wrench_meas.fz"] - 10.0).abs().max() < 0.2
    limits = experiment.robot.limits.tau_max
    for i, name in enumerate(experiment.robot.joint_names):
        assert table[f"tau.{name}"].abs().max() <= limits[i]


@pytest.mark.parametrize(
    ("fault", "outage"), [("nan velocity", 700), ("nan force", 700), ("stale", 50)]
)
def test_in_an_outage_the_arm_never_gathers_speed(fault: str, outage: int) -> None:
    experiment = Eraser(duration=2.5).prepare(Options())
    fine = experiment.plant.reset(experiment.q_start)
    ticks = range(3300, 3300 + outage)
    truth: list[PlantState] = []
    honest = experiment.plant.step

    def step(tau):
        truth.append(honest(tau))
        return truth[-1]

    experiment.plant.step = step
    faulty = Faulty(experiment.plant, fault, ticks, last=fine)
    simulate(replace(experiment, plant=faulty))
    speed = [np.abs(state.v).max() for state in truth]
    before, during = max(speed[3200:3300]), max(speed[3300 : 3300 + outage])
    assert during < 1.5 * before  # measured, not commanded


def test_a_board_out_of_reach_ends_the_run_with_a_failed_verdict() -> None:
    scenario = Eraser(duration=0.5)
    experiment = scenario.prepare(Options())
    far = replace(experiment, horizon=1.5)
    metrics = scenario.metrics(simulate(far))
    assert not all(criterion.passed for criterion in scenario.judge(metrics))


def test_the_path_keeps_its_speed_and_its_derivatives_are_consistent() -> None:
    dt = 1e-3
    path = wiping_loops(0.2, 4.0, dt)
    assert np.diff(path.p, axis=0) / dt == pytest.approx((path.v[1:] + path.v[:-1]) / 2, abs=2e-5)
    assert np.diff(path.v, axis=0) / dt == pytest.approx((path.a[1:] + path.a[:-1]) / 2, abs=2e-3)
    speed = np.linalg.norm(path.v, axis=1)
    assert speed[0] == speed[-1] == 0.0
    assert speed[600:-600] == pytest.approx(0.2)


def test_a_glide_starts_and_ends_at_rest() -> None:
    assert glide(0.0, 2.0) == (0.0, 0.0, 0.0)
    assert glide(9.0, 2.0)[:2] == (1.0, 0.0)
    step = 1e-6
    for t in (0.3, 1.0, 1.7):
        slope = (glide(t + step, 2.0).s - glide(t - step, 2.0).s) / (2 * step)
        assert glide(t, 2.0).s_dot == pytest.approx(slope, abs=1e-8)


def test_a_glide_at_many_times_is_that_at_each() -> None:
    times = np.linspace(-0.5, 2.5, 31)
    for i, at_one in enumerate(glide(float(t), 2.0) for t in times):
        assert [part[i] for part in glides(times, 2.0)] == pytest.approx(at_one, rel=1e-14)


def plan(*, start_on_board: bool = False) -> WipingPlan:
    """Return a plan on a board that is turned and away."""
    X_WE = pin.SE3(pin.utils.rotate("y", 0.7), np.array([0.5, -0.2, 0.4]))
    return WipingPlan(
        X_WE=X_WE,
        X_WT_home=X_WE * pin.SE3(np.eye(3), np.array([0.01, 0.02, -0.03])),
        force=10.0,
        speed=0.2,
        duration=2.0,
        dt=1e-3,
        damping=20.0,
        start_on_board=start_on_board,
    )


def places(job: WipingPlan, phase: str, times: np.ndarray) -> np.ndarray:
    """Return where the tool shall be on the board (times×3) [m]."""
    track = job.tracks[phase]
    return np.array([job.X_WE.actInv(track.at(float(t)).X_WD.translation) for t in times])


def test_each_phase_begins_where_the_one_before_it_ends() -> None:
    job, lift = plan(), 0.8
    begin = {phase: places(job, phase, np.zeros(1))[0] for phase in job.tracks}
    assert begin["approach"] == pytest.approx([0.01, 0.02, -0.03])
    approached, lifted = places(job, "approach", [1.0])[0], places(job, "lift", [lift])[0]
    assert begin["touch"] == pytest.approx(approached)
    assert begin["touch"] == pytest.approx(begin["press"] - [0, 0, 0.006])
    for phase in ("press", "wipe"):
        assert begin[phase] == pytest.approx([*job.loops.p[0], 0])
    wiped = places(job, "wipe", [2.0, 3.0])  # and there it stays
    assert wiped == pytest.approx(np.array([[*job.loops.p[-1], 0]] * 2))
    assert begin["release"] == pytest.approx(wiped[0])
    assert begin["lift"] == pytest.approx(wiped[0])
    assert lifted == pytest.approx(wiped[0] - [0, 0, 0.05])
    assert places(plan(start_on_board=True), "press", [9.0])[0] == pytest.approx(
        [0.01, 0.02, -0.03]
    )


@pytest.mark.parametrize("phase", ["approach", "touch", "press", "wipe", "release", "lift"])
def test_a_track_moves_as_it_says_and_keeps_the_orientation_of_the_board(phase: str) -> None:
    job, dt = plan(), 1e-3
    times = np.arange(-5, 2200) * dt
    found = [job.tracks[phase].at(float(t)) for t in times]
    assert all(motion.X_WD.rotation == pytest.approx(job.X_WE.rotation) for motion in found)
    p, V, A = (
        places(job, phase, times),
        *(np.array([getattr(motion, name) for motion in found]) for name in ("V_des", "V_dot_des")),
    )
    assert not np.any([V[:, 3:], A[:, 3:]])
    inside = times[1:] > 0
    assert np.diff(p, axis=0)[inside] / dt == pytest.approx(
        (V[1:] + V[:-1])[inside, :3] / 2, abs=2e-5
    )
    assert np.diff(V, axis=0)[inside] / dt == pytest.approx((A[1:] + A[:-1])[inside] / 2, abs=4e-3)
    assert np.array_equal(p[:5], [p[5]] * 5)  # before it begins it is at its beginning


def test_the_touch_goes_on_at_its_speed_for_as_long_as_it_takes() -> None:
    job = plan()
    assert job.touch_speed == 0.02
    way = places(job, "touch", [0.0, 0.1, 60.0])[:, 2]
    assert np.diff(way) == pytest.approx([0.02 * 0.05, 0.02 * 59.9])
    motion = job.tracks["touch"].at(60.0)
    assert motion.V_des == pytest.approx([0, 0, 0.02, 0, 0, 0])
    assert not motion.V_dot_des.any()
