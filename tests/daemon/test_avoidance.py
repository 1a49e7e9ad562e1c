"""Regions to keep out of, as the control loop goes by them: nothing is switched that would touch one."""

import threading
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from controller.daemon.avoidance import Avoidance, Kept
from controller.daemon.events import Follow, Improved, KeepOut, Reset
from controller.daemon.loop import PERIOD
from controller.daemon.runner import Runner
from controller.daemon.state import state_payload
from controller.motion import codes
from controller.motion.pacing import Staged
from controller.motion.plan import Plan
from controller.obstacles.clearance import Clearance
from controller.obstacles.regions import NONE, Regions, sphere
from controller.obstacles.sweep import Sweep
from drivers.faults import Fault
from tests.daemon.rig import ARM, TRAVEL, A, B, C, Rig, planned, states

HOME = (0, 0)
POST = sphere("disc 'post'", [-0.2, 0.41], 0.02)  # in it is B; the ways between HOME, A and C are clear
CORNER = sphere("disc 'corner'", [-0.12, 0.37], 0.02)  # in it is B; HOME to C is clear one by one only
ONE_BY_ONE = np.cumsum(np.eye(6, dtype=np.uint8)[:3], axis=0, dtype=np.uint8)
IN_POST = "module 2 is in disc 'post'"


def keeping(*, file: Regions = NONE, sent: Regions = NONE) -> Kept:
    return Kept(Clearance(ARM, file if len(file) else sent), sent)


class Guard:
    """A rig whose arm keeps out of regions."""

    def __init__(self, file: Regions = NONE, **fields: Any) -> None:
        self.avoidance = Avoidance(keeping(file=file))
        self.rig = Rig(avoidance=self.avoidance, **fields)
        self.rig.go()

    def run(self, name: str, plan: Plan) -> None:
        goal = replace(self.rig.goal(name, HOME), plan=plan, kept=self.avoidance.kept)
        stages = [stage for transition in plan.transitions for stage in transition.stages]
        self.avoidance.kept.touched(self.rig.boards.outputs(), stages)  # as the planner has looked at them
        self.rig.loop.inbox.hand_over(goal)

    def keep_out(self, regions: Regions) -> str:
        """Sends regions; returns the answer when what is left of a goal has been looked through."""
        rig, answers = self.rig, list[dict[str, Any]]()
        kept = keeping(sent=regions)
        rig.loop.inbox.hand_over(KeepOut(rig.arrival(), lambda p: answers.append(dict(p)), kept))
        rig.go()
        self.judged()
        assert answers[0]["accepted"]
        return str(answers[0]["message"])

    def judged(self) -> None:
        for thread in threading.enumerate():
            if thread.name == "avoidance":
                thread.join(30)
        self.rig.go()

    @property
    def state(self) -> dict[str, Any]:
        self.rig.go(0.1)
        return dict(state_payload(ARM, self.rig.snapshots[-1]))


def staged(*stages: Any, step: float = 0.4) -> Plan:
    """A plan of one transition in these stages."""
    plan = planned(ARM.configuration(stages[-1]), step=step)
    return replace(plan, transitions=(Staged(np.array(stages, dtype=np.uint8), None),))


@pytest.fixture
def guard() -> Guard:
    return Guard()


def test_a_running_goal_whose_rest_touches_is_aborted_by_name_and_the_arm_holds(guard: Guard) -> None:
    guard.run("a", planned(A, B))
    guard.rig.go(0.1)
    assert guard.rig.boards.commits == [states(A)]
    assert guard.keep_out(POST) == "keeping out of 1 region, 1 of them sent"
    assert guard.rig.results == [("a", "aborted")]
    assert guard.rig.last_result["code"] == codes.PATH_TOLERANCE_VIOLATED
    assert IN_POST in guard.rig.last_result["message"]
    assert (guard.rig.loop.mode, IN_POST in guard.rig.loop.reason) == ("ready", True)
    guard.rig.go(1.0)
    assert guard.rig.boards.commits == [states(A)]
    guard.run("c", planned(C))
    guard.rig.go(0.3)
    assert guard.rig.results[-1] == ("c", "succeeded")


def test_a_running_goal_whose_rest_is_clear_goes_on(guard: Guard) -> None:
    guard.run("a", planned(A, C, A))
    guard.rig.go(0.1)
    guard.keep_out(POST)
    guard.rig.go(1.0)
    assert guard.rig.results == [("a", "succeeded")]
    assert guard.rig.boards.commits == [states(A), states(C), states(A)]


def test_what_a_goal_has_left_behind_is_not_looked_through(guard: Guard) -> None:
    guard.run("a", planned(B, A, C))
    guard.rig.go(0.3)
    assert guard.rig.boards.commits == [states(B), states(A)]
    guard.keep_out(POST)
    guard.rig.go(1.0)
    assert guard.rig.results == [("a", "succeeded")]


