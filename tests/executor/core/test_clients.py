"""Clients: who is accepted, what they are sent, and results until they are acknowledged."""

import pytest

from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ExecutorTick
from hyperbit.controller.host.process import Notify, Quit
from hyperbit.controller.program import (
    MOST_BYTES,
    VERSION,
    Acknowledge,
    Alive,
    Answer,
    BoardErrors,
    Counted,
    Counts,
    Declined,
    Ended,
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
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.sdo.errors import Errors
from tests.executor.fake_master import FakeMaster
from tests.executor.rig import OPERATOR, OTHER, SIZE, Rig, small_arm

A, B = 0b000111, 0b011100


def test_a_planner_is_greeted_and_a_second_hears_who_is_there(rig: Rig) -> None:
    assert rig.last(Welcome) == Welcome(VERSION, "small", "d" * 64, 7, (0,) * SIZE, 0)
    rig.connect(OTHER)
    assert rig.last(Goodbye, OTHER).reason == "a planner is connected already, process 4001; only one may drive the arm"
    rig.gone()
    rig.connect(OTHER)
    assert rig.of(Welcome, OTHER)


@pytest.mark.parametrize(
    "hello", [Hello(VERSION + 1, "planner", "small"), Hello(VERSION, "planner", "other"), Alive(), Stop(1)]
)
def test_who_does_not_belong_here_hears_why(rig: Rig, hello: object) -> None:
    rig.send(hello, OTHER)
    assert rig.last(Goodbye, OTHER).reason
    assert rig.mode == "ready"


def test_an_operator_may_halt_and_nothing_else(rig: Rig) -> None:
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


def test_a_silent_planner_ends_its_program_once_and_may_speak_again(rig: Rig) -> None:
    rig.run(0, A, step=10.0)
    rig.alive = False
    rig.go(1.5)
    assert (rig.mode, rig.results) == ("ready", [(1, "aborted")])
    rig.run(A)
    rig.go(0.2)
    assert rig.results[-1] == (2, "done")


@pytest.mark.parametrize("dies", [False, True])
def test_what_a_planner_sent_before_it_fell_silent_moves_nothing(rig: Rig, dies: bool) -> None:
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
    assert rig.results == [(2, "done")]


def test_the_end_of_an_operator_begins_no_epoch(rig: Rig) -> None:
    before = rig.snapshot.epoch
    rig.connect(OPERATOR, "operator")
    rig.gone(OPERATOR)
    rig.alive = True
    rig.go()
    assert rig.snapshot.epoch == before


def test_the_greater_counts_hold(rig: Rig) -> None:
    rig.send(Counts((5, 0, 0, 0, 0, 7)))
    rig.send(Counts((1,)))
    rig.run(A)
    rig.go(0.3)
    assert rig.journal.counts == [6, 1, 1, 0, 0, 7]


def test_the_planner_hears_the_counts_before_each_result_and_at_the_end(rig: Rig) -> None:
    rig.run(A)
    rig.go(0.3)
    heard = [message for _, message in rig.heard]
    at = heard.index(rig.last(Ended))
    assert heard[at - 1] == Counted((1, 1, 1, 0, 0, 0))
    rig.follow(9, 0)
    rig.go(0.1)
    rig.do(Quit())
    rig.heard.clear()
    rig.do(Quit())
    assert rig.of(Counted) == [Counted((2, 2, 2, 0, 0, 0))]


def test_snapshots_come_20_times_a_second_and_on_change_and_diagnostics_every_second(rig: Rig) -> None:
    rig.heard.clear()
    rig.go(1)
    assert 19 <= len(rig.of(Snapshot)) <= 21
    assert len(rig.diagnostics) == 1
    rig.heard.clear()
    rig.send(Stop(1))
    assert [type(message) for _, message in rig.heard] == [Answer, Snapshot]


def test_a_snapshot_fits_a_message_whatever_is_wrong(rig: Rig) -> None:
    for k in range(1000):
        rig.master.fail(ArmFault("emergency", f"can0/{k}", "é" * 2000))
    rig.go()
    assert len(rig.snapshot.faults) == 50
    assert len(encode(rig.snapshot)) < MOST_BYTES
    assert rig.mode == "fault"


def test_systemd_is_told_that_the_boards_are_simulated() -> None:
    core = Executor(
        small_arm(), SwitchJournal(SIZE), instance=7, simulation=PlayableFaults((), (), (), ()), build_master=FakeMaster
    )
    notified = [action.text for action in core.step(ExecutorTick(), 0.0) if isinstance(action, Notify)]
    assert "STATUS=starting (simulated): the boards are being booted" in notified


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


def test_an_operator_reads_the_errors_of_a_board(rig: Rig) -> None:
    rig.connect(OPERATOR, "operator")
    rig.send(ReadErrors(3, "can0/99"), OPERATOR)
    assert "is no board of this arm" in rig.last(BoardErrors, OPERATOR).why
    rig.send(ReadErrors(4, "can0/1"), OPERATOR)
    rig.send(ReadErrors(5, "can0/1"))
    rig.go()
    assert rig.master.asked_errors == [0, 0]
    rig.master.told_errors = [(0, Errors(0x01, (0x5000,)))]
    rig.go()
    assert rig.last(BoardErrors, OPERATOR) == BoardErrors(4, "", 0x01, (0x5000,))
    assert rig.last(BoardErrors).request == 5
    rig.send(ReadErrors(6, "can0/1"), OPERATOR)
    rig.gone(OPERATOR)
    rig.master.told_errors = [(0, ArmFault("board-missing", "can0/1", "it does not answer"))]
    rig.go()
    assert len(rig.of(BoardErrors, OPERATOR)) == 2
