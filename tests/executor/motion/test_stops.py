"""Stop and cancel while a commit runs: what is given up, when the request is answered, and what the answer tells."""

from __future__ import annotations

import pytest

from hyperbit.controller.executor.motion.actuation import BUSY_FOR
from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import TICK, Answer, Cancel, Ended, Reset, Stop
from hyperbit.drivers.canopen.faults import ArmFault
from tests.executor.rig import CAN, OPERATOR, TRAVEL, Rig, ready

A, B = 0b000111, 0b011100
STOPPED, CANCELED = "stopped; the arm holds until reset", "canceled"


def answers(rig: Rig) -> list[str]:
    return [answer.message for answer in rig.of(Answer)]


@pytest.mark.parametrize(("request_", "answer"), [(Stop(1), STOPPED), (Cancel(1, None, ""), CANCELED)])
def test_a_commit_whose_rpdos_wait_is_given_up_at_once(rig: Rig, request_: Stop | Cancel, answer: str) -> None:
    rig.master.slow_rpdos = True
    rig.run(A)
    rig.send(request_)
    assert (answers(rig), rig.results, rig.last(Ended).switches) == (
        [answer],
        [(1, "aborted" if isinstance(request_, Stop) else "canceled")],
        0,
    )
    rig.master.slow_rpdos = False
    rig.go(0.5)
    assert (rig.master.left, sum(rig.journal.counts)) == ([], 0)


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        (Stop(1), "stopped; 3 switches were under way; the arm holds until reset"),
        (Cancel(1, None, ""), "canceled; 3 switches were under way"),
    ],
)
def test_the_answer_waits_for_a_sync_that_was_handed_out(rig: Rig, request_: Stop | Cancel, answer: str) -> None:
    rig.master.slow_sync = True
    rig.run(A)
    rig.send(request_)
    assert (answers(rig), rig.mode) == ([], "stopped" if isinstance(request_, Stop) else "ready")
    rig.go(3 * TICK)
    assert (answers(rig), rig.results) == ([], [])
    rig.master.leave(rig.now)
    rig.do(CAN)
    assert (answers(rig), rig.last(Ended).switches, sum(rig.journal.counts)) == ([answer], 3, 3)


def test_pulses_that_home_count_as_switches_under_way() -> None:
    rig = ready(channel={"output_off": True, "pulse": 0.05}, sensed=0)
    rig.master.slow_sync = True
    rig.run(0b000001)
    rig.send(Stop(1))
    assert answers(rig) == []
    rig.master.leave(rig.now)
    rig.do(CAN)
    assert answers(rig) == ["stopped; 6 switches were under way; the arm holds until reset"]


def test_a_bus_that_stands_still_does_not_delay_the_answer_for_ever(rig: Rig) -> None:
    rig.master.slow_sync = True
    rig.run(A)
    rig.send(Stop(1))
    asked = rig.now
    while not answers(rig):
        rig.go()
    assert rig.now - asked <= rig.arm.timing.heartbeat_timeout / 2
    text = "3 switches were under way, and the bus has not sent 3 of them yet"
    assert answers(rig) == [f"stopped; {text}; the arm holds until reset"]


def test_each_stop_is_answered_once(rig: Rig) -> None:
    rig.master.slow_sync = True
    rig.run(A)
    rig.send(Stop(1))
    rig.send(Stop(2))
    rig.master.slow_sync = False
    rig.go(0.5)
    assert [answer.request for answer in rig.of(Answer)] == [1, 2]


def test_a_stop_is_answered_before_the_executor_ends(rig: Rig) -> None:
    rig.master.slow_sync = True
    rig.run(A)
    rig.send(Stop(1))
    rig.do(Quit())
    rig.do(Quit())
    assert len(answers(rig)) == 1


