"""An arm presses on a board and runs circles on it; everything about board, arm and sensors is off.

The FR3 of the scenario `eraser` with its MuJoCo contact, without a long approach: the tool just
touches the true board at the start, held as if the believed board were true.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import polars as pl

from qpctrl.arrays import Matrix
from qpctrl.errors import InputError
from scenarios.metric import column
from scenarios.scenario import Experiment
from scenarios.study.parameter import Parameter, choice
from scenarios.study.system import Rollout, Setting
from scenarios.study.systems.trial import run_trial
from scenarios.study.systems.wipe.controller import KINDS, MODE, SOLVERS, controller, guide
from scenarios.study.systems.wipe.guide import PRESS_TIME, Job, circles
from scenarios.study.systems.wipe.measure import MEASURES, Seen, wipe_measures
from scenarios.study.systems.wipe.world import ACTUATORS, STEP, TIPS, Scene, scene

JOB = {
    "force": Parameter("N", 10.0, 0.1, 500.0, "set-point along the believed normal"),
    "speed": Parameter("m_s", 0.2, 1e-3, 2.0, "speed along the circles"),
    "radius": Parameter("m", 0.03, 1e-3, 0.12, "radius of the circles"),
    "duration": Parameter("s", 2.2, 0.1, 600.0, "time in motion"),
    "judged_from": Parameter("s", 0.6, 0.0, 600.0, "time from which errors count"),
    "tip": choice("what touches the board: a ball (k = 1) or flat felt (k = 3)", *TIPS),
}
BOARD = {
    "tilt_x": Parameter("deg", 0.0, -30.0, 30.0, "tilt of the board about its x axis"),
    "tilt_y": Parameter("deg", 0.0, -30.0, 30.0, "tilt of the board about its y axis"),
    "offset": Parameter("m", 0.0, -0.05, 0.05, "board behind its believed place, along its normal"),
    "friction": Parameter("1", 0.3, 0.0, 2.0, "Coulomb friction of tool and board"),
    "friction_model": Parameter(
        "1", 0.3, 0.0, 2.0, "Coulomb friction as a controller with a cone knows it"
    ),
    "pad_time": Parameter("s", 0.01, 0.002, 0.1, "time constant of the contact; short is stiff"),
    "pad_damping": Parameter("1", 1.0, 0.05, 5.0, "damping ratio of the contact"),
}
ARM = {
    "mass_error": Parameter("1", 0.0, -0.9, 2.0, "relative error of the mass of every link"),
    "com_error": Parameter("m", 0.0, -0.1, 0.1, "shift of every link's centre of mass along its x"),
    "gravity_error": Parameter("1", 0.0, -1.0, 1.0, "relative error of gravity"),
    "payload": Parameter("kg", 0.0, 0.0, 10.0, "point mass at the tool that nobody knows of"),
    "torque_gain": Parameter("1", 1.0, 0.0, 3.0, "torque delivered per torque asked for"),
    "torque_spread": Parameter("1", 0.0, 0.0, 1.0, "half range of the torque gain over the joints"),
    "torque_bias": Parameter("Nm", 0.0, 0.0, 50.0, "half range of a constant torque in each joint"),
    "torque_delay": Parameter("ticks", 0.0, 0.0, 50.0, "age of the torque", whole=True),
    "joint_friction": Parameter("Nm", 0.0, 0.0, 50.0, "static and Coulomb friction of each joint"),
    "joint_damping": Parameter("Nms_rad", 0.0, 0.0, 50.0, "viscous friction of each joint"),
    "actuator": choice("what moves the joints", *ACTUATORS),
}
SENSORS = {
    "sensor_gain": Parameter("1", 1.0, 0.1, 3.0, "reading of the force sensor per true wrench"),
    "sensor_bias": Parameter("N", 0.0, -50.0, 50.0, "constant error of the force along the tool"),
    "sensor_noise": Parameter("N", 0.0, 0.0, 20.0, "standard deviation of the measured force"),
    "sensor_delay": Parameter("ticks", 0.0, 0.0, 50.0, "age of the reading beyond one", whole=True),
    "sensor_cutoff": Parameter("Hz", 0.0, 0.0, 500.0, "low-pass of the force sensor; 0: none"),
    "noise_q": Parameter("rad", 0.0, 0.0, 0.01, "standard deviation of measured joint angles"),
    "noise_v": Parameter("rad_s", 0.0, 0.0, 1.0, "standard deviation of measured joint speeds"),
    "latency": Parameter("ticks", 0.0, 0.0, 50.0, "age of measured angles and speeds", whole=True),
}
CONTROL = {
    "period": Parameter("ms", 1.0, 1.0, 10.0, "period of the controller", whole=True),
    "k_p": Parameter("1_s2", 1600.0, 0.0, 1e5, "stiffness of the motion per unit inertia"),
    "k_i": Parameter("1_s3", 0.0, 0.0, 1e6, "integral gain of the motion"),
    "k_d": Parameter("1_s", 80.0, 0.0, 1e3, "damping of the motion per unit inertia"),
    "k_fp": Parameter("1", 0.5, 0.0, 10.0, "proportional force gain"),
    "k_fi": Parameter("1_s", 20.0, 0.0, 1e4, "integral force gain"),
    "k_mi": Parameter("1_s", 0.0, 0.0, 1e4, "integral gain of the moments that keep felt flat"),
    "damping": Parameter("1_s", 20.0, 0.0, 1e3, "velocity damping of the force directions"),
    "cutoff": Parameter(
        "Hz", 50.0, 0.0, 500.0, "feed-forward of the wrench outside the force directions; 0: none"
    ),
    "motion_weight": Parameter("1", 1.0, 1e-6, 1e6, "weight of the motion in the QP"),
    "force_weight": Parameter("1", 1.0, 1e-6, 1e6, "weight of the force in the QP"),
    "spring": Parameter("N_m", 3000.0, 0.0, 1e5, "impedance: stiffness along the board"),
    "spring_normal": Parameter("N_m", 500.0, 1.0, 1e5, "impedance: stiffness into the board"),
    "spring_rot": Parameter("Nm_rad", 100.0, 0.0, 1e4, "impedance: stiffness of rotation"),
    "yield_damping": Parameter("Ns_m", 500.0, 1.0, 1e6, "admittance: force error per speed"),
    "yield_cutoff": Parameter("Hz", 30.0, 0.1, 500.0, "admittance: low-pass of the reading"),
    "solver": choice("what solves the QP", *SOLVERS),
}


@dataclass(frozen=True)
class Wipe:
    """An arm that presses and runs circles on a MuJoCo board it does not know."""

    name: ClassVar[str] = "wipe"
    summary: ClassVar[str] = (
        "an arm presses and runs circles on a MuJoCo board, all of it uncertain"
    )
    parameters: ClassVar[Mapping[str, Parameter]] = {**JOB, **BOARD, **ARM, **SENSORS, **CONTROL}
    controllers: ClassVar[Mapping[str, str]] = {name: kind.words for name, kind in KINDS.items()}
    measures: ClassVar[Mapping[str, str]] = MEASURES

    def run(self, setting: Setting, controller: str, seed: int, *, full: bool = False) -> Rollout:
        """Return the measures of one rollout: errors from ``judged_from`` on, contact once pressed.

        Raises:
            InputError: nothing is left to judge.
            DivergedError: a state that left all bounds.
        """
        whole = PRESS_TIME + setting["duration"]
        if setting["judged_from"] >= whole:
            got = f"judged_from: got {setting['judged_from']:g} s"
            raise InputError(f"{got}, need less than the {whole:g} s that a rollout takes")
        path = circles(
            setting["radius"], setting["speed"], setting["duration"], setting["period"] * STEP
        )
        world = scene(setting, setting["radius"], seed)
        job = Job(world.X_WE, path, setting["force"])
        table = run_trial(_experiment(setting, controller, world, job), full=full)
        seen = Seen(
            robot=world.level.robot,
            job=job,
            X_WE_true=world.X_WE_true,
            table=table,
            q=_true_q(world, table),
            judged_from=setting["judged_from"],
        )
        return Rollout(wipe_measures(seen), table)

    def limit(self, setting: Setting, controller: str, parameter: str) -> float | None:
        """Return none: no limit of this system has a closed form."""
        return None


def _experiment(setting: Setting, name: str, world: Scene, job: Job) -> Experiment:
    return Experiment(
        robot=world.level.robot,
        controller=controller(name, TIPS[int(setting["tip"])], setting),
        plant=world.plant,
        guide=guide(name, job, setting),
        start_mode=MODE,
        q_start=world.q_start,
        horizon=len(job.path.p) * job.path.dt + 1.0,
        geometry={},
    )


def _true_q(world: Scene, table: pl.DataFrame) -> Matrix:
    """Return the true configuration of each tick (ticks×nq) [rad]."""
    if world.observed is not None:
        return world.observed.motion().q[: len(table)]
    names = world.level.robot.joint_names
    return np.stack([column(table, f"q.{name}") for name in names], axis=1)
