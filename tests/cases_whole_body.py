"""Whole bodies to compare: a mobile arm, two arms with a box, a humanoid with a hand on a wall."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import mujoco
import numpy as np
import oracles_whole_body as whole
import pinocchio as pin
from cases import Given, GivenTask

from qpctrl import CentroidalSpace, Controller, Limits, Mode, Robot, TaskSpace, Weighted
from qpctrl.constraint import Constraint, Embedded, FaceOnPlane
from qpctrl.constraint.point_on_plane import PointOnPlane
from qpctrl.contact import Footprint, FrictionCone, MaxForce, WrenchLimit
from qpctrl.objective import ForceObjective, MotionObjective, PostureObjective
from scenarios.plant_model import robot_from_mujoco
from scenarios.robot_file import MODELS
from tasks import GraspForceTask

POINT, FACE = (2,), (2, 3, 4)
PRESS = {"right_hand": 60.0, "eraser/tool": 60.0, "left_sole": 300.0, "right_sole": 300.0}
"""N, into the environment, on top of what is drawn: so the hand need not pull."""


@functools.cache
def body(name: str) -> Robot:
    """Return the robot of a model at its keyframe ``home``."""
    model = mujoco.MjModel.from_xml_path(str(MODELS / f"{name}.xml"))
    return robot_from_mujoco(model, model.key_qpos[0])


def unlimited(robot: Robot) -> Robot:
    """Return a robot without any limits."""
    none, nu = np.full(robot.nv, np.inf), np.full(robot.nu, np.inf)
    limits = Limits(q_min=-none, q_max=none, v_max=none, tau_max=nu, tau_rate=nu)
    return replace(robot, limits=limits)


class Grip(NamedTuple):
    """One contact: its space, what holds it, and whether a task of its own asks for its force."""

    space: TaskSpace
    held: whole.Held
    name: str
    forced: bool = True


class Body(NamedTuple):
    """What is compared on one robot."""

    model: str
    motions: tuple[TaskSpace, ...]
    grips: tuple[Grip, ...]
    grasp: tuple[TaskSpace, TaskSpace] | None = None

    @property
    def robot(self) -> Robot:
        """Its robot."""
        return body(self.model)

    def constraints(self) -> tuple[Constraint, ...]:
        """Return the constraints of its contacts."""
        kinds = {whole.ALL: Embedded, POINT: PointOnPlane}
        found: list[Constraint] = []
        for space, held, name, _ in self.grips:
            if held.rows == FACE:
                found.append(FaceOnPlane(space=space, R_WE=held.R_E, name=name))
            else:
                pose = pin.SE3(held.R_E, np.zeros(3))
                found.append(kinds[held.rows](space=space, X_WE=pose, name=name))
        return tuple(found)

    def mode(self, limits: Sequence[WrenchLimit] = (), **options: Any) -> Mode:
        """Return the mode in which every command is given."""
        tasks = [
            GivenTask(name=f"motion {i}", kind=MotionObjective, size=space.n, space=space)
            for i, space in enumerate(self.motions)
        ]
        tasks += [
            GivenTask(name=f"force {grip.name}", kind=ForceObjective, size=6, space=grip.space)
            for grip in self.grips
            if grip.forced
        ]
        tasks += [GivenTask(name="posture", kind=PostureObjective, size=self.robot.nv)]
        if self.grasp:
            tasks += [GraspForceTask(contacts=self.grasp, ramp=1e9)]
        options = {"metric": "home", **options}
        return Mode(
            name=self.model,
            tasks=tuple(Weighted(task) for task in tasks),
            constraints=self.constraints(),
            contact_limits=tuple(limits),
            **options,
        )

    def state(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return a configuration around home and a velocity that no contact forbids."""
        robot = self.robot
        q = robot.integrate(robot.home, rng.uniform(-0.25, 0.25, robot.nv))
        v = rng.normal(size=robot.nv)
        contacts = [whole.contact_of(robot.model, q, v, grip.held) for grip in self.grips]
        return q, whole.along_free_directions(v, contacts)


