"""Two arms and a box: forces, path and slip from the plant's own numbers, and what gives way."""

import functools
from dataclasses import replace

import numpy as np
import oracles
import pinocchio as pin
import polars as pl
import pytest

from qpctrl import Controller, InputError, Status
from qpctrl.constraint import Embedded, FaceOnPlane
from qpctrl.memory import Measurement
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.space import TaskSpace
from scenarios.bimanual import Bimanual
from scenarios.run import run_scenario
from scenarios.scenario import Options, Outcome
from scenarios.whole_body.bimanual_metric import PHASES, what_gave_way
from scenarios.whole_body.bimanual_modes import CARRY, STAND, Grip, box_modes
from scenarios.whole_body.bimanual_path import AXIS, eight, ring, sink, straight
from scenarios.whole_body.bimanual_world import BOTTOM, PADS, BoxWorld, build_box_world
from tasks import ForceTask, MotionReference

SQUEEZE, PRESS, MASS, GRAVITY = 60.0, 30.0, 2.0, 9.81
QUICK = Bimanual(squeeze=SQUEEZE, duration=3.0)
"""Firmer than by default, so that it can be quicker."""
PLAIN = Options(compiled="no")
DIFFERENCE = 0.1
"""N: of the mass times a second difference over 10 ms, of a motion that changes in 100 ms."""


@functools.cache
def run() -> Outcome:
    """Return the run, made once."""
    return run_scenario(QUICK, PLAIN)


@functools.cache
def failed(**changes: float) -> Outcome:
    """Return a run that cannot go well."""
    return run_scenario(replace(Bimanual(), **changes), PLAIN)


@functools.cache
def world() -> BoxWorld:
    return build_box_world()


def phase(name: str) -> pl.DataFrame:
    return run().table.filter(pl.col("phase") == name)


def missed(outcome: Outcome) -> set[str]:
    return {c["name"] for c in outcome.summary["criteria"] if not c["passed"]}


def wrench(table: pl.DataFrame, name: str) -> np.ndarray:
    return table.select(f"contact.{name}.{part}" for part in ("fx", "fy", "fz")).to_numpy()


def configurations(table: pl.DataFrame) -> np.ndarray:
    return table.select(f"q.{name}" for name in world().robot.configuration_names).to_numpy()


def rotation(q: np.ndarray, frame: str) -> np.ndarray:
    robot = world().robot
    return oracles.frame_terms(robot.model, q, np.zeros(robot.nv), frame).X_WF.rotation


def test_the_job_meets_its_criteria_and_goes_through_every_phase() -> None:
    assert not missed(run()), run().summary["criteria"]
    assert tuple(run().table["phase"].unique(maintain_order=True)) == PHASES
    modes = run().table["mode"].rle().struct.field("value").to_list()
    there = ["reach", "stand", "carry", "stand", "slide", "stand", "carry", "stand", "reach"]
    assert modes == there
    assert run().table["kkt_residual"].max() <= 1e-8
    assert not run().table["fallback"].any()


def test_the_box_is_squeezed_as_set_while_it_is_carried() -> None:
    table = run().table.filter(pl.col("mode") == CARRY)
    force = 0.5 * (wrench(table, "left")[:, 2] + wrench(table, "right")[:, 2])
    assert force.mean() == pytest.approx(SQUEEZE, rel=1e-3)
    share = np.sqrt(np.mean((force - SQUEEZE) ** 2)) / SQUEEZE
    assert share < 0.03
    metrics = run().summary["metrics"]
    assert metrics["grasp_force_rmse_share"] == pytest.approx(share, rel=1e-9)


def test_forces_on_the_box_are_its_mass_times_what_it_accelerates() -> None:
    """Newton's law with true wrenches, and accelerations from differences of places."""
    table, step = phase("carry"), 10
    q = configurations(table)
    p = q[:, :3]
    felt, moved = [], []
    for i in range(step, len(q) - step, 50):
        pads = [
            rotation(q[i], f"{side}_pad") @ wrench(table, side)[i + 1] for side in ("left", "right")
        ]
        felt.append(np.sum(pads, axis=0) - [0, 0, MASS * GRAVITY])
        moved.append(MASS * (p[i + step] - 2 * p[i] + p[i - step]) / (step * 1e-3) ** 2)
    assert np.array(felt) == pytest.approx(np.array(moved), abs=DIFFERENCE)
    assert np.abs(moved).max() > 1.0  # N


