"""An arm on a plane whose normal it does not know."""

from scenarios.study.systems.arm.system import ArmOnPlane

__all__ = ["ArmOnPlane"]
