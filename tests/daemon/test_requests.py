"""Cancel, stop and reset, in every mode."""

import pytest

from controller.daemon.events import Cancel, Reset, Started, Stop
from controller.daemon.loop import PERIOD
from tests.daemon.rig import LOST, A, B, C, Rig, states


def test_cancel_ends_the_goal_and_holds(rig: Rig) -> None:
    rig.run("a", A, B)
    rig.go(0.05)
    rig.request(Cancel)
    rig.go(1)
    assert rig.results == [("a", "canceled")]
    assert rig.boards.commits == [states(A)]
    assert rig.replies[1][1]["message"] == "canceled"
    assert rig.loop.mode == "ready"


def test_cancel_of_nothing_is_answered(rig: Rig) -> None:
    rig.request(Cancel)
    rig.go()
    assert rig.replies[0][1]["message"] == "there was no goal to cancel; the arm holds"
    assert rig.loop.mode == "ready"


@pytest.mark.parametrize("kind", [Cancel, Stop])
def test_what_arrived_before_a_cancel_or_stop_does_not_begin_after_it(rig: Rig, kind: type[Cancel | Stop]) -> None:
    planning = rig.goal("a", A)
    rig.request(kind)
    rig.go()
    rig.loop.inbox.hand_over(planning)
    rig.go(0.5)
    assert rig.replies[1][1] | {"code": 0} == {
        "accepted": False, "id": "a", "code": 0, "message": "a cancel, stop, reset or fault came before it began",
    }  # fmt: skip
    assert rig.boards.commits == []


def test_what_was_planned_before_a_fault_does_not_begin_after_its_reset(rig: Rig) -> None:
    planning = rig.goal("a", A)
    rig.boards.fail(LOST)
    rig.go()
    rig.request(Reset)
    rig.go(2 * PERIOD)
    assert rig.loop.mode == "ready"
    rig.loop.inbox.hand_over(planning)
    rig.go(0.5)
    assert "before it began" in rig.replies[1][1]["message"]
    assert rig.boards.commits == []


def test_stop_aborts_refuses_goals_and_is_left_by_reset_without_moving(rig: Rig) -> None:
    rig.run("a", A, B)
    rig.go(0.05)
    rig.request(Stop)
    rig.run("b", C)
    rig.go(0.5)
    assert rig.results == [("a", "aborted")]
    assert rig.loop.mode == "stopped"
    assert rig.replies[2][1]["message"] == "the arm is stopped: emergency stop; the arm holds until reset"
    rig.request(Reset)
    rig.go(0.5)
    assert rig.loop.mode == "ready"
    assert rig.boards.commits == [states(A)]
    assert rig.loop.commanded.tolist() == list(A)


def test_a_stop_while_starting_stays(starting: Rig) -> None:
    starting.loop.inbox.get(0)  # the start-up's end, which shall come after the stop
    rig = starting
    rig.request(Stop)
    rig.go()
    rig.loop.inbox.put(Started(()))
    rig.go(0.1)
    assert rig.loop.mode == "stopped"
    rig.request(Reset)
    rig.go(0.1)
    assert (rig.loop.mode, rig.boards.starts) == ("ready", 2)


def test_start_ups_never_overlap(rig: Rig) -> None:
    rig.request(Stop)
    rig.go()
    for kind in (Reset, Stop, Reset):  # the first one's end is behind them all
        rig.request(kind)
    rig.go()
    assert rig.boards.starts == 2
    rig.go(2 * PERIOD)
    assert (rig.loop.mode, rig.boards.starts) == ("starting", 2)
    rig.go()
    assert (rig.loop.mode, rig.boards.starts) == ("starting", 3)
    rig.go()
    assert rig.loop.mode == "ready"


@pytest.mark.parametrize("mode", ["ready", "executing", "starting"])
def test_reset_of_nothing_does_nothing(rig: Rig, mode: str) -> None:
    if mode == "executing":
        rig.run("a", A)
    if mode == "starting":
        rig.request(Stop)
        rig.request(Reset)
    rig.request(Reset)
    rig.go(3 * PERIOD if mode == "starting" else PERIOD * (1 + (mode == "executing")))
    assert rig.replies[-1][1]["message"] == f"nothing to reset: the arm is {mode}"
    rig.go(0.5)
    assert rig.loop.mode == "ready"
