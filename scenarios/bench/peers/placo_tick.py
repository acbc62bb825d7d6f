"""placo on the problem of a folder, in its own Python: ``python placo_tick.py FOLDER OUT``.

The point is a hard task with a bilateral contact; orientation and posture are weighted costs,
torque limits are inequalities. The force is a known wrench, and what the contact carries beyond
it is kept small. placo's robots float, so the base is held.
"""

from importlib.metadata import version
from typing import Any

import numpy as np
import placo  # type: ignore[import-not-found]
import timed  # type: ignore[import-not-found]

FORCE_WEIGHT, MOTION_WEIGHT = 1.0, 1.0
POSTURE_WEIGHT = {"met": 1.0}
"""Where every task can be met it does not matter, and a large one hides placo's regularisation."""
SMALL = 1e-4
"""Weight of the posture in all other variants: it may bend the orientation by so much."""
BASE_Q, BASE_V = 7, 6
"""Coordinates and velocities of the base."""


class Scene:
    """Robot, contact, tasks and solver, for one variant."""

    def __init__(self, problem: timed.Given, variant: str) -> None:
        facts = problem.facts
        path = str(problem.folder / "robot.urdf")
        self.robot = placo.RobotWrapper(path, placo.Flags.ignore_collisions)
        self.names = list(self.robot.joint_names())
        for name, armature in zip(self.names, facts["armature"], strict=True):
            self.robot.set_rotor_inertia(name, armature)
            self.robot.set_gear_ratio(name, 1.0)
        self.solver = placo.DynamicsSolver(self.robot)
        self.solver.mask_fbase(True)
        self.solver.torque_cost = 0.0
        frame = facts["frame"]
        self.rest = self.solver.add_position_task(frame, np.array(facts["point"]))
        self.rest.configure("rest", "hard")
        self.rest.kp = self.rest.kd = 0.0
        self.point = self.solver.add_point_contact(self.rest)
        self.point.weight_forces = FORCE_WEIGHT
        self.pressed = self.solver.add_external_wrench_contact(frame, "world")
        wrench = np.concatenate((facts["force"] * np.array(facts["normal"]), np.zeros(3)))
        self.pressed.w_ext = wrench
        self.turn = self.solver.add_orientation_task(frame, np.eye(3))
        self.turn.configure("turn", "soft", MOTION_WEIGHT)
        self.turn.kp, self.turn.kd = facts["motion_gains"]
        self.posture = self.solver.add_joints_task()
        self.posture.configure("posture", "soft", POSTURE_WEIGHT.get(variant, SMALL))
        self.posture.kp, self.posture.kd = facts["posture_gains"]
        self.home = dict(zip(self.names, facts["home"], strict=True))
        self.posture.set_joints(self.home)
        self.solver.enable_torque_limits(True)
        for name, limit in zip(self.names, facts["variants"][variant], strict=True):
            self.solver.set_torque_limit(name, limit)


def ticks(problem: timed.Given, variant: str) -> timed.Ticks:
    """Return the ticks of a variant, in one piece and in parts."""
    scene = Scene(problem, variant)
    robot, solver, turn, point = scene.robot, scene.solver, scene.turn, scene.point
    state, known = robot.state, np.array(scene.pressed.w_ext[:3])
    q, v = problem.rows("q"), problem.rows("v")
    R_WD, omega, alpha = (problem.rows(name) for name in ("R_WD", "omega", "alpha"))
    met = problem.arrays["met"] if variant == "met" else None

    def refer(k: int) -> None:
        turn.R_world_frame = R_WD[k]
        turn.omega_world = omega[k]
        turn.domega_world = alpha[k]
        if met is not None:
            for name, leaning in zip(scene.names, met[k], strict=True):
                scene.posture.set_joint(name, scene.home[name], 0.0, leaning)

    def place(k: int) -> None:
        state.q[BASE_Q:] = q[k]
        state.qd[BASE_V:] = v[k]
        robot.update_kinematics()

    def whole(k: int) -> tuple[bool, np.ndarray, np.ndarray]:
        refer(k)
        place(k)
        result = solver.solve(False)
        return result.success, result.tau[BASE_V:], point.wrench + known

    kept: dict[str, Any] = {}
    parts = {
        "references": refer,
        "state": place,
        "problem data and solve": lambda k: kept.update(result=solver.solve(False)),
        "read": lambda k: (kept["result"].tau[BASE_V:], point.wrench + known),
    }
    return timed.Ticks(whole, parts, scene)


def main() -> None:
    """Check the model, time every variant, and write the answers."""
    problem = timed.given()
    scene = Scene(problem, next(iter(problem.facts["variants"])))

    def terms(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scene.robot.state.q[BASE_Q:] = q
        scene.robot.state.qd[BASE_V:] = v
        scene.robot.update_kinematics()
        M = np.array(scene.robot.mass_matrix())[BASE_V:, BASE_V:]
        return M, np.array(scene.robot.non_linear_effects())[BASE_V:]

    scene.robot.update_kinematics()
    about = {
        "versions": {name: version(name) for name in ("placo", "pin", "numpy")},
        "gaps": timed.model_gaps(problem, terms),
    }
    timed.run(problem, lambda variant: ticks(problem, variant), about)


if __name__ == "__main__":
    main()
