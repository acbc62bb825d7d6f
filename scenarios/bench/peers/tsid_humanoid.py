"""TSID on a humanoid with 38 velocities, in its own Python: ``python tsid_humanoid.py FOLDER OUT``.

TALOS stands on both feet, sways its centre of mass and moves a hand; the torso stays upright and
the posture leans towards half sitting. It is no problem that qpctrl states: its robots don't
float. The figure shows what a tick of such a size costs a peer.
"""

import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import timed  # type: ignore[import-not-found]
import tsid  # type: ignore[import-not-found]

FEET = ("left_sole_link", "right_sole_link")
HAND, TORSO = "gripper_left_base_link", "torso_2_link"
CORNERS = np.array([[-0.1, -0.1, 0.1, 0.1], [-0.07, 0.07, -0.07, 0.07], [0.0, 0.0, 0.0, 0.0]])
"""Of a sole (3×4) [m]."""
FRICTION, SMALLEST, LARGEST = 0.3, 5.0, 1500.0
"""Of each foot: coefficient [1], and bounds on its normal force [N]."""
FORCE_WEIGHT, HAND_WEIGHT, POSTURE_WEIGHT = 1e-5, 0.1, 1e-2
SWAY, REACH = 0.02, 0.05
"""How far the centre of mass and the hand go [m]."""
UNLIMITED = 1e3
"""Torque limit [Nm] of joints whose file gives none."""
DT = 1e-3
HARD, SOFT = 0, 1
TURNING, PLACE = np.array([0.0, 0, 0, 1, 1, 1]), np.array([1.0, 1, 1, 0, 0, 0])


class Scene:
    """Robot, feet, tasks and solver."""

    def __init__(self) -> None:
        model, q = _talos()
        self.robot = tsid.RobotWrapper(model, tsid.FLOATING_BASE_SYSTEM, False)
        self.stack = tsid.InverseDynamicsFormulationAccForce("stack", self.robot, False)
        self.q = q
        self.stack.computeProblemData(0.0, q, np.zeros(model.nv))
        data = self.stack.data()
        self.feet = [self._foot(model, data, frame) for frame in FEET]
        self.com = self._follow(tsid.TaskComEquality("com", self.robot), 3, 20.0, 1.0)
        self.posture = self._follow(
            tsid.TaskJointPosture("posture", self.robot), model.nv - 6, 10.0, POSTURE_WEIGHT
        )
        self.hand = self._follow(
            tsid.TaskSE3Equality("hand", self.robot, HAND), 6, 50.0, HAND_WEIGHT, PLACE
        )
        self.torso = self._follow(
            tsid.TaskSE3Equality("torso", self.robot, TORSO), 6, 50.0, HAND_WEIGHT, TURNING
        )
        self.bounds = tsid.TaskActuationBounds("torque", self.robot)
        tau_max = np.array(model.effortLimit[6:])
        tau_max[tau_max < 1.0] = UNLIMITED
        self.bounds.setBounds(-tau_max, tau_max)
        self.stack.addActuationTask(self.bounds, 1.0, HARD, 0.0)
        self.solver = tsid.SolverHQuadProgFast("solver")
        self.solver.resize(self.stack.nVar, self.stack.nEq, self.stack.nIn)
        self.com_home = np.array(self.robot.com(data))
        self.hand_home = self.robot.framePosition(data, model.getFrameId(HAND)).copy()
        self._hold(model, data)

    def _foot(self, model: pin.Model, data: Any, frame: str) -> Any:
        limits = (FRICTION, SMALLEST, LARGEST)
        up = np.array([0.0, 0.0, 1.0])
        foot = tsid.Contact6d(frame, self.robot, frame, CORNERS, up, *limits)
        foot.setKp(np.full(6, 10.0))
        foot.setKd(np.full(6, 2 * np.sqrt(10.0)))
        foot.setReference(self.robot.framePosition(data, model.getFrameId(frame)))
        self.stack.addRigidContact(foot, FORCE_WEIGHT, 1.0, HARD)
        return foot

    def _follow(
        self, task: Any, size: int, K_p: float, weight: float, mask: np.ndarray | None = None
    ) -> Any:
        task.setKp(np.full(size, K_p))
        task.setKd(np.full(size, 2 * np.sqrt(K_p)))
        if mask is not None:
            task.setMask(mask)
        self.stack.addMotionTask(task, weight, SOFT, 0.0)
        return task

    def _hold(self, model: pin.Model, data: Any) -> None:
        """Give torso and posture what they keep."""
        pose = self.robot.framePosition(data, model.getFrameId(TORSO))
        upright = tsid.TrajectorySample(12, 6)
        upright.value(_numbers(pose.translation, pose.rotation))
        self.torso.setReference(upright)
        home = tsid.TrajectorySample(model.nv - 6)
        home.value(np.array(self.q[7:]))
        self.posture.setReference(home)


