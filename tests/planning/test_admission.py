"""Admission: which requests may begin, by arrival and by epoch."""

from collections.abc import Callable

import pytest

from controller.motion.codes import Refusal
from controller.planning.admission import Admission


@pytest.fixture
def admission() -> Admission:
    admission = Admission()
    admission.snapshot(5)
    return admission


def mailbox(*payloads: bytes) -> Callable[[], bytes | None]:
    waiting = list(payloads)
    return lambda: waiting.pop(0) if waiting else None


def test_a_request_belongs_to_the_epoch_in_which_it_came(admission: Admission) -> None:
    ticket = admission.arrive()
    assert admission.epoch(ticket, 0) == 5
    assert not admission.barred(ticket)


def test_a_fault_bars_what_came_before(admission: Admission) -> None:
    ticket = admission.arrive()
    admission.snapshot(6)
    assert admission.barred(ticket)
    with pytest.raises(Refusal):
        admission.epoch(ticket, 0)
    assert admission.epoch(admission.arrive(), 0) == 6


def test_what_comes_after_a_cancel_belongs_to_the_epoch_that_the_cancel_begins(admission: Admission) -> None:
    before = admission.arrive()
    admission.bar()
    after = admission.arrive()
    assert admission.barred(before)
    assert admission.epoch(after, 0) is None, "the executor may not have heard of the cancel yet"
    admission.snapshot(5)
    assert admission.epoch(after, 0) is None
    admission.answered()
    assert admission.epoch(after, 0) is None
    admission.snapshot(6)
    assert admission.epoch(after, 0) == 6
    admission.snapshot(7)
    assert admission.barred(after), "a fault came later"


def test_of_two_cancels_the_last_counts(admission: Admission) -> None:
    admission.bar()
    between = admission.arrive()
    admission.bar()
    after = admission.arrive()
    admission.answered()
    admission.snapshot(6)
    assert admission.barred(between)
    assert admission.epoch(after, 0) is None
    admission.answered()
    admission.snapshot(7)
    assert admission.epoch(after, 0) == 7


def test_a_cancel_that_could_not_be_sent_holds_nothing_up(admission: Admission) -> None:
    admission.bar()
    admission.unsent()
    assert admission.epoch(admission.arrive(), 0) == 5


def test_a_lost_executor_bars_all(admission: Admission) -> None:
    ticket = admission.arrive()
    admission.bar()
    admission.lost()
    assert admission.barred(ticket)
    assert admission.epoch(admission.arrive(), 0) is None
    admission.snapshot(1)
    assert admission.epoch(admission.arrive(), 0) == 1


def test_the_latest_setpoint_wins_and_the_first_began_the_stream(admission: Admission) -> None:
    admission.read_setpoints(mailbox(b"a", b"b"))
    request = admission.arrive()
    payload, ticket = admission.setpoint() or (b"", request)
    assert (payload, ticket.number < request.number) == (b"b", True)
    assert admission.setpoint() is None


def test_a_goal_ends_the_streams_before_it(admission: Admission) -> None:
    admission.read_setpoints(mailbox(b"a"))
    _, before = admission.setpoint() or (b"", admission.arrive())
    goal, after = admission.arrive(), admission.arrive()
    admission.end_streams(goal)
    assert admission.stream_ended(before)
    assert not admission.stream_ended(after)
    assert not admission.barred(before)


def test_a_setpoint_that_waits_came_before_the_cancel(admission: Admission) -> None:
    admission.read_setpoints(mailbox(b"a"))
    admission.bar()
    assert admission.stream_ended((admission.setpoint() or (b"", admission.arrive()))[1])
