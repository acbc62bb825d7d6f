"""A point mass on a wall, all of whose answers are known."""

from scenarios.study.systems.mass.system import MassOnWall

__all__ = ["MassOnWall"]
