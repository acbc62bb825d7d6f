"""The humanoid at the wall: force, feet and push, judged by MuJoCo's own poses and forces."""

import functools
from dataclasses import replace

import mujoco
import numpy as np
import polars as pl
import pytest

from qpctrl import InputError
from scenarios.humanoid_wipe import LIMITS, HumanoidWipe
from scenarios.plant import PlantState
from scenarios.run import run_scenario
from scenarios.scenario import Options, Outcome
from scenarios.simulation import simulate
from scenarios.whole_body.contact import CarryingContact, friction_margin, pressure_margin
from scenarios.whole_body.contact_panels import contact_panels
from scenarios.whole_body.humanoid_guide import HumanoidGuide
from scenarios.whole_body.humanoid_metric import PUSHED, WIPING, what_gave_way
from scenarios.whole_body.humanoid_world import SOLES

PHASES = ("stand", "approach", "touch", "press", "wipe", "push", "recover", "release", "lift")
WEIGHT = 61.6 * 9.81  # N
SHORT, OPTIONS = {"duration": 0.6}, Options(compiled="no")
RESTS = 5e-4
"""m: what moving the hand leaves of an error of the centre of mass."""
GRAVITY_SHARE = 0.02
"""Of the weight: what the body's own motion adds to what the feet carry while it wipes."""


@functools.cache
def run(**given: float) -> tuple[Outcome, dict[str, np.ndarray]]:
    """Return a short run and what MuJoCo knows of its feet at each tick, made once."""
    scenario = HumanoidWipe(**SHORT, **given)
    experiment = scenario.prepare(OPTIONS)
    plant, seen = experiment.plant, {"place": [], "force": []}
    honest = plant.step

    def step(tau: np.ndarray):
        state = honest(tau)
        data, force = plant.data, np.zeros(6)
        seen["place"].append([data.site(name).xpos.copy() for name in SOLES])
        ground = np.zeros(3)
        for i in range(data.ncon):
            if "ground" in [plant.model.geom(int(g)).name for g in data.contact[i].geom]:
                mujoco.mj_contactForce(plant.model, data, i, force)
                ground += np.abs(data.contact[i].frame.reshape(3, 3)[0]) * force[0]
        seen["force"].append(ground)
        return state

    plant.step = step
    object.__setattr__(scenario, "prepare", lambda options: experiment)
    return run_scenario(scenario, OPTIONS), {key: np.array(rows) for key, rows in seen.items()}


def table() -> pl.DataFrame:
    """Return the record of the default run."""
    return run()[0].table


def of(phase: str, name: str) -> np.ndarray:
    """Return a column of one phase of the default run."""
    return table().filter(pl.col("phase") == phase)[name].to_numpy()


def test_the_humanoid_meets_its_own_criteria_and_goes_through_every_phase() -> None:
    outcome = run()[0]
    assert outcome.passed, [c for c in outcome.summary["criteria"] if not c["passed"]]
    assert tuple(table()["phase"].unique(maintain_order=True)) == PHASES
    modes = table()["mode"].rle().struct.field("value").to_list()
    assert modes == ["free", "contact", "free"]
    assert table()["status"].unique().to_list() == ["OK"]
    assert table()["kkt_residual"].max() < 1e-8


def test_the_hand_presses_with_the_set_force_while_it_goes_in_circles() -> None:
    force = of("wipe", "wrench.fz")
    assert np.sqrt(np.mean((force - 15.0) ** 2)) < 0.03 * 15.0
    place = np.stack([of("recover", f"motion.X_WF.{i}") for i in (10, 11)])  # y and z
    assert np.ptp(place, axis=1).min() > 0.05
    rubbing = np.hypot(of("recover", "wrench.fx"), of("recover", "wrench.fy"))
    assert np.median(rubbing) == pytest.approx(0.5 * 15.0, rel=0.05)  # it slides, with friction
    metrics = run()[0].summary["metrics"]
    assert metrics["force_rmse_N"] == pytest.approx(
        float(np.sqrt(np.mean((force - 15.0) ** 2))), rel=1e-9
    )


