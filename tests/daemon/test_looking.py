"""What nobody has looked at is looked at beside the control loop, which goes on and switches nothing meanwhile."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
import pytest

from controller.daemon.avoidance import Avoidance, Kept
from controller.daemon.events import Cancel, Follow, Improved, KeepOut, Planned, Quit, Reset, Stop
from controller.daemon.loop import PERIOD
from controller.motion.plan import Plan
from controller.obstacles.clearance import Clearance
from controller.obstacles.regions import Regions, sphere
from controller.obstacles.sweep import Sweep, Touch
from tests.daemon.rig import ARM, LOST, A, B, C, Rig, leaving_late, planned, states
from tests.daemon.test_avoidance import CORNER, HOME, IN_POST, ONE_BY_ONE, POST, staged

FAR = sphere("disc 'far'", [5.0, 5.0], 0.1)


def keeping(regions: Regions) -> Kept:
    return Kept(Clearance(ARM, regions), regions)


class Door:
    """Looks in threads wait at it until it is opened.

    Attributes:
        asked: from where, and which actuators.
        seen: what is told in place of what there is, by from where.
    """

    def __init__(self, touch: Callable[..., Touch | None]) -> None:
        self.asked: list[tuple[list[int], list[int]]] = []
        self.seen: dict[tuple[int, ...], Touch | None] = {}
        self._touch, self._opened = touch, threading.Event()

    def touch(self, sweep: Sweep, states: np.ndarray, actuators: np.ndarray) -> Touch | None:
        assert threading.current_thread().name == "avoidance", "the control loop looks itself"
        self.asked.append((states.tolist(), actuators.tolist()))
        assert self._opened.wait(30)
        return self.seen.get(tuple(states.tolist()), self._touch(sweep, states, actuators))

    def open(self) -> None:
        """Lets pass who waits, and all that come."""
        self._opened.set()
        self.wait()

    def let_pass(self) -> None:
        """Lets those pass who wait."""
        self.open()
        self._opened.clear()

    def wait(self) -> None:
        for thread in threading.enumerate():
            if thread.name == "avoidance":
                thread.join(30)


@pytest.fixture
def door(monkeypatch: pytest.MonkeyPatch) -> Iterator[Door]:
    door = Door(Sweep.touch)
    monkeypatch.setattr(Sweep, "touch", lambda *arguments: door.touch(*arguments))
    yield door
    door.open()


class Site:
    """A rig among regions whose steps wait for no look."""

    def __init__(self, regions: Regions = FAR, **fields: Any) -> None:
        self.avoidance = Avoidance(keeping(regions))
        self.rig = Rig(avoidance=self.avoidance, **fields)
        self.rig.awaited = {"start-up"}
        self.rig.go()

    def look_at(self, *configurations: tuple[int, int]) -> None:
        """Begins to look beforehand, as a planner does."""
        rows = np.array([states(configuration) for configuration in configurations], dtype=np.uint8)
        self.avoidance.judge(self.rig.boards.outputs(), rows)

    def run(self, name: str, plan: Plan) -> Planned:
        goal = replace(self.rig.goal(name, HOME), plan=plan, kept=self.avoidance.kept)
        self.rig.loop.inbox.hand_over(goal)
        return goal

    def keep_out(self, regions: Regions) -> None:
        self.rig.loop.inbox.hand_over(KeepOut(self.rig.arrival(), lambda _: None, keeping(regions)))

    def wish(self, stream: int, *stages: Any) -> Follow:
        rows = np.array(stages, dtype=np.uint8)
        return replace(self.rig.wish(stream, ARM.configuration(rows[-1]).tolist()), stages=rows)

    def waits(self, seconds: float = 1.0) -> None:
        """Lets time pass, and sees that the loop goes on while nothing is switched."""
        commits, ticks, shown = len(self.rig.boards.commits), len(self.rig.boards.ticks), len(self.rig.snapshots)
        waits = self.avoidance.waits
        self.rig.go(seconds)
        assert len(self.rig.boards.ticks) - ticks == round(seconds / PERIOD), "boards hear the master's heartbeats"
        assert len(self.rig.snapshots) - shown >= int(seconds / 0.05) - 1, "the state is told"
        assert len(self.rig.boards.commits) == commits
        assert self.avoidance.waits > waits


@pytest.fixture
def site() -> Site:
    return Site()


def test_a_goal_waits_with_its_answer_and_then_goes(door: Door) -> None:
    site = Site(CORNER)
    site.run("c", staged(*ONE_BY_ONE))
    site.waits()
    assert (site.rig.loop.mode, site.rig.replies) == ("ready", [])
    door.open()
    site.rig.go()
    assert site.rig.replies[0][1]["accepted"]
    site.rig.go(1.0)
    assert site.rig.boards.commits == ONE_BY_ONE.tolist()
    assert site.rig.results == [("c", "succeeded")]
    assert all(told.loop.overruns == 0 for told in site.rig.diagnostics)
    assert site.rig.diagnostics[-1].waits == site.avoidance.waits >= 100


def test_a_goal_that_touches_waits_and_is_refused(door: Door) -> None:
    site = Site(POST)
    site.run("b", planned(B))
    site.waits()
    door.open()
    site.rig.go(2 * PERIOD)
    assert IN_POST in site.rig.replies[0][1]["message"]
    assert (site.rig.loop.mode, site.rig.boards.commits) == ("ready", [])


def test_a_stage_of_a_running_goal_waits_and_then_goes(site: Site, door: Door) -> None:
    site.run("c", planned(A, C))
    site.rig.go()
    door.let_pass()
    site.rig.go(0.2)
    assert site.rig.boards.commits == [states(A)]
    site.waits()
    assert site.rig.loop.mode == "executing"
    assert [f["waypoint"] for key, f in site.rig.published if key == "feedback"] == [0], "and what was done is told"
    door.open()
    site.rig.go()
    assert site.rig.boards.commits == [states(A), states(C)]
    site.rig.go(0.5)
    assert site.rig.results == [("c", "succeeded")]


@pytest.mark.parametrize("begun", [False, True])
@pytest.mark.parametrize("kind", ["cancel", "stop", "fault", "quit"])
def test_what_ends_goals_ends_one_that_waits(site: Site, door: Door, kind: str, begun: bool) -> None:
    site.run("c", planned(A, C))
    site.rig.go()
    if begun:
        door.let_pass()
        site.rig.go(0.3)
    site.waits(0.3)
    match kind:
        case "cancel" | "stop":
            site.rig.request({"cancel": Cancel, "stop": Stop}[kind])
            site.rig.go()
            assert [answer["accepted"] for name, answer in site.rig.replies if name == kind] == [True]
        case "fault":
            site.rig.boards.fail(LOST)
            site.rig.go()
        case "quit":
            site.rig.loop.inbox.put(Quit())
            site.rig.loop.run()
    mode = {"cancel": "ready", "stop": "stopped", "fault": "fault", "quit": "ready"}[kind]
    assert site.rig.loop.mode == mode, site.rig.loop.reason
    if begun:
        assert site.rig.results == [("c", "canceled" if kind == "cancel" else "aborted")]
    else:
        (answer,) = [payload for name, payload in site.rig.replies if name == "c"]
        assert not answer["accepted"]
        assert ("shutting down" if kind == "quit" else "came before it began") in answer["message"]
    door.open()
    site.rig.go(0.5)
    assert site.rig.boards.commits == [states(A)] * begun


def test_an_answer_is_for_the_regions_it_was_asked_of(site: Site, door: Door) -> None:
    site.run("b", planned(A, B))
    site.rig.go()
    door.let_pass()
    site.rig.go(0.3)
    site.waits(0.1)
    site.keep_out(POST)
    site.waits(0.1)
    door.open()  # the way to B touches nothing that there was
    site.rig.go(0.2)
    door.wait()
    site.rig.go(0.2)
    assert site.rig.boards.commits == [states(A)]
    assert site.rig.results == [("b", "aborted")]
    assert IN_POST in site.rig.last_result["message"]


def test_an_answer_is_for_the_states_it_was_asked_of(site: Site, door: Door) -> None:
    door.seen = {tuple(states(HOME)): None, tuple(states(A)): Touch(1, 0)}
    site.run("c", planned(C))
    site.waits(0.1)
    site.rig.request(Stop)
    site.rig.go()
    site.rig.boards.commits.append(states(A))  # somebody else moved the arm
    site.rig.boards.states = np.array(states(A), dtype=np.int8)
    site.rig.request(Reset)
    site.rig.go(3 * PERIOD)
    assert site.rig.loop.mode == "ready"
    site.run("d", planned(C))
    site.waits(0.1)
    door.open()
    site.rig.go()
    door.wait()
    site.rig.go(0.3)
    assert [start for start, _ in door.asked] == [states(HOME), states(A)]
    assert "module 2 is in disc 'far'" in site.rig.replies[-1][1]["message"]
    assert site.rig.boards.commits == [states(A)]


def test_an_answer_that_is_there_is_not_asked_for_again(site: Site, door: Door) -> None:
    door.open()
    for name, configuration in [("a", A), ("home", HOME), ("b", A), ("again", HOME)]:
        site.run(name, planned(configuration))
        for _ in range(40):
            site.rig.go()
            door.wait()
    assert [status for _, status in site.rig.results] == ["succeeded"] * 4
    assert [start for start, _ in door.asked] == [states(HOME), states(A)]


def test_a_look_that_fails_bars_the_way(site: Site, door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("no memory")

    with monkeypatch.context() as patch:
        patch.setattr(Sweep, "touch", broken)
        site.run("a", planned(A))
        site.rig.go()
        door.wait()
        site.rig.go()
    assert "nobody knows: RuntimeError('no memory')" in site.rig.replies[0][1]["message"]
    assert (site.rig.loop.mode, site.rig.boards.commits) == ("ready", [])
    door.open()
    site.run("again", planned(A))
    site.rig.go()
    assert site.rig.replies[1] == ("again", {**site.rig.replies[0][1], "id": "again"})
    site.keep_out(FAR)
    site.rig.go()
    site.run("b", planned(A))
    site.rig.go()
    door.wait()
    site.rig.go(0.3)
    assert site.rig.results == [("b", "succeeded")]


def test_goals_that_come_meanwhile_wait_in_line_and_nothing_else_moves(site: Site, door: Door) -> None:
    site.look_at(A, C)
    door.let_pass()
    site.run("a", planned(A, C, step=0.5))
    site.rig.go(0.3)
    assert site.rig.boards.commits == [states(A)]
    goals = [site.run("b", planned(B)), site.run("c", planned(C))]
    site.waits()
    assert site.rig.results == [], "what ran goes on if both are refused"
    assert all(site.rig.loop.may_run(goal.arrival) for goal in goals)
    door.open()
    site.rig.go()
    door.wait()
    site.rig.go(0.5)
    assert [name for name, answer in site.rig.replies if answer["accepted"]] == ["a", "b", "c"]
    assert [name for name, status in site.rig.results if status == "replaced"][:1] == ["a"]
    assert site.rig.boards.commits[-1] == states(C)


def test_a_goal_in_line_takes_better_plans(site: Site, door: Door) -> None:
    goal = site.run("a", planned(A, B))
    site.waits(0.1)
    site.rig.loop.inbox.put(Improved(goal.arrival, planned(A, C), goal.kept))
    site.rig.loop.inbox.put(Improved(goal.arrival, planned(A, HOME), keeping(POST)))  # of other regions
    site.waits(0.1)
    door.open()
    for _ in range(60):
        site.rig.go()
        door.wait()
    assert site.rig.boards.commits == [states(A), states(C)]


def test_the_bus_is_not_blamed_for_waiting(site: Site, door: Door) -> None:
    site.look_at(A, C)
    door.let_pass()
    site.run("a", planned(A, C))
    site.rig.go(0.15)
    site.rig.boards.busy = True
    site.rig.go(0.2)
    assert (site.rig.loop.mode, site.rig.boards.commits) == ("executing", [states(A)])
    site.keep_out(POST)
    site.waits()
    door.open()
    site.rig.go(0.2)
    assert site.rig.loop.mode == "executing", site.rig.loop.reason
    site.rig.boards.busy = False
    site.rig.go(0.5)
    assert site.rig.results == [("a", "succeeded")]


def test_a_wish_waits_whatever_is_wished_meanwhile_and_is_followed(site: Site, door: Door) -> None:
    stream = site.rig.arrival()
    for wanted in (A, B, C, B, C) * 4:
        site.rig.loop.inbox.put(site.wish(stream, states(wanted)))
        site.waits(0.05)
    assert site.rig.loop.mode == "executing"
    door.let_pass()
    site.rig.loop.inbox.put(site.wish(stream, states(B)))
    site.rig.go()
    assert site.rig.boards.commits == [states(A)]
    assert len(door.asked) == 1


def test_a_wish_that_waits_is_dropped_for_one_to_stay(site: Site, door: Door) -> None:
    stream = site.rig.arrival()
    site.rig.loop.inbox.put(site.wish(stream, states(A)))
    site.waits(0.1)
    site.rig.follow(stream, None)
    site.rig.go()
    door.open()
    site.rig.go(0.1)
    assert (site.rig.loop.mode, site.rig.boards.commits) == ("executing", [])


def test_a_stream_that_stops_while_its_wish_waits_is_over(site: Site, door: Door) -> None:
    site.rig.loop.inbox.put(site.wish(site.rig.arrival(), states(A)))
    site.waits(0.1)
    site.rig.go(0.2)
    assert (site.rig.loop.mode, site.rig.loop.reason) == ("ready", "holding; the stream of setpoints has stopped")
    door.open()
    site.rig.go(0.5)
    assert site.rig.boards.commits == []


def test_a_wish_that_touches_is_dropped_and_the_next_is_followed(door: Door) -> None:
    site = Site(POST)
    stream = site.rig.arrival()
    site.rig.loop.inbox.put(site.wish(stream, states(B)))
    site.waits(0.1)
    door.open()
    site.rig.go()
    site.rig.loop.inbox.put(site.wish(stream, states(C)))
    site.rig.go()
    door.wait()
    site.rig.go()
    assert site.rig.boards.commits == [states(C)]


def late(site: Site) -> None:
    """Lets the first SYNC leave late; outputs tell of it when it has left."""
    left_at, outputs, before = leaving_late(site.rig, 3 * PERIOD), site.rig.boards.outputs, site.rig.boards.outputs()
    site.rig.boards.outputs = lambda: before if site.rig.now < max(left_at, default=0.0) else outputs()  # type: ignore[method-assign]


def test_after_a_sync_that_left_late_no_wish_of_before_is_looked_at(site: Site, door: Door) -> None:
    for wanted in (A, C):
        site.look_at(wanted)
    door.let_pass()
    late(site)
    stream, old = site.rig.arrival(), site.wish(0, states(C))
    site.rig.loop.inbox.put(site.wish(stream, states(A)))
    for _ in range(20):
        site.rig.go()
        site.rig.loop.inbox.put(replace(old, arrival=stream))
    assert site.rig.boards.commits == [states(A)]
    assert site.rig.loop.commanded.tolist() == list(A)
    assert site.avoidance.waits == 0


def test_after_a_sync_that_left_late_no_stage_is_looked_at_that_is_there(site: Site, door: Door) -> None:
    site.avoidance.judge(site.rig.boards.outputs(), ONE_BY_ONE)
    door.let_pass()
    late(site)
    site.run("c", staged(*ONE_BY_ONE))
    site.rig.go(1.0)
    assert [stage for stage, _ in groupby(site.rig.boards.commits)] == ONE_BY_ONE.tolist()
    assert site.rig.results == [("c", "succeeded")]
    assert site.avoidance.waits == 0
