"""Where the force loop becomes unstable, found by bisection on the exact rigid plant.

One mass presses on a rigid wall under the real force task and controller; the force is ``delay``
ticks old. With κ = K_fi T_s: |K_fp| < 1 for P at any delay, κ < 2 (1 − K_fp) for PI at one tick,
κ < 2 sin(π / (2 (2d − 1))) for I at d ticks.
"""

import math
from collections import deque
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector, finite_array
from qpctrl.constraint import Pfaffian
from qpctrl.controller import Controller
from qpctrl.errors import InputError
from qpctrl.memory import Measurement
from qpctrl.mode import Mode
from qpctrl.objective import Weighted
from qpctrl.robot import Robot, from_pinocchio
from qpctrl.space import TaskSpace
from scenarios.bisection import boundary
from scenarios.plant_rigid import RigidPlant
from scenarios.scenario import Options
from tasks import ForceReference, ForceTask, MotionReference, MotionTask

SPACE = TaskSpace("tool", ("vx", "vy"))
DT = 1e-3  # s, the control period
UNBOUNDED = 1e9  # ramp [N/s] and integral [N s] that never bind
RUNAWAY = 1e4  # N; the set-point is 1 N
ROUND_OFF = 1e-10  # N, from tick to tick
SEARCHED = (0.01, 2.5)  # gains that are tried; no loop here is stable beyond 2
MODE = "pressing"


WALL = Pfaffian(space=SPACE, A=np.array([[1.0, 0.0]]), name="wall")
"""A rigid, friction-free wall across x."""


class Case(NamedTuple):
    """A force loop whose critical gain is known."""

    words: str
    gain: Literal["k_fp", "k_fi"]
    delay: int
    """Age of the measured force [ticks]."""
    k_fp: float
    """Proportional gain [1] while the integral gain is raised."""
    closed_form: float
    """Critical K_fp [1] or κ = K_fi T_s [1]."""


CASES = (
    *(Case(f"P, {d} ticks", "k_fp", d, 0.0, 1.0) for d in (1, 3)),
    *(Case(f"PI, K_fp = {p:g}", "k_fi", 1, p, 2 * (1 - p)) for p in (0.0, 0.3, 0.6)),
    *(
        Case(f"I, {d} ticks", "k_fi", d, 0.0, 2 * math.sin(math.pi / (2 * (2 * d - 1))))
        for d in (2, 3, 5, 10)
    ),
)
"""Force loops and what theory says of them."""


def critical_gain(
    gain: Literal["k_fp", "k_fi"],
    *,
    delay: int = 1,
    k_fp: float = 0.0,
    tolerance: float = 4e-3,
    options: Options | None = None,
) -> float:
    """Return the largest stable K_fp [1], or κ = K_fi T_s [1], found by bisection.

    Args:
        gain: which gain is raised; the integral is off while ``k_fp`` is.
        delay: age of the measured force [ticks], at least 1.
        k_fp: proportional gain [1] while ``k_fi`` is raised.
        tolerance: width of the last interval over the gain [1].
        options: how the controller solves.

    Raises:
        InputError: unknown gain, a delay below 1, or a gain or tolerance that cannot be used.
    """
    if gain not in ("k_fp", "k_fi"):
        raise InputError(f"gain: got {gain!r}, need k_fp or k_fi")
    if delay < 1:
        raise InputError(f"delay: got {delay}, need at least 1 tick")
    if not 0 < float(finite_array(tolerance, (), "tolerance")) < 1:
        raise InputError(f"tolerance: got {tolerance}, need a number between 0 and 1")
    robot = one_mass()
    given = options or Options()
    controller = Controller(robot, (_mode(k_fp),), dt=DT, solver=given.solver, form=given.form)
    gains = controller.engines[MODE].inputs

    def stable(value: float) -> bool:
        gains[f"force.K_{gain[2:]}"][...] = value if gain == "k_fp" else value / DT
        return settles(_forces(controller, delay))

    low, high = (math.log10(end) for end in SEARCHED)
    width = math.log10(1 + tolerance)
    return float(10.0 ** boundary(lambda exponent: stable(10.0**exponent), low, high, width))


def settles(forces: Vector) -> bool:
    """Return whether a record of force [N] changes less from tick to tick in its last quarter."""
    change = np.diff(forces)
    quarter = len(change) // 4
    early, late = change[quarter : 2 * quarter], change[-quarter:]
    calm = np.abs(late).max() < ROUND_OFF
    return bool(np.abs(forces).max() < RUNAWAY and (calm or late @ late < early @ early))


def one_mass(m: float = 5.0) -> Robot:
    """Return a point mass ``m`` [kg] that slides along x and y, without limits."""
    model = pin.Model()
    model.name = "one_mass"
    model.gravity.linear = np.zeros(3)
    cart = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    joint = model.addJoint(cart, pin.JointModelPY(), pin.SE3.Identity(), "y")
    body = pin.Inertia(m, np.zeros(3), np.zeros((3, 3)))
    model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    model.addFrame(pin.Frame("tool", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return from_pinocchio(model, home=np.zeros(2), tau_rate=UNBOUNDED)


def _mode(k_fp: float) -> Mode:
    force = ForceTask(space=SPACE, K_fp=k_fp, integral_max=UNBOUNDED, ramp=UNBOUNDED)
    tasks = (Weighted(MotionTask(space=SPACE)), Weighted(force))
    return Mode(name=MODE, tasks=tasks, constraints=(WALL,))


def _forces(controller: Controller, delay: int) -> Vector:
    """Return the force [N] tick by tick after a step of the set-point to 1 N."""
    robot = controller.robot
    plant = RigidPlant(robot, WALL, dt=DT)
    state = plant.reset(robot.home)
    memory = controller.start(MODE, robot.home)
    past = deque([np.zeros(2)] * delay, maxlen=delay)
    still, forces = MotionReference(X_WD=pin.SE3.Identity()), []
    for _ in range(200 + 80 * delay):
        reference = ForceReference(F_ref=np.array([1.0, 0.0]), F_meas=past[0])
        measurement = Measurement(state.time, state.q, state.v)
        command, _, memory = controller.step(
            MODE, measurement, {"motion": still, "force": reference}, memory
        )
        state = plant.step(robot.B @ command.tau)
        past.append(state.wrench_meas[:2])
        forces.append(float(past[-1][0]))
        if abs(forces[-1]) > RUNAWAY:
            break
    return np.array(forces)
