"""An arm and a door whose hinge it does not know."""

from scenarios.study.systems.hinge.system import HingedDoor

__all__ = ["HingedDoor"]
