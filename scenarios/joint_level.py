"""The joint level of a run: which drives move the robot, and what that changes about it.

Drives change the robot that the controller believes in: the inertia that it feels at the joints,
and the torque that it may ask for.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from qpctrl.arrays import Vector
from qpctrl.compiled import CompileMode
from qpctrl.errors import InputError
from qpctrl.robot import Robot
from scenarios.actuator.ablation import Ablation, without
from scenarios.actuator.catalogue import default_drives, load_drive
from scenarios.actuator.drive import DESIGNS, Design, JointDrive
from scenarios.actuator.inner import INNER_RATE
from scenarios.plant import Plant, SteppedPlant
from scenarios.plant_actuated import ActuatedPlant, Mobility

Actuator = Literal["ideal", "direct-drive", "geared", "strain-gauge", "series-elastic"]
"""How torque is made at the joints; ideal joints deliver what is asked."""

CAPSTAN = 0.02
"""Radius [m] of the capstan through which a drive moves a sliding joint."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLevel:
    """Drives of a robot's joints, or none."""

    robot: Robot
    """The robot as its controller shall believe it to be."""
    dt: float
    """Period of the plant [s]: that of the controller, or of the inner loop."""
    steps: int = 1
    """Periods of the plant in one of the controller."""
    drives: tuple[JointDrive, ...] = ()
    """One for each actuator; none: ideal joints."""
    armature: Vector | None = None
    """What rotors add to the plant's own inertia (nv) [kg m²]; none: what the controller knows."""
    seed: int = 0
    """Of the drives' noise."""
    compile: CompileMode = "auto"
    """Whether the inner loop runs as generated C."""

    def drive(self, plant: SteppedPlant) -> Plant:
        """Return ``plant``, which has this level's ``dt`` and ``armature``, moved by the drives."""
        if not self.drives:
            return plant
        return ActuatedPlant(
            plant,
            self.robot,
            self.drives,
            step=self.dt,
            steps=self.steps,
            mobility=Mobility(with_armature(self.robot, self.armature)),
            seed=self.seed,
            compile=self.compile,
        )


def joint_level(
    robot: Robot,
    *,
    actuator: Actuator,
    drives: Sequence[str],
    inner_rate: float,
    dt: float,
    seed: int,
    compile: CompileMode,
    ablations: Sequence[Ablation] = (),
) -> JointLevel:
    """Return the joint level of a robot.

    Args:
        robot: as its file describes it.
        actuator: design of the joints.
        drives: names of the catalogue or TOML files: one for each actuator, or one for all of
            them; none: the design's own, by the size of each joint.
        inner_rate: of the drives' loops [Hz].
        dt: period of the controller [s].
        seed: of the drives' noise.
        compile: whether the inner loop runs as generated C.
        ablations: what is taken away from every drive.

    Raises:
        InputError: unknown drives, too many or of another design, a rate that is no multiple
            of the controller's, or no drive has what shall be taken away.
    """
    if actuator == "ideal":
        for name, given in (("drives", drives), ("without", ablations)):
            if given:
                raise InputError(f"{name}: got {', '.join(given)} with actuator 'ideal', need none")
        if inner_rate != INNER_RATE:
            raise InputError(f"inner_rate: got {inner_rate:g} Hz, but ideal joints have no loops")
        return JointLevel(robot=robot, dt=dt)
    steps = inner_steps(inner_rate, dt)
    chosen = _on_their_joints(robot, _chosen(robot, actuator, drives))
    chosen = _without(chosen, ablations)
    felt = np.array([drive.apparent_inertia for drive in chosen])
    rotor = np.array([drive.inertia if drive.rigid else 0.0 for drive in chosen])
    return JointLevel(
        robot=_with_limits(with_armature(robot, robot.B @ felt), chosen, dt),
        dt=dt / steps,
        steps=steps,
        drives=chosen,
        armature=robot.B @ rotor,
        seed=seed,
        compile=compile,
    )


