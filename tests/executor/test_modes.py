"""Modes, faults, recovery, requests of clients, and the end."""

import pytest

from controller.executor.active_faults import PASSING
from controller.executor.actuation import BUSY_FOR
from controller.executor.core import PERIOD
from controller.executor.events import Quit
from controller.executor.modes import RETRY
from controller.program import (
    MOST_BYTES,
    Acknowledge,
    Alive,
    Answer,
    Cancel,
    Counts,
    Declined,
    Ended,
    Goodbye,
    Halt,
    Hello,
    Lock,
    Reset,
    Snapshot,
    Welcome,
    encode,
    unpack,
)
from drivers.canopen.faults import Fault
from tests.executor.rig import CAN, LOST, OPERATOR, OTHER, PLANNER, SIZE, TRAVEL, Rig, ready

A, B = 0b000111, 0b011100


@pytest.fixture
def rig() -> Rig:
    return ready()


def answer(rig: Rig) -> tuple[bool, str]:
    last = rig.last(Answer)
    return last.accepted, last.message


# --- clients


def test_a_planner_is_greeted_and_a_second_hears_who_is_there(rig: Rig) -> None:
    assert rig.last(Welcome) == Welcome(1, "small", "d" * 64, 7, (0,) * SIZE, 0)
    rig.connect(OTHER)
    assert rig.last(Goodbye, OTHER).reason == "a planner is connected already, process 4001; only one may drive the arm"
    rig.gone()
    rig.connect(OTHER)
    assert rig.of(Welcome, OTHER)


@pytest.mark.parametrize("hello", [Hello(2, "planner", "small"), Hello(1, "planner", "other"), Alive(), Halt(1)])
def test_who_does_not_belong_here_hears_why(rig: Rig, hello: object) -> None:
    rig.send(hello, OTHER)
    assert rig.last(Goodbye, OTHER).reason
    assert rig.mode == "ready"


def test_an_operator_may_halt_and_nothing_else(rig: Rig) -> None:
    rig.run(A, B)
    rig.connect(OPERATOR, "operator")
    rig.send(Halt(5), OPERATOR)
    assert rig.last(Answer, OPERATOR) == Answer(5, True, "stopped; the arm holds until reset")
    assert (rig.mode, rig.results) == ("stopped", [(1, "aborted")])
    rig.send(Reset(6), OPERATOR)
    assert rig.last(Goodbye, OPERATOR).reason == "an operator may only halt"
    assert rig.mode == "stopped"


def test_results_are_sent_again_until_they_are_acknowledged(rig: Rig) -> None:
    rig.run(A, B, context=b"context")
    rig.gone()
    rig.go(1)
    assert (rig.mode, rig.reason, rig.switched) == ("ready", "holding; the planner is gone", [A])
    for _ in range(2):
        rig.heard.clear()
        rig.connect()
        (ended,) = rig.of(Ended)
        assert (ended.status, ended.context) == ("aborted", b"context")
        rig.gone()
    rig.connect()
    rig.send(Acknowledge(ended.result))
    rig.gone()
    rig.heard.clear()
    rig.connect()
    assert rig.of(Ended) == []


def test_a_silent_planner_ends_its_program_once_and_may_speak_again(rig: Rig) -> None:
    rig.run(0, A, step=10.0)
    rig.alive = False
    rig.go(1.5)
    assert (rig.mode, rig.results) == ("ready", [(1, "aborted")])
    rig.run(A)
    rig.go(0.2)
    assert rig.results[-1] == (2, "done")


def test_the_greater_counts_hold(rig: Rig) -> None:
    rig.send(Counts((5, 0, 0, 0, 0, 7)))
    rig.send(Counts((1,)))
    rig.run(A)
    rig.go(0.3)
    assert rig.journal.counts == [6, 1, 1, 0, 0, 7]


# --- reports


def test_snapshots_come_20_times_a_second_and_on_change_and_diagnostics_every_second(rig: Rig) -> None:
    rig.heard.clear()
    rig.go(1)
    assert 19 <= len(rig.of(Snapshot)) <= 21
    assert len(rig.diagnostics) == 1
    rig.heard.clear()
    rig.send(Halt(1))
    assert [type(message) for _, message in rig.heard] == [Answer, Snapshot]


def test_a_snapshot_fits_a_message_whatever_is_wrong(rig: Rig) -> None:
    for k in range(1000):
        rig.master.fail(Fault("emergency", f"can0/{k}", "é" * 2000))
    rig.go()
    assert len(rig.snapshot.faults) == 50
    assert len(encode(rig.snapshot)) < MOST_BYTES
    assert rig.mode == "fault"


