"""An arm that runs circles on a board, everything about both uncertain."""

from scenarios.study.systems.wipe.system import Wipe

__all__ = ["Wipe"]