def test_a_goal_that_is_due_before_it_is_looked_through_does_not_touch_either(
    guard: Guard, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Runner, "judge", lambda *_: None)
    guard.run("a", planned(A, B))
    guard.rig.go(0.1)
    guard.keep_out(POST)
    guard.rig.go(1.0)
    assert guard.rig.boards.commits == [states(A)]
    assert guard.rig.results == [("a", "aborted")]


def test_a_goal_that_cannot_be_looked_through_is_aborted(guard: Guard, monkeypatch: pytest.MonkeyPatch) -> None:
    guard.run("a", planned(A, C, step=10))
    guard.rig.go(0.1)

    def broken(*_: object) -> None:
        raise RuntimeError("no memory")

    monkeypatch.setattr(Sweep, "touch", broken)
    guard.keep_out(POST)
    assert guard.rig.results == [("a", "aborted")]
    assert "nobody knows: RuntimeError('no memory')" in guard.rig.last_result["message"]


def test_a_goal_that_was_planned_before_regions_changed_is_refused(guard: Guard) -> None:
    goal = replace(guard.rig.goal("a", C), kept=guard.avoidance.kept)
    guard.keep_out(POST)
    guard.rig.loop.inbox.hand_over(goal)
    guard.rig.go(0.3)
    assert guard.rig.replies[0][1]["message"].endswith("changed while the goal was planned; send it again")
    assert guard.rig.boards.commits == []


def test_a_better_plan_of_before_is_not_taken(guard: Guard) -> None:
    before = guard.avoidance.kept
    guard.run("a", planned(A, C))
    guard.rig.go(0.1)
    guard.keep_out(POST)
    arrival = guard.rig.loop._runner.execution.goal.arrival  # type: ignore[union-attr]
    guard.rig.loop.inbox.put(Improved(arrival, planned(A, B), before))
    guard.rig.go(1.0)
    assert guard.rig.boards.commits == [states(A), states(C)]
    assert guard.rig.results == [("a", "succeeded")]


def test_an_arm_that_stands_in_a_region_says_so_holds_and_takes_no_goal_until_it_is_gone(guard: Guard) -> None:
    guard.run("b", planned(B))
    guard.rig.go(0.3)
    assert guard.keep_out(POST) == f"keeping out of 1 region, 1 of them sent; {IN_POST} where the arm stands"
    (fault,) = guard.state["faults"]
    assert (fault["code"], fault["source"], fault["message"].startswith(IN_POST)) == ("in-obstacle", "arm", True)
    assert guard.state["mode"] == "ready"
    for goal in (A, B):
        guard.run("a", planned(goal))
        guard.rig.go(0.3)
        assert guard.rig.replies[-1][1]["message"] == f"on the way from where the arm is, {IN_POST}"
    assert guard.rig.boards.commits == [states(B)]
    assert guard.keep_out(NONE) == "keeping out of 0 regions, 0 of them sent"
    assert guard.state["faults"] == []
    guard.run("a", planned(A))
    guard.rig.go(0.3)
    assert guard.rig.results[-1] == ("a", "succeeded")


def test_regions_may_change_in_a_fault_and_are_kept_over_a_reset(guard: Guard) -> None:
    guard.rig.boards.fail(Fault("stuck", "1.left", "actuator 1.left is stuck"))
    guard.rig.go()
    guard.keep_out(POST)
    assert guard.rig.loop.mode == "fault"
    guard.rig.request(Reset)
    guard.rig.go(0.1)
    guard.run("b", planned(B))
    guard.rig.go(0.3)
    assert IN_POST in guard.rig.replies[-1][1]["message"]


def test_a_way_that_touches_is_refused_though_both_ends_are_clear() -> None:
    guard = Guard(CORNER)
    guard.run("c", planned(C))
    guard.rig.go(0.3)
    refused = guard.rig.replies[0][1]["message"]
    assert refused == "on the way from where the arm is, module 2 is in disc 'corner'"
    assert guard.rig.boards.commits == []


def test_a_later_way_that_touches_aborts_the_goal_before_it() -> None:
    guard = Guard(CORNER)
    guard.run("c", planned(A, HOME, C))
    guard.rig.go(1.0)
    assert guard.rig.boards.commits == [states(A), states(HOME)]
    assert guard.rig.results == [("c", "aborted")]
    assert "module 2 is in disc 'corner'" in guard.rig.loop.reason


