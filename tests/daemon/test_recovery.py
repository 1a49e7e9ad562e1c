"""Faults that pass are left without a reset, and a daemon that was halted acts on nothing old."""

import pytest

from controller.daemon.events import Stop
from controller.daemon.loop import PERIOD, RETRY
from drivers.faults import Fault
from tests.daemon.rig import LOST, A, B, Rig, states


@pytest.mark.parametrize("code", ["bus-down", "bus-off", "bus-busy", "board-lost", "board-missing"])
def test_what_passes_is_left_by_itself_and_waits_for_a_fresh_goal(rig: Rig, code: str) -> None:
    rig.run("a", A, B)
    rig.go(0.05)
    old = rig.goal("old", A)
    rig.boards.fail(Fault(code, "can0", "gone"))
    rig.go(5 * RETRY)
    assert (rig.loop.mode, rig.results) == ("fault", [("a", "aborted")])
    rig.boards.returned = True
    rig.go(RETRY + 3 * PERIOD)
    assert (rig.loop.mode, rig.snapshots[-1].faults) == ("ready", ())
    rig.loop.inbox.hand_over(old)
    rig.go(0.5)
    assert rig.replies[-1] == ("old", {**rig.replies[-1][1], "accepted": False})
    assert rig.boards.commits == [states(A)]
    rig.run("b", B)
    rig.go(0.5)
    assert rig.results[-1] == ("b", "succeeded")


@pytest.mark.parametrize("code", ["stuck", "unexpected-motion", "board-rebooted", "foreign-master", "emergency"])
def test_what_needs_a_look_waits_for_reset_whatever_passed_beside_it(rig: Rig, code: str) -> None:
    rig.boards.returned = True
    rig.boards.fail(LOST)
    rig.boards.fail(Fault(code, "can0/3", "look"))
    rig.go(5 * RETRY)
    assert rig.loop.mode == "fault"


def test_an_emergency_stop_is_not_left_when_a_fault_passes(rig: Rig) -> None:
    rig.boards.returned = True
    rig.boards.fail(LOST)
    rig.go()
    rig.request(Stop)
    rig.go(5 * RETRY)
    assert rig.loop.mode == "stopped"


def test_one_that_fails_again_is_tried_again_once_a_second(rig: Rig) -> None:
    rig.boards.returned, rig.boards.missing = True, [LOST]
    rig.boards.fail(LOST)
    starts = rig.boards.starts
    rig.go(10 * RETRY)
    assert rig.loop.mode == "fault"
    assert 5 <= rig.boards.starts - starts <= 10
    rig.boards.missing = []
    rig.go(2 * RETRY)
    assert rig.loop.mode == "ready"


def test_a_halted_daemon_aborts_its_goal_and_takes_none_that_waited(rig: Rig) -> None:
    rig.run("a", A, B)
    rig.go(0.05)
    rig.run("late", B)
    rig.boards.halt = Fault("halted", "daemon", "halted for 3 s")
    rig.now += 3
    rig.go()
    assert rig.results == [("a", "aborted")]
    assert rig.last_result["message"] == "halted for 3 s"
    assert rig.replies[-1][1]["accepted"] is False
    assert rig.boards.commits == [states(A)]
    assert rig.loop.mode == "fault"
