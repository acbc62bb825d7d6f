"""Rollouts of studies: what becomes of them, and of which every tick is kept."""

import io
import math
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl
import pytest
from scripted import TICKS, diverge, scripted

from qpctrl import InputError
from scenarios.study.outcome import OutcomeClass, contact_measures, force_measures
from scenarios.study.plan import Plan, Task
from scenarios.study.rollout import Made, RolloutError, Tracing, roll_out, roll_out_all, row_schema
from scenarios.study.search import Boundary
from scenarios.study.study import Study

TASK = Task("x", 3, 0, (2.5,), "one", 7)


def study_of(found: Any) -> Study:
    """Return a study whose rollouts find ``found``, or raise it."""

    def script(*_: Any) -> Any:
        if isinstance(found, Exception):
            raise found
        return found

    return scripted(script)


def outcome(found: Any) -> dict[str, Any]:
    """Return the row of a rollout that finds ``found``."""
    return roll_out(study_of(found), TASK).row


@pytest.mark.parametrize(
    ("found", "kind"),
    [
        ({}, "ok"),
        ({"force_rmse_ratio": 0.1, "saturated_fraction": 0.01, "contact_breaks": 2}, "ok"),
        ({"force_rmse_ratio": 0.2}, "degraded"),
        ({"fallback_ticks": 1}, "degraded"),
        ({"saturated_fraction": 0.5, "force_rmse_ratio": 0.2}, "saturated"),
        ({"contact_breaks": 3, "longest_loss_ms": 49, "saturated_fraction": 0.5}, "chatter"),
        ({"longest_loss_ms": 50, "contact_breaks": 1, "saturated_fraction": 0.5}, "lost"),
    ],
)
def test_the_worst_that_happened_is_the_outcome(found: dict[str, float], kind: str) -> None:
    row = outcome(found)
    assert row["outcome"] == kind
    assert (row["x_1"], row["controller"], row["seed"], row["reason"]) == (2.5, "one", 7, "")
    assert {name: row[name] for name in found} == found


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (ZeroDivisionError("by\nzero"), "ZeroDivisionError: by zero"),
        ({"value_N": math.nan, "contact_breaks": 9}, "not finite: value_N"),
        ({"value_N": 1.0, "fallback_ticks": math.inf}, "not finite: fallback_ticks"),
    ],
)
def test_what_goes_wrong_is_an_outcome_with_a_reason_and_no_numbers(
    found: Any, reason: str
) -> None:
    study = study_of(found)
    row = roll_out(study, TASK).row
    assert row["outcome"] == OutcomeClass.DIVERGED
    assert pl.Series([row["reason"]]).str.contains(f"^{reason}$").all()
    assert [row[name] for name in study.measures] == [None] * len(study.measures)


@pytest.mark.parametrize(
    ("found", "kind", "said"),
    [
        (InputError("no such duration"), InputError, "no such duration"),
        (TypeError("of\nours"), RolloutError, "TypeError: of ours"),
        ({"value_N": "high"}, RolloutError, "TypeError: .*"),
    ],
)
@pytest.mark.parametrize("searches", [False, True])
def test_a_fault_is_no_outcome_and_ends_the_study(
    found: Any, kind: type[Exception], said: str, searches: bool
) -> None:
    study = study_of(found)
    if searches:
        edge = Boundary(parameter="y", low=0.1, high=1.0, measure="value_N", limit=1.0)
        study = replace(study, search=edge)
    with pytest.raises(kind, match=f"^rollout of row 3 with 'one': {said}$"):
        roll_out(study, TASK)


def test_a_process_with_other_code_makes_no_rows() -> None:
    with pytest.raises(InputError, match=r"the code changed since the study began: .* was old"):
        roll_out_all(scripted(), Tracing(), "old", [TASK])


def test_a_state_that_leaves_all_bounds_is_its_own_outcome() -> None:
    row = roll_out(scripted(diverge), TASK).row
    assert (row["outcome"], row["reason"], row["value_N"]) == ("diverged", "left all bounds", None)


def test_a_quantity_that_a_rollout_does_not_have_is_no_divergence() -> None:
    row = outcome({"value_N": 3.0, "fallback_ticks": None})
    assert (row["outcome"], row["value_N"], row["fallback_ticks"]) == ("ok", 3.0, None)


