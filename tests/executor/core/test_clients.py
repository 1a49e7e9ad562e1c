"""Clients: who is accepted, what they are sent, and results until they are acknowledged."""

import logging

import pytest

from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ExecutorTick, Health
from hyperbit.controller.executor.core.reports import SNAPSHOT_EVERY
from hyperbit.controller.host.process import Notify, Quit
from hyperbit.controller.messages.state import LoopTimes
from hyperbit.controller.program import (
    MOST_BYTES,
    TICK,
    VERSION,
    Acknowledge,
    Alive,
    Answer,
    BoardErrors,
    Counted,
    Counts,
    Declined,
    Diagnostics,
    Ended,
    Fault,
    Goodbye,
    Hello,
    PlayableFaults,
    ReadErrors,
    Reset,
    Snapshot,
    Stop,
    Welcome,
    encode,
)
from hyperbit.drivers.canopen.faults import ArmFault, board_error, left_operational, remedy
from hyperbit.drivers.canopen.sdo.errors import Errors
from tests.executor.fake_master import FakeMaster
from tests.executor.rig import OPERATOR, OTHER, PLANNER, SIZE, A, B, Rig, small_arm


def test_a_planner_is_greeted_and_others_hear_why_not(rig: Rig) -> None:
    assert rig.last(Welcome) == Welcome("small", "d" * 64, 7, (0,) * SIZE, 0)
    assert rig.core.clients.planner == PLANNER
    rig.connect(OTHER)
    assert rig.last(Goodbye, OTHER).reason == "a planner is connected already, process 4001; only one may drive the arm"
    for first in (Hello(VERSION + 1, "planner", "small"), Hello(VERSION, "planner", "other"), Alive(), Stop(1)):
        rig.heard.clear()
        rig.send(first, OTHER)
        assert rig.last(Goodbye, OTHER).reason
        assert rig.mode == "ready"
    rig.gone()
    rig.connect(OTHER)
    assert rig.of(Welcome, OTHER)


def test_an_operator_may_halt_and_nothing_else_and_its_end_begins_no_epoch(rig: Rig) -> None:
    before = rig.epoch
    rig.connect(OPERATOR, "operator")
    rig.gone(OPERATOR)
    assert rig.epoch == before
    rig.run(A, B)
    rig.connect(OPERATOR, "operator")
    rig.send(Stop(5), OPERATOR)
    assert rig.last(Answer, OPERATOR) == Answer(5, "stopped; the arm holds until reset")
    assert (rig.mode, rig.results) == ("stopped", [(1, "aborted")])
    rig.send(Reset(6, rig.epoch), OPERATOR)
    assert rig.last(Goodbye, OPERATOR).reason == "an operator may only stop the arm and read errors"
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


@pytest.mark.parametrize("dies", [False, True])
def test_what_a_planner_sent_before_it_was_lost_moves_nothing(rig: Rig, dies: bool) -> None:
    """Also where nothing runs: it was planned before, and still lies in the socket."""
    before = rig.snapshot.epoch
    if dies:
        rig.gone()
        rig.connect()
    else:
        rig.alive = False
        rig.go(1.5)
    rig.run(A, epoch=before)
    rig.follow(2, A, epoch=before)
    assert rig.last(Declined).refused.reason.value == "overtaken"
    rig.go()
    assert (rig.switched, rig.mode, rig.snapshot.epoch) == ([], "ready", before + 1)
    rig.run(A)
    rig.go(0.2)
    assert rig.results == [(2, "done")], "it may speak again"


def test_counts_are_sent_before_each_result_and_at_the_end_and_the_greater_ones_hold(rig: Rig) -> None:
    rig.run(A)
    rig.go(0.3)
    heard = [message for _, _, message in rig.heard]
    assert heard[heard.index(rig.last(Ended)) - 1] == Counted((1, 1, 1, 0, 0, 0))
    rig.send(Counts((5, 0, 0, 0, 0, 7)))
    rig.send(Counts((1,)))
    rig.follow(9, 0)
    rig.go(0.1)
    rig.do(Quit())
    rig.heard.clear()
    rig.do(Quit())
    assert rig.of(Counted) == [Counted((6, 2, 2, 0, 0, 7))]


def test_snapshots_come_20_times_a_second_and_on_change_and_diagnostics_every_second(rig: Rig) -> None:
    rig.heard.clear()
    for k in range(1_000):  # ticks are late, as real ones are
        rig.agenda.run(TICK + (0.0003 if k % 2 else -0.0003))
        rig.send(Alive())
        rig.do(ExecutorTick())
    assert 198 <= len(rig.of(Snapshot)) <= 202
    assert len(rig.of(Diagnostics)) == 10
    rig.heard.clear()
    rig.send(Stop(1))
    assert [type(message) for _, _, message in rig.heard] == [Answer, Snapshot]


def test_no_snapshot_is_sent_between_the_rpdos_of_a_commit_and_its_sync(rig: Rig) -> None:
    rig.master.slow_rpdos = True
    shown = len(rig.of(Snapshot))
    rig.run(A)
    assert len(rig.of(Snapshot)) == shown
    rig.master.slow_rpdos = False
    rig.go(SNAPSHOT_EVERY + TICK)
    assert len(rig.of(Snapshot)) > shown


