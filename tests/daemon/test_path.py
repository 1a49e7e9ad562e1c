"""Goals that follow lines, as the control loop runs them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controller.daemon.events import Improved, Planned
from controller.daemon.loop import PERIOD
from controller.motion import codes
from controller.motion.pacing import Staged
from tests.daemon.rig import ARM, A, B, C, Rig, states

STEP = 0.2
PATH = 0.01


def path(rig: Rig, *configurations: tuple[int, int], off: tuple[int, ...] = (), by: float = 2 * PATH) -> Planned:
    """A goal of two waypoints, the first and the last of these; some points lie off where the plan brings the tip."""
    goal = rig.goal("a", *configurations, step=STEP)
    trajectory, transitions = goal.plan.trajectory, goal.plan.transitions
    positions = trajectory.positions.copy()
    positions[list(off), 1] += by
    trajectory = replace(
        trajectory, positions=positions, waypoints=np.array([0, len(positions) - 1]), path_tolerance=PATH
    )
    strayed = tuple(replace(transition, excursion=k / 10) for k, transition in enumerate(transitions))
    return replace(goal, plan=replace(goal.plan, trajectory=trajectory, transitions=strayed))


def told(rig: Rig) -> list[dict[str, Any]]:
    return [payload for key, payload in rig.published if key == "feedback"]


def test_what_holds_is_not_commanded_again_and_only_waypoints_are_told(rig: Rig) -> None:
    rig.loop.inbox.hand_over(path(rig, A, A, A, B, B, C, C))
    rig.go(2 * PERIOD)
    assert rig.replies[0][1]["message"].startswith("accepted, 2 waypoints, ")
    for seconds, commits in [(0.3, [A]), (0.1, [A]), (0.2, [A, B]), (0.2, [A, B]), (0.2, [A, B, C])]:
        rig.go(seconds)
        assert rig.boards.commits == [states(c) for c in commits]
        assert rig.snapshots[-1].waypoint == 0
    rig.go(0.5)
    assert rig.boards.commits == [states(c) for c in (A, B, C, C)], "the last waypoint is told to the boards"
    assert [(f["waypoint"], f["waypoints"], f["stages"]) for f in told(rig)] == [(0, 2, 1), (1, 2, 2)]
    assert [f["excursion"] for f in told(rig)] == [0.0, 0.6]
    assert (rig.results, rig.last_result["code"]) == ([("a", "succeeded")], codes.SUCCESSFUL)


def test_each_is_switched_to_before_its_point_and_not_before_the_last_one_ends(rig: Rig) -> None:
    rig.loop.inbox.hand_over(path(rig, A, B, B, C))
    began, moments = None, {}
    for _ in range(100):
        rig.go()
        began = rig.now if began is None and rig.boards.commits else began
        moments.setdefault(len(rig.boards.commits), rig.now)
    assert [round(moments[k] - began, 3) for k in (1, 2, 3)] == pytest.approx([0.0, STEP, 3 * STEP], abs=PERIOD + 1e-9)


@pytest.mark.parametrize(("point", "after", "commits"), [(0, 0, [A]), (2, 0, [A, B]), (3, 0, [A, B, C])])
def test_a_measured_tip_off_the_line_ends_the_goal_and_the_arm_holds(
    rig: Rig, point: int, after: int, commits: list[tuple[int, int]]
) -> None:
    rig.loop.inbox.hand_over(path(rig, A, A, B, C, A, off=(point,)))
    rig.go(2.0)
    result = rig.last_result
    assert (result["status"], result["code"]) == ("aborted", codes.PATH_TOLERANCE_VIOLATED)
    assert result["message"] == (
        f"after waypoints[{after}] the measured tip is 0.0200 from the line's point, path_tolerance 0.01"
    )
    assert rig.boards.commits == [states(c) for c in commits]
    assert (rig.loop.mode, rig.loop.reason) == ("ready", f"holding; goal a left its path: {result['message']}")


def test_the_end_is_missed_as_ever(rig: Rig) -> None:
    rig.loop.inbox.hand_over(path(rig, A, B, C, off=(2,)))
    rig.go(2.0)
    assert (rig.last_result["status"], rig.last_result["code"]) == ("aborted", codes.GOAL_TOLERANCE_VIOLATED)


def test_a_tip_that_cannot_be_told_is_off_the_line(rig: Rig) -> None:
    rig.loop.inbox.hand_over(path(rig, A, A, B, C))
    rig.go(0.3)
    rig.boards.measured = lambda: np.full(len(ARM.actuators), -1)  # type: ignore[method-assign]
    rig.go(0.5)
    assert "the measured tip is unknown" in rig.last_result["message"]
    assert rig.last_result["code"] == codes.PATH_TOLERANCE_VIOLATED


def test_without_a_path_tolerance_nothing_is_checked_on_the_way(rig: Rig) -> None:
    goal = path(rig, A, B, C, off=(0, 1))
    free = replace(goal.plan.trajectory, path_tolerance=None)
    rig.loop.inbox.hand_over(replace(goal, plan=replace(goal.plan, trajectory=free)))
    rig.go(2.0)
    assert rig.results == [("a", "succeeded")]


def test_a_better_plan_that_comes_late_is_caught_up_with(rig: Rig) -> None:
    """It has another configuration for a point that is past, and holds that."""
    goal = path(rig, A, A, A, A, A, A)
    better = path(rig, A, B, B, B, B, B).plan
    better = replace(better, transitions=tuple(replace(t, excursion=0.0) for t in better.transitions))
    rig.loop.inbox.hand_over(goal)
    rig.go(0.5)
    assert rig.boards.commits == [states(A)]
    rig.loop.inbox.put(Improved(goal.arrival, better))
    rig.go(2 * PERIOD)
    assert rig.boards.commits == [states(A), states(B)]
    rig.go(1.5)
    assert rig.results == [("a", "succeeded")]


def test_stages_to_a_point_between_are_all_carried_out(rig: Rig) -> None:
    goal = path(rig, A, B, B, C)
    first, _, *rest = goal.plan.transitions
    staged = Staged(np.array([states((3, 2)), states(B)], dtype=np.uint8), 0.0)
    rig.loop.inbox.hand_over(replace(goal, plan=replace(goal.plan, transitions=(first, staged, *rest))))
    rig.go(2.0)
    assert rig.boards.commits == [states(A), states((3, 2)), states(B), states(C)]
    assert [f["stages"] for f in told(rig)] == [1, 3]