def inner_steps(inner_rate: float, dt: float) -> int:
    """Return how many inner steps a period of the controller has.

    Raises:
        InputError: the rate is no multiple of the controller's.
    """
    ratio = inner_rate * dt
    if not 1 <= ratio <= 1000 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        outer = 1 / dt
        near = outer * min(max(round(ratio), 1), 1000) if np.isfinite(ratio) else 10 * outer
        raise InputError(
            f"inner_rate: got {inner_rate:g} Hz, need a multiple of the controller's {outer:g} Hz, "
            f"at most 1000 times as much; nearest {near:g} Hz"
        )
    return round(ratio)


def with_armature(robot: Robot, armature: Vector | None) -> Robot:
    """Return the robot with other rotors (nv) [kg m²], on a model of its own."""
    if armature is None:
        return robot
    model = robot.model.copy()
    model.armature = np.array(armature)
    return replace(robot, model=model)


def _chosen(robot: Robot, actuator: Design, names: Sequence[str]) -> tuple[JointDrive, ...]:
    if not names:
        return default_drives(actuator, robot.limits.tau_max * _lever(robot))
    found = tuple(load_drive(name) for name in names)
    for drive in found:
        if drive.design != actuator:
            raise InputError(
                f"drives: {drive.name!r} is a {drive.design} drive, got actuator {actuator!r}; "
                f"allowed actuators: {', '.join(('ideal', *DESIGNS))}"
            )
    if len(found) not in (1, robot.nu):
        raise InputError(f"drives: got {len(found)}, need 1 or {robot.nu}, one for each actuator")
    return found if len(found) == robot.nu else found * robot.nu


def _without(
    drives: tuple[JointDrive, ...], ablations: Sequence[Ablation]
) -> tuple[JointDrive, ...]:
    for ablation in ablations:
        changed = tuple(without(drive, ablation) for drive in drives)
        if changed == drives:
            names = ", ".join(dict.fromkeys(drive.name for drive in drives))
            raise InputError(f"without: got {ablation}, which none of the drives has: {names}")
        drives = changed
    return drives


def _on_their_joints(robot: Robot, drives: Sequence[JointDrive]) -> tuple[JointDrive, ...]:
    if not np.isin(robot.B, (0.0, 1.0)).all() or (robot.B.sum(axis=0) != 1).any():
        raise InputError("drives: each actuator must move one joint, B being a choice of joints")
    return tuple(
        drive if lever == 1.0 else drive.on_capstan(float(lever))
        for drive, lever in zip(drives, _lever(robot), strict=True)
    )


def _lever(robot: Robot) -> Vector:
    """Return torque per force of each actuator (nu): 1 on a hinge, the capstan's on a slide."""
    slides = [joint.shortname().startswith("JointModelP") for joint in list(robot.model.joints)[1:]]
    return np.where(np.array(slides) @ robot.B > 0, CAPSTAN, 1.0)


def _with_limits(robot: Robot, drives: Sequence[JointDrive], dt: float) -> Robot:
    """Return the robot with what the drives can give a controller of period ``dt`` [s]."""
    own = robot.limits
    v_max = np.abs(robot.B.T) @ np.where(np.isfinite(own.v_max), own.v_max, 0.0)
    speeds = [min(v, drive.no_load_speed) for v, drive in zip(v_max, drives, strict=True)]
    limits = [drive.limits(v) for v, drive in zip(speeds, drives, strict=True)]
    peak, rate, step, stall, droop = (np.array(values) for values in zip(*limits, strict=True))
    for drive, most in zip(drives, peak, strict=True):
        if most <= 0:
            raise InputError(
                f"drives: {drive.name!r} has no torque left at the joint's highest speed, which "
                "friction takes"
            )
    return replace(
        robot,
        limits=replace(
            own,
            tau_max=np.minimum(own.tau_max, peak),
            tau_rate=np.minimum(own.tau_rate, np.minimum(rate, step / dt)),
            tau_stall=stall,
            tau_droop=droop,
        ),
    )
