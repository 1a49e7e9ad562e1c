"""The control loop's modes, goals and faults, on boards in memory and a clock of the test's own."""

import time

import pytest

from controller.daemon.events import Cancel, Quit, Reset, Started, Stop
from controller.daemon.inbox import MOST_WAITING
from controller.daemon.loop import PERIOD
from controller.daemon.runner import BUSY_FOR
from controller.motion import codes
from drivers.faults import Fault
from tests.daemon.rig import ARM, TRAVEL, Rig

A, B, C = (1, 2), (3, 4), (7, 0)
LOST = Fault("board-lost", "can0/1", "board can0/1: no heartbeat")


@pytest.fixture
def starting() -> Rig:
    return Rig()


@pytest.fixture
def rig(starting: Rig) -> Rig:
    starting.go()
    assert starting.loop.mode == "ready"
    return starting


def states(configuration: tuple[int, int]) -> list[int]:
    return ARM.actuator_states(configuration).tolist()


# --- goals


def test_a_goal_is_run_to_its_end(rig: Rig) -> None:
    rig.run("a", A, B)
    rig.go(2 * PERIOD)
    assert (rig.loop.mode, rig.loop.reason) == ("executing", "goal a")
    assert rig.replies[0][1] == {"accepted": True, "code": 0, "id": "a", "message": "accepted, 2 waypoints, 2 switches planned"}  # fmt: skip  # noqa: E501
    rig.go(0.5)
    assert rig.boards.commits == [states(A), states(B)]
    assert [(k, p.get("waypoint"), p.get("status")) for k, p in rig.published] == [
        ("feedback", 0, None),
        ("feedback", 1, None),
        ("result", None, "succeeded"),
    ]
    assert rig.loop.mode == "ready"
    assert rig.last_result["code"] == codes.SUCCESSFUL
    assert rig.last_result["error"] == pytest.approx(0, abs=1e-9)
    assert rig.ledger.goals == {1: ["a", "succeeded"]}
    assert rig.ledger.counts.sum() == rig.last_result["switches"] == ARM.switches((0, 0), A) + ARM.switches(A, B)


def test_a_goal_without_a_stamp_skips_no_waypoint_and_keeps_their_distances(rig: Rig) -> None:
    rig.run("a", A, B, C, step=TRAVEL + PERIOD)
    rig.go(0.5)
    assert rig.boards.commits == [states(A), states(B), states(C)]
    assert [p["waypoint"] for k, p in rig.published if k == "feedback"] == [0, 1, 2]


def test_a_goal_in_the_future_waits(rig: Rig) -> None:
    rig.run("a", A, stamp=time.time() + 60)
    rig.go(50)
    assert (rig.loop.mode, rig.boards.commits) == ("executing", [])
    rig.go(11)
    assert rig.results == [("a", "succeeded")]


def test_of_a_goal_half_past_only_what_is_due_is_run(rig: Rig) -> None:
    rig.run("a", A, B, C, step=1000, stamp=time.time() - 1500)
    rig.go(0.1)
    assert rig.boards.commits == [states(B)]


def test_a_goal_that_ended_while_it_was_planned_is_refused(rig: Rig) -> None:
    rig.run("a", A, stamp=time.time() - 5)
    rig.go()
    assert rig.replies[0][1]["code"] == codes.OLD_HEADER_TIMESTAMP
    assert "s before it was planned" in rig.replies[0][1]["message"]
    assert rig.boards.commits == []


def test_a_new_goal_replaces_the_running_one_which_says_by_which(rig: Rig) -> None:
    rig.run("a", A, B)
    rig.go(0.05)
    rig.run("b", C)
    rig.go(0.5)
    assert rig.results == [("a", "replaced"), ("b", "succeeded")]
    assert next(p["message"] for k, p in rig.published if k == "result") == "replaced by goal b"
    assert rig.boards.commits == [states(A), states(C)]
    assert rig.ledger.goals == {1: ["a", "replaced"], 2: ["b", "succeeded"]}


def test_the_running_goals_id_is_refused(rig: Rig) -> None:
    rig.run("a", A, B)
    rig.go(0.05)
    rig.run("a", C)
    rig.go(0.5)
    assert [r["accepted"] for _, r in rig.replies] == [True, False]
    assert "running already" in rig.replies[1][1]["message"]
    assert rig.results == [("a", "succeeded")]


