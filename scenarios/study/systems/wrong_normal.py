"""A wrong normal: what the hybrid law does on a plane that is tilted against the believed one.

At rest the wrench of the true plane, A_tᵀ λ, balances what the law commands with the believed
rows A_b, P Λ a_cmd + A_bᵀ f_cmd, where P A_bᵀ = 0 and A_b Λ⁻¹ P = 0:

    λ = g f_cmd,  g = (A_b Λ⁻¹ A_bᵀ) / (A_b Λ⁻¹ A_tᵀ),   X_e = (λ / K_p) Λ⁻¹ P A_tᵀ

The feedback reads A_b A_tᵀ λ = λ cos α, so f_cmd = f_d + K_fp (f_d − λ cos α) without integral
and λ = f_d / cos α with one. For Λ = m I, g = 1 / cos α, and all laws of force agree; an arm
whose inertia couples the directions is further off without integral. Where the task feeds the
wrench outside A_b forward, that wrench is A_tᵀ λ − A_bᵀ λ cos α, so λ = f_d / cos α and X_e = 0.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from qpctrl.arrays import Matrix, Vector
from qpctrl.robot import Robot


class Held(NamedTuple):
    """What is left while a point holds still on the tilted plane."""

    force_ratio: float
    """λ / f_d [1]."""
    offset: Vector
    """X_e (6) [m, rad]: pose error, desired − actual, in the axes of the frame."""


class ForceLaw(NamedTuple):
    """What of the controller decides on force and offset."""

    f_d: float
    """Set-point along the believed normal [N]."""
    K_fp: float
    """Proportional force gain [1]."""
    K_fi: float
    """Integral force gain [1/s]; any positive one gives the same."""
    K_p: float
    """Stiffness of the motion task, in all directions [1/s²]."""
    outside: bool
    """Whether the wrench outside the believed rows is fed forward."""


def held(Lambda_inv: Matrix, A_b: Vector, A_t: Vector, law: ForceLaw) -> Held:
    """Return force and pose error at rest, exactly, for one row (k = 1).

    Args:
        Lambda_inv: mobility (6×6) of the frame, in its own axes.
        A_b: believed row (6): normal and zeros, in the axes of the frame.
        A_t: true row (6).
        law: the controller.
    """
    cos = float(A_b @ A_t)
    if law.outside:
        return Held(1 / cos, np.zeros(6))
    S_bb, S_bt = float(A_b @ Lambda_inv @ A_b), float(A_b @ Lambda_inv @ A_t)
    g, K = S_bb / S_bt, law.K_fp
    ratio = 1 / cos if law.K_fi > 0 else g * (1 + K) / (1 + K * g * cos)
    P_A_t = A_t - A_b * S_bt / S_bb
    return Held(ratio, ratio * law.f_d / law.K_p * (Lambda_inv @ P_A_t))


def mobility(robot: Robot, frame: str, q: Vector) -> Matrix:
    """Return Λ⁻¹ = J M⁻¹ Jᵀ (6×6) of ``frame``, in its own axes, at ``q`` (nq)."""
    model, data = robot.model, robot.model.createData()
    M = pin.crba(model, data, q)
    J = pin.computeFrameJacobian(model, data, q, robot.frame_id(frame), pin.ReferenceFrame.LOCAL)
    return J @ np.linalg.solve(M, J.T)