def test_rows_fit_their_columns_whatever_kind_of_number_is_measured() -> None:
    study = study_of({"value_N": np.float32(1.5), "fallback_ticks": np.int64(2)})
    rows = [roll_out(study, TASK).row, outcome(ValueError("no")), outcome({"value_N": 1})]
    table = pl.DataFrame(rows, schema=row_schema(study), orient="row")
    assert table["value_N"].to_list() == [1.5, None, 1.0]
    assert table["fallback_ticks"].to_list() == [2.0, None, None]
    assert (table["elapsed_s"] > 0).all()


def test_force_statistics_of_a_known_signal() -> None:
    force = np.r_[np.full(90, 11.0), np.full(10, 4.0)]  # errors +1 and −6
    found = force_measures(force, 10.0)
    assert found["force_mae_N"] == pytest.approx(1.5)
    assert found["force_bias_N"] == pytest.approx(0.3)
    assert found["force_rmse_N"] == pytest.approx(math.sqrt(4.5))
    assert found["force_rmse_ratio"] == pytest.approx(math.sqrt(4.5) / 10)
    assert found["force_p95_N"] == pytest.approx(6.0)
    assert found["force_peak_N"] == 11.0
    assert found["force_spread_N"] == pytest.approx(0.3 + 3 * math.sqrt(4.5 - 0.09))


def test_contact_statistics_of_a_known_signal() -> None:
    touching = np.array([0, 1, 1, 0, 0, 0, 1, 0, 1, 0], dtype=bool)
    assert contact_measures(touching, dt=2e-3) == pytest.approx(
        {"contact_lost_fraction": 0.6, "longest_loss_ms": 6.0, "contact_breaks": 4}
    )
    none = {"contact_lost_fraction": 0.0, "longest_loss_ms": 0.0, "contact_breaks": 0}
    assert contact_measures(np.ones(5, dtype=bool), dt=1e-3) == none


# Traces --------------------------------------------------------------------------------------


def traced(study: Study, tracing: Tracing) -> list[Task]:
    """Return the tasks of a study whose ticks are kept."""
    return [task for task in Plan(study, 0) if roll_out(study, task, tracing).trace is not None]


@pytest.mark.parametrize(("rows", "of"), [(1, 5), (2, 5), (3, 5), (5, 5), (9, 5)])
def test_ticks_of_as_many_rows_as_asked_are_kept_with_every_controller(rows: int, of: int) -> None:
    study = scripted(controllers=("one", "two"), repeats=2)
    kept = traced(study, Tracing(rows, of))
    assert len({task.row for task in kept}) == min(rows, of)
    assert len(kept) == 2 * min(rows, of)
    assert {task.repeat for task in kept} == {0}


def test_ticks_of_failures_are_kept_and_of_nothing_else() -> None:
    def script(setting: Any, *_: Any) -> dict[str, float]:
        if setting["x"] == 10:
            return diverge(setting, "", 0)  # type: ignore[return-value]
        return {-10: {"longest_loss_ms": 60.0}, -5: {"contact_breaks": 5.0}}.get(setting["x"], {})

    assert traced(scripted(script), Tracing()) == []
    kept = traced(scripted(script), Tracing(failures=True))
    assert [task.point for task in kept] == [(-10.0,), (-5.0,), (10.0,)]


@pytest.mark.parametrize("found", [{}, ValueError("at once")])
def test_a_trace_holds_the_full_record_and_changes_nothing_in_the_row(found: Any) -> None:
    def read(made: Made) -> pl.DataFrame:
        return pl.read_parquet(io.BytesIO(made.trace or b""))

    study = study_of(found)
    made = roll_out(study, TASK, Tracing(rows=5, of=5))
    plain = roll_out(study, TASK)
    assert plain.trace is None
    assert {**made.row, "elapsed_s": 0} == {**plain.row, "elapsed_s": 0}
    if found == {}:
        assert read(made).to_dict(as_series=False) == {"tick": [*range(TICKS)], "x": [2.5] * TICKS}
    else:
        assert len(read(made)) == 0
