"""Which limit each active row stands for, and how far each task gave way to it.

One CasADi function of the certified point and the tick's outputs, evaluated where a limit binds.
"""

import casadi as ca

from qpctrl import limit
from qpctrl.robot import Robot
from qpctrl.spatial import SX
from qpctrl.tick import Tick

SAME_TORQUE = 1e-6
"""Distance [Nm] within which a torque is said to be on a limit."""

SAME_BOUND = 1e-9
"""Relative distance within which a bound on an acceleration is said to be that of the speed."""

KINDS = (
    *("torque", "torque-speed", "torque rate"),
    *("position", "velocity", "unilateral", "contact"),
)
"""What a row of the QP can stand for, by its number in the output ``kind``."""

INPUTS = ("x", "z", "tau", "lb", "ub", "G", "x_law", "v", "u")


def build_explanation(robot: Robot, tick: Tick) -> ca.Function:
    """Return (x, z, tau, lb, ub, G, x_law, v, u) → (kind, give) for one tick.

    ``kind``: number in `KINDS` of what each inequality stands for on the side where its dual
    is; ``give``: G (x − x_law), in the rows of ``Tick.gives``.
    """
    f = tick.function
    s = {name: ca.SX.sym(name, *f.size_out(name)) for name in ("lb", "ub", "G", "x_law")}
    s |= {"x": ca.SX.sym("x", f.size1_out("g")), "z": ca.SX.sym("z", f.size1_out("lb"))}
    s |= {"tau": ca.SX.sym("tau", robot.nu), "v": ca.SX.sym("v", robot.nv)}
    s["u"], u = tick.inputs.symbols("u")
    inputs: list[SX] = [s[name] for name in INPUTS]
    limits = limit.named(u)
    G = ca.project(s["G"], tick.patterns["G"])
    others = tick.rows.inequality[robot.nu + robot.nv :]
    kinds = ca.vertcat(
        *_torque_kinds(robot, limits, s),
        *_acceleration_kinds(robot, limits, s),
        *(ca.SX(KINDS.index(row.partition(" ")[0])) for row in others),
    )
    outputs = [ca.densify(kinds), ca.densify(G @ (s["x"] - s["x_law"]))]
    return ca.Function("explanation", inputs, outputs, INPUTS, ["kind", "give"], {"cse": True})


def _torque_kinds(robot: Robot, limits: dict[str, SX], s: dict[str, SX]) -> list[SX]:
    """Return whether maximum, voltage or rate bounds the torque of each actuator."""
    v_a = limit.actuator_speed(robot, s["v"])
    kinds = []
    for i in range(robot.nu):
        upper = s["z"][i] > 0
        side = ca.if_else(upper, 1, -1)
        stall, droop = limits["tau_stall"][i], limits["tau_droop"][i]
        over, under = (limit.torque_speed(end, stall, droop, v_a[i]) for end in (1.0, -1.0))
        line = ca.if_else(upper, over, under)
        at_most = side * s["tau"][i] > limits["tau_max"][i] - SAME_TORQUE
        on_line = side * s["tau"][i] > side * line - SAME_TORQUE  # or beyond it, at ∓tau_max
        kinds.append(
            ca.if_else(
                at_most,
                KINDS.index("torque"),
                ca.if_else(on_line, KINDS.index("torque-speed"), KINDS.index("torque rate")),
            )
        )
    return kinds


def _acceleration_kinds(robot: Robot, limits: dict[str, SX], s: dict[str, SX]) -> list[SX]:
    """Return whether position or velocity bounds the acceleration of each joint."""
    kinds = []
    for i in range(robot.nv):
        upper = s["z"][robot.nu + i] > 0
        bound = ca.if_else(upper, s["ub"][robot.nu + i], s["lb"][robot.nu + i])
        v_max = ca.if_else(upper, limits["v_max"][i], -limits["v_max"][i])
        by_speed = limits["rates"][1] * (v_max - s["v"][i])
        same = ca.fabs(bound - by_speed) < SAME_BOUND * (1 + ca.fabs(bound))
        kinds.append(ca.if_else(same, KINDS.index("velocity"), KINDS.index("position")))
    return kinds