def _talos() -> tuple[pin.Model, np.ndarray]:
    """Return the robot, half sitting, with its soles on the ground."""
    below = "cmeel.prefix/share/example-robot-data/robots/talos_data"
    homes = [Path(place) / below for place in sys.path if (Path(place) / below).is_dir()]
    if not homes:
        sys.exit("its robot is not installed; run make peers-humanoid")
    path = homes[0] / "robots" / "talos_reduced.urdf"
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    pin.loadReferenceConfigurations(model, str(homes[0] / "srdf" / "talos.srdf"), False)
    q = np.array(model.referenceConfigurations["half_sitting"])
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    q[2] -= data.oMf[model.getFrameId(FEET[0])].translation[2]
    return model, q


def _numbers(p: np.ndarray, R: np.ndarray) -> np.ndarray:
    return np.concatenate((p, R.T.ravel()))


def ticks(problem: timed.Given) -> timed.Ticks:
    """Return the ticks of a motion that is found beforehand, each on the answer before it."""
    scene = Scene()
    stack, solver, com, hand = scene.stack, scene.solver, scene.com, scene.hand
    swaying, reaching = tsid.TrajectorySample(3), tsid.TrajectorySample(12, 6)
    count = len(problem.arrays["q"])
    angle = 2 * np.pi * np.arange(count) / count
    still, R = np.zeros(count), scene.hand_home.rotation
    sway = SWAY * np.column_stack((still, np.sin(angle), np.sin(2 * angle) / 2))
    speed = np.gradient(sway, DT, axis=0)
    reach = REACH * np.column_stack((np.sin(2 * angle), np.sin(angle), np.sin(3 * angle)))
    places = list(scene.com_home + sway)
    poses = [_numbers(scene.hand_home.translation + way, R) for way in reach]
    q, v = [scene.q], [np.zeros(scene.robot.nv)]

    def refer(k: int) -> None:
        swaying.value(places[k])
        swaying.derivative(speed[k])
        com.setReference(swaying)
        reaching.value(poses[k])
        hand.setReference(reaching)

    def whole(k: int) -> tuple[bool, np.ndarray, np.ndarray]:
        refer(k)
        solution = solver.solve(stack.computeProblemData(0.0, q[k], v[k]))
        force = stack.getContactForce(FEET[0], solution)
        return solution.status == 0, stack.getActuatorForces(solution), force[:3]

    kept: dict[str, Any] = {}
    parts: dict[str, Callable[[int], object]] = {
        "references": refer,
        "problem data": lambda k: kept.update(data=stack.computeProblemData(0.0, q[k], v[k])),
        "solve": lambda k: kept.update(solution=solver.solve(kept["data"])),
        "read": lambda k: (
            stack.getActuatorForces(kept["solution"]),
            stack.getContactForce(FEET[0], kept["solution"]),
        ),
    }
    for k in range(count - 1):
        for part in parts.values():
            part(k)
        a = np.array(stack.getAccelerations(kept["solution"]))
        q.append(pin.integrate(scene.robot.model(), q[k], DT * v[k] + DT**2 / 2 * a))
        v.append(v[k] + DT * a)
    return timed.Ticks(whole, parts, scene)


def main() -> None:
    """Time the motion, and write its answers."""
    problem = timed.given()
    scene = Scene()
    about = {
        "versions": {name: version(name) for name in ("tsid", "pin", "example-robot-data")},
        "gaps": {"M": 0.0, "h": 0.0},
        "sizes": [scene.stack.nVar, scene.stack.nEq, scene.stack.nIn],
        "joints": scene.robot.nv,
    }
    timed.run(problem, lambda _: ticks(problem), about)


if __name__ == "__main__":
    main()