def test_the_box_flies_its_eight_turned_and_risen() -> None:
    q = configurations(phase("carry"))
    p_bottom = [row[:3] - 0.12 * rotation(row, "box")[:, 2] for row in q]
    reach = np.ptp(np.array(p_bottom), axis=0)
    assert reach == pytest.approx([0.16, 0.08, 0.05], abs=1e-3)
    turned = [np.linalg.norm(pin.log3(rotation(row, "box"))) for row in q]
    assert np.degrees(max(turned)) == pytest.approx(15.0, abs=0.1)


def test_the_box_is_pressed_on_the_table_while_it_slides() -> None:
    table = phase("slide")
    force = wrench(table, "table")
    assert force[:, 2].mean() == pytest.approx(PRESS, rel=3e-3)
    assert np.abs(force[:, 2] - PRESS).max() < 0.03 * PRESS
    fast = slice(len(force) // 3, 2 * len(force) // 3)
    drag = np.linalg.norm(force[fast, :2], axis=1)
    assert drag == pytest.approx(0.3 * force[fast, 2], rel=0.01)  # Coulomb's law: it does slide
    x = configurations(table)[:, 0]
    assert np.ptp(x) == pytest.approx(0.08, abs=5e-4)


def test_no_pad_slips_and_margins_are_those_of_the_wrenches() -> None:
    metrics = run().summary["metrics"]
    assert 0.0 < metrics["slip_max_mm"] <= 0.5
    phases = PHASES[PHASES.index("unload") : PHASES.index("loose")]
    table = run().table.filter(pl.col("phase").is_in(phases))
    left = [
        wrench(table, side)[:, 2] - np.hypot(*wrench(table, side)[:, :2].T)
        for side in ("left", "right")
    ]
    assert metrics["friction_margin_min_N"] == pytest.approx(np.min(left))
    assert metrics["friction_margin_min_N"] > 0.5 * SQUEEZE
    assert metrics["cop_margin_min_mm"] > 0.0


def test_no_torque_jumps_where_contacts_come_and_go() -> None:
    table = run().table
    tau = table.select(f"tau.{name}" for name in world().robot.actuator_names).to_numpy()
    step = np.abs(np.diff(tau, axis=0)).max(axis=1)  # Nm; a tick allows 1 Nm
    mode = table["mode"].to_numpy()
    switches = step[mode[1:] != mode[:-1]]
    assert len(switches) == 8
    assert switches.max() < 0.6
    metrics = run().summary["metrics"]
    assert metrics["torque_step_switch_max"] == pytest.approx(switches.max())
    assert metrics["torque_step_max_share"] == pytest.approx(step.max())


def test_the_box_is_left_where_it_stood_and_the_hands_are_off() -> None:
    first, last = (configurations(run().table)[i] for i in (0, -1))
    assert last[:2] == pytest.approx(first[:2], abs=2e-3)
    assert wrench(run().table, "left")[-1] == pytest.approx(np.zeros(3), abs=0)
    assert wrench(run().table, "table")[-1] == pytest.approx([0, 0, MASS * GRAVITY], abs=0.05)


@pytest.mark.parametrize(
    ("changes", "criteria", "words"),
    [
        ({"squeeze": 5.0}, {"pad_friction_limit_ticks"}, "friction at its limit"),
        (
            {"squeeze": 5.0, "squeeze_max": 6.0},
            {"pad_friction_limit_ticks", "pad_force_limit_ticks", "unloaded_share"},
            "force at its limit",
        ),
        ({"friction": 0.2}, {"slip_max_mm", "friction_used_max"}, "pad slipped 0.5 mm"),
        (
            {"mass": 60.0, "squeeze": 150.0, "squeeze_max": 300.0},
            {"unloaded_share", "phases_left"},
            "torque at its limit",
        ),
    ],
    ids=["too light a grasp", "nothing to spare", "slippery", "too heavy"],
)
def test_what_cannot_be_held_ends_with_a_verdict(changes, criteria, words) -> None:
    outcome = failed(**changes)
    assert not outcome.passed
    assert criteria <= missed(outcome), outcome.summary["criteria"]
    assert any(words in said for said in what_gave_way(outcome.table, world()))
    robot, table = world().robot, outcome.table
    tau = table.select(f"tau.{name}" for name in robot.actuator_names).to_numpy()
    assert np.isfinite(tau).all()
    assert (np.abs(tau) <= robot.limits.tau_max + 1e-9).all()
    assert "carry" not in table["phase"].unique()


def test_a_grasp_that_is_too_light_never_lifts_the_box() -> None:
    table = failed(squeeze=5.0, squeeze_max=6.0).table
    assert set(table["phase"]) == {"reach", "squeeze", "unload"}
    left = wrench(table, "table")[-1, 2]
    most = 2 * 0.8 * 6.0  # N, what two pads can lift with the friction that is assumed
    assert MASS * GRAVITY - most <= left < MASS * GRAVITY
    assert "task press gave way" in table["explanation"][-1]


def a_mode(name: str, *more) -> Mode:
    """Return a mode of the scenario with further constraints on the box."""
    (mode,) = [m for m in box_modes(world(), Grip(friction=0.8, most=80.0)) if m.name == name]
    forces = [Weighted(ForceTask(space=c.space, name=f"{c.name} force")) for c in more]
    held = {weighted.task.space for weighted in mode.tasks}
    forces = [force for force in forces if force.task.space not in held]
    return replace(mode, tasks=(*mode.tasks, *forces), constraints=(*mode.constraints, *more))


BOX = TaskSpace("box")


def to_world(name: str = "world") -> Embedded:
    return Embedded(space=BOX, X_WE=pin.SE3.Identity(), name=name)


def test_a_box_that_is_fixed_twice_is_refused_by_name_or_the_rows_are_dropped() -> None:
    twice = a_mode(STAND, to_world())
    with pytest.raises(InputError, match=r"constraint row world\.\w+ depends on the rows before"):
        Controller(world().robot, [twice])
    dropped = Controller(world().robot, [twice], dependent_rows="drop").engines[STAND].tick.rows
    assert not [row for row in dropped.constraint if row.startswith("world.")]
    assert len(dropped.constraint) == 18


def test_planes_that_oppose_each_other_depend_on_each_other() -> None:
    up = world().X_WT.rotation @ np.diag([1.0, -1.0, -1.0])
    ceiling = FaceOnPlane(space=BOX, R_WE=up, name="ceiling")
    with pytest.raises(InputError, match=r"ceiling\.vz depends"):
        Controller(world().robot, [a_mode(STAND, ceiling)])
    rows = (
        Controller(world().robot, [a_mode(STAND, ceiling)], dependent_rows="drop")
        .engines[STAND]
        .tick.rows
    )
    assert "ceiling.vz" not in rows.constraint


def test_a_box_that_only_a_ceiling_holds_has_no_solution_and_torques_stay_in_their_limits() -> None:
    """A face that can push alone does not carry what hangs below it."""
    robot = world().robot
    up = world().X_WT.rotation @ np.diag([1.0, -1.0, -1.0])
    ceiling = FaceOnPlane(space=BOTTOM, R_WE=up, name="ceiling")
    (reach,) = [m for m in box_modes(world(), Grip(friction=0.8, most=80.0)) if m.name == "reach"]
    controller = Controller(robot, [replace(reach, constraints=(ceiling,))])
    references = {f"{side} hand": hand_at_home(side) for side in ("left", "right")}
    memory = controller.start("reach", robot.home)
    state = Measurement(0.0, robot.home, np.zeros(robot.nv))
    command, report, _ = controller.step("reach", state, references, memory)
    assert report.status is Status.INFEASIBLE
    assert "no torque within the limits" in report.explain()
    assert (np.abs(command.tau) <= robot.limits.tau_max).all()
    g = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.home)
    assert command.tau == pytest.approx(g[6:], abs=1e-6)  # the arms hold themselves


