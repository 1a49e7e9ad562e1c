"""Interlocks: while one is open, nothing moves, the mode is fault, and Reset is refused."""

from __future__ import annotations

import pytest

from hyperbit.controller.program import TICK, Answer, Lock, Reset, Stop
from hyperbit.drivers.canopen.wiring import Interlock, WatchedObject
from tests.executor.rig import CAN, LOST, SIZE, Rig, ready

STOP, AIR = Interlock("stop", "can0", 9, 0), Interlock("air", "can0", 9, 1)
OPEN = "interlock stop (can0/9 input 0) is open: close it, then reset"


@pytest.fixture
def rig() -> Rig:
    return ready(interlocks=(STOP, AIR))


def test_motion_ends_at_once_when_one_opens(rig: Rig) -> None:
    rig.run(1, 0, 1, 0)
    rig.go(2 * TICK)
    rig.master.inputs &= ~(1 << SIZE)
    rig.do(CAN)
    assert (rig.mode, rig.reason) == ("fault", OPEN)
    assert rig.faults == [("interlock", "stop (can0/9 input 0)")]
    rig.go(1.0)
    assert (rig.switched, rig.results) == ([1], [(1, "aborted")])


def test_reset_is_refused_while_one_is_open(rig: Rig) -> None:
    rig.master.inputs &= ~(0b11 << SIZE)
    rig.go()
    rig.send(Reset(1, rig.epoch))
    answer = rig.last(Answer)
    assert (answer.accepted, answer.message) == (False, f"{OPEN} (and 1 more)")
    assert rig.mode == "fault"
    rig.master.inputs |= 0b10 << SIZE
    rig.send(Reset(2, rig.epoch))
    assert (rig.last(Answer).accepted, rig.last(Answer).message) == (False, OPEN)
    rig.master.inputs |= 0b01 << SIZE
    rig.go(3.0)
    assert rig.mode == "fault", "that it is closed again is not enough"
    rig.send(Reset(3, rig.epoch))
    rig.go(0.1)
    assert (rig.last(Answer).accepted, rig.mode, rig.faults) == (True, "ready", [])


def test_an_interlock_that_is_open_at_the_start_is_a_fault() -> None:
    rig = Rig(interlocks=(STOP, AIR))
    rig.master.inputs &= ~(1 << SIZE)
    rig.connect()
    rig.go(0.1)
    assert (rig.mode, rig.reason) == ("fault", OPEN)


def test_an_interlock_that_opens_while_the_arm_is_stopped_keeps_it_stopped(rig: Rig) -> None:
    rig.send(Stop(1))
    rig.master.inputs &= ~(1 << SIZE)
    rig.go()
    assert (rig.mode, rig.faults) == ("stopped", [("interlock", "stop (can0/9 input 0)")])
    rig.send(Reset(2, rig.epoch))
    assert not rig.last(Answer).accepted


def test_an_object_that_does_not_answer_counts_as_open_and_says_why() -> None:
    rig = ready(interlocks=(STOP, Interlock("supply", "can0", 9, 0, watched=WatchedObject(0x2102, 0))))
    rig.master.inputs &= ~(0b10 << SIZE)
    rig.master.silent["supply"] = "board can0/9 does not answer to 2102h sub 0"
    rig.go()
    why = "board can0/9 does not answer to 2102h sub 0. Mend this, then reset"
    assert (rig.mode, rig.reason) == ("fault", f"interlock supply (can0/9 2102h sub 0 bit 0) counts as open: {why}")


def test_an_interlock_of_a_lost_board_does_not_count_as_open(rig: Rig) -> None:
    rig.master.fail(LOST, lost=0b111111)
    rig.master.inputs = 0
    rig.go()
    assert rig.faults == [("board-lost", "can0/1")]


def test_locks_may_change_while_one_is_open(rig: Rig) -> None:
    rig.master.inputs &= ~(1 << SIZE)
    rig.go()
    rig.send(Lock(1, 0, 0))
    assert rig.last(Answer).accepted
    assert rig.mode == "fault"
