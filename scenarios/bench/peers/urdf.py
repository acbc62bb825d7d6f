"""A robot as a mesh-free URDF: joints, inertias, limits and one frame; what every peer can read.

A URDF has no field for armature: it is handed to the peers beside it.
"""

import xml.etree.ElementTree as ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Vector
from qpctrl.robot import NO_LIMIT, Robot

ROOT = "base"
"""Name of the link that does not move."""


def robot_urdf(robot: Robot, frame: str) -> str:
    """Return the URDF of a robot; its only named frame is ``frame``, fixed to its joint.

    Numbers have all their digits: M, h and J of what is read back are the robot's to round-off,
    but for the armature.

    Raises:
        InputError: no such frame.
    """
    tool = robot.model.frames[robot.frame_id(frame)]
    root = Element("robot", name=robot.name or "robot")
    SubElement(root, "link", name=ROOT)
    links = [ROOT, *(f"{name} link" for name in robot.joint_names)]
    for i in range(1, robot.model.njoints):
        _add_inertia(SubElement(root, "link", name=links[i]), robot.model.inertias[i])
        joint = _add_joint(root, robot.joint_names[i - 1], links[robot.model.parents[i]], links[i])
        _describe(joint, robot, i)
    SubElement(root, "link", name=frame)
    fixed = _add_joint(root, f"{frame} fixed", links[tool.parentJoint], frame)
    fixed.set("type", "fixed")
    _place(fixed, tool.placement)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _add_inertia(link: Element, inertia: pin.Inertia) -> None:
    inertial = SubElement(link, "inertial")
    _place(inertial, pin.SE3(np.eye(3), np.array(inertia.lever)))
    SubElement(inertial, "mass", value=_number(inertia.mass))
    I = np.array(inertia.inertia)  # noqa: E741
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2)}
    entries |= {"iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    SubElement(inertial, "inertia", {name: _number(I[at]) for name, at in entries.items()})


def _add_joint(root: Element, name: str, parent: str, child: str) -> Element:
    joint = SubElement(root, "joint", name=name)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    return joint


def _describe(joint: Element, robot: Robot, i: int) -> None:
    """Write placement, kind, axis and limits of joint ``i`` of the model."""
    limits, kind = robot.limits, robot.model.joints[i]
    at, data = kind.idx_v, kind.createData()
    kind.calc(data, pin.neutral(robot.model), np.ones(robot.nv))
    twist = np.array(data.v.vector)
    turns = bool(np.abs(twist[3:]).max() > 0)
    joint.set("type", "revolute" if turns else "prismatic")
    _place(joint, robot.model.jointPlacements[i])
    SubElement(joint, "axis", xyz=_numbers(twist[3:] if turns else twist[:3]))
    bounds = {"lower": limits.q_min, "upper": limits.q_max}
    bounds |= {"effort": limits.tau_max, "velocity": limits.v_max}
    values = {name: np.clip(bound[at], -NO_LIMIT, NO_LIMIT) for name, bound in bounds.items()}
    SubElement(joint, "limit", {name: _number(value) for name, value in values.items()})


def _place(element: Element, X: pin.SE3) -> None:
    angles = pin.rpy.matrixToRpy(X.rotation)
    SubElement(element, "origin", xyz=_numbers(X.translation), rpy=_numbers(angles))


def _numbers(values: Vector) -> str:
    return " ".join(_number(value) for value in values)


def _number(value: float) -> str:
    return repr(float(value))
