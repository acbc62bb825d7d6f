"""The equivalence table: it holds, and it notices when it should not."""

import numpy as np
import pytest
from cases import needs_compiler

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


@needs_compiler
@pytest.mark.parametrize("form", ["reduced", "full"])
@pytest.mark.parametrize("case", [CASES[0], CASES[3], CASES[-1]], ids=str)
def test_compiled_ticks_keep_the_table_and_equal_the_interpreted(case: Case, form: str) -> None:
    (row,) = compare(states=FEW, cases=(case,), form=form, compiled="yes")
    assert not [criterion for criterion in row.criteria() if not criterion.passed]
    assert row.compiled_gap is not None
    assert 0 < row.compiled_gap < 1e-10
    assert row.limited > FEW // 3


def test_where_nothing_is_compiled_the_table_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    (row,) = compare(states=2, cases=CASES[:1], compiled="auto")
    assert row.compiled_gap is None
    assert not any("compiled" in criterion.name for criterion in row.criteria())


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
