"""Natural and artificial constraints of a contact, as numbers.

The environment sets A V = v_c, and that the wrench is some Aᵀ λ: N F = 0, where the rows of N span
the motions that A leaves free. The rest is for the task to choose. Both sets of equations are
solved for complementary directions, so that in each of the six either the twist is natural and
the wrench artificial, or the other way round.
Source: LynchPark2017 §11.6.1.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np
import pinocchio as pin

from qpctrl.arrays import Matrix, Twist, Vector, Wrench
from qpctrl.constraint import Constraint, PfaffianRows, row_function
from qpctrl.dynamics import Dynamics
from qpctrl.factor import Factor
from qpctrl.law import Split
from qpctrl.robot import Robot
from qpctrl.space import terms_here
from qpctrl.spatial import AXES
from scenarios.constraint_catalogue import Entry
from scenarios.guided import FLANGE

NEGLIGIBLE = 1e-9
"""Coefficients below this are round-off of numbers of order one."""

ILL_CONDITIONED = 1e8
"""Condition number of S above which λ loses half of its digits."""


class Row(NamedTuple):
    """One row of A, along the axes of the tool."""

    name: str
    A: Twist
    """Coefficients (6) [1, or m and 1/m between a length and an angle]."""
    A_dot_V: float
    """Ȧ V on the example motion [m/s² or rad/s²]."""
    v_c: float
    """Velocity of the environment along the row [m/s or rad/s]."""
    unilateral: bool
    """Whether the robot can only push (λ ≥ 0)."""

    @property
    def angular(self) -> bool:
        """Whether A V is in rad/s and λ in Nm, not in m/s and N.

        The coefficients of a row's own kind are a direction: their length is one.
        """
        linear, angular = (abs(np.linalg.norm(part) - 1) for part in (self.A[:3], self.A[3:]))
        return bool(angular < linear)


class Equations(NamedTuple):
    """m equations ``rows x = right``, each solved for one of the six directions."""

    rows: Matrix
    """Coefficients (m×6): 1 in the direction that a row is solved for, where the others have 0."""
    right: Vector
    """Right-hand sides (m)."""
    solved: tuple[int, ...]
    """The direction of each row, ascending."""

    @property
    def left(self) -> tuple[int, ...]:
        """The directions that no row is solved for."""
        return tuple(i for i in range(6) if i not in self.solved)


@dataclass(frozen=True, kw_only=True, eq=False)
class ConstraintTable:
    """What the environment sets and what the task may choose, at a pose in contact.

    Twists and wrenches are in the frame P: along the axes of E, about the origin of the tool or
    that of E, whichever gives the equations with fewer terms.
    """

    X_FP: pin.SE3
    """Frame P in the tool."""
    rows: tuple[Row, ...]
    twist: Equations
    """Natural constraints on the twist: A V = v_c."""
    wrench: Equations
    """Natural constraints on the wrench: N F = 0; the rows of N are the free motions."""
    push: Matrix
    """Rows (m×6) with push · F = λ ≥ 0: what can only be pushed."""
    V: Twist
    """The example motion [m/s, rad/s], A V = v_c."""
    S: Matrix
    """A Λ⁻¹ Aᵀ (k×k) [1/kg …] of the arm in that pose."""
    excess: Wrench
    """Aᵀ S⁻¹ (Ȧ V − v̇_c) [N, Nm]: what the textbook law presses too much on that motion."""

    @property
    def A(self) -> Matrix:
        """The rows (k×6) along the axes of the tool."""
        return np.array([row.A for row in self.rows]).reshape(-1, 6)

    @property
    def singular_values(self) -> Vector:
        """Of A, the largest first (k)."""
        return np.linalg.svd(self.A, compute_uv=False)

    @property
    def about_tool(self) -> bool:
        """Whether the origin of P is that of the tool; else that of the environment."""
        return not self.X_FP.translation.any()


def constraint_table(entry: Entry, robot: Robot) -> ConstraintTable:
    """Return the table of an entry whose environment touches the robot's flange at home."""
    X_WF = robot.pose(robot.home, FLANGE.frame)
    X_WE = X_WF * entry.X_EF.inverse()
    constraint = entry.build(X_WE) if entry.build else None
    V_env = X_WE.action @ entry.V_E
    resting = _evaluate(constraint, X_WF, np.zeros(6), V_env)
    X_FP, twist = _simplest(resting, entry.X_EF)
    V = _example(twist, entry.motion)
    values = _evaluate(constraint, X_WF, X_FP.action @ V, V_env)
    names, sides = (constraint.row_names, constraint.unilateral) if constraint else ((), ())
    A, A_dot_V, v_c, _ = values
    split = Split(PfaffianRows(*map(ca.SX, values)), ca.SX(_mobility(robot)))
    return ConstraintTable(
        X_FP=X_FP,
        rows=tuple(map(Row, names, A, A_dot_V.tolist(), v_c.tolist(), sides)),
        twist=twist,
        wrench=_reciprocal(twist),
        push=_pushes(A @ X_FP.action, sides, twist.solved),
        V=V,
        S=np.array(ca.DM(split.S)),
        excess=X_FP.action.T @ np.array(ca.DM(split.curvature_wrench)).ravel(),
    )


