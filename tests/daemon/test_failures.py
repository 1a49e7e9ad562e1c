"""Faults of the boards and defects of the daemon: hold, tell, and wait for reset."""

import pytest

from controller.daemon.events import Cancel, Reset, Started, Stop
from controller.daemon.loop import PERIOD
from controller.daemon.switching import BUSY_FOR
from drivers.faults import Fault, Leaving
from tests.daemon.rig import ARM, LOST, A, B, C, Rig, states


def test_a_fault_aborts_the_goal_and_is_left_by_reset(rig: Rig) -> None:
    rig.run("a", A, B)
    rig.go(0.05)
    rig.boards.fail(LOST)
    rig.boards.fail(Fault("board-lost", "can0/2", "another"))
    rig.go(0.5)
    assert rig.results == [("a", "aborted")]
    assert rig.last_result["message"] == LOST.message
    assert (rig.loop.mode, rig.loop.reason) == ("fault", LOST.message)
    assert [fault.source for fault in rig.snapshots[-1].faults] == ["can0/1", "can0/2"]
    rig.run("b", C)
    rig.request(Reset)
    rig.go(0.5)
    assert rig.replies[1][1]["message"] == f"the arm is fault: {LOST.message}"
    assert rig.loop.mode == "ready"
    assert rig.snapshots[-1].faults == ()
    assert rig.boards.commits == [states(A)]


def test_after_a_fault_plans_start_from_what_was_measured(rig: Rig) -> None:
    rig.boards.stuck = True
    rig.run("a", A)
    rig.go(0.5)
    rig.request(Reset)
    rig.go()
    assert rig.loop.commanded is None
    rig.go()
    assert rig.loop.commanded.tolist() == [0, 0]


def test_a_stuck_actuator_and_not_the_missed_goal_is_what_the_result_tells(rig: Rig) -> None:
    rig.boards.stuck = True
    rig.run("a", A)
    rig.go(0.5)
    assert rig.results == [("a", "aborted")]
    assert rig.last_result["message"] == "actuator 1.left is stuck"
    assert rig.loop.mode == "fault"


def test_a_missing_board_is_told_and_reset_tries_again(starting: Rig) -> None:
    rig = starting
    rig.go()
    rig.boards.missing = [LOST, Fault("board-missing", "can0/2", "another")]
    rig.request(Stop)
    rig.request(Reset)
    rig.go(4 * PERIOD)
    assert (rig.loop.mode, rig.loop.reason) == ("fault", f"{LOST.message} (and 1 more)")
    rig.boards.missing = []
    rig.request(Reset)
    rig.go(2 * PERIOD)
    assert rig.loop.mode == "ready"


def test_a_fault_while_starting_counts_at_its_end(starting: Rig) -> None:
    starting.boards.fail(LOST)
    starting.loop.inbox.get(0)
    starting.go()
    assert starting.loop.mode == "starting"
    starting.loop.inbox.put(Started(()))
    starting.go()
    assert (starting.loop.mode, starting.loop.reason) == ("fault", LOST.message)


def test_boards_that_measure_no_configuration_are_a_fault() -> None:
    rig = Rig()
    rig.boards.states[:] = -1
    rig.go()
    assert rig.loop.mode == "fault"
    assert "no configuration" in rig.loop.reason


def test_a_busy_bus_is_tried_again(rig: Rig) -> None:
    rig.boards.busy = True
    rig.run("a", A)
    rig.go(BUSY_FOR - 2 * PERIOD)
    assert (rig.loop.mode, rig.boards.commits) == ("executing", [])
    rig.boards.busy = False
    rig.go(0.2)
    assert rig.results == [("a", "succeeded")]
    assert rig.ledger.counts.sum() == ARM.switches((0, 0), A)


def test_a_bus_that_stays_busy_is_a_fault(rig: Rig) -> None:
    rig.boards.busy = True
    rig.run("a", A)
    rig.go(BUSY_FOR + 5 * PERIOD)
    assert rig.results == [("a", "aborted")]
    assert rig.loop.mode == "fault"
    assert rig.loop.reason == "no command could be sent for 0.25 s: the queue is full"
    assert rig.ledger.counts.sum() == 0


def test_frames_that_leave_slowly_are_waited_for(rig: Rig) -> None:
    commit = rig.boards.commit

    def leaving(states: object, now: float) -> None:
        raise Leaving("not left yet")

    rig.boards.commit = leaving  # type: ignore[method-assign]
    rig.run("a", A)
    rig.go(4 * BUSY_FOR)
    assert (rig.loop.mode, rig.boards.commits) == ("executing", [])
    rig.boards.commit = commit  # type: ignore[method-assign]
    rig.go(0.2)
    assert rig.results == [("a", "succeeded")]
    assert rig.ledger.counts.sum() == ARM.switches((0, 0), A)


def test_how_long_a_bus_was_busy_for_one_goal_does_not_count_for_the_next(rig: Rig) -> None:
    rig.boards.busy = True
    rig.run("a", A)
    rig.go(0.1)
    rig.request(Cancel)
    rig.go(1)
    rig.run("b", B)
    rig.go(0.1)
    assert rig.loop.mode == "executing"


@pytest.mark.parametrize("verb", ["tick", "commit", "measured"])
def test_a_defect_is_a_fault_the_arm_holds_and_the_loop_goes_on(rig: Rig, verb: str) -> None:
    rig.run("a", A, B)
    rig.go(0.05)
    rig.boards.broken = {verb}
    rig.go(0.5)
    assert rig.results == [("a", "aborted")]
    assert rig.loop.mode == "fault"
    assert "internal error" in rig.loop.reason
    assert rig.boards.ticks[-1] == rig.now
    rig.boards.broken = set()
    rig.request(Reset)
    rig.go(2 * PERIOD)
    assert rig.loop.mode == "ready"


@pytest.mark.parametrize("verb", ["start", "hold", "measured"])
def test_a_defect_while_starting_is_a_fault_that_reset_leaves(rig: Rig, verb: str) -> None:
    rig.request(Stop)
    rig.request(Reset)
    rig.boards.broken = {verb}
    rig.go(0.1)
    assert rig.loop.mode == "fault"
    rig.boards.broken = set()
    rig.request(Reset)
    rig.go(2 * PERIOD)
    assert rig.loop.mode == "ready"


def test_a_defect_of_the_boards_is_still_told_on_state(rig: Rig) -> None:
    rig.boards.broken = {"tick"}
    rig.go()
    assert rig.snapshots[-1].mode == "fault"
