"""Independent answers, in numpy and pinocchio, from the formulas of docs/formulation.md.

Nothing here imports qpctrl: what both get wrong alike must be a wrong formula, not shared code.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import quadprog


class FrameTerms(NamedTuple):
    """M, h and the kinematics of one frame in its own coordinates, all six axes."""

    M: np.ndarray
    h: np.ndarray
    J: np.ndarray
    J_dot_v: np.ndarray
    X_WF: pin.SE3


def frame_terms(model: pin.Model, q: np.ndarray, v: np.ndarray, frame: str) -> FrameTerms:
    """Return M, h, J, J̇v and the pose, with pinocchio."""
    data = model.createData()
    fid = model.getFrameId(frame)
    M = np.triu(pin.crba(model, data, q))
    M = M + np.triu(M, 1).T
    h = pin.rnea(model, data, q, v, np.zeros(model.nv)).copy()
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    pin.updateFramePlacements(model, data)
    X_WF = data.oMf[fid].copy()
    drift = pin.getFrameAcceleration(model, data, fid, pin.LOCAL).vector.copy()
    J = pin.computeFrameJacobian(model, data, q, fid, pin.LOCAL).copy()
    return FrameTerms(M, h, J, drift, X_WF)


class BodyTerms(NamedTuple):
    """Terms of a task space: axes ``index`` of the body twist of one frame."""

    M: np.ndarray
    h: np.ndarray
    J: np.ndarray
    J_dot_v: np.ndarray
    V: np.ndarray
    X_WF: pin.SE3
    V_full: np.ndarray
    Lambda_inv: np.ndarray
    Lambda: np.ndarray
    eta: np.ndarray


def body_terms(
    model: pin.Model, q: np.ndarray, v: np.ndarray, frame: str, index: list[int]
) -> BodyTerms:
    """Return Λ⁻¹ = J M⁻¹ Jᵀ, η = J̄ᵀ h − Λ J̇v and what they are made from."""
    M, h, J_full, drift_full, X_WF = frame_terms(model, q, v, frame)
    J, drift = J_full[index], drift_full[index]
    Lambda_inv = J @ np.linalg.solve(M, J.T)
    Lambda = np.linalg.inv(Lambda_inv)
    J_bar = np.linalg.solve(M, J.T) @ Lambda
    eta = J_bar.T @ h - Lambda @ drift
    return BodyTerms(M, h, J, drift, J @ v, X_WF, J_full @ v, Lambda_inv, Lambda, eta)


def projector(A: np.ndarray, Lambda_inv: np.ndarray) -> np.ndarray:
    """P = I − Aᵀ (A Λ⁻¹ Aᵀ)⁻¹ A Λ⁻¹."""
    S = A @ Lambda_inv @ A.T
    return np.eye(A.shape[1]) - A.T @ np.linalg.solve(S, A @ Lambda_inv)


def euclidean_projector(A: np.ndarray) -> np.ndarray:
    """I − A⁺A: the trap. It moves the robot correctly and pushes wrongly."""
    return np.eye(A.shape[1]) - np.linalg.pinv(A) @ A


def curvature_wrench(terms: BodyTerms, rows: "Rows") -> np.ndarray:
    """Aᵀ S⁻¹ (Ȧ V − v̇_c)."""
    S = rows.A @ terms.Lambda_inv @ rows.A.T
    return rows.A.T @ np.linalg.solve(S, rows.A_dot_V - rows.v_c_dot)


class Rows(NamedTuple):
    """A V̇ + Ȧ V = v̇_c."""

    A: np.ndarray
    A_dot_V: np.ndarray
    v_c_dot: np.ndarray


class Wanted(NamedTuple):
    """Commands of the law; F_ext is a known wrench on the environment besides Aᵀ λ."""

    a_cmd: np.ndarray
    F_cmd: np.ndarray
    F_ext: np.ndarray
    a_post: np.ndarray


def textbook(
    terms: BodyTerms, rows: Rows, wanted: Wanted, P: np.ndarray | None = None
) -> np.ndarray:
    """τ = Jᵀ (P Λ a_cmd + (I−P) F_cmd + η) + Nᵀ (M a_post + h), the law as printed.

    η holds J̄ᵀ h, so the posture part carries the rest of h: h = Jᵀ J̄ᵀ h + Nᵀ h.
    """
    P = projector(rows.A, terms.Lambda_inv) if P is None else P
    J_bar = np.linalg.solve(terms.M, terms.J.T) @ terms.Lambda
    N = np.eye(len(terms.M)) - J_bar @ terms.J
    pushing = (np.eye(len(P)) - P) @ wanted.F_cmd
    F = P @ terms.Lambda @ wanted.a_cmd + pushing + terms.eta
    return terms.J.T @ (F + wanted.F_ext) + N.T @ (terms.M @ wanted.a_post + terms.h)


def hybrid(terms: BodyTerms, rows: Rows, wanted: Wanted) -> np.ndarray:
    """The textbook law less its curvature error."""
    return textbook(terms, rows, wanted) - terms.J.T @ curvature_wrench(terms, rows)


class Response(NamedTuple):
    """What a plant does under a torque."""

    a: np.ndarray
    V_dot: np.ndarray
    lam: np.ndarray


def plant(
    terms: BodyTerms, rows: Rows, tau: np.ndarray, F_ext: np.ndarray | float = 0.0
) -> Response:
    """Solve M a + h + Jᵀ (Aᵀ λ + F_ext) = τ and A (J a + J̇v) + Ȧ V = v̇_c for (a, λ)."""
    AJ, k = rows.A @ terms.J, len(rows.A)
    kkt = np.block([[terms.M, AJ.T], [AJ, np.zeros((k, k))]])
    load = terms.J.T @ np.broadcast_to(F_ext, (len(terms.J),))
    drift = rows.v_c_dot - rows.A_dot_V - rows.A @ terms.J_dot_v
    found = np.linalg.solve(kkt, np.concatenate([tau - terms.h - load, drift]))
    a = found[: len(tau)]
    return Response(a, terms.J @ a + terms.J_dot_v, found[len(tau) :])


def motion_cross(V: np.ndarray, W: np.ndarray) -> np.ndarray:
    """ad_V W, by pinocchio."""
    return pin.Motion(V).cross(pin.Motion(W)).vector


def pose_error(X_WF: pin.SE3, X_WD: pin.SE3) -> np.ndarray:
    """[X_e] = log(X⁻¹ X_d)."""
    return pin.log6(X_WF.actInv(X_WD)).vector


def transported(X_WF: pin.SE3, X_WD: pin.SE3, V_des: np.ndarray) -> np.ndarray:
    """Ad_{X⁻¹X_d} V_d."""
    return X_WF.actInv(X_WD).action @ V_des


def transport_rate(
    X_WF: pin.SE3,
    V: np.ndarray,
    X_WD: pin.SE3,
    V_des: np.ndarray,
    V_dot_des: np.ndarray,
    step: float = 1e-5,
) -> np.ndarray:
    """d/dt (Ad_{X⁻¹X_d} V_d) by central differences along both motions."""

    def at(t: float) -> np.ndarray:
        X, X_d = X_WF * pin.exp6(t * V), X_WD * pin.exp6(t * V_des)
        return transported(X, X_d, V_des + t * V_dot_des)

    return (at(step) - at(-step)) / (2 * step)


def face_rows(R_WE: np.ndarray, X_WF: pin.SE3) -> np.ndarray:
    """A of a face on a plane: z of R_EF v, x and y of R_EF ω."""
    R_EF = R_WE.T @ X_WF.rotation
    A = np.zeros((3, 6))
    A[0, :3], A[1, 3:], A[2, 3:] = R_EF[2], R_EF[0], R_EF[1]
    return A


def without_components(A: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """(I − A⁺A) vector."""
    return vector - np.linalg.pinv(A) @ (A @ vector)


class Optimum(NamedTuple):
    """Minimiser of the QP in (a, λ), and its torque."""

    a: np.ndarray
    lam: np.ndarray
    tau: np.ndarray


def limited_optimum(
    terms: BodyTerms,
    rows: Rows,
    wanted: Wanted,
    weights: tuple[float, float, float],
    tau_min: np.ndarray,
    tau_max: np.ndarray,
    slack: float | None = None,
) -> Optimum:
    """Minimise the three costs of the formulation over (a, λ) within torque bounds, by quadprog.

    w_m/2 ‖J a + J̇v − a_cmd‖²_Λ + w_f/2 ‖Aᵀ λ − F_cmd‖²_{Λ⁻¹} + w_p/2 ‖N (a − a_post)‖²_M

    With slack the rows hold no more: w_s/2 ‖A V̇ + Ȧ V − v̇_c‖²_{S⁻¹} is a fourth cost, and the
    first is taken of Pᵀ (J a + J̇v − a_cmd).
    """
    nv, k = len(terms.M), len(rows.A)
    J_bar = np.linalg.solve(terms.M, terms.J.T) @ terms.Lambda
    N = np.eye(nv) - J_bar @ terms.J
    costs = [
        (weights[0] * terms.Lambda, np.hstack([terms.J, np.zeros((len(terms.J), k))])),
        (weights[1] * terms.Lambda_inv, np.hstack([np.zeros((len(terms.J), nv)), rows.A.T])),
        (weights[2] * terms.M, np.hstack([N, np.zeros((nv, k))])),
    ]
    targets = [wanted.a_cmd - terms.J_dot_v, wanted.F_cmd, N @ wanted.a_post]
    AJ = rows.A @ terms.J
    equality = np.hstack([AJ, np.zeros((k, k))])
    drift = rows.v_c_dot - rows.A_dot_V - rows.A @ terms.J_dot_v
    if slack is not None:
        PT = projector(rows.A, terms.Lambda_inv).T
        costs[0], targets[0] = (costs[0][0], PT @ costs[0][1]), PT @ targets[0]
        S = rows.A @ terms.Lambda_inv @ rows.A.T
        costs, targets = [*costs, (slack * np.linalg.inv(S), equality)], [*targets, drift]
        equality, drift = equality[:0], drift[:0]
    H = sum(E.T @ metric @ E for metric, E in costs)
    pull = sum(E.T @ metric @ goal for (metric, E), goal in zip(costs, targets, strict=True))
    torque = np.hstack([terms.M, AJ.T])
    bias = terms.h + terms.J.T @ wanted.F_ext
    bounded = np.vstack([equality, torque, -torque])
    limits = np.concatenate([drift, tau_min - bias, bias - tau_max])
    x = quadprog.solve_qp((H + H.T) / 2, pull, bounded.T, limits, len(equality))[0]
    return Optimum(x[:nv], x[nv:], torque @ x + bias)