def test_a_reset_boots_when_nothing_is_under_way_any_more() -> None:
    rig = ready(sensed=0)
    rig.master.slow_sync = True
    rig.run(A)
    rig.send(Stop(1))
    booted = rig.master.booted
    rig.send(Reset(2, rig.epoch))
    rig.go(2 * TICK)
    assert (rig.master.booted, rig.mode) == (booted, "starting")
    rig.master.slow_sync = False
    rig.go(4 * TICK)
    assert (rig.master.booted, rig.mode) == (booted + 1, "ready")
    rig.go(TRAVEL)
    rig.run(B)
    rig.go(0.3)
    assert rig.results[-1] == (2, "done")


def test_a_commit_given_up_is_no_sign_of_a_busy_bus(rig: Rig) -> None:
    rig.master.slow_rpdos = True
    rig.run(A)
    rig.send(Cancel(1, None, ""))
    rig.master.slow_rpdos = False
    rig.go(2 * BUSY_FOR)
    rig.master.busy = True
    rig.run(B)
    rig.go(2 * TICK)
    assert rig.mode == "executing"
    rig.master.busy = False
    rig.go(0.3)
    assert rig.results[-1] == (2, "done")


def test_a_client_that_is_gone_gets_no_answer(rig: Rig) -> None:
    rig.connect(OPERATOR, "operator")
    rig.master.slow_sync = True
    rig.run(A)
    rig.send(Stop(1), OPERATOR)
    rig.gone(OPERATOR)
    rig.master.leave(rig.now)
    rig.do(CAN)
    assert rig.of(Answer, OPERATOR) == []


def test_the_time_of_a_busy_bus_begins_anew_with_the_next_motion(rig: Rig) -> None:
    rig.master.busy = True
    rig.run(A)
    rig.send(Cancel(1, None, ""))
    rig.go(2 * BUSY_FOR)
    rig.run(B)
    rig.go(2 * TICK)
    assert rig.mode == "executing"
    rig.send(Cancel(2, None, ""))
    rig.follow(3, A)
    rig.follow(3)
    for _ in range(4):
        rig.go(BUSY_FOR / 2)
        rig.follow(3)
    rig.follow(3, A)
    rig.go(2 * TICK)
    assert (rig.mode, rig.switched) == ("executing", [])


def test_a_bus_is_busy_for_a_quarter_of_a_second_before_this_is_a_fault(rig: Rig) -> None:
    rig.master.busy = True
    actuation = rig.core.motion.actuation
    for now in (0.0, 0.125, BUSY_FOR):
        assert not actuation.switch(A, now)
        assert actuation.fault is None
    assert not actuation.switch(A, 0.375)
    assert actuation.fault == ArmFault("bus-busy", "bus", "no command could be sent for 0.25 s: the queue is full")


def test_no_sentence_promises_the_safety_of_an_emergency_stop(rig: Rig) -> None:
    rig.run(A, B)
    rig.send(Stop(1))
    assert (rig.last(Ended).message, rig.reason) == (
        "stopped; the arm holds",
        "a stop was requested; the arm holds until reset",
    )


def test_cancels_of_one_program_may_share_a_number_and_bar_nothing_else(rig: Rig) -> None:
    rig.master.slow_sync = True
    rig.run(A)
    epoch = rig.snapshot.epoch
    for program in (2, 1, 1):
        rig.send(Cancel(0, program, "off its path"))
    rig.master.slow_sync = False
    rig.go(2 * TICK)
    assert {answer.request for answer in rig.of(Answer)} == {0}
    assert answers(rig) == [
        "program 2 is not running",
        "program 1 is not running",
        "canceled; 3 switches were under way",
    ]
    assert (rig.results, rig.last(Ended).message, rig.snapshot.epoch) == ([(1, "canceled")], "off its path", epoch)


def test_requests_of_number_zero_that_wait_are_all_answered(rig: Rig) -> None:
    rig.master.slow_sync = True
    rig.run(A)
    for request in (Cancel(0, 1, ""), Cancel(0, None, ""), Stop(0)):
        rig.send(request)
    assert answers(rig) == []
    rig.master.slow_sync = False
    rig.go(2 * TICK)
    assert [answer.request for answer in rig.of(Answer)] == [0, 0, 0]
    rig.send(Reset(0, rig.epoch))
    assert rig.last(Answer).message == "resetting; the mode will be ready, or fault with the reason"