def hand_at_home(side: str) -> MotionReference:
    return MotionReference(X_WD=world().robot.pose(world().robot.home, f"{side}_pad"))


def test_the_start_is_a_box_on_the_table_and_pads_five_millimetres_off() -> None:
    robot = world().robot
    X_WO = robot.pose(robot.home, "box")
    assert robot.pose(robot.home, BOTTOM.frame).translation == pytest.approx([0, 0, 0.83])
    for pad, sign in zip(PADS, (1.0, -1.0), strict=True):
        X_OP = X_WO.inverse() * robot.pose(robot.home, pad.frame)
        assert X_OP.translation == pytest.approx([0, sign * 0.125, 0], abs=1e-9)
        assert X_OP.rotation[:, 2] == pytest.approx([0, -sign, 0], abs=1e-9)
    state = world().plant().reset(robot.home)
    assert not np.any(state.contacts[:2])


PATHS = {
    "straight": straight(np.zeros(3), np.array([0.1, -0.2, 0.3]), 1.0),
    "sink": sink(np.zeros(3), 0.01),
    "eight": eight(np.array([0.0, 0.0, 0.1]), (0.08, 0.04, 0.05), 0.3, 1.0),
    "ring": ring(np.zeros(3), 0.04, 1.0),
}


@pytest.mark.parametrize("name", PATHS)
def test_derivatives_of_a_path_are_those_of_its_poses(name: str) -> None:
    step, X_WT = 1e-5, world().X_WT
    for t in (0.05, 0.3, 0.55, 0.8):
        before, here, after = (PATHS[name](t + s).reference(X_WT) for s in (-step, 0, step))
        V = pin.log6(before.X_WD.inverse() * after.X_WD).vector / (2 * step)
        assert here.V_des == pytest.approx(V, abs=1e-6)
        V_dot = (after.V_des - before.V_des) / (2 * step)
        assert here.V_dot_des == pytest.approx(V_dot, abs=1e-5)
        assert np.abs(V).max() > 1e-3
    assert np.linalg.norm(AXIS) == pytest.approx(1.0)