def test_systemd_is_told_and_the_watchdog_is_fed_by_good_ticks_only(rig: Rig) -> None:
    assert rig.notified[:2] == ["READY=1", "STATUS=starting: the boards are being booted"]
    assert {"STATUS=ready: holding what the boards measured", "WATCHDOG=1"} <= set(rig.notified)
    rig.notified.clear()
    rig.go(1)
    assert 9 <= rig.notified.count("WATCHDOG=1") <= 12
    rig.master.broken = {"tick"}
    rig.notified.clear()
    rig.go(1)
    assert "WATCHDOG=1" not in rig.notified


# --- cancel, halt, reset


def test_cancel_holds_and_begins_a_new_epoch(rig: Rig) -> None:
    old = rig.program(A)
    rig.run(A, B, number=2)
    rig.go(0.05)
    rig.send(Cancel(1, None, "canceled; the arm holds"))
    assert answer(rig) == (True, "canceled")
    assert rig.last(Ended).message == "canceled; the arm holds"
    assert (rig.mode, rig.reason) == ("ready", "holding; goal 2 was canceled")
    rig.send(old)
    assert rig.last(Declined).cause == "epoch"
    rig.send(Cancel(2, None, ""))
    assert answer(rig) == (True, "there was no goal to cancel; the arm holds")
    rig.go(0.5)
    assert rig.switched == [A]


def test_one_program_alone_is_canceled(rig: Rig) -> None:
    rig.run(A, B)
    epoch = rig.snapshot.epoch
    rig.send(Cancel(1, 7, "its path was left"))
    assert (answer(rig)[1], rig.results) == ("program 7 is not running", [])
    rig.send(Cancel(2, 1, "its path was left"))
    assert (rig.last(Ended).message, rig.snapshot.epoch) == ("its path was left", epoch)


def test_a_halt_stays_until_reset(rig: Rig) -> None:
    rig.send(Halt(1))
    rig.run(A)
    assert (rig.last(Declined).cause, rig.mode) == ("mode", "stopped")
    rig.go(3 * RETRY)
    rig.send(Reset(2))
    assert rig.mode == "starting"
    rig.go(2 * PERIOD)
    assert rig.mode == "ready"
    rig.send(Reset(3))
    assert answer(rig) == (True, "nothing to reset: the arm is ready")
    assert rig.switched == []


def test_a_halt_while_booting_stays(rig: Rig) -> None:
    rig.send(Halt(1))
    rig.send(Reset(2))
    rig.send(Halt(3))
    rig.go(0.1)
    assert rig.mode == "stopped"


# --- faults


def test_a_fault_ends_the_program_and_waits_for_reset(rig: Rig) -> None:
    rig.run(A, B)
    rig.go(0.05)
    rig.master.fail(Fault("emergency", "can0/1", "short circuit"))
    rig.do(CAN)
    assert (rig.mode, rig.reason, rig.results) == ("fault", "short circuit", [(1, "aborted")])
    rig.go(5 * RETRY)
    assert rig.mode == "fault"
    rig.send(Reset(1))
    rig.go(2 * PERIOD)
    assert (rig.mode, rig.snapshot.faults, rig.switched) == ("ready", (), [A])


@pytest.mark.parametrize("code", sorted(PASSING))
def test_what_passes_is_left_by_itself(rig: Rig, code: str) -> None:
    rig.run(A, B)
    rig.go(0.15)
    rig.master.fail(Fault(code, "can0", "gone"))
    rig.go(5 * RETRY)
    assert rig.mode == "fault"
    rig.master.back = True
    rig.go(RETRY + 3 * PERIOD)
    assert (rig.mode, rig.snapshot.faults, rig.switched) == ("ready", (), [A])


def test_one_that_fails_again_is_tried_once_a_second(rig: Rig) -> None:
    boots = rig.master.boots
    rig.master.back, rig.master.boot_faults = True, [LOST]
    rig.master.fail(LOST)
    rig.go(10 * RETRY)
    assert rig.mode == "fault"
    assert 5 <= rig.master.boots - boots <= 10


def test_faults_of_a_boot_are_told_at_its_end(rig: Rig) -> None:
    rig.master.boot_faults = [LOST, Fault("board-missing", "can0/2", "another")]
    rig.send(Halt(1))
    rig.send(Reset(2))
    rig.go(3 * PERIOD)
    assert (rig.mode, rig.reason) == ("fault", f"{LOST.message} (and 1 more)")


def test_a_halted_process_acts_on_nothing_old(rig: Rig) -> None:
    rig.run(A, B)
    rig.go(0.05)
    late = rig.program(B, start=A)
    rig.now += 3
    rig.master.halt = Fault("halted", "executor", "halted for 3 s")
    rig.send(late)
    assert (rig.mode, rig.last(Declined).cause, rig.last(Ended).message) == ("fault", "mode", "halted for 3 s")
    rig.go(0.5)
    assert rig.switched == [A]


