"""The certificate of a tick: KKT residuals and gaps to both laws.

One CasADi function of the solver's answer and the tick's outputs.
"""

import casadi as ca

from qpctrl.contact_report import margins, wrenches
from qpctrl.limit import UNBOUNDED
from qpctrl.report import TINY_TORQUE
from qpctrl.spatial import SX
from qpctrl.tick import Tick

KKT_TOLERANCE = 1e-9
"""Largest KKT residual of a tick that is accepted."""

INPUTS = (
    *("H", "g", "A", "b", "C", "lb", "ub", "t"),
    *("tau_textbook", "tau_hybrid", "curvature"),
)
"""Outputs of the tick that the certificate reads, after x, y and z."""


def build_certificate(tick: Tick) -> ca.Function:
    """Return (x, y, z, *INPUTS, *A) → (tau, kkt, gaps, wrench, margin) for one tick.

    ``kkt`` (4): stationarity, equality, inequality, complementarity, each as its largest
    entry over the largest of the terms that it balances, or over 1 where those are smaller.
    ``gaps`` (4), relative to max |τ|: QP − hybrid, QP − textbook, QP − textbook + curvature,
    curvature. ``wrench``, ``margin``: of each contact Aᵀ λ, and what is left of each of its
    limits; empty where `Tick.contacts` is.
    """
    f = tick.function
    contacts = {place.A for place in tick.contacts}
    s = {name: ca.SX.sym(name, *f.size_out(name)) for name in (*INPUTS, *sorted(contacts))}
    x, y, z = (ca.SX.sym(n, s[of].shape[0]) for n, of in (("x", "g"), ("y", "b"), ("z", "lb")))
    inputs = [x, y, z, *s.values()]
    s |= {
        name: ca.project(s[name], pattern) for name, pattern in tick.patterns.items() if name in s
    }
    Cx = s["C"] @ x
    tau = Cx[: s["t"].shape[0]] + s["t"]
    size = ca.fmax(ca.fmax(_largest(s["tau_hybrid"]), _largest(tau)), TINY_TORQUE)
    gaps = ca.vertcat(
        _largest(tau - s["tau_hybrid"]),
        _largest(tau - s["tau_textbook"]),
        _largest(tau - s["tau_textbook"] + s["curvature"]),
        _largest(s["curvature"]),
    )
    margin = margins(tick.rows.inequality, tick.contacts, s["ub"] - Cx)
    lam = x[x.shape[0] - tick.mode_rows :]
    return ca.Function(
        "certificate",
        inputs,
        [
            *(tau, _kkt(s, Cx, x, y, z), gaps / size),
            *(wrenches(tick.contacts, s, lam), margin),
        ],
        ["x", "y", "z", *s],
        ["tau", "kkt", "gaps", "wrench", "margin"],
        {"cse": True},
    )


def _kkt(s: dict[str, SX], Cx: SX, x: SX, y: SX, z: SX) -> SX:
    Ax = s["A"] @ x
    terms = (s["H"] @ x, s["g"], s["A"].T @ y, s["C"].T @ z)
    above, below = s["ub"] - Cx, Cx - s["lb"]
    push_down, push_up = ca.fmax(z, 0), ca.fmax(-z, 0)
    complementarity = ca.fmax(
        push_down * ca.if_else(s["ub"] < UNBOUNDED / 2, ca.fabs(above), 1),
        push_up * ca.if_else(s["lb"] > -UNBOUNDED / 2, ca.fabs(below), 1),
    )
    return ca.vertcat(
        _largest(terms[0] + terms[1] + terms[2] + terms[3]) / _scale(*terms),
        _largest(Ax - s["b"]) / _scale(Ax, s["b"]),
        ca.fmax(_largest(ca.fmax(-above, 0)), _largest(ca.fmax(-below, 0))) / _scale(Cx),
        _largest(complementarity) / _scale(z),
    )


def _scale(*terms: SX) -> SX:
    return _largest(ca.vertcat(1, *terms))


def _largest(vector: SX) -> SX:
    """Return the largest size of an entry, in pairs: a processor need not wait for the last one."""
    sizes = [ca.fabs(entry) for entry in ca.vertsplit(ca.densify(vector))] or [ca.SX(0)]
    while len(sizes) > 1:
        pairs = zip(sizes[::2], sizes[1::2], strict=False)
        sizes = [ca.fmax(one, other) for one, other in pairs] + sizes[len(sizes) & ~1 :]
    return sizes[0]
