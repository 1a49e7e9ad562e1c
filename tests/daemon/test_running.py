"""Goals as the control loop runs them."""

import time
from dataclasses import replace

import numpy as np
import pytest

from controller.daemon.events import Planned
from controller.daemon.loop import PERIOD
from controller.manipulator.frames import planar
from controller.motion import codes
from tests.daemon.rig import ARM, TRAVEL, A, B, C, Rig, planned, states


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


@pytest.mark.parametrize(("turned", "reached"), [(0.0, True), (0.04, True), (0.06, False)])
def test_a_goal_is_held_to_its_orientation_by_what_the_boards_measured(rig: Rig, turned: float, reached: bool) -> None:
    found = planned(A)
    wanted = ARM.tip(A) @ planar(0.0, 0.0, turned)
    trajectory = replace(found.trajectory, rotations=wanted[None, :3, :3], turns=np.array([0.05]))
    rig.loop.inbox.hand_over(Planned(1, lambda payload: None, "a", replace(found, trajectory=trajectory)))
    rig.go(0.5)
    assert rig.last_result["error"] == pytest.approx(0, abs=1e-9)
    assert rig.last_result["orientation_error"] == pytest.approx(turned, abs=1e-7)
    assert rig.last_result["code"] == (codes.SUCCESSFUL if reached else codes.GOAL_TOLERANCE_VIOLATED)
    assert reached or "turned 0.0600 rad, tolerances 0.002 and 0.05" in rig.last_result["message"]