@pytest.mark.parametrize("late", [0.0, 0.2, 10.0])
def test_stages_are_taken_one_after_the_other_however_late_it_is(late: float) -> None:
    guard = Guard(CORNER)
    times = list[float]()
    guard.run("c", staged(*ONE_BY_ONE))
    guard.rig.now += late  # the loop was halted
    for _ in range(100):
        before = len(guard.rig.boards.commits)
        guard.rig.go()
        times += [guard.rig.now] * (len(guard.rig.boards.commits) - before)
    assert guard.rig.boards.commits == ONE_BY_ONE.tolist()
    assert all(b - a >= TRAVEL - 1e-9 for a, b in pairwise(times)), "each is settled before the next"
    assert guard.rig.results == [("c", "succeeded")]


def test_points_are_passed_over_where_that_touches_nothing() -> None:
    guard = Guard(POST)
    plan = planned(A, C, A, C)
    guard.run("c", plan)
    guard.rig.go(0.1)
    guard.rig.now += 0.5
    guard.rig.go(1.0)
    assert guard.rig.boards.commits == [states(A), states(C)]
    assert guard.rig.results == [("c", "succeeded")]


def test_a_goal_waits_until_what_moves_has_settled(guard: Guard) -> None:
    guard.keep_out(POST)
    guard.run("a", planned(A))
    guard.rig.go(2 * PERIOD)
    committed = guard.rig.now
    guard.run("c", planned(C))
    while len(guard.rig.boards.commits) < 2:
        guard.rig.go()
    assert guard.rig.now - committed >= TRAVEL - PERIOD - 1e-9


def wish(guard: Guard, stream: int, *stages: Any) -> Follow:
    rows = np.array(stages, dtype=np.uint8)
    guard.avoidance.kept.touched(guard.rig.boards.outputs(), rows)  # as the follower has looked at them
    return replace(guard.rig.wish(stream, ARM.configuration(rows[-1]).tolist()), stages=rows)


def test_a_wish_that_touches_is_not_followed() -> None:
    guard = Guard(POST)
    stream = guard.rig.arrival()
    guard.rig.loop.inbox.put(wish(guard, stream, states(B)))
    guard.rig.go(0.1)
    assert (guard.rig.loop.mode, guard.rig.boards.commits) == ("executing", [])
    guard.rig.loop.inbox.put(wish(guard, stream, states(C)))
    guard.rig.go(0.1)
    assert guard.rig.boards.commits == [states(C)]


def test_a_wish_is_followed_stage_by_stage() -> None:
    guard = Guard(CORNER)
    stream, rows = guard.rig.arrival(), ONE_BY_ONE
    guard.rig.loop.inbox.put(replace(wish(guard, stream, *rows), until=guard.rig.now + 1))
    guard.rig.go(0.5)
    assert guard.rig.boards.commits == rows.tolist()


def test_a_stage_waits_for_an_actuator_that_is_late() -> None:
    guard = Guard(CORNER)
    guard.run("c", staged(*ONE_BY_ONE))
    guard.rig.go(2 * PERIOD)
    guard.rig.boards.slow = True
    guard.rig.go(1.0)
    assert guard.rig.boards.commits == ONE_BY_ONE[:1].tolist()
    guard.rig.boards.slow = False
    guard.rig.go(1.0)
    assert guard.rig.boards.commits == ONE_BY_ONE.tolist()
    assert guard.rig.results == [("c", "succeeded")]


def test_what_stuck_on_its_way_may_come_free_in_a_stage() -> None:
    commanded, wanted = [0, 1, 1, 1, 0, 1], [0, 0, 1, 1, 1, 0]
    guard = Guard(sphere("disc 'post'", [0.16, 0.36], 0.02))
    guard.rig.boards.stuck = True
    guard.run("a", staged(commanded))
    guard.rig.go(0.2)
    assert guard.rig.loop.mode == "fault"
    guard.rig.boards.stuck = False
    guard.rig.request(Reset)
    guard.rig.go(0.1)
    assert guard.avoidance.kept.touched(np.array(commanded), np.array([wanted])) is None, "had all of it arrived"
    guard.run("b", staged(wanted))
    guard.rig.go(0.3)
    assert guard.rig.boards.commits == [commanded]
    assert guard.rig.results[-1] == ("b", "aborted")
    assert IN_POST in guard.rig.last_result["message"]


def test_a_stream_that_stops_between_two_stages_leaves_the_arm_there() -> None:
    guard = Guard(CORNER)
    guard.rig.loop.inbox.put(replace(wish(guard, guard.rig.arrival(), *ONE_BY_ONE), until=guard.rig.now + TRAVEL))
    guard.rig.go(0.5)
    assert guard.rig.boards.commits == ONE_BY_ONE[:1].tolist()
    assert (guard.rig.loop.mode, guard.rig.loop.reason) == ("ready", "holding; the stream of setpoints has stopped")
