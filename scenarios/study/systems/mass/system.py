"""A point mass presses on a wall and slides along it; all of its answers are known.

The controller is the real one, with believed normal x. The wall is an exact rigid plane or a
spring with a damper that pushes and never pulls, and it rubs; it is turned against what the
controller believes by a signed tilt: a mass that moves along +y sees the wall recede if the tilt
is positive. Closed forms: `scenarios.study.systems.mass.forms`.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector
from qpctrl.constraint import Pfaffian
from qpctrl.controller import Controller
from qpctrl.law import Law
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.robot import Robot
from scenarios.critical_gain import SPACE, UNBOUNDED, WALL, one_mass
from scenarios.disturbed_plant import DisturbedPlant, TorqueError
from scenarios.environment import SpringWall
from scenarios.force_sensor import ForceSensor, SensedPlant
from scenarios.model_error import ModelError
from scenarios.plant import Plant, PlantState
from scenarios.plant_compliant import CompliantPlant
from scenarios.plant_rigid import RigidPlant
from scenarios.runge_kutta import FINE
from scenarios.scenario import Directive, Experiment, Options
from scenarios.study.parameter import Parameter, choice
from scenarios.study.system import DivergedError, Rollout, Setting
from scenarios.study.systems.law import LAW_WORDS, LAWS, force_gains
from scenarios.study.systems.mass.forms import (
    COMPLIANT,
    GRAVITY,
    K_D,
    K_P,
    MASS,
    lost_tilt,
    slip_speed,
    stability_limit,
    true_axes,
)
from scenarios.study.systems.mass.measure import MEASURES, mass_measures
from scenarios.study.systems.trial import run_trial
from tasks import ForceReference, ForceTask, MotionReference, MotionTask

MODE = "press"
RUNAWAY = 1e4  # times the set-point, where a run ends
FINEST = 0.2  # rad, of the wall's oscillation in one step of the plant
FINEST_MIDPOINT = 0.05  # the same, where the plant takes the midpoint rule
DECAY = 0.5  # of the wall's damper in one step
SCANNED = {"k_fp": (1e-3, 1e3), "k_fi": (1e-2, 1e5), "stiffness": (1.0, 1e8)}
"""Parameters whose stability limit is known, and where it is looked for."""


class Pressing(NamedTuple):
    """Presses along x, and sets off along y at once: a constant acceleration up to the speed."""

    setting: Setting

    def direct(self, state: PlantState) -> Directive | None:
        """Return what to do at ``state``, or none when the time is over or the force ran away."""
        setting, t = self.setting, state.time
        ran_away = abs(state.wrench[0]) > RUNAWAY * setting["force"]
        if t >= setting["duration"] - 0.5 / setting["rate"] or ran_away:
            return None
        y, v, a = stroke(t, setting["speed"], setting["acceleration"])
        along = np.eye(6)[1]
        motion = MotionReference(
            X_WD=pin.SE3(np.eye(3), y * along[:3]), V_des=v * along, V_dot_des=a * along
        )
        force = ForceReference(
            F_ref=np.array([setting["force"], 0.0]),
            F_meas=state.wrench_meas[:2],
            gains=force_gains(setting, 2),
        )
        phase = "hold" if setting["speed"] == 0 else "slide"
        return Directive(phase, MODE, {"motion": motion, "force": force})


@dataclass(frozen=True)
class MassOnWall:
    """A point mass on an exact rigid or compliant wall, with everything that can be wrong."""

    name: ClassVar[str] = "mass-on-wall"
    summary: ClassVar[str] = "a point mass on an exact rigid or compliant wall, all answers known"
    parameters: ClassVar[Mapping[str, Parameter]] = {
        "wall": choice("what the mass presses on", "rigid", "compliant"),
        "tilt": Parameter("deg", 0.0, -45.0, 45.0, "tilt of the wall against the believed one"),
        "friction": Parameter("1", 0.0, 0.0, 1.0, "Coulomb friction of the wall"),
        "stiffness": Parameter("N_m", 1e4, 1e2, 1e7, "stiffness of the compliant wall"),
        "wall_damping": Parameter("Ns_m", 50.0, 0.0, 1e4, "damping of the compliant wall"),
        "offset": Parameter("m", 0.0, -0.02, 0.02, "compliant wall behind its believed place"),
        "pressed": Parameter("1", 1.0, 0.0, 2.0, "force over set-point at which a run starts"),
        "mass_error": Parameter("1", 0.0, -0.9, 10.0, "relative error of the mass"),
        "gravity_error": Parameter("1", 0.0, -2.0, 2.0, "relative error of gravity"),
        "force": Parameter("N", 20.0, 0.01, 100.0, "set-point along the believed normal"),
        "speed": Parameter("m_s", 0.0, -20.0, 20.0, "speed along the believed wall; 0: holds"),
        "acceleration": Parameter("m_s2", 5.0, 1e-3, 100.0, "acceleration up to the speed"),
        "k_fp": Parameter("1", 0.0, 0.0, 1e3, "proportional force gain"),
        "k_fi": Parameter("1_s", 0.0, 0.0, 1e5, "integral force gain"),
        "damping": Parameter("1_s", 0.0, 0.0, 1e3, "velocity damping of the force directions"),
        "cutoff": Parameter(
            "Hz", 0.0, 0.0, 500.0, "feed-forward of the force outside the believed normal; 0: none"
        ),
        "delay": Parameter("ticks", 1.0, 1.0, 100.0, "age of the force reading", whole=True),
        "sensor_gain": Parameter("1", 1.0, 0.1, 10.0, "force read per true force"),
        "sensor_bias": Parameter(
            "N", 0.0, -50.0, 50.0, "constant error of the force read, along x"
        ),
        "sensor_noise": Parameter("N", 0.0, 0.0, 10.0, "standard deviation of the force read"),
        "sensor_cutoff": Parameter("Hz", 0.0, 0.0, 5e3, "low-pass of the force read; 0: none"),
        "torque_gain": Parameter("1", 1.0, 0.1, 10.0, "force delivered per force asked for"),
        "torque_bias": Parameter(
            "N", 0.0, -50.0, 50.0, "constant error of the force delivered, along x"
        ),
        "rate": Parameter("Hz", 1e3, 100.0, 1e4, "rate of control", whole=True),
        "duration": Parameter("s", 1.0, 0.1, 20.0, "length of a run, judged in its second half"),
    }
    controllers: ClassVar[Mapping[str, str]] = LAW_WORDS
    measures: ClassVar[Mapping[str, str]] = MEASURES

    def run(self, setting: Setting, controller: str, seed: int, *, full: bool = False) -> Rollout:
        """Return the measures of one rollout; it diverged where the force ran away."""
        robot = _robot()
        experiment = Experiment(
            robot=robot,
            controller=_controller(LAWS[controller], setting["rate"]),
            plant=_plant(robot, setting, seed),
            guide=Pressing(setting),
            start_mode=MODE,
            q_start=_start(setting),
            horizon=setting["duration"] + 1.0,
            geometry={},
        )
        table = run_trial(experiment, full=full)
        if len(table) < round(setting["duration"] * setting["rate"]):
            end = len(table) / setting["rate"]
            raise DivergedError(f"force above {RUNAWAY:g} × set-point at {end:.3f} s", table)
        return Rollout(mass_measures(table, setting), table)

    def limit(self, setting: Setting, controller: str, parameter: str) -> float | None:
        """Return the tilt at which contact is lost, or the gain or stiffness that is critical."""
        if parameter == "tilt":
            return lost_tilt(setting)
        if parameter in SCANNED:
            return stability_limit(setting, parameter, *SCANNED[parameter])
        return None


def stroke(t: float, speed: float, acceleration: float) -> tuple[float, float, float]:
    """Return place [m], speed [m/s] and acceleration [m/s²] along y at time ``t`` [s]."""
    a, ramp = math.copysign(acceleration, speed), abs(speed) / acceleration
    if t < ramp:
        return a * t**2 / 2, a * t, a
    return speed * (t - ramp / 2), speed, 0.0


def _start(setting: Setting) -> Vector:
    """Return where the mass starts (2) [m]: pressed in by the believed place of the wall."""
    if setting["wall"] != COMPLIANT:
        return np.zeros(2)
    depth = setting["pressed"] * setting["force"] / setting["stiffness"]
    return np.array([depth / true_axes(setting)[0][0], 0.0])


def _plant(robot: Robot, setting: Setting, seed: int) -> Plant:
    """Return the true world, seen through its sensor."""
    n, t = true_axes(setting)
    dt, mu = 1 / setting["rate"], setting["friction"]
    error = ModelError(mass=setting["mass_error"], gravity=setting["gravity_error"])
    slip = slip_speed(setting)
    plant: Plant
    if setting["wall"] == COMPLIANT:
        R_WE = np.array([[0, t[0], n[0]], [0, t[1], n[1]], [-1, 0, 0]])
        X_WE = pin.SE3(R_WE, np.array([*(setting["offset"] * n), 0.0]))
        wall = SpringWall(X_WE, setting["stiffness"], setting["wall_damping"], mu, slip)
        plant = CompliantPlant(
            robot, SPACE.frame, wall, model_error=error, dt=dt, substeps=_substeps(setting)
        )
    else:
        true = Pfaffian(space=SPACE, A=n[np.newaxis], name="wall")
        plant = RigidPlant(robot, true, friction=mu, slip_speed=slip, model_error=error, dt=dt)
    torque = TorqueError(
        gain=setting["torque_gain"], bias=setting["torque_bias"] * np.array([1.0, 0.0])
    )
    sensor = ForceSensor(
        gain=setting["sensor_gain"],
        bias=setting["sensor_bias"] * np.eye(6)[0],
        noise=setting["sensor_noise"],
        cutoff=setting["sensor_cutoff"],
        delay=round(setting["delay"]) - 1,
    )
    return SensedPlant(DisturbedPlant(plant, torque, robot), sensor, seed)


def _substeps(setting: Setting) -> int:
    """Return how many steps of the plant make a period, for what the wall does meanwhile."""
    m, dt = (1 + setting["mass_error"]) * MASS, 1 / setting["rate"]
    angle, decay = math.sqrt(setting["stiffness"] / m) * dt, setting["wall_damping"] / m * dt
    finest = FINEST_MIDPOINT if dt <= FINE else FINEST
    return max(math.ceil(angle / finest), math.ceil(decay / DECAY), 1)


@functools.lru_cache(maxsize=1)
def _robot() -> Robot:
    """Return the mass that the controller believes in, on a table: x points down."""
    robot = one_mass(MASS)
    robot.model.gravity.linear = np.array([GRAVITY, 0.0, 0.0])
    return robot


@functools.lru_cache(maxsize=24)
def _controller(law: Law, rate: float) -> Controller:
    """Return the controller that believes in a wall across x."""
    force = ForceTask(space=SPACE, integral_max=UNBOUNDED, ramp=UNBOUNDED)
    tasks = (Weighted(MotionTask(space=SPACE, K_p=K_P, K_d=K_D)), Weighted(force))
    mode = Mode(name=MODE, tasks=tasks, constraints=(WALL,))
    return Options(law=law, compiled="no").controller(_robot(), [mode], 1 / rate)