def test_both_feet_together_carry_the_weight_and_stay_where_they_are() -> None:
    outcome, seen = run()
    place, ground = seen["place"], seen["force"]
    slip = np.linalg.norm(place[:, :, :2] - place[0, :, :2], axis=2).max()
    assert slip < 1e-4
    assert 1e3 * slip == pytest.approx(outcome.summary["metrics"]["foot_slip_max_mm"], abs=2e-3)
    wiping = (table()["phase"] == "wipe").to_numpy()
    assert ground[wiping, 2] == pytest.approx(WEIGHT, rel=GRAVITY_SHARE)
    told = sum(table()[f"contact.{name}.fz"].to_numpy() for name in SOLES)
    assert told[1:] == pytest.approx(ground[:-1, 2], rel=1e-3)
    away = sum(table()[f"contact.{name}.fx"].to_numpy() for name in SOLES)
    assert np.mean(away[wiping]) == pytest.approx(-15.0, abs=1.0)  # what the wall pushes back


def test_the_push_is_felt_and_the_body_comes_back() -> None:
    error = np.abs(of("recover", "centre of mass.c_e.0"))
    speed, rate = 40.0 * 0.2 / 61.6, 4.0  # m/s, 1/s: what the push gives, and √K_p, critical
    assert error.max() == pytest.approx(speed / (rate * np.e), rel=0.15)
    assert error[-1] < RESTS
    assert len(of("push", "time")) == 200
    away = sum(of("push", f"contact.{name}.fx") for name in SOLES)
    before = sum(of("wipe", f"contact.{name}.fx")[-1] for name in SOLES)
    assert np.abs(away - before).max() > 10.0  # N, the feet hold against it
    assert np.abs(of("wipe", "centre of mass.c_e.0")).max() < RESTS


def test_no_torque_jumps_where_the_hand_touches_and_leaves() -> None:
    outcome = run()[0]
    robot = outcome.experiment.robot
    tau = table().select(f"tau.{name}" for name in robot.actuator_names).to_numpy()
    assert (np.abs(tau) <= robot.limits.tau_max).all()
    step = (np.abs(np.diff(tau, axis=0)) / (1e-3 * robot.limits.tau_rate)).max(axis=1)
    mode = table()["mode"].to_numpy()
    switches = np.flatnonzero(mode[1:] != mode[:-1])
    assert len(switches) == 2
    metrics = outcome.summary["metrics"]
    assert metrics["torque_step_switch_max"] == pytest.approx(step[switches].max(), rel=1e-6)
    assert 0.0 < step.max() < 0.5


@pytest.mark.parametrize(
    ("given", "missed", "words"),
    [
        ({"push": 400.0}, {"foot_tilt_max_deg", "torso_drop_max_mm"}, ("footprint", "torso down")),
        ({"ground_friction": 0.03}, {"foot_slip_max_mm"}, ("friction", "slipped")),
    ],
    ids=["push", "friction"],
)
def test_what_the_feet_cannot_hold_ends_in_a_verdict_that_says_why(given, missed, words) -> None:
    outcome = run(**given)[0]
    record, robot = outcome.table, outcome.experiment.robot
    failed = {c["name"] for c in outcome.summary["criteria"] if not c["passed"]}
    assert missed <= failed
    tau = record.select(f"tau.{name}" for name in robot.actuator_names).to_numpy()
    assert np.isfinite(tau).all()
    assert (np.abs(tau) <= robot.limits.tau_max * (1 + 1e-12)).all()
    said = what_gave_way(record, HumanoidWipe(**given).world())
    assert words[0] in said[0]  # the limit that was met first
    assert words[1] in " ".join(said)
    missing = {key for key, value in outcome.summary["metrics"].items() if value is None}
    reached = "push" in record["phase"].to_list()
    assert missing <= (set() if reached else {*WIPING, *PUSHED, "contact_loss_fraction"})
    assert reached or "push" not in given


def test_a_start_above_the_ground_or_deep_in_it_is_refused_with_the_distance() -> None:
    with pytest.raises(InputError, match=r"lift: got 5 mm, which puts left sole 4\.78 mm above"):
        HumanoidWipe(lift=5.0).prepare(OPTIONS)
    with pytest.raises(InputError, match=r"lift: got -3 mm.* 3\.22 mm deep in the ground"):
        HumanoidWipe(lift=-3.0).prepare(OPTIONS)