def solved(A: Matrix, right: Vector) -> Equations:
    """Return ``A x = right`` (k×6), each equation solved for the direction that matters most.

    Gauss–Jordan elimination; the pivot is the largest entry left, the first among equals.
    """
    work, pivots = np.column_stack([A, right]), list[int]()
    for i in range(len(A)):
        left = np.abs(work[i:, :6]).round(9)
        row, column = np.unravel_index(left.argmax(), left.shape)
        work[[i, i + row]] = work[[i + row, i]]
        work[i] /= work[i, column]
        others = np.arange(len(A)) != i
        work[others] -= np.outer(work[others, column], work[i])
        pivots.append(int(column))
    work = work[np.argsort(pivots)]
    work[np.abs(work) < NEGLIGIBLE] = 0.0
    return Equations(work[:, :6], work[:, 6], tuple(sorted(pivots)))


def condition(matrix: Matrix) -> float:
    """Return the largest singular value over the smallest."""
    return float(np.linalg.cond(matrix))


class _Values(NamedTuple):
    """The numbers of `PfaffianRows`."""

    A: Matrix
    A_dot_V: Vector
    v_c: Vector
    v_c_dot: Vector


def _evaluate(constraint: Constraint | None, X_WF: pin.SE3, V: Twist, V_env: Twist) -> _Values:
    """Return the rows at pose and body twist of the tool, and spatial twist of the environment."""
    if constraint is None:
        return _Values(np.zeros((0, 6)), *(np.zeros(0) for _ in range(3)))
    given = dict(constraint.inputs())
    if "V_env" in given:
        given["V_env"] = V_env
    A, *rates = row_function(constraint)(X_WF.rotation, X_WF.translation, V, *given.values())
    return _Values(np.array(A), *(np.array(rate).ravel() for rate in rates))


def _simplest(values: _Values, X_EF: pin.SE3) -> tuple[pin.SE3, Equations]:
    """Return the frame P that gives A V = v_c the fewest terms, and the equations there."""
    at_tool = pin.SE3(X_EF.rotation.T, np.zeros(3))
    frames = (at_tool, X_EF.inverse())
    views = [(X_FP, solved(values.A @ X_FP.action, values.v_c)) for X_FP in frames]
    return min(views, key=lambda view: np.count_nonzero(view[1].rows))


def _reciprocal(twist: Equations) -> Equations:
    """Return N F = 0, where the rows of N span the null space of the twist's equations."""
    free, natural = list(twist.left), list(twist.solved)
    N = np.zeros((len(free), 6))
    N[:, free] = np.eye(len(free))
    N[:, natural] = 0.0 - twist.rows[:, free].T
    return Equations(N, np.zeros(len(free)), twist.left)


def _pushes(A: Matrix, sides: Sequence[bool], natural: Sequence[int]) -> Matrix:
    """Return the λ of the one-sided rows by the artificial components of F = Aᵀ λ."""
    rows = np.zeros((len(A), 6))
    if len(A):
        rows[:, natural] = np.linalg.inv(A[:, natural]).T
    return rows[list(sides)]


def _example(twist: Equations, motion: Mapping[str, float]) -> Twist:
    """Return the twist (6) that satisfies the equations with these components chosen."""
    V = np.array([motion.get(axis, 0.0) for axis in AXES])
    V[list(twist.solved)] = twist.right - twist.rows[:, twist.left] @ V[list(twist.left)]
    return V


def _mobility(robot: Robot) -> Matrix:
    """Return Λ⁻¹ (6×6) of the flange at home."""
    dynamics = Dynamics(robot)
    space = terms_here(FLANGE, dynamics, Factor(dynamics.M), ca.SX(0))
    return np.array(ca.Function("mobility", [dynamics.q], [space.Lambda_inv])(robot.home))
