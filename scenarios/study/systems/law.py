"""The laws that systems compare, and the gains of a force task as their parameters set them."""

import numpy as np

from qpctrl.arrays import Array
from qpctrl.law import Law
from scenarios.study.system import Setting

LAWS: dict[str, Law] = {"qp": "qp", "hybrid": "hybrid", "textbook": "textbook"}
"""Controllers of the systems that compare laws, by name."""

LAW_WORDS: dict[str, str] = {
    "qp": "the QP",
    "hybrid": "the closed form that the QP equals",
    "textbook": "the closed form as printed",
}
"""Words of `LAWS`."""


def force_gains(setting: Setting, n: int = 6, ramp: float | None = None) -> dict[str, Array]:
    """Return the gains of a force task, alike in all directions.

    Args:
        setting: of a system with the parameters k_fp [1], k_fi [1/s], damping [1/s], cutoff [Hz].
        n: dimension of the task.
        ramp: rate [N/s, Nm/s] at which the set-point ramps up; none: that of the task.
    """
    gains: dict[str, Array] = {
        "K_fp": np.full(n, setting["k_fp"]),
        "K_fi": np.full(n, setting["k_fi"]),
        "damping": np.array(setting["damping"]),
        "cutoff": np.array(setting["cutoff"]),
    }
    return gains if ramp is None else {**gains, "ramp": np.full(n, ramp)}
