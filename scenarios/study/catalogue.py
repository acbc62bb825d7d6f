"""All studies, by name."""

from scenarios.study.study import Study
from scenarios.study.tilt import Tilt

STUDIES: dict[str, type[Study]] = {kind.name: kind for kind in (Tilt,)}
"""Study classes by the name that the command line uses."""
