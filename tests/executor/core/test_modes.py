"""Modes: cancel, halt, reset, faults, recovery, locks and the end."""

import logging

import msgspec
import pytest

from hyperbit.controller.executor.core.modes import CLEARING, RETRY
from hyperbit.controller.executor.motion.actuation import BUSY_FOR
from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import TICK, Cancel, Declined, Ended, Reset, Stop
from hyperbit.drivers.canopen.faults import ArmFault
from tests.executor.rig import CAN, LOST, PLANNER, TRAVEL, Rig, ready

A, B = 0b000111, 0b011100


def test_cancel_holds_and_begins_a_new_epoch(rig: Rig) -> None:
    old = rig.program(A)
    rig.run(A, B, number=2)
    rig.go(0.05)
    rig.send(Cancel(1, None, "canceled; the arm holds"))
    assert rig.answer == (True, "canceled")
    assert rig.last(Ended).message == "canceled; the arm holds"
    assert (rig.mode, rig.reason) == ("ready", "holding; goal 2 was canceled")
    rig.send(old)
    assert rig.last(Declined).refused.reason.value == "overtaken"
    rig.send(Cancel(2, None, ""))
    assert rig.answer == (True, "there was no goal to cancel; the arm holds")
    rig.go(0.5)
    assert rig.switched == [A]


def test_one_program_alone_is_canceled(rig: Rig) -> None:
    rig.run(A, B)
    epoch = rig.snapshot.epoch
    rig.send(Cancel(1, 7, "its path was left"))
    assert (rig.answer[1], rig.results) == ("program 7 is not running", [])
    rig.send(Cancel(2, 1, "its path was left"))
    assert (rig.last(Ended).message, rig.snapshot.epoch) == ("its path was left", epoch)


def test_a_halt_stays_until_reset(rig: Rig) -> None:
    rig.send(Stop(1))
    rig.run(A)
    assert (rig.last(Declined).refused.reason.value, rig.mode) == ("arm-stopped", "stopped")
    rig.go(3 * RETRY)
    rig.send(Reset(2, rig.epoch))
    assert rig.mode == "starting"
    rig.go(2 * TICK)
    assert rig.mode == "ready"
    rig.send(Reset(3, rig.epoch))
    assert rig.answer == (True, "nothing to reset: the arm is ready")
    assert rig.switched == []


def test_a_halt_while_booting_stays(rig: Rig) -> None:
    rig.send(Stop(1))
    rig.send(Reset(2, rig.epoch))
    rig.send(Stop(3))
    rig.go(0.1)
    assert rig.mode == "stopped"


@pytest.mark.parametrize("bar", [Stop(3), Cancel(3, None, "canceled")])
def test_a_reset_that_arrived_before_a_stop_is_refused_after_it(rig: Rig, bar: Stop | Cancel) -> None:
    rig.send(Stop(1))
    earlier = rig.epoch
    rig.send(bar)
    rig.send(Reset(2, earlier))
    assert (rig.answer[0], rig.mode) == (False, "stopped")
    rig.send(Reset(4, rig.epoch))
    assert rig.mode == "starting"


def test_a_program_that_comes_too_late_is_declined(rig: Rig) -> None:
    rig.send(msgspec.structs.replace(rig.program(A), until=rig.now - TICK))
    assert (rig.last(Declined).refused.reason.value, rig.mode) == ("too-late-to-begin", "ready")
    rig.go(1.0)
    assert rig.switched == []
    rig.send(msgspec.structs.replace(rig.program(A), until=rig.now))
    assert rig.mode == "executing"


def test_a_fault_ends_the_program_and_waits_for_reset(rig: Rig) -> None:
    rig.run(A, B)
    rig.go(0.05)
    rig.master.fail(ArmFault("emergency", "can0/1", "short circuit"))
    rig.do(CAN)
    assert (rig.mode, rig.reason, rig.results) == ("fault", "short circuit", [(1, "aborted")])
    rig.go(5 * RETRY)
    assert rig.mode == "fault"
    rig.send(Reset(1, rig.epoch))
    rig.go(2 * TICK)
    assert (rig.mode, rig.snapshot.faults, rig.switched) == ("ready", (), [A])


def test_lines_on_modes_and_faults_have_fields_for_the_journal(rig: Rig) -> None:
    rig.master.fail(ArmFault("emergency", "can0/3", "short circuit"))
    rig.do(CAN)
    fields = {text: it for (_, text), it in zip(rig.logged, rig.fields, strict=True)}
    fault, mode = fields["emergency: short circuit"], fields["fault: short circuit"]
    assert (fault["HYPERBIT_FAULT"], fault["HYPERBIT_BUS"], fault["HYPERBIT_BOARD"]) == ("emergency", "can0", "3")
    assert mode["HYPERBIT_MODE"] == "fault"
    assert len({fault["MESSAGE_ID"], mode["MESSAGE_ID"]}) == 2


