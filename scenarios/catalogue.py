"""All scenarios, by name."""

from collections.abc import Sequence

from qpctrl.errors import InputError, unknown_name
from scenarios.admittance import Admittance
from scenarios.bimanual import Bimanual
from scenarios.conveyor import Conveyor
from scenarios.crank import Crank
from scenarios.door import Door
from scenarios.drawer import Drawer
from scenarios.edge import Edge
from scenarios.eraser import Eraser
from scenarios.force_loop import ForceLoop
from scenarios.gap import Gap
from scenarios.haptic import Haptic
from scenarios.humanoid_wipe import HumanoidWipe
from scenarios.impedance import Impedance
from scenarios.mobile_eraser import MobileEraser
from scenarios.press import Press
from scenarios.scenario import Scenario
from scenarios.sphere import Sphere
from scenarios.stiff_wall import StiffWall
from scenarios.valve import Valve
from scenarios.virtual_wall import VirtualWall

SCENARIOS: dict[str, type[Scenario]] = {
    kind.name: kind
    for kind in (
        *(Eraser, Gap, Edge, Conveyor, Sphere, Door, Drawer, Crank, Valve, Press, ForceLoop),
        *(Haptic, Impedance, VirtualWall, Admittance, StiffWall),
        *(MobileEraser, Bimanual, HumanoidWipe),
    )
}
"""Scenario classes by the name that the command line uses."""


def scenario_named(arguments: Sequence[str]) -> type[Scenario]:
    """Return the scenario that the first argument of a command names.

    Raises:
        InputError: there is none, or it is unknown.
    """
    if not arguments:
        raise InputError(f"missing SCENARIO; allowed: {', '.join(SCENARIOS)}")
    if arguments[0] not in SCENARIOS:
        raise unknown_name("scenario", arguments[0], SCENARIOS)
    return SCENARIOS[arguments[0]]
