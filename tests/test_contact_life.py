"""The life of a contact: which phase follows which, and what a tick says of it."""

import math
from itertools import groupby
from typing import Any

import numpy as np
import pytest
from cases import SPACES, board, chain
from hypothesis import given, settings
from hypothesis import strategies as st

from qpctrl import (
    Contact,
    ContactLife,
    ContactPhase,
    Controller,
    InputError,
    Measurement,
    Mode,
    TaskSpace,
    Weighted,
)
from tasks import ForceReference, ForceTask, MotionReference, MotionTask, PostureTask

DT = 1e-3
LIFE = ContactLife(touch_force=0.5, loss_time=0.005, regain_time=0.02)
APPROACH, TOUCH, PRESS, LOSS, REGAIN = ContactPhase

FOLLOWS = {
    APPROACH: {TOUCH},
    TOUCH: {PRESS, APPROACH},
    PRESS: {LOSS, APPROACH},
    LOSS: {REGAIN, APPROACH},
    REGAIN: {PRESS, LOSS, APPROACH},
}
"""The allowed successors of each phase, written down from its description."""


def lived(forces: list[float], contact: Contact, life: ContactLife = LIFE) -> list[Contact]:
    """Return the contact tick by tick, one force [N] each period after ``contact``."""
    states = []
    for force in forces:
        contact = life.advance(contact, contact.time + DT, force)
        states.append(contact)
    return states


def pressing(life: ContactLife = LIFE) -> Contact:
    """Return a contact that presses at time 0."""
    return life.start(0.0, closed=True)


def test_a_contact_goes_through_its_whole_life() -> None:
    contact = LIFE.feel(LIFE.start(0.0), 0.001)
    states = lived([0.0] * 3 + [2.0] * 10 + [0.0] * 8 + [2.0] * 30, contact)
    states.append(LIFE.lift(states[-1], states[-1].time))
    phases = [phase for phase, _ in groupby(state.phase for state in states)]
    assert phases == [TOUCH, PRESS, LOSS, REGAIN, PRESS, APPROACH]
    assert states[-1].losses == 1


def test_it_is_lost_after_the_loss_time_and_not_a_tick_before() -> None:
    phases = [state.phase for state in lived([3.0, 3.0, *[0.1] * 6], pressing())]
    assert phases == [PRESS] * 6 + [LOSS, LOSS]
    dip = lived([3.0, *[0.1] * 4, 3.0, *[0.1] * 4], pressing())
    assert {state.phase for state in dip} == {PRESS}


def test_it_is_lost_after_as_many_ticks_at_any_time_of_the_day() -> None:
    contact, ticks = pressing(), set()
    for _ in range(2000):
        contact = lived([3.0], contact)[0]
        phases = [state.phase for state in lived([0.0] * 6, contact)]
        ticks.add(phases.index(LOSS) + 1)
    assert ticks == {5}


def test_a_regained_contact_presses_only_while_it_is_felt() -> None:
    states = lived([0.0] * 5 + [3.0] * 20 + [0.0] * 2 + [3.0], pressing())
    assert [state.phase for state in states[-4:]] == [REGAIN, REGAIN, REGAIN, PRESS]


def test_a_regained_contact_presses_only_after_it_has_held() -> None:
    states = lived([0.0] * 6 + [3.0] * 25, pressing())
    regained = [state.time for state in states if state.phase is REGAIN]
    assert regained[0] == pytest.approx(0.007)
    assert len(regained) == 20
    assert states[-1].phase is PRESS


def test_a_regained_contact_can_be_lost_again() -> None:
    states = lived([0.0] * 6 + [3.0] * 2 + [0.0] * 6, pressing())
    assert [state.losses for state in states] == [0] * 4 + [1] * 8 + [2] * 2
    assert states[-1].phase is LOSS


def test_nothing_is_touched_before_one_feels_for_it() -> None:
    contact = lived([5.0] * 3, LIFE.start(0.0))[-1]
    assert contact.phase is APPROACH
    assert contact.felt
    touching = LIFE.feel(contact, contact.time)
    assert touching.phase is TOUCH
    assert lived([5.0], touching)[0].phase is PRESS


@pytest.mark.parametrize("phase", [TOUCH, PRESS, LOSS, REGAIN])
def test_only_a_contact_that_approaches_obeys_feel(phase: ContactPhase) -> None:
    contact = Contact(phase, since=1.0, time=2.0, felt_at=1.5, losses=3)
    assert LIFE.feel(contact, 2.5) == contact
    lifted = LIFE.lift(contact, 2.5)
    assert (lifted.phase, lifted.since, lifted.losses) == (APPROACH, 2.5, 3)


@pytest.mark.parametrize("time", [math.nan, math.inf, -math.inf, 1.0])
@pytest.mark.parametrize("told", ["advance", "feel", "lift"])
def test_old_news_and_news_at_no_time_change_nothing(time: float, told: str) -> None:
    for phase in ContactPhase:
        contact = Contact(phase, since=1.0, time=2.0, felt_at=1.5)
        more = (9.0,) if told == "advance" else ()
        assert getattr(LIFE, told)(contact, time, *more) == contact