@pytest.mark.parametrize(
    ("left", "right", "shares"),
    [
        ((300.0, 0.0), (300.0, 0.0), (0.5, 0.5)),
        ((400.0, 0.0), (200.0, 0.0), (2 / 3, 1 / 3)),
        ((300.0, -6.0), (300.0, -6.0), (0.6, 0.4)),  # 20 mm to the left of the middle of each
        ((0.0, 0.0), (0.0, 0.0), (0.5, 0.5)),
    ],
)
def test_the_weight_is_shared_so_that_each_sole_carries_in_its_middle(left, right, shares) -> None:
    scenario = HumanoidWipe(**SHORT)
    world, pushed = scenario.world(), []
    guide = HumanoidGuide(scenario.stance(world), pushed.append)
    soles = [np.array([0.0, 0.0, fz, mx, 0.0, 0.0]) for fz, mx in (left, right)]
    none = np.zeros(6)
    state = PlantState(
        *(0.0, world.start, np.zeros(world.robot.nv), none, none, False),
        contacts=(none, *soles),
    )
    references = guide.direct(state).references
    asked = [references[f"{name} force"].F_ref for name in SOLES]
    assert [F[2] / WEIGHT for F in asked] == pytest.approx(shares, rel=1e-3)
    assert not any(F[[0, 1, 3, 4, 5]].any() for F in asked)
    assert not pushed


def test_the_start_carries_the_weight_from_the_first_tick() -> None:
    total = sum(table()[f"contact.{name}.fz"].to_numpy() for name in SOLES)
    assert total[1:50] == pytest.approx(WEIGHT, rel=0.01)


def test_a_run_that_ends_early_fails_without_a_crash() -> None:
    scenario = HumanoidWipe()
    experiment = replace(scenario.prepare(OPTIONS), horizon=0.05)
    metrics = scenario.metrics(simulate(experiment))
    failed = {c.name for c in scenario.judge(metrics) if not c.passed}
    assert failed == {
        *("force_rmse_share", "position_rmse_mm", "orientation_rmse_deg"),
        *("touch_peak_ratio", "contact_loss_fraction"),
    }


def test_the_pictures_show_margins_pressure_and_what_gave_way() -> None:
    outcome = run()[0]
    panels = {panel.key: panel for panel in HumanoidWipe(**SHORT).panels(outcome)}
    assert all(panel.figure for panel in panels.values())
    margins = panels["margins"].figure["data"]
    least = outcome.summary["metrics"]["cop_margin_min_mm"]
    drawn = [np.nanmin(trace["y"]) for trace in margins if "edge" in trace["name"]]
    assert min(drawn) == pytest.approx(least, abs=1e-6)
    pushed = HumanoidWipe(**SHORT, push=400.0)
    told = {panel.key: panel for panel in pushed.panels(run(push=400.0)[0])}["margins"].caption
    assert "footprint" in told
    assert "torso down" in told
    edge, path = panels["pressure-left_sole"].figure["data"][:2]
    assert (max(edge["x"]), max(edge["y"])) == pytest.approx((50.0, 110.0))
    assert np.abs(path["y"]).max() < 110.0


def test_margins_of_a_contact_by_hand() -> None:
    sole = CarryingContact("sole", 0.5, (0.1, 0.05))
    wrench = np.array([[3.0, 4.0, 20.0, 0.4, -1.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    assert friction_margin(wrench, sole) == pytest.approx([5.0, 0.0])
    left = pressure_margin(wrench, sole)  # at x = 50 mm, y = 20 mm
    assert left[0] == pytest.approx(0.03)
    assert np.isnan(left[1])
    names = [f"contact.sole.{axis}" for axis in ("fx", "fy", "fz", "mx", "my", "mz")]
    record = pl.DataFrame(wrench, schema=names).with_columns(time=pl.Series([0.0, 0.001]))
    keys = [panel.key for panel in contact_panels(record, (sole,), "held")]
    assert keys == ["contact-sole", "margins", "pressure-sole"]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"force": 0.0}, "force: .*> 0"),
        ({"push": -1.0}, "push: .*>= 0"),
        ({"speed": 2.0}, "speed: got 2.0, need at most 0.5 m/s"),
        ({"radius": 0.3}, "radius: got 0.3, need at most 0.1 m"),
        ({"ground_friction": 0.0}, "ground_friction: .*> 0"),
        ({"push_direction": float("nan")}, "push_direction: .*finite"),
        ({"lift": float("inf")}, "lift: .*finite"),
    ],
    ids=str,
)
def test_the_humanoid_refuses_what_makes_no_sense(wrong, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        HumanoidWipe(**wrong)
    assert "\n" not in str(refused.value)


def test_joints_with_drives_are_refused() -> None:
    with pytest.raises(InputError, match="actuator: got 'series-elastic'"):
        HumanoidWipe().prepare(Options(actuator="series-elastic"))


def test_every_limit_belongs_to_a_metric_of_the_run() -> None:
    assert set(LIMITS) <= set(run()[0].summary["metrics"])
