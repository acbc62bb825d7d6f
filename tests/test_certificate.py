"""The certificate: each residual sees its own kind of wrong."""

import casadi as ca
import numpy as np
import pytest
from cases import ROBOTS, SPACES, Given, draw, given_mode, states

from qpctrl import Controller, Measurement, Status
from qpctrl.certificate import INPUTS, build_certificate

EXACT = 1e-9
"""Promised residual of an accepted tick."""

SPOILT = 1e-6
"""Far above the promise: what a certificate must not pass over."""


@pytest.fixture(scope="module")
def solved() -> tuple[ca.Function, dict[str, np.ndarray]]:
    """Return the certificate and the exact solution of a tick whose shoulder torque binds."""
    robot, space = ROBOTS["planar_2r"](), SPACES["planar_2r"]
    controller = Controller(robot, [given_mode(robot, space, 1)], solver="daqp")
    engine = controller.engines["contact"]
    q, v, rng = next(states(robot, space, 1))
    references = draw(rng, 1, 2, 2).references()
    free = controller.step(
        "contact", Measurement(0.0, q, v), references, controller.start("contact", q)
    )
    limits = Given(tau_max=np.abs(free[0].tau) * np.array([0.8, 2.0]))
    memory = controller.start("contact", q)
    _, report, _ = controller.step(
        "contact", Measurement(0.0, q, v), {**references, "limits": limits}, memory
    )
    assert report.status is Status.OK
    assert [limit.name for limit in report.active] == ["torque shoulder"]
    seen = {name: engine.terms[name].copy() for name in INPUTS}
    qp = {name: seen[name] for name in ("H", "g", "A", "b", "C", "lb", "ub")}
    return build_certificate(engine.tick), {**seen, **by_hand(qp, report.active[0].dual)}


def by_hand(qp: dict[str, np.ndarray], dual: float) -> dict[str, np.ndarray]:
    """Return x, y, z on the active set: row 0 of C at the side that the dual tells."""
    side = qp["ub"][0] if dual > 0 else qp["lb"][0]
    rows = np.vstack([qp["A"], qp["C"][:1]])
    n, m = len(qp["g"]), len(rows)
    kkt = np.block([[qp["H"], rows.T], [rows, np.zeros((m, m))]])
    point = np.linalg.solve(kkt, np.concatenate([-qp["g"], qp["b"].ravel(), [side]]))
    z = np.zeros(len(qp["lb"]))
    z[0] = point[-1]
    return {"x": point[:n], "y": point[n:-1], "z": z}


def residuals(certificate: ca.Function, values: dict[str, np.ndarray]) -> np.ndarray:
    """Return stationarity, equality, inequality, complementarity."""
    return np.array(certificate(**values)["kkt"]).ravel()


def test_the_exact_solution_has_no_residual(
    solved: tuple[ca.Function, dict[str, np.ndarray]],
) -> None:
    certificate, values = solved
    assert residuals(certificate, values).max() < EXACT


@pytest.mark.parametrize(
    ("name", "row", "amount", "residual"),
    [
        ("g", 0, 1e-3, "stationarity"),
        ("y", 0, 1e-3, "stationarity"),
        ("z", 0, 1e-3, "stationarity"),
        ("b", 0, 1e-3, "equality"),
        ("lb", 1, +1e4, "inequality"),
        ("ub", 1, -1e4, "inequality"),
        ("z", 1, +1e-3, "complementarity"),
        ("z", 1, -1e-3, "complementarity"),
        ("z", 2, +1e-3, "complementarity"),  # a multiplier on a bound at infinity
        ("z", 2, -1e-3, "complementarity"),
    ],
)
def test_what_is_spoilt_is_seen_by_its_own_residual(
    solved: tuple[ca.Function, dict[str, np.ndarray]],
    name: str,
    row: int,
    amount: float,
    residual: str,
) -> None:
    certificate, exact = solved
    values = {**exact, name: exact[name].copy()}
    values[name][row] += amount
    found = residuals(certificate, values)
    kinds = ("stationarity", "equality", "inequality", "complementarity")
    assert found[kinds.index(residual)] > SPOILT


def test_the_torque_is_the_map_of_the_solution(
    solved: tuple[ca.Function, dict[str, np.ndarray]],
) -> None:
    certificate, values = solved
    tau = np.array(certificate(**values)["tau"]).ravel()
    assert tau == pytest.approx(values["C"][: len(tau)] @ values["x"] + values["t"].ravel())
    gaps = np.array(certificate(**values)["gaps"]).ravel()
    size = max(np.abs(tau).max(), np.abs(values["tau_hybrid"]).max())
    assert gaps[0] == pytest.approx(np.abs(tau - values["tau_hybrid"]).max() / size)
    assert gaps[1] == pytest.approx(np.abs(tau - values["tau_textbook"]).max() / size)
