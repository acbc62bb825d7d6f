"""Independent answers for robots with many contacts, in numpy and pinocchio alone.

All act on z = (a, τ, λ). The physics of a tick are linear in it:

    M a + h + Jᵀ Aᵀ λ = B τ,   A (J a + J̇v) + Ȧ V = 0                                   E z = e

and so is what each cost looks at. Nothing here imports qpctrl.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import oracles
import pinocchio as pin
import quadprog

ALL = tuple(range(6))


class Motion(NamedTuple):
    """Kinematics of a frame along its own axes, or of the momentum along those of the world."""

    X: pin.SE3
    """Pose in the world, or as seen from another frame; of the momentum where its centre is."""
    V: np.ndarray
    """Twist or momentum (6)."""
    J: np.ndarray
    """Its Jacobian (6×nv)."""
    J_dot_v: np.ndarray
    """Its rate where v̇ = 0 (6)."""


def motion_of(
    model: pin.Model, q: np.ndarray, v: np.ndarray, frame: str, other: str | None = None
) -> Motion:
    """Return the motion of a frame, seen from ``other``; of ``centre of mass``: of the momentum.

    V = V_F − Ad_{X_FO} V_O, and with d/dt Ad_{X_FO} = −ad_V Ad_{X_FO}
    V̇ = V̇_F − Ad_{X_FO} V̇_O + ad_V Ad_{X_FO} V_O.  Source: LynchPark2017 §8.2.
    """
    if frame == "centre of mass":
        data = model.createData()
        drift = pin.computeCentroidalMomentumTimeVariation(model, data, q, v, 0 * v).vector.copy()
        J = pin.computeCentroidalMap(model, data, q).copy()
        return Motion(pin.SE3(np.eye(3), pin.centerOfMass(model, data, q)), J @ v, J, drift)
    own = oracles.frame_terms(model, q, v, frame)
    if other is None:
        return Motion(own.X_WF, own.J @ v, own.J, own.J_dot_v)
    its = oracles.frame_terms(model, q, v, other)
    X_OF = its.X_WF.actInv(own.X_WF)
    Ad = X_OF.inverse().action
    J = own.J - Ad @ its.J
    carried = oracles.motion_cross(J @ v, Ad @ its.J @ v)
    return Motion(X_OF, J @ v, J, own.J_dot_v - Ad @ its.J_dot_v + carried)


class Held(NamedTuple):
    """What holds a frame: directions of an environment that its twist must not have."""

    frame: str
    other: str | None
    R_E: np.ndarray
    """Orientation of the environment, in the world or in ``other`` (3×3)."""
    rows: tuple[int, ...] = ALL
    """Which of (v, ω) along the axes of the environment vanish."""


class Contact(NamedTuple):
    """One contact at one state: A V̇ + Ȧ V = 0 with A rows of diag(R_EF, R_EF)."""

    motion: Motion
    A: np.ndarray
    A_dot_V: np.ndarray


def contact_of(model: pin.Model, q: np.ndarray, v: np.ndarray, held: Held) -> Contact:
    """Return rows and drift; Ṙ_EF = R_EF [ω]× makes the latter R_EF (ω × v, 0)."""
    motion = motion_of(model, q, v, held.frame, held.other)
    R_EF = held.R_E.T @ motion.X.rotation
    linear, angular = motion.V[:3], motion.V[3:]
    drift = np.r_[R_EF @ np.cross(angular, linear), np.zeros(3)]
    rows = list(held.rows)
    return Contact(motion, np.kron(np.eye(2), R_EF)[rows], drift[rows])


def along_free_directions(v: np.ndarray, contacts: Sequence[Contact]) -> np.ndarray:
    """Return the part of a velocity (nv) that no contact forbids."""
    AJ = np.vstack([contact.A @ contact.motion.J for contact in contacts])
    return v - np.linalg.pinv(AJ) @ (AJ @ v)


class Physics(NamedTuple):
    """M, h, B of a state, its contacts, and E z = e."""

    M: np.ndarray
    h: np.ndarray
    B: np.ndarray
    AJ: np.ndarray
    b: np.ndarray
    """−Ȧ V − A J̇v (k)."""
    E: np.ndarray
    e: np.ndarray
    places: tuple[slice, ...]
    """Multipliers of each contact in z."""


def physics(
    model: pin.Model, q: np.ndarray, v: np.ndarray, B: np.ndarray, contacts: Sequence[Contact]
) -> Physics:
    """Return the physics with these contacts."""
    M, h, *_ = oracles.frame_terms(model, q, v, "universe")
    AJ = np.vstack([contact.A @ contact.motion.J for contact in contacts])
    b = np.concatenate([-c.A_dot_V - c.A @ c.motion.J_dot_v for c in contacts])
    k, nu = len(AJ), B.shape[1]
    E = np.block([[M, -B, AJ.T], [AJ, np.zeros((k, nu + k))]])
    ends = len(M) + nu + np.cumsum([0, *(len(contact.A) for contact in contacts)])
    places = tuple(slice(*ends[i : i + 2]) for i in range(len(contacts)))
    return Physics(M, h, B, AJ, b, E, np.concatenate([-h, b]), places)


class Cost(NamedTuple):
    """½ w ‖L z − goal‖² in a metric."""

    L: np.ndarray
    goal: np.ndarray
    metric: np.ndarray
    weight: float


def motion_cost(
    motion: Motion, index: list[int], a_cmd: np.ndarray, Lambda: np.ndarray, w: float, size: int
) -> Cost:
    """w/2 ‖J a + J̇v − a_cmd‖²_Λ along some of the axes."""
    L = np.zeros((len(index), size))
    L[:, : motion.J.shape[1]] = motion.J[index]
    return Cost(L, a_cmd - motion.J_dot_v[index], Lambda, w)


def force_cost(
    contact: Contact, F_cmd: np.ndarray, Lambda_inv: np.ndarray, w: float, place: slice, size: int
) -> Cost:
    """w/2 ‖Aᵀ λ − F_cmd‖²_{Λ⁻¹}."""
    L = np.zeros((6, size))
    L[:, place] = contact.A.T
    return Cost(L, F_cmd, Lambda_inv, w)


def posture_cost(a_post: np.ndarray, M_home: np.ndarray, driven: np.ndarray, w: float, size: int):
    """w/2 ‖a − a_post‖² of the driven joints, in their part of M at home."""
    L = np.zeros((len(driven), size))
    L[:, driven] = np.eye(len(driven))
    return Cost(L, a_post[driven], M_home[np.ix_(driven, driven)], w)


def internal_map(one: Motion, other: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Return how two wrenches of hands on an object give (F₁ − F₂)/2, about each hand (6×6)."""
    first, second = (np.kron(np.eye(2), m.X.rotation) for m in (one, other))
    return first / 2, -second / 2


