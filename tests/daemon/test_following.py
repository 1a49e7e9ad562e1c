"""A moving goal as the control loop follows it."""

from itertools import pairwise

import pytest

from controller.daemon.events import Cancel, Planned, Reset, Stop
from controller.daemon.loop import PERIOD
from tests.daemon.rig import LOST, TRAVEL, A, B, C, Rig, leaving_late, states


def test_a_wish_is_followed_and_its_end_holds(rig: Rig) -> None:
    stream = rig.arrival()
    rig.follow(stream, A)
    rig.go(2 * PERIOD)
    assert (rig.loop.mode, rig.loop.reason) == ("executing", "following a setpoint")
    rig.go(1)
    assert (rig.loop.mode, rig.loop.reason) == ("ready", "holding; the stream of setpoints has stopped")
    assert rig.boards.commits == [states(A)]
    assert rig.ledger.counts.sum() == sum(states(A))
    assert (rig.ledger.goals, rig.published) == ({}, [])


def test_a_wish_to_stay_keeps_executing_and_switches_nothing(rig: Rig) -> None:
    stream = rig.arrival()
    for _ in range(10):
        rig.follow(stream, None)
        rig.go(0.1)
        assert rig.loop.mode == "executing"
    assert rig.boards.commits == []


def test_one_transition_at_a_time(rig: Rig) -> None:
    stream, times = rig.arrival(), []
    for k in range(100):
        rig.follow(stream, (A, B, C)[k % 3])
        before = len(rig.boards.commits)
        rig.go()
        times += [rig.now] * (len(rig.boards.commits) - before)
    assert len(times) > 5
    assert all(b - a >= TRAVEL + PERIOD - 1e-9 for a, b in pairwise(times))


def test_after_a_sync_that_leaves_late_the_next_transition_waits_as_after_any(rig: Rig) -> None:
    left_at, stream = leaving_late(rig, 3 * PERIOD), rig.arrival()
    rig.boards.moving = lambda now: False  # the actuators are quick
    for k in range(60):
        rig.follow(stream, (A, B)[k % 2])
        before = len(rig.boards.commits)
        rig.go()
        if left_at and rig.now > left_at[0] - PERIOD and len(rig.boards.commits) > before:
            break
    assert rig.now >= left_at[0] + TRAVEL + PERIOD - 1e-9


def test_nothing_is_switched_while_it_moves(rig: Rig) -> None:
    rig.boards.slow = True
    stream = rig.arrival()
    for k in range(100):
        rig.follow(stream, (A, B)[k % 2])
        rig.go()
    assert len(rig.boards.commits) == 1


def test_a_wish_from_a_configuration_left_meanwhile_is_none(rig: Rig) -> None:
    stream = rig.arrival()
    late = rig.wish(stream, B)
    rig.follow(stream, A)
    rig.go(0.1)
    rig.loop.inbox.put(late)
    rig.go(0.5)
    assert rig.boards.commits == [states(A)]


def test_a_wish_that_comes_too_late_is_none(rig: Rig) -> None:
    rig.follow(rig.arrival(), A, lasting=-PERIOD)
    rig.go(0.5)
    assert (rig.loop.mode, rig.boards.commits) == ("ready", [])


def test_a_stream_replaces_the_goal_which_says_so(rig: Rig) -> None:
    rig.run("a", A, B, step=10)
    rig.go(0.2)
    rig.follow(rig.arrival(), C)
    rig.go(0.5)
    assert rig.results == [("a", "replaced")]
    assert rig.last_result["message"] == "replaced by a setpoint"
    assert rig.boards.commits == [states(A), states(C)]


def test_a_goal_replaces_following_and_the_stream_that_runs(rig: Rig) -> None:
    stream = rig.arrival()
    rig.follow(stream, A)
    rig.go(0.1)
    rig.run("a", B)
    rig.go(2 * PERIOD)
    for _ in range(20):
        rig.follow(stream, C)
        rig.go()
    rig.go(0.5)
    assert rig.results == [("a", "succeeded")]
    assert rig.boards.commits == [states(A), states(B)]
    rig.follow(rig.arrival(), C)
    rig.go(0.5)
    assert rig.boards.commits[-1] == states(C)


