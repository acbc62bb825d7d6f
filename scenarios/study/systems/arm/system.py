"""An arm presses and slides on a plane whose normal it does not know.

A point of the tool (k = 1) is held by an exact rigid plane, or a ball touches a MuJoCo board. The
controller believes in a plane that is turned against the true one by a signed angle about its x
axis; it presses along the believed normal, holds still, then slides along the believed y axis.
Closed forms: `scenarios.study.systems.arm.forms`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import pinocchio as pin

from scenarios.guided import Stroke, ThereAndBack
from scenarios.plant import PlantState
from scenarios.scenario import Directive, Experiment
from scenarios.study.parameter import Parameter, choice
from scenarios.study.system import Rollout, Setting
from scenarios.study.systems.arm.measure import MEASURES, arm_measures
from scenarios.study.systems.arm.scene import (
    DIRECTIONS,
    DT,
    MODE,
    PLANTS,
    RISE,
    ROBOTS,
    arm,
    controller_of,
    plant_of,
)
from scenarios.study.systems.law import LAW_WORDS, LAWS, force_gains
from scenarios.study.systems.trial import run_trial
from tasks import ForceReference, MotionReference


class Sliding(NamedTuple):
    """Rests, then sets off along ±y of E and is not stopped."""

    X_WE: pin.SE3
    """Believed plane; the tool starts in this pose."""
    setting: Setting
    stroke: ThereAndBack

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the time is over."""
        t, setting = state.time - self.setting["hold"], self.setting
        if t >= setting["slide"] - DT / 2:
            return None
        stroke = self.stroke.at(t) if t > -DT / 2 else Stroke(0.0, 0.0, 0.0)
        along = DIRECTIONS[int(setting["direction"])] * np.eye(6)[1]
        motion = MotionReference(
            X_WD=self.X_WE * pin.SE3(np.eye(3), stroke.s * along[:3]),
            V_des=stroke.s_dot * along,
            V_dot_des=stroke.s_ddot * along,
        )
        force = ForceReference(
            F_ref=setting["force"] * np.eye(6)[2],
            F_meas=state.wrench_meas,
            gains=force_gains(setting, ramp=setting["force"] / RISE),
        )
        phase = "hold" if t < -DT / 2 else "slide"
        return Directive(phase, MODE, {"motion": motion, "force": force})


@dataclass(frozen=True)
class ArmOnPlane:
    """An arm on a plane, tilted against what the controller believes."""

    name: ClassVar[str] = "arm-on-plane"
    summary: ClassVar[str] = "an arm presses and slides on an exact or a MuJoCo plane, k = 1"
    parameters: ClassVar[Mapping[str, Parameter]] = {
        "tilt": Parameter("deg", 0.0, -45.0, 45.0, "tilt of the plane about its x axis"),
        "force": Parameter("N", 10.0, 0.01, 1e4, "set-point along the believed normal"),
        "speed": Parameter("m_s", 0.1, 1e-3, 2.0, "speed along the believed plane"),
        "direction": choice("way along the believed y axis", "forward", "backward"),
        "friction": Parameter("1", 0.0, 0.0, 1.0, "Coulomb friction of the plane"),
        "sensor_bias": Parameter(
            "N", 0.0, -50.0, 50.0, "constant error of the force read, along the tool"
        ),
        "k_fp": Parameter("1", 0.5, 0.0, 0.99, "proportional force gain"),
        "k_fi": Parameter("1_s", 100.0, 0.0, 1e4, "integral force gain"),
        "damping": Parameter("1_s", 0.0, 0.0, 500.0, "velocity damping of the force direction"),
        "cutoff": Parameter(
            "Hz", 0.0, 0.0, 500.0, "feed-forward of the wrench outside the believed normal; 0: none"
        ),
        "plant": choice("what is pressed on: an exact plane, a MuJoCo board", *PLANTS),
        "contact_time": Parameter(
            "s", 0.01, 0.002, 0.1, "time constant of the MuJoCo contact; short is stiff"
        ),
        "hold": Parameter("s", 0.4, 0.3, 10.0, "time at rest"),
        "slide": Parameter("s", 0.6, 0.6, 10.0, "time in motion"),
        "robot": choice("the arm", *ROBOTS),
    }
    controllers: ClassVar[Mapping[str, str]] = LAW_WORDS
    measures: ClassVar[Mapping[str, str]] = MEASURES

    def run(self, setting: Setting, controller: str, seed: int, *, full: bool = False) -> Rollout:
        """Return the measures of one rollout; no QP−law gap where every tick is saturated."""
        names = ROBOTS[int(setting["robot"])], PLANTS[int(setting["plant"])]
        held, speed = arm(*names), setting["speed"]
        far = 2 * speed * setting["slide"]
        experiment = Experiment(
            robot=held.robot,
            controller=controller_of(*names, LAWS[controller]),
            plant=plant_of(held, setting),
            guide=Sliding(held.X_WE, setting, ThereAndBack(far=far, speed=speed)),
            start_mode=MODE,
            q_start=held.robot.home,
            horizon=setting["hold"] + setting["slide"] + 1.0,
            geometry={},
        )
        table = run_trial(experiment, full=full)
        return Rollout(arm_measures(held, table, setting), table)

    def limit(self, setting: Setting, controller: str, parameter: str) -> float | None:
        """Return none: no limit of this system has a closed form."""
        return None
