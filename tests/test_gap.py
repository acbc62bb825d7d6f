"""The board that falls away: no speed is gathered, and contact is found again gently."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import groupby

import mujoco
import numpy as np
import pinocchio as pin
import polars as pl
import pytest

from qpctrl import InputError
from scenarios.gap import Gap, longest_loss
from scenarios.metric import loss_events, loss_metrics, normal_speed
from scenarios.plant import PlantState
from scenarios.plant_falling_board import FallingBoard
from scenarios.run import run_scenario
from scenarios.scenario import Directive, Options, Outcome
from scenarios.simulation import simulate
from scenarios.wiping import WipingGuide, WipingPlan
from scenarios.world import TOOL, build_world
from tasks import MotionReference

TOUCHED, SOON, AGAIN = 1.6, 3.5, 4.3
"""s: the board is touched; it has fallen and is not found yet; it is wiped again."""

SLOW = Gap(loss_time=0.02)

PREDICTED = 0.1
"""Of the speed: what friction's last pull and the posture's change do to the free fall."""

KICK = 0.015
"""m/s: 3 N of friction are fed forward for a few ms after the board has gone."""

FELT = 3e-4
"""m: how deep the pad is pressed in at most."""


@cache
def outcome(robot: str) -> Outcome:
    """Return the run of the scenario as it comes."""
    return run_scenario(Gap(robot=robot), Options())


@cache
def slow() -> pl.DataFrame:
    """Return the record, up to where it is wiping again, with a loss noticed after 20 ms."""
    experiment = SLOW.prepare(Options())
    return simulate(replace(experiment, horizon=AGAIN))


def wiping(table: pl.DataFrame) -> pl.DataFrame:
    """Return the ticks spent wiping."""
    return table.filter(pl.col("phase") == "wipe")


def falling(table: pl.DataFrame) -> pl.DataFrame:
    """Return the ticks of wiping from the last touch on."""
    wipe = wiping(table)
    gone = wipe.filter(~pl.col("touching"))["time"][0]
    return wipe.filter(pl.col("time") >= gone - 1.5e-3)


@pytest.mark.parametrize("robot", ["fr3", "ur5"])
def test_the_gap_meets_its_criteria(robot: str) -> None:
    assert not [c for c in outcome(robot).summary["criteria"] if not c["passed"]]


def test_the_contact_is_lost_once_and_lives_on() -> None:
    table = outcome("fr3").table
    phases = [phase for phase, _ in groupby(table["contact"])]
    assert phases == ["APPROACH", "TOUCH", "PRESS", "LOSS", "REGAIN", "PRESS", "APPROACH"]
    searching = table.filter(pl.col("contact") == "LOSS")
    assert searching["mode"].unique().to_list() == ["free"]
    sideways = np.hypot(*(searching[f"motion.V.{i}"].to_numpy() for i in range(2)))
    assert sideways == pytest.approx(0.2, abs=KICK)  # it keeps wiping


def test_the_board_is_found_where_it_fell() -> None:
    table, geometry = outcome("fr3").table, outcome("fr3").experiment.geometry
    events = loss_events(wiping(table))
    assert events is not None
    p_W = table.select(f"motion.X_WF.{i}" for i in (9, 10, 11)).to_numpy()
    depth = (p_W - geometry["X_WE"][:3, 3]) @ geometry["X_WE"][:3, 2]
    time = table["time"].to_numpy()
    before, after = np.searchsorted(time, [events.gone - 0.1, events.regained + 0.5])
    assert depth[after] - depth[before] == pytest.approx(8e-3, abs=FELT)


def test_the_force_ramps_anew_after_the_regain() -> None:
    table = outcome("fr3").table
    regained = table.filter(pl.col("contact") == "REGAIN")
    set_point = regained["force.F_des.2"].to_numpy()
    assert set_point[:3] == pytest.approx([0.1, 0.2, 0.3])  # 100 N/s
    assert set_point[-1] == 10.0
    energy = table["force.energy.0"].to_numpy()
    steps = np.diff(energy)
    assert np.abs(steps).max() < 0.3 * 30.0 * 0.25 * 1e-3  # μ f v dt: no switch of modes shows
    free = table.filter((pl.col("contact") == "LOSS") & ~pl.col("touching"))
    assert np.ptp(free["force.energy.0"].to_numpy()[1:]) < 1e-12  # nothing to give energy to
    assert 0.1 < free["force.energy.0"][-1] < energy[-1]


def test_pressing_on_without_a_contact_life_makes_the_tool_fast() -> None:
    experiment = Gap(loss_time=0.4).prepare(Options())
    table = falling(simulate(replace(experiment, horizon=SOON)))
    assert table["contact"].unique().to_list() == ["PRESS"]
    in_the_gap = table.filter(~pl.col("touching"))
    assert normal_speed(in_the_gap).max() > 5 * Gap().set_speed


def normal_terms(robot: str, q: Sequence[float]) -> tuple[float, np.ndarray]:
    """Return S_zz [1/kg] and the Jacobian's row (nv) along the normal at ``q``, by MuJoCo."""
    world = build_world(robot)
    model, data = world.model, mujoco.MjData(world.model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    M, J = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_fullM(model, data, M)
    mujoco.mj_jacSite(model, data, J, None, model.site(TOOL).id)
    along = world.X_WE.rotation[:, 2] @ J
    return float(along @ np.linalg.solve(M, along)), along


def test_until_the_loss_is_noticed_the_tool_falls_as_force_over_mass_says() -> None:
    table = falling(slow())
    S_zz, _ = normal_terms("fr3", table.select(pl.col("^q\\..*$")).row(0))
    force, v, expected = 10.0, 0.0, []
    for i in range(21):
        expected.append(v)
        F_e = 0.0 if i == 0 else force  # what is measured is one tick old
        F_cmd = force + 0.5 * F_e + 20.0 * force * i * 1e-3
        v += 1e-3 * (S_zz * F_cmd - 20.0 * v)
    found = normal_speed(table)[:21]
    assert found[5:] == pytest.approx(np.array(expected[5:]), rel=PREDICTED)
    assert found[20] < 1.5 * force * S_zz * 0.02  # the bound, without the damping


@pytest.mark.parametrize("robot", ["fr3", "ur5"])
def test_the_loss_time_by_default_is_the_longest_that_is_safe_by_numbers(robot: str) -> None:
    table, arm = outcome(robot).table, outcome(robot).experiment.robot
    events = loss_events(wiping(table))
    assert events is not None
    noticed = round((events.lost - events.gone) / 1e-3) * 1e-3
    S_zz, along = normal_terms(robot, arm.home)
    faster, unload = 15.0 * S_zz, np.abs(15.0 * along / arm.limits.tau_rate).max()
    assert faster * (noticed + unload / 2) <= 0.02
    assert faster * (noticed + 1e-3 + unload / 2) > 0.02


def test_a_slower_notice_breaks_the_promise_and_the_criteria_say_so() -> None:
    metrics = SLOW.metrics(slow())
    assert metrics["loss_noticed_ms"] == pytest.approx(20.0)
    failed = [criterion.name for criterion in SLOW.judge(metrics) if not criterion.passed]
    assert "loss_speed_ratio" in failed
    assert "regain_peak_ratio" not in failed  # the search that follows lands gently all the same


def test_a_force_that_no_search_can_follow_is_refused() -> None:
    with pytest.raises(InputError, match=r"search_speed: got 0.01, need at least .* m/s") as caught:
        Gap(search_speed=0.01).prepare(Options())
    assert "\n" not in str(caught.value)
    least = float(str(caught.value).split("at least ")[1].split()[0])
    arm = build_world("fr3").robot
    assert longest_loss(arm, Gap(search_speed=1.01 * least)) == pytest.approx(1e-3)
    with pytest.raises(InputError):
        longest_loss(arm, Gap(search_speed=0.99 * least))


def test_the_board_is_back_when_a_run_starts_again() -> None:
    experiment = Gap().prepare(Options())
    board = experiment.plant
    assert isinstance(board, FallingBoard)
    board.plant.move_board(board.way_W)
    board.fallen = True
    table = simulate(replace(experiment, horizon=TOUCHED))
    known = outcome("fr3").table.head(len(table))
    assert table.drop("tick_us").equals(known.drop("tick_us"), null_equal=True)
    assert table["contact"][-1] == "PRESS"


def test_without_a_loss_there_is_nothing_to_judge() -> None:
    never = wiping(outcome("fr3").table).filter(pl.col("contact") == "PRESS").head(100)
    metrics = loss_metrics(never, force=10.0, speed=0.02)
    assert metrics
    assert all(math.isnan(value) for value in metrics.values())


def test_the_report_shows_speed_force_and_energy(tmp_path) -> None:
    gap, known = Gap(), outcome("fr3")
    panels = {panel.key: panel for panel in gap.panels(known)}
    assert list(panels) == ["loss-speed", "loss-force", "path", "error", "force", "energy"]
    assert all(panel.figure for panel in panels.values())
    near = panels["loss-speed"].figure
    assert near is not None
    assert near["data"][0]["x"][-1] - near["data"][0]["x"][0] == pytest.approx(0.79, abs=0.05)
    empty = Outcome(experiment=known.experiment, table=known.table.head(50), summary=known.summary)
    assert "loss-speed" not in [panel.key for panel in gap.panels(empty)]


def guided(depths: Sequence[float], forces: Sequence[float]) -> list[Directive]:
    """Return what the guide asks of a tool that starts on the board, one tick after another.

    Args:
        depths: how far the tool is behind the plan [m].
        forces: what it presses with [N].
    """
    plan = WipingPlan(
        X_WE=pin.SE3.Identity(),
        X_WT_home=pin.SE3.Identity(),
        force=10.0,
        speed=0.2,
        duration=1.0,
        dt=1e-3,
        damping=20.0,
        start_on_board=True,
        loss_time=2e-3,
        search_speed=0.02,
    )
    guide = WipingGuide(plan, lambda q: pin.SE3(np.eye(3), np.array([0.0, 0.0, q[0]])))
    directives = []
    for i, (depth, force) in enumerate(zip(depths, forces, strict=True)):
        wrench = np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])
        state = PlantState(i * 1e-3, np.full(7, depth), np.zeros(7), wrench, wrench, touching=True)
        directive = guide.direct(state)
        assert directive is not None
        directives.append(directive)
    return directives