def test_the_pictures_show_path_forces_contacts_and_what_gave_way() -> None:
    panels = {panel.key: panel for panel in QUICK.panels(run())}
    assert {"path", "error", "forces", "margins", "contact-left", "step"} <= set(panels)
    assert "Nothing gave way" in panels["forces"].caption
    force = panels["forces"].figure["data"][0]
    assert np.nanmax(force["y"]) == pytest.approx(SQUEEZE, rel=0.01)
    failing = {panel.key: panel for panel in Bimanual().panels(failed(friction=0.2))}
    assert "slipped 0.5 mm" in failing["margins"].caption


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"squeeze": 0.0}, "squeeze: .*> 0"),
        ({"squeeze": 90.0}, "squeeze: got 90 N, need at most squeeze_max, 80 N"),
        ({"press": -1.0}, "press: .*> 0"),
        ({"mass": float("nan")}, "mass: .*finite"),
        ({"mass": 1000.0}, "mass: got 1000.0, need at most 100 kg"),
        ({"height": 0.5}, "height: got 0.5, need at most 0.15 m"),
        ({"friction": -0.1}, "friction: .*>= 0"),
        ({"turn": 90.0}, "turn: got 90.0, need at most 30 deg"),
    ],
    ids=str,
)
def test_what_makes_no_sense_is_refused(wrong, words: str) -> None:
    with pytest.raises(InputError, match=words) as refused:
        Bimanual(**wrong)
    assert "\n" not in str(refused.value)


def test_joints_with_drives_are_refused() -> None:
    with pytest.raises(InputError, match="actuator: got 'direct-drive'"):
        Bimanual().prepare(Options(actuator="direct-drive"))