def _grip(model: str, frame: str, rows: tuple[int, ...], **options: Any) -> Grip:
    """Return a contact whose environment has the axes that the frame has at home."""
    other, robot = options.pop("other", None), body(model)
    X_WF = robot.pose(robot.home, frame)
    X = X_WF if other is None else robot.pose(robot.home, other).actInv(X_WF)
    held = whole.Held(frame, other, X.rotation, rows)
    return Grip(TaskSpace(frame, relative_to=other), held, frame, **options)


LINEAR, ANGULAR = ("vx", "vy", "vz"), ("wx", "wy", "wz")


@functools.cache
def bodies() -> Mapping[str, Body]:
    """Return what is compared, by name."""
    tool = _grip("mobile_arm", "eraser/tool", FACE)
    carriage = TaskSpace("carriage", ("vx", "vy", "wz"))
    pads = [_grip("two_arms", f"{s}_pad", whole.ALL, other="box") for s in ("left", "right")]
    light = tuple(pad._replace(forced=False) for pad in pads)
    feet = [_grip("humanoid", f"{side}_sole", whole.ALL) for side in ("left", "right")]
    hand = _grip("humanoid", "right_hand", POINT)
    upright = TaskSpace("torso", ANGULAR)
    momentum = (CentroidalSpace(axes=LINEAR), CentroidalSpace(axes=ANGULAR))
    return {
        "mobile arm": Body("mobile_arm", (tool.space, carriage), (tool,)),
        "two arms": Body("two_arms", (TaskSpace("box"),), tuple(pads)),
        "grasp": Body("two_arms", (TaskSpace("box"),), light, (light[0].space, light[1].space)),
        "humanoid": Body("humanoid", (hand.space, upright, *momentum), (*feet, hand)),
    }


BODIES = ("mobile arm", "two arms", "grasp", "humanoid")


@functools.cache
def free_controller(name: str) -> Controller:
    """Return the controller of a body that nothing limits."""
    of = bodies()[name]
    return Controller(unlimited(of.robot), [of.mode()])


FRICTION, SIDES = 0.4, 8
HALF = (0.04, 0.03)
MOST = 45.0


def contact_limits(of: Body) -> tuple[WrenchLimit, ...]:
    """Return friction, footprint and a largest force for the contacts of a body that have them."""
    found: list[WrenchLimit] = []
    for grip in of.grips:
        if grip.held.rows == whole.ALL:
            found.append(
                FrictionCone(
                    space=grip.space, mu=FRICTION, sides=SIDES, name=f"friction {grip.name}"
                )
            )
        else:
            found.append(MaxForce(space=grip.space, limit=MOST, name=f"most {grip.name}"))
        if grip.held.rows != POINT:
            found.append(Footprint(space=grip.space, half=HALF, name=f"footprint {grip.name}"))
    return tuple(found)


def limited_controller(name: str, **options: Any) -> Controller:
    """Return the controller of a body with limits of its contacts; torques have none by default."""
    of = bodies()[name]
    return Controller(unlimited(of.robot), [of.mode(contact_limits(of))], **options)


