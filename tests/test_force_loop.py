"""The force loop of the real controller becomes unstable where the closed forms say."""

import math

import numpy as np
import pytest
from runs import ran

from qpctrl import InputError
from scenarios.bisection import boundary
from scenarios.critical_gain import CASES, critical_gain, settles
from scenarios.force_loop import ForceLoop


def test_every_critical_gain_is_its_closed_form_within_one_per_cent() -> None:
    metrics = ran("force_loop").metrics
    shares = [metrics[f"critical gain: {case.words}"] for case in CASES]
    assert shares == pytest.approx([1.0] * len(CASES), rel=0.01)
    assert not ran("force_loop").missed


def test_the_closed_forms_are_those_of_theory() -> None:
    found = {case.words: case.closed_form for case in CASES}
    assert found["P, 3 ticks"] == 1.0
    assert found["PI, K_fp = 0.6"] == pytest.approx(0.8)
    integral = [found[f"I, {d} ticks"] for d in (2, 3, 5, 10)]
    assert integral == pytest.approx([1.0, 0.618, 0.347, 0.165], abs=5e-4)


def test_a_growing_record_does_not_settle() -> None:
    t = np.arange(400)
    assert settles(0.99**t * np.sin(t))
    assert not settles(1.001**t * np.sin(t))
    assert not settles(np.full(400, np.nan))


def test_bisection_finds_where_a_property_is_lost() -> None:
    asked = []

    def holds(value: float) -> bool:
        asked.append(value)
        return value < 0.3

    assert boundary(holds, 0.0, 1.0, 1e-3) == pytest.approx(0.3, abs=5e-4)
    assert len(asked) == 10


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"gain": "k_fd"}, "k_fp or k_fi"),
        ({"gain": "k_fi", "delay": 0}, "at least 1 tick"),
        ({"gain": "k_fi", "k_fp": -1.0}, "values >= 0"),
        ({"gain": "k_fi", "tolerance": 0.0}, "between 0 and 1"),
        ({"gain": "k_fi", "tolerance": math.nan}, "finite"),
    ],
    ids=str,
)
def test_what_cannot_be_used_is_refused(wrong, words: str) -> None:
    with pytest.raises(InputError, match=words):
        critical_gain(wrong.pop("gain"), **wrong)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"delay": 0}, "delay: got 0"),
        ({"share": -1.0}, "share"),
        ({"force": math.nan}, "force: .*finite"),
        ({"duration": 1e3}, "at most 60 s"),
    ],
    ids=str,
)
def test_a_loop_that_makes_no_sense_is_refused(wrong, words: str) -> None:
    with pytest.raises(InputError, match=words):
        ForceLoop(**wrong)