@pytest.mark.parametrize(("request_", "mode"), [(Cancel, "ready"), (Stop, "stopped")])
def test_cancel_and_stop_hold_until_a_stream_that_begins_later(rig: Rig, request_: type[Cancel], mode: str) -> None:
    stream = rig.arrival()
    rig.follow(stream, A)
    rig.go(0.1)
    rig.request(request_)
    for _ in range(50):
        rig.follow(stream, B)
        rig.go()
    assert (rig.loop.mode, rig.boards.commits) == (mode, [states(A)])
    if request_ is Stop:
        rig.request(Reset)
        rig.go(0.1)
    else:
        assert rig.replies == [("cancel", {"accepted": True, "code": 0, "message": "canceled"})]
        assert rig.loop.reason == "holding; following was canceled"
    rig.follow(rig.arrival(), C)
    rig.go(0.5)
    assert rig.boards.commits == [states(A), states(C)]


def test_a_fault_ends_following_and_a_stream_that_came_meanwhile_is_not_followed_after_reset(rig: Rig) -> None:
    old = rig.arrival()
    rig.follow(old, A)
    rig.go(0.1)
    rig.boards.fail(LOST)
    rig.go()
    assert rig.loop.mode == "fault"
    rig.request(Reset)
    early = rig.arrival()
    rig.follow(early, B)  # is handled while the boards start
    rig.loop.step()
    assert rig.loop.mode == "starting"
    rig.go(0.1)
    assert rig.loop.mode == "ready"
    for stream in (old, early):
        rig.follow(stream, C)
        rig.go(0.5)
    assert (rig.loop.mode, rig.boards.commits) == ("ready", [states(A)])


def test_a_bus_that_is_busy_is_tried_again_and_at_last_a_fault(rig: Rig) -> None:
    rig.boards.busy = True
    stream = rig.arrival()
    rig.follow(stream, A, lasting=10)
    rig.go(0.2)
    assert rig.loop.mode == "executing"
    rig.boards.busy = False
    rig.go(0.02)
    assert rig.boards.commits == [states(A)]
    rig.boards.busy = True
    rig.go(0.1)
    rig.follow(stream, B, lasting=10)
    rig.go(0.5)
    assert rig.loop.mode == "fault"
    assert "no command could be sent" in rig.loop.reason


def test_a_goal_that_was_asked_for_before_the_stream_is_replaced_by_it(rig: Rig) -> None:
    goal: Planned = rig.goal("a", B, C, step=10)
    stream = rig.arrival()
    rig.follow(stream, A)
    rig.go(0.1)
    rig.loop.inbox.hand_over(goal)
    rig.go(2 * PERIOD)
    rig.follow(stream, None)
    rig.go(0.1)
    assert rig.results == [("a", "replaced")]
    assert rig.loop.reason == "following a setpoint"


def test_no_more_switch_at_once_than_the_supply_can_take() -> None:
    rig = Rig(inrush=1)
    rig.go()
    stream = rig.arrival()
    for _ in range(60):
        rig.follow(stream, B)
        rig.go()
    assert rig.boards.commits[-1] == states(B)
    before = [states((0, 0)), *rig.boards.commits]
    assert max(sum(x != y for x, y in zip(a, b, strict=True)) for a, b in pairwise(before)) == 1


def test_a_goal_may_run_until_it_has_ended_or_is_refused(rig: Rig) -> None:
    replaced, refused = rig.goal("a", A), rig.goal("b", B)
    assert rig.loop.may_run(replaced.arrival)
    rig.loop.inbox.hand_over(replaced)
    rig.go()
    assert rig.loop.may_run(replaced.arrival)
    rig.follow(rig.arrival(), C)
    rig.go()
    assert not rig.loop.may_run(replaced.arrival)
    rig.request(Stop)
    rig.loop.inbox.hand_over(refused)
    rig.go(2 * PERIOD)
    assert not rig.loop.may_run(refused.arrival)
