"""An arm opens a door whose hinge is not where the controller believes it to be.

The tool is grasped (k = 5) by an exact rigid door. At the start the door is closed and nothing is
wrong yet; as it opens, the believed way of the handle and the true one part. The arm holds still,
opens the door, and holds again; the force is set in the handle, away from the believed hinge.
Closed forms: `scenarios.study.systems.hinge.forms`.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array
from qpctrl.constraint import Hinge
from qpctrl.controller import Controller
from qpctrl.law import Law
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.robot import Robot
from qpctrl.space import TaskSpace
from scenarios.guided import ThereAndBack, TwistPath
from scenarios.plant import PlantState
from scenarios.plant_rigid import RigidPlant
from scenarios.robot_file import load_robot
from scenarios.scenario import Directive, Experiment, Options
from scenarios.study.parameter import Parameter, choice
from scenarios.study.system import Rollout, Setting
from scenarios.study.systems.equilibrium import Loop
from scenarios.study.systems.hinge.forms import Door, closed_door
from scenarios.study.systems.hinge.measure import MEASURES, hinge_measures
from scenarios.study.systems.law import LAW_WORDS, LAWS, force_gains
from scenarios.study.systems.trial import run_trial
from tasks import ForceReference, ForceTask, MotionReference, MotionTask, PostureTask

ROBOTS = ("fr3", "ur5")
FRAME, MODE, HINGE, DT = "flange", "open", "hinge", 1e-3
HOLD = 0.4  # s, at rest before and after
K_P, K_D = 2500.0, 100.0  # 1/s², 1/s, of the motion: settled within the hold
RISE = 0.05  # s, in which the set-point ramps up


class BelievedHinge(NamedTuple):
    """Where the controller believes the hinge to be."""

    X_WE: pin.SE3

    @property
    def arrays(self) -> Mapping[str, Array]:
        """The input of the constraint."""
        return {"X_WE": self.X_WE.homogeneous[:3]}


class Opening(NamedTuple):
    """Holds the handle for `HOLD`, opens the door, and holds it again."""

    robot: Robot
    door: Door
    stroke: ThereAndBack
    setting: Setting

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the time is over."""
        t, setting, half = state.time - HOLD, self.setting, self.stroke.half
        if t >= half + HOLD - DT / 2:
            return None
        force = ForceReference(
            F_ref=self.door.push(self.robot.pose(state.q, FRAME)),
            F_meas=state.wrench_meas,
            gains=force_gains(setting, ramp=setting["force"] / RISE),
        )
        path = TwistPath(X_W0=self.door.X_W0, xi_W=self.door.opening(self.door.X_WE))
        references: dict[str, MotionReference | ForceReference | BelievedHinge] = {
            "motion": path.reference(self.stroke.at(min(t, half))),
            "force": force,
            HINGE: BelievedHinge(self.door.X_WE),
        }
        phase = "hold" if t < 0 else "open" if t < half else "rest"
        return Directive(phase, MODE, references)


@dataclass(frozen=True)
class HingedDoor:
    """An arm and an exact door, hinged elsewhere than the controller believes."""

    name: ClassVar[str] = "hinge"
    summary: ClassVar[str] = "an arm opens an exact door that is hinged elsewhere, k = 5"
    parameters: ClassVar[Mapping[str, Parameter]] = {
        "offset_x": Parameter(
            "m", 0.0, -0.2, 0.1, "hinge nearer to the handle: the radius is shorter by that much"
        ),
        "offset_y": Parameter("m", 0.0, -0.1, 0.1, "hinge aside, against the way of the handle"),
        "tilt_x": Parameter(
            "deg", 0.0, -20.0, 20.0, "tilt of the axis about the line to the handle"
        ),
        "tilt_y": Parameter(
            "deg", 0.0, -20.0, 20.0, "tilt of the axis about the way of the handle"
        ),
        "radius": Parameter("m", 0.35, 0.15, 0.6, "believed distance from hinge to handle"),
        "angle": Parameter("deg", 30.0, 1e-3, 60.0, "angle by which the door is opened"),
        "door_speed": Parameter("deg_s", 40.0, 0.1, 200.0, "speed at which the door is opened"),
        "force": Parameter("N", 8.0, 0.01, 200.0, "set-point, away from the believed hinge"),
        "k_fp": Parameter("1", 0.5, 0.0, 0.99, "proportional force gain"),
        "k_fi": Parameter("1_s", 100.0, 0.0, 1e4, "integral force gain"),
        "damping": Parameter("1_s", 0.0, 0.0, 500.0, "velocity damping of the force directions"),
        "cutoff": Parameter(
            "Hz", 0.0, 0.0, 500.0, "feed-forward of the wrench outside the believed rows; 0: none"
        ),
        "robot": choice("the arm", *ROBOTS),
    }
    controllers: ClassVar[Mapping[str, str]] = LAW_WORDS
    measures: ClassVar[Mapping[str, str]] = MEASURES

    def run(self, setting: Setting, controller: str, seed: int, *, full: bool = False) -> Rollout:
        """Return the measures of one rollout."""
        name = ROBOTS[int(setting["robot"])]
        robot = _robot(name)
        door = closed_door(robot.pose(robot.home, FRAME), setting)
        far, speed = np.radians([setting["angle"], setting["door_speed"]])
        guide = Opening(robot, door, ThereAndBack(far=float(far), speed=float(speed)), setting)
        experiment = Experiment(
            robot=robot,
            controller=_controller(name, LAWS[controller]),
            plant=RigidPlant(robot, Hinge(space=TaskSpace(FRAME), X_WE=door.X_WE_true), dt=DT),
            guide=guide,
            start_mode=MODE,
            q_start=robot.home,
            horizon=2 * HOLD + guide.stroke.half + 1.0,
            geometry={},
        )
        table = run_trial(experiment, full=full)
        gains = (setting["k_fp"], setting["k_fi"])
        loop = Loop(door.push, *gains, K_P, outside=setting["cutoff"] > 0)
        return Rollout(hinge_measures(robot, FRAME, door, loop, table, setting), table)

    def limit(self, setting: Setting, controller: str, parameter: str) -> float | None:
        """Return none: no limit of this system has a closed form."""
        return None


@functools.lru_cache(maxsize=2)
def _robot(name: str) -> Robot:
    return load_robot(name)


@functools.lru_cache(maxsize=8)
def _controller(name: str, law: Law) -> Controller:
    """Return the controller of a grasped door; where its hinge is comes with the references."""
    robot, space = _robot(name), TaskSpace(FRAME)
    tasks = (
        MotionTask(space=space, K_p=K_P, K_d=K_D),
        ForceTask(space=space),
        PostureTask(q_ref=robot.home),
    )
    believed = Hinge(space=space, X_WE=robot.pose(robot.home, FRAME), name=HINGE)
    mode = Mode(name=MODE, tasks=tuple(Weighted(task) for task in tasks), constraints=(believed,))
    return Options(law=law, compiled="no").controller(robot, [mode], DT)
