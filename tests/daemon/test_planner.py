"""Every question to the planner is answered once, whatever happens meanwhile."""

import copy
import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from controller.config import Arm
from controller.daemon import planner as module
from controller.daemon.avoidance import Avoidance, keeping
from controller.daemon.events import Cancel, Event, Improved, Planned
from controller.daemon.inbox import Inbox
from controller.daemon.planner import MOST_WAITING, Planner, Question, stages_of
from controller.motion import codes
from controller.motion.goal import MOST_BYTES
from controller.obstacles.regions import sphere
from controller.search.solver import Solver
from tests.daemon.waiting import PATIENCE, eventually

GOAL = json.dumps({"id": "a", "waypoints": [{"t": k, "position": (0.55 - 0.1 * (k % 2), 2.9)} for k in range(5)]})


class FakeLoop:
    """What the planner sees of the control loop."""

    def __init__(self) -> None:
        self.inbox = Inbox()
        self.mode, self.reason, self.accept_after = "ready", "holding", 0
        self.commanded: Any = np.zeros(16, dtype=np.int64)
        self.ended: set[int] = set()

    def may_run(self, arrival: int) -> bool:
        return arrival not in self.ended


class Desk:
    """Asks the planner, and holds it up before a waypoint if told to."""

    def __init__(self, arm: Arm, solver: Solver) -> None:
        self.loop = FakeLoop()
        self.answers: list[dict[str, Any]] = []
        self.planning, self.free = threading.Event(), threading.Event()
        self.free.set()
        self._arrival = 0

        class Slow(Solver):
            def solve(slow, *args: Any, **fields: Any) -> Any:
                self.planning.set()
                assert self.free.wait(PATIENCE)
                return super().solve(*args, **fields)

        held = copy.copy(solver)
        held.__class__ = Slow
        self.expected: list[Any] = []
        held.expect = lambda previous, tolerance: self.expected.append(list(previous)) or iter(())
        self.avoidance = Avoidance(keeping(arm))
        self.planner = Planner(arm, held, self.loop, avoidance=self.avoidance)

    def ask(self, payload: str | bytes = GOAL, *, run: bool = True) -> None:
        self._arrival += 1
        data = payload.encode() if isinstance(payload, str) else payload
        self.planner.submit(Question(self._arrival, lambda p: self.answers.append(dict(p)), data, 1e9, run))

    def hold_up(self) -> None:
        self.free.clear()
        self.ask()
        assert self.planning.wait(PATIENCE)


@pytest.fixture
def desk(arm: Arm, solver: Solver) -> Iterator[Desk]:
    desk = Desk(arm, solver)
    yield desk
    desk.free.set()
    desk.planner.close(PATIENCE)


def answered(desk: Desk, count: int = 1) -> list[dict[str, Any]]:
    return eventually(lambda: desk.answers if len(desk.answers) >= count else [])


def handed_over(desk: Desk) -> Event | None:
    """What comes to the loop next, but for better plans of what came before."""
    while isinstance(event := desk.loop.inbox.get(PATIENCE), Improved):
        pass
    return event


def test_a_goal_goes_to_the_loop_unanswered(desk: Desk) -> None:
    desk.ask()
    event = handed_over(desk)
    assert isinstance(event, Planned)
    assert (event.id, event.arrival, len(event.plan.solutions)) == ("a", 1, 5)
    assert desk.answers == []


def test_a_goal_without_an_id_gets_one(desk: Desk) -> None:
    desk.ask('{"waypoints": [{"position": [0.55, 2.9]}]}')
    event = handed_over(desk)
    assert isinstance(event, Planned)
    assert len(event.id) == 12


def test_a_question_is_answered_and_nothing_handed_over(desk: Desk) -> None:
    desk.ask(run=False)
    (answer,) = answered(desk)
    assert [w["t"] for w in answer["waypoints"]] == [0, 1, 2, 3, 4]
    assert desk.loop.inbox.waiting() == 0


def test_points_between_waypoints_are_told_apart(desk: Desk) -> None:
    ends = [{"position": [0.55, 2.9]}, {"t": 1.0, "position": [0.45, 2.9]}]
    desk.ask(json.dumps({"waypoints": ends, "path_tolerance": 0.05}), run=False)
    (answer,) = answered(desk)
    assert [w["between"] for w in answer["waypoints"]] == [False, *[True] * 7, False]
    assert answer["message"].startswith("2 waypoints, 7 points between them, ")
    assert all(w["error"] <= 0.05 for w in answer["waypoints"])
    assert sum(w["switches"] for w in answer["waypoints"]) == answer["switches"]


@pytest.mark.parametrize("mode", ["starting", "fault", "stopped"])
def test_a_goal_in_a_mode_that_takes_none_is_refused_with_its_reason(desk: Desk, mode: str) -> None:
    desk.loop.mode, desk.loop.reason = mode, "because"
    desk.ask()
    assert answered(desk)[0]["message"] == f"the arm is {mode}: because"
    assert answered(desk)[0]["id"] == "a"


def test_before_the_states_are_known_nothing_can_be_planned(desk: Desk) -> None:
    desk.loop.mode, desk.loop.reason, desk.loop.commanded = "starting", "booting", None
    desk.ask(run=False)
    assert answered(desk)[0]["message"] == "the arm is starting: booting"


def test_a_cancel_ends_the_planning_at_once(desk: Desk) -> None:
    desk.hold_up()
    desk.ask()
    desk.loop.accept_after = 2
    desk.free.set()
    answers = answered(desk, 2)
    assert [a["message"] for a in answers] == ["a cancel, stop, reset or fault came before it began"] * 2
    assert desk.loop.inbox.waiting() == 0
    desk.ask()
    assert isinstance(handed_over(desk), Planned)