def test_a_goal_that_misses_says_by_how_much(rig: Rig) -> None:
    rig.run("a", A, error=0.5)
    rig.go(0.5)
    assert rig.last_result["code"] == codes.GOAL_TOLERANCE_VIOLATED
    assert rig.last_result["message"] == "the measured tip is 0.5000 from the last waypoint, tolerance 0.002"
    assert rig.loop.mode == "ready"
    assert "missed" in rig.loop.reason


def test_nothing_counts_as_reached_while_it_moves(rig: Rig) -> None:
    rig.boards.slow = True
    rig.run("a", A)
    rig.go(1)
    assert rig.published == []
    rig.boards.slow = False
    rig.go(0.1)
    assert rig.results == [("a", "succeeded")]


# --- cancel, stop, reset


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
        "accepted": False, "id": "a", "code": 0, "message": "canceled, stopped or reset before it began",
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


# --- faults


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


def test_how_long_a_bus_was_busy_for_one_goal_does_not_count_for_the_next(rig: Rig) -> None:
    rig.boards.busy = True
    rig.run("a", A)
    rig.go(0.1)
    rig.request(Cancel)
    rig.go(1)
    rig.run("b", B)
    rig.go(0.1)
    assert rig.loop.mode == "executing"


# --- defects


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


# --- what it tells


def test_state_is_told_20_times_a_second_and_on_change(rig: Rig) -> None:
    rig.go(0.1)
    before = len(rig.snapshots)
    rig.go(1)
    assert 19 <= len(rig.snapshots) - before <= 21
    rig.request(Stop)
    rig.go()
    assert rig.snapshots[-1].mode == "stopped"


def test_diagnostics_are_told_every_second(rig: Rig) -> None:
    before = len(rig.diagnostics)
    rig.go(10)
    assert 9 <= len(rig.diagnostics) - before <= 11
    assert rig.diagnostics[-1].loop.overruns == 0


def test_the_watchdog_is_fed_by_good_ticks_only(rig: Rig) -> None:
    rig.go(1)
    assert 9 <= rig.notifier.sent.count("WATCHDOG=1") <= 12
    rig.notifier.sent.clear()
    rig.boards.broken = {"tick"}
    rig.go(1)
    assert "WATCHDOG=1" not in rig.notifier.sent


def test_every_mode_is_told_to_systemd(rig: Rig) -> None:
    rig.run("a", A)
    rig.go(0.5)
    assert [word for word in rig.notifier.sent if word != "WATCHDOG=1"] == [
        "READY=1",
        "STATUS=starting: the boards are being brought up",
        "STATUS=ready: holding what the boards measured",
        "STATUS=executing: goal a",
        "STATUS=ready: holding; goal a was reached",
    ]


# --- overload and the end


def test_more_requests_than_can_wait_are_refused_but_a_stop_goes_on(rig: Rig) -> None:
    for _ in range(MOST_WAITING + 10):
        rig.request(Cancel)
    rig.run("a", A)
    assert [(name, reply["accepted"]) for name, reply in rig.replies] == [("cancel", False)] * 10 + [("a", False)]
    for _ in range(MOST_WAITING + 10):
        rig.request(Stop)
    assert [reply["message"] for _, reply in rig.replies[11:]] == ["an emergency stop is on its way already"] * 10
    rig.go((2 * MOST_WAITING + 1) * PERIOD)
    assert rig.loop.mode == "stopped"
    assert len(rig.replies) == 2 * MOST_WAITING + 21


def test_at_the_end_goal_and_waiting_requests_are_told(rig: Rig) -> None:
    rig.run("a", A, B)
    rig.go(0.05)
    rig.loop.inbox.put(Quit())
    rig.run("b", C)
    rig.request(Stop)
    rig.loop.run()
    rig.loop.inbox.close()
    rig.run("c", C)
    assert rig.results == [("a", "aborted")]
    assert rig.last_result["message"] == "the daemon is shutting down; the arm holds"
    late = [(name, reply["accepted"], reply["message"]) for name, reply in rig.replies[1:]]
    assert late == [(name, False, "the daemon is shutting down; the arm holds") for name in ("b", "stop", "c")]
    assert "STOPPING=1" in rig.notifier.sent
    assert (rig.snapshots[-1].mode, rig.snapshots[-1].goal) == ("ready", None)
    assert rig.boards.commits == [states(A)]