def grasp_cost(
    contacts: tuple[Contact, Contact],
    f_cmd: float,
    mobilities: Sequence[np.ndarray],
    w: float,
    places: Sequence[slice],
    size: int,
) -> Cost:
    """w/2 ‖(F₁ − F₂)/2 − f_cmd (e, 0)‖² with one mobility for forces and one for moments."""
    one, other = (contact.motion for contact in contacts)
    L = np.zeros((6, size))
    for contact, place, E in zip(contacts, places, internal_map(one, other), strict=True):
        L[:, place] = E @ contact.A.T
    way = other.X.translation - one.X.translation
    diagonal = np.mean([np.diag(mobility) for mobility in mobilities], axis=0).reshape(2, 3)
    metric = np.diag(np.repeat(diagonal.mean(axis=1), 3))
    return Cost(L, np.r_[f_cmd * way / np.linalg.norm(way), np.zeros(3)], metric, w)


def inertia_at(
    model: pin.Model, q: np.ndarray, frame: str, other: str | None, index: list[int]
) -> np.ndarray:
    """Return (J M⁻¹ Jᵀ)⁻¹ (n×n) of some axes at a configuration."""
    J = motion_of(model, q, np.zeros(model.nv), frame, other).J[index]
    return np.linalg.inv(J @ np.linalg.solve(mass_matrix(model, q), J.T))