def test_a_goal_that_has_ended_is_bettered_no_more(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    left = threading.Event()

    class Endless:
        def __init__(self, *_: Any) -> None:
            pass

        def betters(self) -> Iterator[Any]:
            try:
                while True:
                    yield None
            finally:
                left.set()

    monkeypatch.setattr(module, "Foresight", Endless)
    desk.ask()
    assert isinstance(handed_over(desk), Planned)
    assert not left.is_set()
    desk.loop.ended.add(1)
    assert left.wait(PATIENCE)


def test_too_many_and_too_large_are_refused_at_once(desk: Desk) -> None:
    desk.hold_up()
    for _ in range(MOST_WAITING + 3):
        desk.ask()
    assert [a["message"] for a in desk.answers] == ["busy: 16 goals are waiting to be planned already"] * 3
    desk.ask(b" " * (MOST_BYTES + 1))
    assert "1000001 bytes" in desk.answers[-1]["message"]
    desk.free.set()
    for _ in range(MOST_WAITING + 1):
        assert isinstance(handed_over(desk), Planned)


def test_closing_refuses_all_that_waits_and_comes(desk: Desk) -> None:
    desk.hold_up()
    for _ in range(3):
        desk.ask()
    closing = threading.Thread(target=desk.planner.close, args=(PATIENCE,))
    closing.start()
    eventually(lambda: desk.planner._closing)
    desk.free.set()
    closing.join(PATIENCE)
    desk.ask()
    assert [a["message"] for a in desk.answers] == ["the daemon is shutting down; the arm holds"] * 5
    assert desk.loop.inbox.waiting() == 0


def test_a_plan_that_comes_after_the_loop_ended_is_refused(desk: Desk) -> None:
    desk.loop.inbox.close()
    desk.ask()
    assert answered(desk)[0]["message"] == "the daemon is shutting down; the arm holds"


def test_a_defect_is_answered_and_the_next_goal_planned(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any) -> Any:
        raise ZeroDivisionError

    with monkeypatch.context() as patched:
        patched.setattr(module, "plan", broken)
        desk.ask()
        assert answered(desk)[0]["message"] == "internal error while planning, see the journal"
    desk.ask()
    assert isinstance(handed_over(desk), Planned)


def test_an_inbox_that_is_full_answers_for_the_goal(desk: Desk) -> None:
    reply: Callable[[Any], None] = lambda payload: None  # noqa: E731
    for k in range(256):
        desk.loop.inbox.hand_over(Cancel(k, reply))
    desk.ask()
    assert "busy" in answered(desk)[0]["message"]


def test_while_nobody_asks_the_search_is_prepared_for_where_the_arm_is(desk):
    assert eventually(lambda: desk.expected)[-1] == [0] * 16
    desk.loop.commanded = [1] * 16
    assert eventually(lambda: [1] * 16 in desk.expected)
    desk.ask()
    assert isinstance(handed_over(desk), Planned)


def test_a_plan_goes_by_what_is_kept_out_of_now_and_says_so(desk: Desk, arm: Arm) -> None:
    desk.avoidance.kept = kept = keeping(arm, sphere("disc 'post'", [1.5, 1.5], 0.2))
    desk.ask()
    event = handed_over(desk)
    assert isinstance(event, Planned)
    assert event.kept is kept
    configurations = np.array([solution.configuration for solution in event.plan.solutions])
    assert not kept.clearance.blocked(configurations).any()
    assert kept.touched(np.zeros(48, dtype=np.uint8), stages_of(event.plan)) is None


def test_a_goal_in_a_region_is_refused(desk: Desk, arm: Arm) -> None:
    desk.avoidance.kept = keeping(arm, sphere("disc 'crate'", [0.55, 2.9], 0.1))
    desk.ask()
    (answer,) = answered(desk)
    assert (answer["accepted"], answer["code"]) == (False, codes.GOAL_TOLERANCE_VIOLATED)


def test_an_arm_that_stands_in_a_region_is_not_planned_for(desk: Desk, arm: Arm) -> None:
    tip = arm.manipulator.tip(np.zeros(16, dtype=np.int64))[:2, 3]
    desk.avoidance.kept = keeping(arm, sphere("disc 'hand'", tip, 0.05))
    desk.ask()
    assert "disc 'hand'" in answered(desk)[0]["message"]


def test_a_goal_is_planned_again_when_regions_change_meanwhile(desk: Desk, arm: Arm) -> None:
    before = desk.avoidance.kept
    desk.hold_up()
    desk.avoidance.kept = keeping(arm, sphere("disc 'post'", [1.5, 1.5], 0.2))
    desk.free.set()
    event = handed_over(desk)
    assert isinstance(event, Planned)
    assert event.kept is desk.avoidance.kept is not before


def test_a_goal_is_planned_again_when_the_arm_moves_on_meanwhile(desk: Desk, arm: Arm) -> None:
    desk.avoidance.kept = keeping(arm, sphere("disc 'post'", [1.5, 1.5], 0.2))
    desk.ask()
    first = handed_over(desk)
    assert isinstance(first, Planned)
    desk.hold_up()
    desk.loop.commanded = first.plan.solutions[0].configuration
    desk.free.set()
    event = handed_over(desk)
    assert isinstance(event, Planned)
    start = arm.manipulator.actuator_states(desk.loop.commanded)
    assert event.plan.transitions[0].stages[-1].tolist() == start.tolist(), "it is there already"
