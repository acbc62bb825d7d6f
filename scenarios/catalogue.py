"""All scenarios, by name."""

from scenarios.crank import Crank
from scenarios.door import Door
from scenarios.drawer import Drawer
from scenarios.eraser import Eraser
from scenarios.scenario import Scenario
from scenarios.sphere import Sphere

SCENARIOS: dict[str, type[Scenario]] = {
    kind.name: kind for kind in (Eraser, Door, Drawer, Crank, Sphere)
}
"""Scenario classes by the name that the command line uses."""