def test_a_bus_that_takes_nothing_is_tried_again_and_then_a_fault(rig: Rig) -> None:
    rig.master.busy = True
    rig.run(A)
    rig.go(BUSY_FOR - 2 * PERIOD)
    assert rig.mode == "executing"
    rig.master.busy = False
    rig.go(0.3)
    assert rig.results == [(1, "done")]
    rig.master.busy = True
    rig.run(B)
    rig.go(BUSY_FOR + 3 * PERIOD)
    assert (rig.mode, rig.reason) == ("fault", "no command could be sent for 0.25 s: the queue is full")
    assert sum(rig.journal.counts) == 3


@pytest.mark.parametrize("verb", ["tick", "commit", "measured", "take"])
def test_a_defect_is_a_fault_the_arm_holds_and_the_executor_goes_on(rig: Rig, verb: str) -> None:
    rig.run(A, B)
    rig.go(0.05)
    rig.master.broken = {verb}
    rig.do(CAN)
    rig.go(0.5)
    assert (rig.results, rig.mode) == ([(1, "aborted")], "fault")
    assert "internal error" in rig.reason
    assert sum("Traceback" in text for text in rig.errors()) == 1
    rig.master.broken = set()
    rig.send(Reset(1))
    rig.go(2 * PERIOD)
    assert rig.mode == "ready"


# --- locks


def test_a_locked_actuator_is_switched_by_no_program(rig: Rig) -> None:
    rig.send(Lock(1, 0, 0))
    assert answer(rig) == (True, "locked: 1.left (contracted)")
    assert (unpack(rig.snapshot.locked), rig.snapshot.locks) == (1, 1)
    assert [fault.code for fault in rig.snapshot.faults] == ["degraded"]
    rig.run(A)
    assert rig.last(Declined).cause == "locked"
    rig.follow(9, A)
    rig.run(A & ~1)
    rig.go(0.3)
    assert (rig.switched, rig.results) == ([A & ~1], [(2, "done")])
    rig.send(Lock(2, 0, -1))
    assert answer(rig) == (True, "no actuator is locked")
    rig.run(A)
    rig.go(0.3)
    assert rig.switched[-1] == A


def test_a_lock_is_refused_while_the_arm_moves_and_against_an_end_stop(rig: Rig) -> None:
    rig.send(Lock(1, 0, 1))
    assert answer(rig) == (False, "state: the end-stop of 1.left reads contracted")
    rig.send(Lock(1, SIZE, 1))
    assert not answer(rig)[0]
    rig.run(A)
    rig.send(Lock(2, 0, 0))
    assert "the arm is executing" in answer(rig)[1]


def test_a_stuck_actuator_is_locked_and_the_arm_goes_on_if_its_file_says_so() -> None:
    rig = ready(continue_on_stuck=True)
    rig.master.stuck, rig.master.back = 1, True
    rig.run(A)
    rig.go(RETRY + 0.3)
    assert (rig.mode, rig.reason) == ("ready", "holding what the boards measured, locked: 1.left (contracted)")
    rig.run(A ^ 0b110)
    rig.go(0.3)
    assert rig.results == [(1, "aborted"), (2, "done")]


def test_a_locked_actuator_without_end_stop_is_measured_as_locked() -> None:
    rig = ready(sensed=0b111110, locked=1, locked_states=1)
    assert (unpack(rig.snapshot.measured), unpack(rig.snapshot.outputs)) == (1, 0)


# --- the end


def test_at_the_end_the_program_has_its_result_and_nothing_more_is_taken(rig: Rig) -> None:
    rig.run(A, B)
    rig.go(TRAVEL)
    rig.do(Quit())
    assert rig.core.ended
    assert rig.last(Ended).message == "the executor is shutting down; the arm holds"
    assert "STOPPING=1" in rig.notified
    rig.run(B)
    assert rig.last(Declined).reason == "the executor is shutting down"
    rig.go(0.5)
    assert rig.switched == [A]


def test_at_the_end_the_stage_under_way_is_waited_for_but_not_for_ever(rig: Rig) -> None:
    rig.master.slow_sync = True
    rig.run(A, B)
    rig.do(Quit())
    assert (rig.core.ended, rig.results) == (False, [])
    rig.do(Quit())
    assert rig.results == [(1, "aborted")]
    rig.master.slow_sync = False
    rig.go()
    assert rig.core.ended


def test_the_planner_is_named_by_its_process(rig: Rig) -> None:
    assert rig.core._clients.planner == PLANNER
