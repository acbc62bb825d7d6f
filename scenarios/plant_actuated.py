"""A plant whose joints are moved by drives: their inner loops run faster than the controller."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Array, Vector
from qpctrl.compiled import CompileMode, compiled
from qpctrl.evaluator import Evaluator
from qpctrl.robot import Robot
from scenarios.actuator.drive import JointDrive
from scenarios.actuator.inner import NOISES, build_inner_tick, initial_state
from scenarios.plant import JointReading, PlantState, SteppedPlant

CONFIGURATIONS = 300
"""At which the largest mobility of a joint is looked for."""

MOBILITY_PERIODS = 10
"""Periods of the controller for which a mobility is taken to stay; it changes with the posture."""

NOISE_BLOCK = 256
"""Periods of the controller whose noise is drawn at once."""


class Mobility:
    """Acceleration of each driven joint per torque of its own, (M⁻¹)_jj, where the robot is."""

    def __init__(self, robot: Robot) -> None:
        """Describe the mobility of ``robot``, whose rotors are the plant's own."""
        self._model, self._data = robot.model, robot.model.createData()
        self._joint, self._limits = np.argmax(robot.B != 0, axis=0), robot.limits

    def at(self, q: Vector) -> Vector:
        """Return it (nu) [1/(kg m²) or 1/kg] at ``q`` (nq)."""
        return pin.computeMinverse(self._model, self._data, q).diagonal()[self._joint]

    def largest(self) -> Vector:
        """Return the largest (nu) at some hundred configurations within the joints' range."""
        rng, limits = np.random.default_rng(0), self._limits
        low, high = np.maximum(limits.q_min, -np.pi), np.minimum(limits.q_max, np.pi)
        return np.max([self.at(rng.uniform(low, high)) for _ in range(CONFIGURATIONS)], axis=0)


class ActuatedPlant:
    """Commanded torque in, delivered torque on the joints, and what the drives read.

    Plant and drives take the same short steps: a drive answers the joint's motion of each.
    """

    def __init__(
        self,
        plant: SteppedPlant,
        robot: Robot,
        drives: Sequence[JointDrive],
        *,
        step: float,
        steps: int,
        mobility: Mobility,
        seed: int = 0,
        compile: CompileMode = "auto",
    ) -> None:
        """Put ``drives`` between the controller and ``plant``.

        Args:
            plant: the robot and its environment, in steps of the inner loop.
            robot: the robot, for its gravity at the start and for which joints are driven.
            drives: one for each actuator.
            step: period of the inner loop [s].
            steps: inner steps in a period of the controller.
            mobility: of the driven joints, without the rotors of elastic drives.
            seed: seed of the drives' noise.
            compile: whether the inner tick runs as generated C.

        Raises:
            InputError: the inner loop is too slow for a drive.
        """
        self._plant, self._robot, self._drives = plant, robot, tuple(drives)
        self._steps, self._seed = steps, seed
        tick = build_inner_tick(drives, step, mobility.largest())
        self._evaluate = Evaluator(compiled(tick.function, compile=compile).function)
        self._in, self._out = self._evaluate.inputs, self._evaluate.outputs
        self._in["p"][:] = tick.numbers.vector()
        self._free = tick.numbers.views(self._in["p"])["mobility"]
        self._mobility, self._q, self._periods = mobility, robot.home, 0
        self._state = tick.states.views(self._in["x"])
        self._joint = np.argmax(robot.B != 0, axis=0)  # which joint each actuator moves
        self._all_driven = np.array_equal(robot.B, np.eye(robot.nv))
        self._tau = np.zeros(robot.nv)
        self._noisy = any(_noisy(drive) for drive in drives)
        self._noise = np.zeros((NOISE_BLOCK, steps, len(NOISES) * len(drives)))
        self._drawn, self._rng = NOISE_BLOCK, np.random.default_rng(seed)

    def reset(self, q: Vector) -> PlantState:
        """Return the state at rest in ``q`` (nq), held against gravity by the drives."""
        self._drawn, self._rng = NOISE_BLOCK, np.random.default_rng(self._seed)
        model = self._robot.model
        gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
        hold = np.linalg.lstsq(self._robot.B, gravity, rcond=None)[0]
        self._in["x"][:] = 0.0
        for name, value in initial_state(self._drives, q[self._joint], hold).items():
            self._state[name][:] = value
        state = self._plant.reset(q)
        self._q, self._periods = state.q, 0
        self._in["q"][...], self._in["v"][...] = state.q[self._joint], state.v[self._joint]
        return state._replace(joints=self._reading(hold, hold))

    def step(self, tau: Vector) -> PlantState:
        """Return the state after ``tau`` (nv) [Nm] was asked of the joints for one period."""
        evaluate, advance, joint = self._evaluate, self._plant.advance, self._joint
        x, q_in, v_in, noise_in = (self._in[name] for name in ("x", "q", "v", "noise"))
        x_next, torque = self._out["x_next"], self._out["tau"]
        self._in["tau_cmd"][...] = tau[joint]
        if self._periods % MOBILITY_PERIODS == 0:
            self._free[...] = self._mobility.at(self._q)
        self._periods += 1
        self._state["delivered"][...] = self._state["limited"][...] = 0.0
        for noise in self._draw():
            noise_in[...] = noise
            evaluate()
            x[...] = x_next
            if self._all_driven:
                q_in[...], v_in[...] = advance(torque)
            else:
                self._tau[joint] = torque
                q, v = advance(self._tau)
                q_in[...], v_in[...] = q[joint], v[joint]
        delivered, state = self._state["delivered"] / self._steps, self._plant.read()
        self._q = state.q
        return state._replace(joints=self._reading(delivered, self._state["torque"].copy()))

    def _draw(self) -> Array:
        """Return the noise of each step (steps×m) [1]: numbers of variance 1."""
        if not self._noisy:
            return self._noise[0]
        if self._drawn == NOISE_BLOCK:  # one large draw costs less than many small ones
            self._noise, self._drawn = self._rng.standard_normal(self._noise.shape), 0
        self._drawn += 1
        return self._noise[self._drawn - 1]

    def _reading(self, delivered: Vector, measured: Vector) -> JointReading:
        return JointReading(
            tau_delivered=delivered,
            tau_meas=measured,
            current=self._state["current"].copy(),
            voltage=self._out["voltage"].copy(),
            limited=bool(self._state["limited"].any()),
        )


def _noisy(drive: JointDrive) -> bool:
    gauge = drive.strain_gauge
    return drive.motor.current_noise > 0 or (gauge is not None and gauge.noise > 0)
