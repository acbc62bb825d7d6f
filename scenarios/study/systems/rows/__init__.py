"""An arm on a plane whose number of rows it does not know."""

from scenarios.study.systems.rows.system import FaceOnExactPlane

__all__ = ["FaceOnExactPlane"]
