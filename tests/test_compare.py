"""The equivalence table: it holds, and it notices when it should not."""

import numpy as np
import pytest

from qpctrl import law, model
from qpctrl.spatial import AXES
from scenarios.compare import CASES, compare
from scenarios.comparison import WORST
from scenarios.equivalence import Case, Row

FEW = 40


@pytest.mark.parametrize("case", CASES, ids=str)
@pytest.mark.parametrize("form", ["reduced", "full"])
def test_qp_equals_the_closed_forms_and_a_second_solver(case: Case, form: str) -> None:
    (row,) = compare(states=FEW, cases=(case,), form=form)
    missed = [criterion for criterion in row.criteria() if not criterion.passed]
    assert not missed
    assert row.limited > FEW // 3  # limits did bind
    if case.k:
        assert row.textbook_gap > 1e-6  # and the textbook law is another one


def test_a_wrong_law_is_noticed(monkeypatch) -> None:
    right = law.Split.curvature_wrench.fget

    def flipped(self):
        return -right(self)

    monkeypatch.setattr(law.Split, "curvature_wrench", property(flipped))
    (row,) = compare(states=5, cases=(Case("fr3", AXES, 3),))
    assert row.law_gap > 1e-4


def test_a_wrong_textbook_law_is_noticed(monkeypatch) -> None:
    right = model.ModeModel._null_space_inertia
    monkeypatch.setattr(model.ModeModel, "_null_space_inertia", lambda self: 1.01 * right(self))
    (row,) = compare(states=5, cases=(Case("fr3", AXES, 3),))
    assert row.curvature_gap > 1e-4


def test_the_same_seed_gives_the_same_table() -> None:
    case = (Case("planar_2r", ("vx", "vy"), 1),)
    rows = [next(compare(states=10, seed=seed, cases=case)) for seed in (1, 1, 2)]
    assert rows[0] == rows[1] != rows[2]


def test_a_nan_in_the_table_fails_its_criterion() -> None:
    values = dict.fromkeys(WORST, np.nan)
    row = Row(robot="x", k=1, states=1, limited=0, damped=0, unsolved=0, **values)
    assert not any(c.passed for c in row.criteria() if "unsolved" not in c.name)