@pytest.mark.parametrize("force", [math.nan, math.inf, -math.inf, -9.0])
def test_a_force_that_nobody_knows_or_that_pulls_is_not_felt(force: float) -> None:
    states = lived([force] * 5, pressing())
    assert [state.phase for state in states] == [PRESS] * 4 + [LOSS]
    assert lived([force], states[-1])[0].phase is LOSS
    assert lived([force, 1.0], LIFE.feel(LIFE.start(0.0), 0.0))[0].phase is TOUCH


news = st.tuples(
    st.sampled_from(["advance", "advance", "advance", "feel", "lift"]),
    st.sampled_from([DT, DT, DT, 0.0, 0.004, -0.003, math.nan, math.inf]),
    st.sampled_from([0.0, 0.49, 0.5, 3.0, -2.0, math.nan, math.inf]),
)


@settings(derandomize=True, max_examples=300, deadline=None)
@given(st.lists(news, min_size=1, max_size=60), st.booleans())
def test_whatever_comes_the_contact_keeps_to_its_rules(events: list[Any], closed: bool) -> None:
    contact, known = LIFE.start(0.0, closed=closed), [0.0] if closed else []
    for told, step, force in events:
        time = contact.time + step
        more = (force,) if told == "advance" else ()
        after = getattr(LIFE, told)(contact, time, *more)
        if told == "advance" and math.isfinite(time) and time >= contact.time:
            known += [time] if math.isfinite(force) and force >= 0.5 else []
            if contact.phase in (PRESS, REGAIN):
                quiet = time - max(known) > 0.005 - 1e-9
                assert (after.phase is LOSS) == quiet
        assert after.phase is contact.phase or after.phase in FOLLOWS[contact.phase]
        entered = after.phase is LOSS and contact.phase is not LOSS
        assert after.losses == contact.losses + entered
        assert after.time >= contact.time
        assert after.since == (contact.since if after.phase is contact.phase else after.time)
        assert after.closed == (after.phase in (PRESS, REGAIN))
        contact = after
    assert contact.felt_at == max(known, default=-math.inf)


def test_a_contact_says_in_words_where_it_is() -> None:
    contact = lived([0.0] * 5, pressing())[-1]
    words = contact.explain()
    assert words.startswith("LOSS since 0.005 s: nothing felt")
    assert words.endswith("losses so far: 1")
    assert "losses" not in pressing().explain()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"touch_force": 0.0}, "touch_force: .*values > 0"),
        ({"touch_force": math.nan}, "touch_force: .*finite"),
        ({"loss_time": -0.1}, "loss_time: .*values > 0"),
        ({"loss_time": math.inf}, "loss_time: .*finite"),
        ({"regain_time": -1.0}, "regain_time: .*values >= 0"),
    ],
    ids=str,
)
def test_a_life_that_cannot_be_is_refused_in_one_line(wrong, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        ContactLife(**wrong)
    assert "\n" not in str(caught.value)


def test_a_life_starts_at_a_finite_time() -> None:
    with pytest.raises(InputError, match=r"time: .*finite"):
        LIFE.start(math.nan)


SPACE: TaskSpace = SPACES["arm_7"]


def one_tick(contact: ContactPhase, *, time: float = DT) -> tuple[Any, Any]:
    """Return the report and the memory of one tick of a pressing arm."""
    robot = chain(7, seed=7)
    tasks = (
        MotionTask(space=SPACE),
        ForceTask(space=SPACE, K_fi=5.0),
        PostureTask(q_ref=robot.home),
    )
    weighted = tuple(Weighted(task) for task in tasks)
    mode = Mode(name="contact", tasks=weighted, constraints=(board(SPACE),))
    controller = Controller(robot, [mode])
    memory = controller.start("contact", robot.home)
    measured = Measurement(time, robot.home, np.zeros(7), contact)
    references = {
        "motion": MotionReference(X_WD=robot.pose(robot.home, SPACE.frame)),
        "force": ForceReference(F_ref=np.ones(6), F_meas=np.zeros(6)),
    }
    _, report, after = controller.step("contact", measured, references, memory)
    return report, after


@pytest.mark.parametrize("phase", list(ContactPhase))
def test_a_tick_carries_the_phase_to_report_and_memory(phase: ContactPhase) -> None:
    report, memory = one_tick(phase)
    assert report.contact is phase
    assert memory.contact is phase
    assert not report.saturated
    assert memory.freeze == (phase not in (PRESS, REGAIN))
    assert ("contact lost" in report.explain()) == (phase is LOSS)
    assert ("contact regained" in report.explain()) == (phase is REGAIN)


def test_a_fallback_tick_says_that_the_contact_is_lost() -> None:
    report, memory = one_tick(LOSS, time=math.nan)
    assert memory.contact is LOSS
    assert report.explain().startswith("fallback torque")
    assert "contact lost: nothing felt where the contact was" in report.explain()
