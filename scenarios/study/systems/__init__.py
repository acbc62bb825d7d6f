"""Systems that a study can run, by name; a new one is one package here and one entry below."""

from scenarios.study.system import System
from scenarios.study.systems.arm import ArmOnPlane
from scenarios.study.systems.hinge import HingedDoor
from scenarios.study.systems.mass import MassOnWall
from scenarios.study.systems.rows import FaceOnExactPlane
from scenarios.study.systems.wipe import Wipe

SYSTEMS: dict[str, System] = {
    system.name: system
    for system in (ArmOnPlane(), HingedDoor(), FaceOnExactPlane(), MassOnWall(), Wipe())
}
"""All systems by the name that study files use."""