def inward(directive: Directive) -> tuple[float, float]:
    """Return depth [m] and speed into the board [m/s] of the motion reference."""
    reference = directive.references["motion"]
    assert isinstance(reference, MotionReference)
    return float(reference.X_WD.translation[2]), float(reference.V_des[2])


def test_the_search_starts_where_the_tool_is_and_ends_at_its_depth() -> None:
    depths = [0.0, 0.001, 0.002, 0.003, 0.051, math.nan, 0.004]
    found = guided(depths, [9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert [directive.mode for directive in found] == ["contact"] * 2 + ["free"] * 5
    references = [inward(directive) for directive in found]
    assert references[:2] == [(0.0, 0.0)] * 2
    slow = pytest.approx(0.018)
    assert references[2:4] == [(0.002, slow), (0.003, slow)]
    assert references[4:6] == [(0.051, 0.0), (0.051, 0.0)]  # a depth nobody knows changes nothing
    assert references[6] == (0.004, slow)


def test_a_regained_contact_is_damped_more_until_it_has_held() -> None:
    found = guided([0.0, 0.0, 0.0, *[0.006] * 203], [0.0] * 4 + [9.0] * 202)
    damping = [
        float(directive.references["force"].arrays["damping"])
        for directive in found
        if directive.mode == "contact"
    ]
    assert damping == [20.0] * 2 + [60.0] * 200 + [20.0] * 2
    assert {inward(directive) for directive in found[4:]} == {(0.006, 0.0)}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"depth": 0.0}, "depth: .*values > 0"),
        ({"depth": 0.06}, "depth: got 0.06, need less than 0.05 m"),
        ({"search_speed": -0.1}, "search_speed: .*values > 0"),
        ({"loss_time": math.nan}, "loss_time: .*finite"),
        ({"fall_after": 1.5}, "fall_after: got 1.5, need more than 1.7 s"),
        ({"duration": 2.0}, r"duration: got 2.0, need at least 2.04 s"),
        ({"friction": -0.1}, "friction: .*>= 0"),
        ({"force": math.inf}, "force: .*finite"),
    ],
    ids=str,
)
def test_what_cannot_be_used_is_refused_in_one_line(wrong, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        Gap(**wrong)
    assert "\n" not in str(caught.value)