@pytest.mark.parametrize("code", sorted(CLEARING))
def test_faults_that_clear_by_themselves_are_left_without_a_reset(rig: Rig, code: str) -> None:
    rig.run(A, B)
    rig.go(0.15)
    rig.master.fail(ArmFault(code, "can0", "gone"))
    rig.go(5 * RETRY)
    assert rig.mode == "fault"
    rig.master.back = True
    rig.go(RETRY + 3 * TICK)
    assert (rig.mode, rig.snapshot.faults, rig.switched) == ("ready", (), [A])


def test_a_moving_arm_is_not_booted_without_a_reset() -> None:
    rig = ready(channel={"travel": (3 * RETRY, 3 * RETRY)}, sensed=0)
    rig.go(3 * RETRY)
    rig.run(A)
    rig.go()
    boots, rig.master.back = rig.master.booted, True
    rig.master.fail(LOST)
    rig.go(2 * RETRY)
    assert (rig.mode, rig.master.booted) == ("fault", boots)
    rig.go(3 * RETRY)
    assert rig.mode == "ready"


def test_one_that_fails_again_is_tried_once_a_second(rig: Rig) -> None:
    boots = rig.master.booted
    rig.master.back, rig.master.boot_faults = True, [LOST]
    rig.master.fail(LOST)
    rig.go(10 * RETRY)
    assert rig.mode == "fault"
    assert 5 <= rig.master.booted - boots <= 10


def test_limits_of_boards_are_in_the_journal_after_each_boot(rig: Rig) -> None:
    limit = ArmFault("board-limits", "can0/5", "board can0/5: RPDO1 refuses to wait for SYNC")
    rig.master.warnings = lambda: (limit,)
    rig.send(Stop(1))
    rig.send(Reset(2, rig.epoch))
    rig.go(3 * TICK)
    assert (rig.mode, (logging.WARNING, f"board-limits: {limit.message}") in rig.logged) == ("ready", True)


def test_faults_of_a_boot_are_reported_at_its_end(rig: Rig) -> None:
    rig.master.boot_faults = [LOST, ArmFault("board-missing", "can0/2", "another")]
    rig.send(Stop(1))
    rig.send(Reset(2, rig.epoch))
    rig.go(3 * TICK)
    assert (rig.mode, rig.reason) == ("fault", f"{LOST.message} (and 1 more)")


def test_a_halted_process_acts_on_nothing_old(rig: Rig) -> None:
    rig.run(A, B)
    rig.go(0.05)
    late = rig.program(B, start=A)
    rig.agenda.run(3)
    rig.master.pause = ArmFault("halted", "executor", "halted for 3 s")
    rig.send(late)
    assert (rig.mode, rig.last(Declined).refused.reason.value, rig.last(Ended).message) == (
        "fault",
        "arm-in-fault",
        "halted for 3 s",
    )
    rig.go(0.5)
    assert rig.switched == [A]


def test_a_bus_that_takes_nothing_is_tried_again_and_then_a_fault(rig: Rig) -> None:
    rig.master.busy = True
    rig.run(A)
    rig.go(BUSY_FOR - 2 * TICK)
    assert rig.mode == "executing"
    rig.master.busy = False
    rig.go(0.3)
    assert rig.results == [(1, "done")]
    rig.master.busy = True
    rig.run(B)
    rig.go(BUSY_FOR + 3 * TICK)
    assert (rig.mode, rig.reason) == ("fault", "no command could be sent for 0.25 s: the queue is full")
    assert sum(rig.journal.counts) == 3


@pytest.mark.parametrize("verb", ["tick", "commit", "measured", "receive_event"])
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
    rig.send(Reset(1, rig.epoch))
    rig.go(2 * TICK)
    assert rig.mode == "ready"


def test_at_the_end_the_program_has_its_result_and_nothing_more_is_taken(rig: Rig) -> None:
    rig.run(A, B)
    rig.go(TRAVEL)
    rig.do(Quit())
    assert rig.core.ended
    assert rig.last(Ended).message == "the executor is shutting down; the arm holds"
    assert "STOPPING=1" in rig.notified
    rig.run(B)
    assert rig.last(Declined).refused.reason.value == "executor-shutting-down"
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
    assert rig.core.clients.planner == PLANNER