def mass_matrix(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """Return M (nv×nv)."""
    return oracles.frame_terms(model, q, np.zeros(model.nv), "universe").M


def null_space_optimum(
    costs: Sequence[Cost],
    of: Physics,
    G: np.ndarray | None = None,
    d: np.ndarray | None = None,
) -> np.ndarray:
    """Return the z that minimises the costs subject to E z = e, and to G z ≤ d where given.

    z = z₀ + Z y with E Z = 0. With the square roots of all metrics stacked, L Z = Q R, the costs
    are ‖R y − Qᵀ (goal − L z₀)‖² and a constant: the minimiser without inequalities solves a
    triangular system, that with them is the projection of a point, by quadprog.
    Source: Nocedal2006 §16.2.
    """
    roots = [np.sqrt(cost.weight) * np.linalg.cholesky(cost.metric).T for cost in costs]
    L = np.vstack([root @ cost.L for root, cost in zip(roots, costs, strict=True)])
    goal = np.concatenate([root @ cost.goal for root, cost in zip(roots, costs, strict=True)])
    left, sizes, right = np.linalg.svd(of.E)
    rank = len(of.e)
    z_0 = right[:rank].T @ ((left.T @ of.e) / sizes)
    Z = right[rank:].T
    Q, R = np.linalg.qr(L @ Z)
    wanted = Q.T @ (goal - L @ z_0)
    if G is None or d is None:
        return z_0 + Z @ np.linalg.solve(R, wanted)
    rows = np.linalg.solve(R.T, (G @ Z).T).T
    size = np.linalg.norm(rows, axis=1)
    found = quadprog.solve_qp(
        np.eye(len(R)), wanted, -(rows / size[:, None]).T, -(d - G @ z_0) / size
    )
    return z_0 + Z @ np.linalg.solve(R, found[0])


def projected_inverse_dynamics(
    of: Physics, a: np.ndarray, costs: Sequence[Cost]
) -> tuple[np.ndarray, np.ndarray]:
    """Return τ (nu) and λ (k) that give the acceleration ``a``, with the least cost of force.

    The orthogonal decomposition (A J)ᵀ = Q (R, 0) splits the dynamics: its lower part,
    S_u Qᵀ B τ = S_u Qᵀ (M a + h), knows no contact force and leaves τ = τ₀ + N y; its upper part
    gives the force, λ = R⁻¹ S_c Qᵀ (B τ − M a − h), which then is linear in y; y minimises the
    costs.  Source: Mistry2010; Righetti2013.
    """
    k, nv = len(of.AJ), len(of.M)
    Q, R = np.linalg.qr(of.AJ.T, mode="complete")
    upper, lower, inertial = Q[:, :k].T, Q[:, k:].T, of.M @ a + of.h
    free = lower @ of.B
    tau_0 = np.linalg.lstsq(free, lower @ inertial, rcond=None)[0]
    _, sizes, right = np.linalg.svd(free)
    N = right[int((sizes > 1e-10 * sizes[0]).sum()) :].T
    lam_0 = np.linalg.solve(R[:k], upper @ (of.B @ tau_0 - inertial))
    slope = np.linalg.solve(R[:k], upper @ of.B @ N)
    at = nv + of.B.shape[1]
    roots = [np.sqrt(cost.weight) * np.linalg.cholesky(cost.metric).T for cost in costs]
    L = np.vstack([root @ cost.L[:, at:] for root, cost in zip(roots, costs, strict=True)])
    goal = np.concatenate([root @ cost.goal for root, cost in zip(roots, costs, strict=True)])
    y = np.linalg.lstsq(L @ slope, goal - L @ lam_0, rcond=None)[0]
    return tau_0 + N @ y, lam_0 + slope @ y


class Wish(NamedTuple):
    """A motion to have: some axes of a frame, and their command."""

    motion: Motion
    index: list[int]
    a_cmd: np.ndarray


def operational_space_law(
    of: Physics, contact: Contact, F_cmd: np.ndarray, wishes: Sequence[Wish], a_post: np.ndarray
) -> np.ndarray:
    """Return τ of a robot with every joint driven, for task spaces that do not compete.

    The first wish is that of the frame in contact; together the spaces have no more axes than
    there are joints. Its command is brought onto the constraint by the least change in its own
    inertia, ã₁ = a₁ − Λ₁⁻¹ Aᵀ S⁻¹ (A a₁ + Ȧ V); then, J and Λ those of all spaces together,

        τ = h + Jᵀ Λ ((ã₁, a₂ …) − J̇v) + Nᵀ M a_post + J₁ᵀ Aᵀ S⁻¹ A Λ₁⁻¹ F_cmd

    Every cost but that of ã₁ − a₁, which nothing can change, is zero then: the weights say
    nothing.  Source: Khatib1987; LynchPark2017 §11.6.
    """
    first = contact.motion
    Lambda_1_inv = first.J @ np.linalg.solve(of.M, first.J.T)
    S = contact.A @ Lambda_1_inv @ contact.A.T
    off = contact.A @ wishes[0].a_cmd + contact.A_dot_V
    feasible = wishes[0].a_cmd - Lambda_1_inv @ contact.A.T @ np.linalg.solve(S, off)
    J = np.vstack([wish.motion.J[wish.index] for wish in wishes])
    drift = np.concatenate([wish.motion.J_dot_v[wish.index] for wish in wishes])
    command = np.concatenate([feasible, *(wish.a_cmd for wish in wishes[1:])])
    M_inv_JT = np.linalg.solve(of.M, J.T)
    Lambda = np.linalg.inv(J @ M_inv_JT)
    N = np.eye(len(of.M)) - M_inv_JT @ Lambda @ J
    lam = np.linalg.solve(S, contact.A @ Lambda_1_inv @ F_cmd)
    moving = J.T @ Lambda @ (command - drift)
    return of.h + moving + N.T @ of.M @ a_post + first.J.T @ contact.A.T @ lam


def accelerations(
    model: pin.Model,
    q: np.ndarray,
    v: np.ndarray,
    force: np.ndarray,
    pushes: Sequence[tuple[Contact, np.ndarray]],
) -> np.ndarray:
    """Return a (nv) under generalised forces B τ and wrenches on the environment, by ABA."""
    back = sum((contact.motion.J.T @ F for contact, F in pushes), np.zeros(model.nv))
    return pin.aba(model, model.createData(), q, v, force - back).copy()


def moved(
    model: pin.Model, q: np.ndarray, v: np.ndarray, a: np.ndarray, t: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the state a short time later [s], to second order."""
    return pin.integrate(model, q, t * v + t**2 / 2 * a), v + t * a