def test_a_journal_that_cannot_be_written_is_a_warning_until_it_can(rig: Rig) -> None:
    rig.do(Health(LoopTimes(), 0, "the disk is full"))
    assert rig.snapshot.faults == (Fault("journal", "executor", "the disk is full"),)
    rig.do(Health(LoopTimes(), 0, None))
    assert rig.snapshot.faults == ()


def test_a_snapshot_fits_a_message_whatever_is_wrong(rig: Rig) -> None:
    for k in range(1000):
        rig.master.fail(ArmFault("emergency", f"can0/{k}", "é" * 2000))
    rig.go()
    assert len(rig.snapshot.faults) == 50
    assert len(encode(rig.snapshot)) < MOST_BYTES
    assert rig.mode == "fault"


@pytest.mark.parametrize("board", ["can0/5", f"{'b' * 64}/126"])
def test_the_longest_sentences_on_boards_keep_their_beginning_and_their_remedy(rig: Rig, board: str) -> None:
    errors = Errors(0xFF, (0x8130,) * 254, complete=False)
    stopped = left_operational(board, "without a command and is pre-operational")
    rig.master.fail(board_error(board, errors.words(0x2340)))
    rig.master.fail(ArmFault("board-stopped", board, stopped))
    rig.go()
    assert len(rig.snapshot.faults) == 2
    for fault in rig.snapshot.faults:
        assert len(fault.message) <= 300
        assert fault.message.startswith(f"board {board} ")
        assert fault.message.endswith(remedy(board))


def test_systemd_gets_the_state_and_only_good_ticks_feed_the_watchdog(rig: Rig) -> None:
    assert rig.notified[:2] == ["READY=1", "STATUS=starting: the boards are being booted"]
    assert {"STATUS=ready: holding what the boards measured", "WATCHDOG=1"} <= set(rig.notified)
    rig.notified.clear()
    rig.go(1)
    assert 9 <= rig.notified.count("WATCHDOG=1") <= 12
    rig.master.broken = {"tick"}
    rig.notified.clear()
    rig.go(1)
    assert "WATCHDOG=1" not in rig.notified
    simulation = PlayableFaults((), (), (), ())
    core = Executor(small_arm(), SwitchJournal(SIZE), instance=7, simulation=simulation, build_master=FakeMaster)
    notified = [action.text for action in core.step(ExecutorTick(), 0.0) if isinstance(action, Notify)]
    assert "STATUS=starting (simulated): the boards are being booted" in notified


def test_an_operator_reads_the_errors_of_a_board(rig: Rig) -> None:
    rig.connect(OPERATOR, "operator")
    rig.send(ReadErrors(3, "can0/99"), OPERATOR)
    assert "is no board of this arm" in rig.last(BoardErrors, OPERATOR).why
    rig.send(ReadErrors(4, "can0/1"), OPERATOR)
    rig.send(ReadErrors(5, "can0/1"))
    rig.go()
    assert rig.master.errors.asked == [0, 0]
    rig.master.errors.told = [(0, Errors(0x01, (0x5000,)))]
    rig.go()
    assert rig.last(BoardErrors, OPERATOR) == BoardErrors(4, "", 0x01, (0x5000,))
    assert rig.last(BoardErrors).request == 5
    rig.send(ReadErrors(6, "can0/1"), OPERATOR)
    rig.gone(OPERATOR)
    rig.master.errors.told = [(0, ArmFault("board-missing", "can0/1", "it does not answer"))]
    rig.go()
    assert len(rig.of(BoardErrors, OPERATOR)) == 2


def test_lines_on_modes_and_faults_have_fields_for_the_journal_and_limits_of_boards_are_told(rig: Rig) -> None:
    rig.master.fail(ArmFault("emergency", "can0/3", "short circuit"))
    rig.go()
    fields = {text: it for (_, text), it in zip(rig.logged, rig.fields, strict=True)}
    fault, mode = fields["emergency: short circuit"], fields["fault: short circuit"]
    assert (fault["HYPERBIT_FAULT"], fault["HYPERBIT_BUS"], fault["HYPERBIT_BOARD"]) == ("emergency", "can0", "3")
    assert mode["HYPERBIT_MODE"] == "fault"
    assert fault["MESSAGE_ID"] != mode["MESSAGE_ID"]
    rig.master.limits = (ArmFault("board-limits", "can0/5", "board can0/5: RPDO1 refuses to wait for SYNC"),)
    rig.send(Reset(2, rig.epoch))
    rig.go(3 * TICK)
    assert rig.mode == "ready"
    assert (logging.WARNING, "board-limits: board can0/5: RPDO1 refuses to wait for SYNC") in rig.logged


def test_a_warning_at_start_and_end_says_that_the_boards_will_contract() -> None:
    told = "when the executor has ended, the boards contract all 6 actuators (on_loss: contract)"
    for fields in ({}, {"channel": {"output_off": True}, "sensed": 0}):
        rig = Rig(on_loss="contract", **fields)
        rig.go()
        rig.do(Quit())
        assert [text for level, text in rig.logged if level == logging.WARNING] == [told, told]
    rig = Rig()
    rig.go()
    rig.do(Quit())
    assert logging.WARNING not in [level for level, _ in rig.logged]