def inequalities(
    of: Body, contacts: Sequence[whole.Contact], physics: whole.Physics, tau_max: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return G z ≤ d: torques, one-sided contacts and what `contact_limits` says, in numpy."""
    nv, nu, size = of.robot.nv, of.robot.nu, physics.E.shape[1]
    torque = np.eye(size)[nv : nv + nu]
    blocks, bounds = [torque, -torque], [tau_max, tau_max]

    def bound(W: np.ndarray, contact: whole.Contact, place: slice, most: float) -> None:
        block = np.zeros((len(W), size))
        block[:, place] = W @ contact.A.T
        blocks.append(block)
        bounds.append(np.full(len(W), most))

    for grip, contact, place in zip(of.grips, contacts, physics.places, strict=True):
        z, (a, b) = np.eye(6)[2], HALF
        if grip.held.rows == whole.ALL:
            phi = 2 * np.pi * np.arange(SIDES) / SIDES
            sides = [np.r_[np.cos(p), np.sin(p), 0, 0, 0, 0] for p in phi]
            steep = FRICTION * np.cos(np.pi / SIDES) * z
            bound(np.array(sides) - steep, contact, place, 0.0)
        else:
            bound(z[None], contact, place, MOST)
            blocks.append(-np.eye(size)[[place.start]])  # the first of its rows only pushes
            bounds.append(np.zeros(1))
        if grip.held.rows != POINT:
            m_x, m_y = np.eye(6)[3], np.eye(6)[4]
            tips = np.array([m_y - a * z, -m_y - a * z, m_x - b * z, -m_x - b * z])
            bound(tips, contact, place, 0.0)
    return np.vstack(blocks), np.concatenate(bounds)


class Commands(NamedTuple):
    """Random commands and weights of one tick."""

    motions: tuple[np.ndarray, ...]
    forces: tuple[np.ndarray, ...]
    a_post: np.ndarray
    f_cmd: float
    weights: Mapping[str, float]

    def references(self, of: Body) -> dict[str, Given]:
        """Return them as references."""
        found = {f"motion {i}": Given(a_cmd=a) for i, a in enumerate(self.motions)}
        found |= {
            f"force {grip.name}": Given(F_cmd=F)
            for grip, F in zip(of.grips, self.forces, strict=True)
            if grip.forced
        }
        found["posture"] = Given(a_post=self.a_post)
        if of.grasp:
            found["grasp"] = Given(f_ref=np.array(self.f_cmd))
        for task, weight in self.weights.items():
            found[task]["weight"] = np.array(weight)
        return found


def commands(of: Body, rng: np.random.Generator) -> Commands:
    """Return commands none of which is zero; what can only push is pressed on."""
    motions = tuple(rng.normal(size=space.n) for space in of.motions)
    pressed = tuple(PRESS.get(grip.name, 0.0) * np.eye(6)[2] for grip in of.grips)
    drawn = Commands(
        motions=motions,
        forces=tuple(10 * rng.normal(size=6) + push for push in pressed),
        a_post=rng.normal(size=of.robot.nv),
        f_cmd=rng.uniform(20, 60),
        weights={},
    )
    names = drawn.references(of)
    return drawn._replace(weights={name: 10 ** rng.uniform(-1.5, 1.5) for name in names})


def physics_of(of: Body, q: np.ndarray, v: np.ndarray) -> tuple[whole.Physics, list[whole.Contact]]:
    """Return the physics of a body at a state, its contacts in the order of ``grips``."""
    model = of.robot.model
    contacts = [whole.contact_of(model, q, v, grip.held) for grip in of.grips]
    return whole.physics(model, q, v, of.robot.B, contacts), contacts


def costs_of(
    of: Body,
    q: np.ndarray,
    v: np.ndarray,
    wanted: Commands,
    physics: whole.Physics,
    contacts: Sequence[whole.Contact],
) -> tuple[list[whole.Cost], list[whole.Cost]]:
    """Return the costs of motion, and those of force, with the metric of home."""
    robot, size, w = of.robot, physics.E.shape[1], wanted.weights
    metric = functools.partial(whole.inertia_at, robot.model, robot.home)
    moving = [
        whole.motion_cost(
            whole.motion_of(robot.model, q, v, space.frame, space.relative_to),
            space.index,
            a_cmd,
            metric(space.frame, space.relative_to, space.index),
            w[f"motion {i}"],
            size,
        )
        for i, (space, a_cmd) in enumerate(zip(of.motions, wanted.motions, strict=True))
    ]
    M_home = whole.mass_matrix(robot.model, robot.home)
    driven = np.flatnonzero(robot.B.any(axis=1))
    moving.append(whole.posture_cost(wanted.a_post, M_home, driven, w["posture"], size))
    mobilities = [np.linalg.inv(metric(g.held.frame, g.held.other, [*whole.ALL])) for g in of.grips]
    pressing = [
        whole.force_cost(contact, F_cmd, mobility, w[f"force {grip.name}"], place, size)
        for grip, contact, F_cmd, mobility, place in zip(
            of.grips, contacts, wanted.forces, mobilities, physics.places, strict=True
        )
        if grip.forced
    ]
    if of.grasp:
        pair = contacts[0], contacts[1]
        grasp = wanted.f_cmd, mobilities, w["grasp"], physics.places, size
        pressing.append(whole.grasp_cost(pair, *grasp))
    return moving, pressing
