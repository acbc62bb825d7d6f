"""The numbers that one tick leaves behind, in one vector, whoever computed them."""

import numpy as np

from qpctrl.layout import Layout
from qpctrl.robot import Robot
from qpctrl.tick import Tick

FIRST = ("tau", "q", "memory")
"""What the next tick needs, in front."""


def outcome_layout(robot: Robot, tick: Tick) -> Layout:
    """Return the layout of the numbers of a tick.

    ``tau`` to send, ``q`` that was believed, ``memory`` of the tasks; ``time``, ``damping``;
    torques of QP, solver and both laws; ``lam``; residuals ``kkt`` and ``gaps`` as in
    `qpctrl.certificate`, and so what contacts carry, ``wrench``, and what is left of their limits,
    ``margin``; duals ``z``, what each of them stands for, ``kind``, and what the tasks ``give``, as
    in `qpctrl.explanation`; ``signals`` of the tasks.
    """
    size = tick.function.size1_out
    torque = dict.fromkeys(("tau_qp", "tau_solver", "tau_hybrid", "tau_textbook"), robot.nu)
    sizes = {
        **{"tau": robot.nu, "q": robot.nq, "memory": tick.memory.size, "time": 1, "damping": 1},
        **torque,
        **{"lam": tick.mode_rows, "kkt": 4, "gaps": 4, "z": size("lb"), "kind": size("lb")},
        **{
            "wrench": sum(len(place.axes) for place in tick.contacts),
            "margin": sum(len(place.limits) for place in tick.contacts),
        },
        **{"give": size("G"), "signals": size("signals")},
    }
    return Layout({name: np.zeros(length) for name, length in sizes.items()})
