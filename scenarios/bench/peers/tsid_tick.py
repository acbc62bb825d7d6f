"""TSID on the problem of a folder, in its own Python: ``python tsid_tick.py FOLDER OUT``.

The point is a rigid contact of highest priority, the orientation, the posture and the force are
weighted costs, torque limits and the friction pyramid are inequalities.
"""

from importlib.metadata import version
from typing import Any

import numpy as np
import pinocchio as pin
import timed  # type: ignore[import-not-found]
import tsid  # type: ignore[import-not-found]

FORCE_WEIGHT, MOTION_WEIGHT = 1.0, 1.0
POSTURE_WEIGHT = {"met": 1.0}
"""Where every task can be met it does not matter, and a large one hides TSID's regularisation."""
SMALL = 1e-4
"""Weight of the posture in all other variants: it may bend the orientation by so much."""
HARD = 0
"""Highest priority."""


class Scene:
    """Robot, contact, tasks and solver, for one variant."""

    def __init__(self, problem: timed.Given, variant: str) -> None:
        facts = problem.facts
        model = pin.buildModelFromXML((problem.folder / "robot.urdf").read_text())
        model.armature = np.array(facts["armature"])
        self.robot = tsid.RobotWrapper(model, tsid.FIXED_BASE_SYSTEM, False)
        self.stack = tsid.InverseDynamicsFormulationAccForce("stack", self.robot, False)
        q, v = problem.arrays["q"][0], problem.arrays["v"][0]
        self.stack.computeProblemData(0.0, q, v)
        self.point = self._contact(facts, model, q)
        self.turn = self._orientation(facts)
        self.posture = self._posture(facts, POSTURE_WEIGHT.get(variant, SMALL))
        self.bounds = tsid.TaskActuationBounds("torque", self.robot)
        tau_max = np.array(facts["variants"][variant])
        self.bounds.setBounds(-tau_max, tau_max)
        self.stack.addActuationTask(self.bounds, 1.0, HARD, 0.0)
        self.solver = tsid.SolverHQuadProgFast("solver")
        self.solver.resize(self.stack.nVar, self.stack.nEq, self.stack.nIn)

    def _contact(self, facts: dict[str, Any], model: pin.Model, q: np.ndarray) -> tsid.ContactPoint:
        normal, frame = np.array(facts["normal"]), facts["frame"]
        limits = (facts["friction"], facts["smallest"], facts["largest"])
        point = tsid.ContactPoint("point", self.robot, frame, normal, *limits)
        point.setKp(np.zeros(3))
        point.setKd(np.zeros(3))
        point.useLocalFrame(False)
        data = model.createData()
        pin.framesForwardKinematics(model, data, q)
        point.setReference(data.oMf[model.getFrameId(frame)])
        point.setForceReference(facts["force"] * normal)
        point.setRegularizationTaskWeightVector(np.ones(3))
        self.stack.addRigidContact(point, FORCE_WEIGHT, 1.0, HARD)
        return point

    def _orientation(self, facts: dict[str, Any]) -> tsid.TaskSE3Equality:
        turn = tsid.TaskSE3Equality("turn", self.robot, facts["frame"])
        turn.setKp(np.full(6, facts["motion_gains"][0]))
        turn.setKd(np.full(6, facts["motion_gains"][1]))
        turn.setMask(np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]))
        turn.useLocalFrame(True)  # the same cost, and cheaper
        self.stack.addMotionTask(turn, MOTION_WEIGHT, 1, 0.0)
        return turn

    def _posture(self, facts: dict[str, Any], weight: float) -> tsid.TaskJointPosture:
        home = np.array(facts["home"])
        posture = tsid.TaskJointPosture("posture", self.robot)
        posture.setKp(np.full(len(home), facts["posture_gains"][0]))
        posture.setKd(np.full(len(home), facts["posture_gains"][1]))
        sample = tsid.TrajectorySample(len(home))
        sample.value(home)
        posture.setReference(sample)
        self.stack.addMotionTask(posture, weight, 1, 0.0)
        return posture


def ticks(problem: timed.Given, variant: str) -> timed.Ticks:
    """Return the ticks of a variant, in one piece and in parts."""
    scene = Scene(problem, variant)
    stack, solver, turn, posture = scene.stack, scene.solver, scene.turn, scene.posture
    q, v = problem.rows("q"), problem.rows("v")
    still = np.zeros(3)
    point = np.array(problem.facts["point"])
    poses = [np.concatenate((point, R.T.ravel())) for R in problem.arrays["R_WD"]]
    twists = [np.concatenate((still, w)) for w in problem.arrays["omega"]]
    rates = [np.concatenate((still, w)) for w in problem.arrays["alpha"]]
    sample = tsid.TrajectorySample(12, 6)
    met = problem.rows("met") if variant == "met" else None
    leaning = tsid.TrajectorySample(len(q[0]))
    leaning.value(np.array(problem.facts["home"]))

    def refer(k: int) -> None:
        sample.value(poses[k])
        sample.derivative(twists[k])
        sample.second_derivative(rates[k])
        turn.setReference(sample)
        if met is not None:
            leaning.second_derivative(met[k])
            posture.setReference(leaning)

    def whole(k: int) -> tuple[bool, np.ndarray, np.ndarray]:
        refer(k)
        solution = solver.solve(stack.computeProblemData(0.0, q[k], v[k]))
        tau = stack.getActuatorForces(solution)
        return solution.status == 0, tau, stack.getContactForce("point", solution)

    kept: dict[str, Any] = {}
    parts = {
        "references": refer,
        "problem data": lambda k: kept.update(data=stack.computeProblemData(0.0, q[k], v[k])),
        "solve": lambda k: kept.update(solution=solver.solve(kept["data"])),
        "read": lambda k: (
            stack.getActuatorForces(kept["solution"]),
            stack.getContactForce("point", kept["solution"]),
        ),
    }
    return timed.Ticks(whole, parts, scene)


def main() -> None:
    """Check the model, time every variant, and write the answers."""
    problem = timed.given()
    scene = Scene(problem, next(iter(problem.facts["variants"])))

    def terms(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scene.stack.computeProblemData(0.0, q, v)
        data = scene.stack.data()
        return scene.robot.mass(data), scene.robot.nonLinearEffect(data)

    about = {
        "versions": {name: version(name) for name in ("tsid", "pin", "eiquadprog", "numpy")},
        "gaps": timed.model_gaps(problem, terms),
        "sizes": [scene.stack.nVar, scene.stack.nEq, scene.stack.nIn],
    }
    timed.run(problem, lambda variant: ticks(problem, variant), about)


if __name__ == "__main__":
    main()
