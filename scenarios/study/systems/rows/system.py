"""An arm on a plane whose number of constraint rows it does not know.

The tool is a flat face that an exact plane holds without friction (k = 3: depth and both tips).
The controller believes in one row to four: a point, an edge, the face, or a face in a groove along
y. It presses, asked to hold a pose that is turned about y against the plane, and pushes along x
where it believes in the groove. Closed forms: `scenarios.study.systems.rows.forms`.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import pinocchio as pin

from qpctrl.constraint import (
    Constraint,
    EdgeOnPlane,
    Embedded,
    FaceOnPlane,
    PointOnPlane,
    Selection,
)
from qpctrl.controller import Controller
from qpctrl.law import Law
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from scenarios.plant import PlantState
from scenarios.plant_rigid import RigidPlant
from scenarios.robot_file import load_robot
from scenarios.scenario import Directive, Experiment, Options
from scenarios.study.parameter import Parameter, choice
from scenarios.study.system import Rollout, Setting
from scenarios.study.systems.law import LAW_WORDS, LAWS, force_gains
from scenarios.study.systems.rows.forms import DT, K_P, PRESS, asked, set_point
from scenarios.study.systems.rows.measure import MEASURES, rows_measures
from scenarios.study.systems.trial import run_trial
from tasks import ForceReference, ForceTask, MotionReference, MotionTask, PostureTask

ROBOTS = ("fr3", "ur5")
FRAME, MODE = "flange", "press"
SPACE = TaskSpace(FRAME)
K_D = 60.0  # 1/s, of the motion: settled within a run
RAMP, STEP = 400.0, 1e4  # N/s, into the plane and then aside: there at once, within torque rates


class Holding(NamedTuple):
    """Presses for `PRESS`, then holds still and pushes aside."""

    X_WE: pin.SE3
    """Plane, z into it; the tool starts in this pose."""
    setting: Setting

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the time is over."""
        setting = self.setting
        t = state.time - PRESS
        if t >= setting["duration"] - DT / 2:
            return None
        pressing = t < -DT / 2
        force = ForceReference(
            F_ref=set_point(setting) * [float(not pressing), 1, 1, 1, 1, 1],
            F_meas=state.wrench_meas,
            gains=force_gains(setting, ramp=RAMP if pressing else STEP),
        )
        motion = MotionReference(X_WD=self.X_WE * asked(setting))
        return Directive("press" if pressing else "hold", MODE, {"motion": motion, "force": force})


@dataclass(frozen=True)
class FaceOnExactPlane:
    """An arm and an exact plane that holds its tool in three directions."""

    name: ClassVar[str] = "rows"
    summary: ClassVar[str] = "an arm on an exact plane, k = 3, that believes in 1 to 4 rows"
    parameters: ClassVar[Mapping[str, Parameter]] = {
        "rank_error": Parameter("1", 0.0, -2.0, 1.0, "believed rows − true rows", whole=True),
        "turn": Parameter("deg", 0.5, -2.0, 2.0, "asked pose against the plane, about y"),
        "force": Parameter("N", 20.0, 0.01, 500.0, "set-point into the plane"),
        "side_force": Parameter("N", 1.0, -50.0, 50.0, "set-point along x, if x is believed held"),
        "k_fp": Parameter("1", 0.5, 0.0, 0.99, "proportional force gain"),
        "k_fi": Parameter("1_s", 0.0, 0.0, 1e4, "integral force gain"),
        "damping": Parameter("1_s", 0.0, 0.0, 500.0, "velocity damping of the force directions"),
        "cutoff": Parameter(
            "Hz", 0.0, 0.0, 500.0, "feed-forward of the wrench outside the believed rows; 0: none"
        ),
        "duration": Parameter("s", 0.2, 0.1, 10.0, "length of a run, once pressed"),
        "robot": choice("the arm", *ROBOTS),
    }
    controllers: ClassVar[Mapping[str, str]] = LAW_WORDS
    measures: ClassVar[Mapping[str, str]] = MEASURES

    def run(self, setting: Setting, controller: str, seed: int, *, full: bool = False) -> Rollout:
        """Return the measures of one rollout."""
        name = ROBOTS[int(setting["robot"])]
        robot, rank_error = _robot(name), round(setting["rank_error"])
        X_WE = robot.pose(robot.home, FRAME)
        experiment = Experiment(
            robot=robot,
            controller=_controller(name, LAWS[controller], rank_error),
            plant=RigidPlant(robot, FaceOnPlane(space=SPACE, R_WE=X_WE.rotation), dt=DT),
            guide=Holding(X_WE, setting),
            start_mode=MODE,
            q_start=robot.home,
            horizon=PRESS + setting["duration"] + 1.0,
            geometry={},
        )
        table = run_trial(experiment, full=full)
        return Rollout(rows_measures(robot, FRAME, X_WE, table, setting), table)

    def limit(self, setting: Setting, controller: str, parameter: str) -> float | None:
        """Return none: no limit of this system has a closed form."""
        return None


def believed(X_WE: pin.SE3, rank_error: int) -> Constraint:
    """Return what the controller believes of the contact."""
    found: dict[int, Constraint] = {
        -2: PointOnPlane(space=SPACE, X_WE=X_WE),
        -1: EdgeOnPlane(space=SPACE, X_WE=X_WE, edge=(0.0, 1.0, 0.0)),
        0: FaceOnPlane(space=SPACE, R_WE=X_WE.rotation),
        1: Selection(whole=Embedded(space=SPACE, X_WE=X_WE), keep=(2, 3, 4, 0)),
    }
    return found[rank_error]


@functools.lru_cache(maxsize=2)
def _robot(name: str) -> Robot:
    return load_robot(name)


@functools.lru_cache(maxsize=24)
def _controller(name: str, law: Law, rank_error: int) -> Controller:
    """Return the controller that believes in ``rank_error`` more rows than there are."""
    robot = _robot(name)
    tasks = (
        MotionTask(space=SPACE, K_p=K_P, K_d=K_D),
        ForceTask(space=SPACE),
        PostureTask(q_ref=robot.home),
    )
    mode = Mode(
        name=MODE,
        tasks=tuple(Weighted(task) for task in tasks),
        constraints=(believed(robot.pose(robot.home, FRAME), rank_error),),
    )
    return Options(law=law, compiled="no").controller(robot, [mode], DT)
