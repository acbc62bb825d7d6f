"""Robots from URDF files."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pinocchio as pin

from qpctrl.arrays import Vector
from qpctrl.errors import InputError
from qpctrl.robot import NO_LIMIT, Robot, from_pinocchio


def from_urdf(path: Path | str, *, home: Vector | None = None) -> Robot:
    """Return the robot of a URDF file (continuous joints become unlimited revolute ones).

    Raises:
        InputError: no such file, not XML, or not a URDF that pinocchio can read.
    """
    try:
        model = pin.buildModelFromXML(urdf_text(Path(path)))
    except (ValueError, RuntimeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: not a usable URDF ({error})") from error
    return from_pinocchio(model, home=home)


def xml_root(path: Path) -> ElementTree.Element:
    """Return the root element of an XML file.

    Raises:
        InputError: it cannot be read, or is not XML.
    """
    try:
        return ElementTree.parse(path).getroot()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise InputError(f"{path}: not XML ({error})") from error


def urdf_text(path: Path) -> str:
    """Return the URDF text without meshes, with continuous joints as unlimited revolute."""
    root = xml_root(path)
    if root.tag != "robot":
        raise InputError(f"{path}: got <{root.tag}>, need a URDF with <robot> at its root")
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    for joint in root.findall("joint"):
        if joint.find("mimic") is not None:
            raise InputError(f"{path}: joint {joint.get('name')!r} is a mimic; not supported")
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
            limit.attrib = {"effort": "0", "velocity": "0", **limit.attrib}
            limit.attrib |= {"lower": f"{-NO_LIMIT}", "upper": f"{NO_LIMIT}"}
    return ElementTree.tostring(root, encoding="unicode")
