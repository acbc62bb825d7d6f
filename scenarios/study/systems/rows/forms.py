"""Too few rows and too many: what the hybrid law does on a plane that holds a face (k = 3).

Axes of the plane: g = (x, y, turn about z) are free, z and the tips about x and y are held.

Too few: in a tip f that is forgotten the motion task does not give way. Of the directions u that
it believes free, N W = K_p N Λ N X_e with W_g = 0 leaves

    m_f = Λ_eff K_p e_f,     Λ_eff = Λ_ff − Λ_fg Λ_gg⁻¹ Λ_gf

for a pose that is asked for e_f off the plane, whatever the law of force. Where the wrench outside
the believed rows is fed forward this moment feeds itself: it grows by m_f (1 − exp(−2π f_c dt)) in
each tick dt.

Too many: along x, believed held, the arm pushes with F_x = (1 + K_fp) f_d + K_fi f_d t − D v and
nothing pushes back. With S_x, the mobility along x while the plane holds, D = d / S_x and

    v̇ = S_x f_d (1 + K_fp + K_fi t) − d v

so that it drifts by ½ S_x f_d (1 + K_fp) t² without damping and ends at f_d (1 + K_fp) / D with.
The plane takes the reaction r = S_cc⁻¹ S_cx f_d (1 + K_fp) of its own rows c, of which feedback
without integral leaves r / (1 + K_fp). All of it is exact where the arm is; S_x changes on its way.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Matrix, Vector, Wrench
from scenarios.study.system import Setting
from scenarios.study.systems.equilibrium import Loop, Place, Rest, has_rest, rest

DT = 1e-3  # s
PRESS = 0.3  # s, before it is pushed aside
K_P = 900.0  # 1/s², of the motion

HELD = (2, 3, 4)
"""Axes that the plane holds: z, and the tips about x and y."""

GROOVE = 0
"""Axis x, held by the groove that is not there."""


def asked(setting: Setting) -> pin.SE3:
    """Return the pose that is asked for, in the axes of the plane."""
    return pin.SE3(pin.utils.rotate("y", np.radians(setting["turn"])), np.zeros(3))


def set_point(setting: Setting) -> Wrench:
    """Return the set-point (6) [N, Nm] in the axes of the tool."""
    side = setting["side_force"] if setting["rank_error"] > 0 else 0.0
    return np.array([side, 0.0, setting["force"], 0.0, 0.0, 0.0])


def at_rest(Lambda_inv: Matrix, setting: Setting) -> Rest | None:
    """Return wrench (in the axes of the tool) and pose (in those of the plane) at rest, if any.

    Args:
        Lambda_inv: mobility (6×6) of the tool at rest, in its own axes.
        setting: value of every parameter.
    """
    loop = Loop(
        lambda X_EF: set_point(setting),
        *(setting["k_fp"], setting["k_fi"], K_P),
        outside=setting["cutoff"] > 0,
    )
    place = Place(
        Lambda_inv=Lambda_inv,
        believed=lambda X_EF: believed_rows(X_EF, round(setting["rank_error"])),
        true=true_rows,
        X_WF=pin.SE3.Identity(),
        X_WD=asked(setting),
    )
    return rest(place, loop) if has_rest(place, loop) else None


def true_rows(X_EF: pin.SE3) -> Matrix:
    """Return the rows (3×6) of the plane on the body twist of a face at ``X_EF``."""
    return _axes(X_EF)[list(HELD)]


def believed_rows(X_EF: pin.SE3, rank_error: int) -> Matrix:
    """Return the rows (3 + ``rank_error``, ×6) that the controller believes in."""
    if rank_error == -1:  # n and e × n, e = y of the tool
        n = X_EF.rotation[2]
        lift = np.cross([0.0, 1.0, 0.0], n)
        return np.array([[*n, 0, 0, 0], [0, 0, 0, *lift]])
    keep = {-2: [2], 0: list(HELD), 1: [*HELD, GROOVE]}[rank_error]
    return _axes(X_EF)[keep]


def forgotten_moment(Lambda_inv: Matrix, rank_error: int, e: float) -> float:
    """Return m_f [Nm] about y, to first order in the error ``e`` [rad] about y.

    Args:
        Lambda_inv: mobility (6×6) of the tool, its axes those of the plane.
        rank_error: −1 or −2.
        e: how far the pose that is asked for is turned off the plane.
    """
    free, forgotten = [0, 1, 5], [4] if rank_error == -1 else [3, 4]
    Lambda = np.linalg.inv(Lambda_inv)
    coupling = Lambda[np.ix_(forgotten, free)]
    held = np.linalg.solve(Lambda[np.ix_(free, free)], coupling.T)
    effective = Lambda[np.ix_(forgotten, forgotten)] - coupling @ held
    return float(effective[-1, -1] * K_P * e)


class Drift(NamedTuple):
    """Motion along the believed groove."""

    speed: float
    """v [m/s]."""
    way: float
    """∫v [m]."""


def drift(S_x: Vector, setting: Setting) -> Drift:
    """Return where a free direction that is believed held ends, force and damping held in a step.

    Args:
        S_x: mobility [1/kg] along it in each step (steps) of `DT`, the first one at rest.
        setting: value of every parameter.
    """
    d, f, way, v = setting["damping"], setting["side_force"], 0.0, 0.0
    for step, mobility in enumerate(S_x, start=1):
        F_x = f * (1 + setting["k_fp"] + setting["k_fi"] * step * DT)
        a = float(mobility) * F_x - d * v
        way, v = way + v * DT + a * DT**2 / 2, v + a * DT
    return Drift(v, way)


class Groove(NamedTuple):
    """What a push along x meets that the plane does not hold."""

    S_x: float
    """Acceleration along x per force [1/kg], while the plane holds the face."""
    reaction: Vector
    """Force along z [N] and moments about x and y [Nm] on the plane per force."""


def groove(Lambda_inv: Matrix, X_EF: pin.SE3) -> Groove:
    """Return what a push along x meets at the pose ``X_EF`` of a tool with mobility (6×6)."""
    axes, c = _axes(X_EF), list(HELD)
    S: Matrix = axes @ Lambda_inv @ axes.T
    reaction: Vector = np.linalg.solve(S[np.ix_(c, c)], S[c, GROOVE])
    return Groove(float(S[GROOVE, GROOVE] - S[GROOVE, c] @ reaction), reaction)


def _axes(X_EF: pin.SE3) -> Matrix:
    """Return the rows (6×6) that turn a body twist into its components along the plane's axes."""
    axes = np.zeros((6, 6))
    axes[:3, :3] = axes[3:, 3:] = X_EF.rotation
    return axes
