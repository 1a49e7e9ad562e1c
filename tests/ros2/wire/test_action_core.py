"""The core of an action server: rules of rcl_action, and invariants over random sequences of events."""

from itertools import count

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from hyperbit.controller.ros2.wire import action_events as events
from hyperbit.controller.ros2.wire.action_core import ACTIVE, NO_UUID, ActionCore, IllegalTransition
from hyperbit.controller.ros2.wire.action_events import Action, CancelCode, GoalInfo, Status

A, B, C = (bytes([number]) * 16 for number in (1, 2, 3))

# The transitions of rcl_action, see goal_state_machine.c of ros2/rcl.
LEGAL = {
    (Status.ACCEPTED, Status.EXECUTING),
    (Status.ACCEPTED, Status.CANCELING),
    (Status.EXECUTING, Status.CANCELING),
    (Status.EXECUTING, Status.SUCCEEDED),
    (Status.EXECUTING, Status.ABORTED),
    (Status.CANCELING, Status.SUCCEEDED),
    (Status.CANCELING, Status.ABORTED),
    (Status.CANCELING, Status.CANCELED),
}
ENDS = (Status.SUCCEEDED, Status.CANCELED, Status.ABORTED)


def accepted(core: ActionCore, uuid: bytes, request: int = 0, stamp: int = 1, now: float = 0.0) -> list[Action]:
    assert core.step(events.GoalRequested(request, uuid, uuid), now) == [events.AskGoal(uuid)]
    return core.step(events.GoalDecided(uuid, accepted=True, stamp=stamp), now)


def ended(core: ActionCore, uuid: bytes, status: Status = Status.SUCCEEDED, now: float = 0.0) -> list[Action]:
    core.step(events.StatusChanged(uuid, Status.EXECUTING), now)
    return core.step(events.StatusChanged(uuid, status, "result"), now)


def test_an_accepted_goal_is_answered_and_published() -> None:
    core = ActionCore()
    assert accepted(core, A, request=7, stamp=5) == [
        events.AnswerGoal(7, accepted=True, stamp=5),
        events.PublishStatus((GoalInfo(A, 5, Status.ACCEPTED),)),
    ]


def test_a_rejected_goal_is_answered_and_forgotten() -> None:
    core = ActionCore()
    core.step(events.GoalRequested(7, A, A), 0.0)
    assert core.step(events.GoalDecided(A, accepted=False, stamp=0), 0.0) == [events.AnswerGoal(7, accepted=False)]
    assert not core.goals


@pytest.mark.parametrize("state", ["asked", "accepted", "ended"])
def test_a_known_id_is_rejected(state: str) -> None:
    core = ActionCore()
    core.step(events.GoalRequested(0, A, A), 0.0)
    if state != "asked":
        core.step(events.GoalDecided(A, accepted=True, stamp=1), 0.0)
    if state == "ended":
        ended(core, A)
    assert core.step(events.GoalRequested(1, A, A), 0.0) == [events.AnswerGoal(1, accepted=False)]


def test_a_result_is_answered_before_and_after_the_end() -> None:
    core = ActionCore()
    accepted(core, A)
    assert core.step(events.ResultRequested(1, A), 0.0) == []
    assert ended(core, A, Status.ABORTED) == [
        events.AnswerResult(1, Status.ABORTED, "result"),
        events.PublishStatus((GoalInfo(A, 1, Status.ABORTED),)),
    ]
    assert core.step(events.ResultRequested(2, A), 0.0) == [events.AnswerResult(2, Status.ABORTED, "result")]
    assert core.goals[A].waiting == []


def test_a_result_is_kept_for_its_time() -> None:
    core = ActionCore(result_timeout=10.0)
    accepted(core, A)
    ended(core, A, now=5.0)
    known, unknown = (events.AnswerResult(1, Status.SUCCEEDED, "result"), events.AnswerResult(1, Status.UNKNOWN, None))
    assert core.step(events.ResultRequested(1, A), 15.0) == [known]
    assert core.step(events.ResultRequested(1, A), 15.1) == [unknown]
    assert core.step(events.GoalRequested(2, A, A), 15.2) == [events.AskGoal(A)]


@pytest.mark.parametrize("asked", [True, False])
def test_the_result_of_a_goal_that_was_not_accepted_is_unknown(asked: bool) -> None:
    core = ActionCore()
    if asked:
        core.step(events.GoalRequested(0, A, A), 0.0)
    assert core.step(events.ResultRequested(1, A), 0.0) == [events.AnswerResult(1, Status.UNKNOWN, None)]


def test_further_goals_are_rejected_unless_one_has_ended() -> None:
    core = ActionCore(most_goals=2)
    accepted(core, A)
    accepted(core, B)
    assert core.step(events.GoalRequested(2, C, C), 0.0) == [events.AnswerGoal(2, accepted=False)]
    ended(core, B)
    assert core.step(events.GoalRequested(3, C, C), 0.0) == [events.AskGoal(C)]
    assert list(core.goals) == [A, C]


@pytest.mark.parametrize(
    ("uuid", "stamp", "goals"),
    [
        (B, 0, (B,)),  # one
        (NO_UUID, 0, (A, B, C)),  # all
        (NO_UUID, 20, (A, B)),  # all until then
        (C, 10, (A, C)),  # all until then, and one
    ],
)
def test_a_cancel_request_chooses_goals(uuid: bytes, stamp: int, goals: tuple[bytes, ...]) -> None:
    core = ActionCore()
    for number, it in enumerate((A, B, C)):
        accepted(core, it, request=number, stamp=10 * (number + 1))
    assert core.step(events.CancelRequested(9, uuid, stamp), 0.0) == [events.AskCancel(9, goals)]


@pytest.mark.parametrize(
    ("uuid", "stamp", "code"),
    [
        (B, 0, CancelCode.UNKNOWN_GOAL),
        (NO_UUID, 0, CancelCode.NONE),
        (A, 0, CancelCode.TERMINATED),
        (B, 9, CancelCode.NONE),
    ],
)
def test_a_cancel_request_without_goals_is_answered(uuid: bytes, stamp: int, code: CancelCode) -> None:
    core = ActionCore()
    accepted(core, A)
    ended(core, A)
    assert core.step(events.CancelRequested(9, uuid, stamp), 0.0) == [events.AnswerCancel(9, code)]


def test_a_goal_that_is_canceling_cannot_be_canceled_again() -> None:
    core = ActionCore()
    accepted(core, A)
    core.step(events.CancelDecided(8, (A,)), 0.0)
    assert core.step(events.CancelRequested(9, A, 0), 0.0) == [events.AnswerCancel(9, CancelCode.TERMINATED)]


def test_goals_that_may_be_canceled_are_canceling() -> None:
    core = ActionCore()
    accepted(core, A)
    accepted(core, B)
    infos = (GoalInfo(B, 1, Status.CANCELING),)
    assert core.step(events.CancelDecided(9, (B,)), 0.0) == [
        events.AnswerCancel(9, CancelCode.NONE, infos),
        events.PublishStatus((GoalInfo(A, 1, Status.ACCEPTED), *infos)),
        events.TellCanceling(B),
    ]


@pytest.mark.parametrize("new", [Status.EXECUTING, *ENDS])
@pytest.mark.parametrize("old", [Status.ACCEPTED, Status.EXECUTING, Status.CANCELING, *ENDS])
def test_the_program_makes_legal_transitions_only(old: Status, new: Status) -> None:
    core = ActionCore()
    accepted(core, A)
    if old in (Status.CANCELING, Status.CANCELED):
        core.step(events.CancelDecided(9, (A,)), 0.0)
    if old in ENDS:
        ended(core, A, old)
    elif old is Status.EXECUTING:
        core.step(events.StatusChanged(A, Status.EXECUTING), 0.0)
    assert core.status(A) is old
    if (old, new) in LEGAL:
        core.step(events.StatusChanged(A, new), 0.0)
        assert core.status(A) is new
    elif (old, new) != (Status.CANCELING, Status.EXECUTING):  # which changes nothing
        with pytest.raises(IllegalTransition, match=f"is {old.name}, it cannot become {new.name}"):
            core.step(events.StatusChanged(A, new), 0.0)


def test_a_cancel_may_come_between_acceptance_and_execution() -> None:
    core = ActionCore()
    accepted(core, A)
    core.step(events.CancelDecided(9, (A,)), 0.0)
    assert core.step(events.StatusChanged(A, Status.EXECUTING), 0.0) == []
    assert core.status(A) is Status.CANCELING


def test_a_cancel_request_is_rejected_if_no_goal_may_be_canceled() -> None:
    core = ActionCore()
    accepted(core, A)
    assert core.step(events.CancelDecided(9, ()), 0.0) == [events.AnswerCancel(9, CancelCode.REJECTED)]


def test_a_goal_that_ends_before_the_decision_on_its_cancel_is_terminated() -> None:
    core = ActionCore()
    accepted(core, A)
    ended(core, A)
    assert core.step(events.CancelDecided(9, (A,)), 0.0) == [events.AnswerCancel(9, CancelCode.TERMINATED)]


def test_feedback_is_published_of_active_goals_only() -> None:
    core = ActionCore()
    accepted(core, A)
    assert core.step(events.FeedbackGiven(A, "half"), 0.0) == [events.PublishFeedback(A, "half")]
    ended(core, A)
    assert core.step(events.FeedbackGiven(A, "all"), 0.0) == []


def test_an_end_of_the_server_ends_all_goals() -> None:
    core = ActionCore()
    accepted(core, A)
    core.step(events.GoalRequested(2, B, B), 0.0)
    core.step(events.ResultRequested(3, A), 0.0)
    actions = core.step(events.ServerClosed("closed"), 0.0)
    assert events.AnswerResult(3, Status.ABORTED, "closed") in actions
    assert events.AnswerGoal(2, accepted=False) in actions
    assert core.step(events.GoalRequested(4, C, C), 0.0) == [events.AnswerGoal(4, accepted=False)]


class RandomEvents(RuleBasedStateMachine):
    """Any events in any order, the program's illegal ones among them."""

    uuids = st.sampled_from([bytes([number]) * 16 for number in range(1, 7)])
    which = st.integers(0, 4)  # of the known goals, or another

    def __init__(self) -> None:
        super().__init__()
        self.core = ActionCore(result_timeout=3.0, most_goals=4)
        self.now, self.numbers = 0.0, count()
        self.open: set[int] = set()  # requests without an answer
        self.answers: dict[int, int] = {}
        self.states: dict[bytes, Status] = {}  # as published
        self.asked: dict[int, tuple[bytes, ...]] = {}
        self.closed = False

    def step(self, event: events.Event, may_be_illegal: bool = False) -> None:
        self.core.step(events.FeedbackGiven(NO_UUID, None), self.now)  # forgets old results
        before = repr(self.core.goals) if may_be_illegal else ""
        try:
            actions = self.core.step(event, self.now)
        except IllegalTransition:
            assert may_be_illegal
            assert repr(self.core.goals) == before
            return
        for action in actions:
            match action:
                case events.AskCancel(request, goals):
                    self.asked[request] = goals
                case events.PublishStatus(goals):
                    self.publish(goals)
                case events.AnswerGoal(request) | events.AnswerCancel(request) | events.AnswerResult(request):
                    self.answers[request] = self.answers.get(request, 0) + 1
                    self.open.discard(request)

    def publish(self, goals: tuple[GoalInfo, ...]) -> None:
        assert goals == self.core.infos()
        for info in goals:
            old = self.states.get(info.uuid)
            if self.closed and old is Status.ACCEPTED:
                old = Status.EXECUTING  # the end of the server takes both steps at once
            if old in ENDS and info.status is not old:
                old = None  # a goal with the id of a forgotten one
                assert info.status is Status.ACCEPTED
            assert old in (None, info.status) or (old, info.status) in LEGAL
            self.states[info.uuid] = info.status

    def request(self) -> int:
        number = next(self.numbers)
        self.open.add(number)
        return number

    def uuid(self, which: int) -> bytes:
        return [*self.core.goals, bytes(15) + b"?"][which % (len(self.core.goals) + 1)]

    @rule(uuid=uuids)
    def send_goal(self, uuid: bytes) -> None:
        self.step(events.GoalRequested(self.request(), uuid, uuid))

    @rule(which=which, accept=st.sampled_from([True, True, False]))
    def decide(self, which: int, accept: bool) -> None:
        self.step(events.GoalDecided(self.uuid(which), accept, stamp=int(self.now) + 1), may_be_illegal=True)

    @rule(which=which, status=st.sampled_from([Status.EXECUTING, *ENDS]))
    def change(self, which: int, status: Status) -> None:
        self.step(events.StatusChanged(self.uuid(which), status, "result"), may_be_illegal=True)

    @rule(which=which, stamp=st.sampled_from([0, 1, 2, 5, -1]))
    def cancel(self, which: int, stamp: int) -> None:
        self.step(events.CancelRequested(self.request(), self.uuid(which), stamp))

    @rule(stamp=st.sampled_from([0, 0, 2]))
    def cancel_all(self, stamp: int) -> None:
        self.step(events.CancelRequested(self.request(), NO_UUID, stamp))

    @precondition(lambda self: self.asked)
    @rule(data=st.data())
    def decide_cancel(self, data: st.DataObject) -> None:
        request, goals = self.asked.popitem()
        chosen = data.draw(st.lists(st.sampled_from(goals), unique=True))
        self.step(events.CancelDecided(request, tuple(chosen)))

    @rule(which=which)
    def ask_result(self, which: int) -> None:
        self.step(events.ResultRequested(self.request(), self.uuid(which)))

    @rule(seconds=st.sampled_from([0.5, 2.0, 4.0]))
    def wait(self, seconds: float) -> None:
        self.now += seconds

    @precondition(lambda self: not self.closed and self.now > 8.0)
    @rule()
    def close(self) -> None:
        self.closed = True
        self.step(events.ServerClosed("closed"))

    @invariant()
    def each_request_has_one_answer(self) -> None:
        assert all(number == 1 for number in self.answers.values())
        waiting = {request for goal in self.core.goals.values() for request in goal.waiting}
        undecided = {goal.request for goal in self.core.goals.values() if goal.status is Status.UNKNOWN}
        assert self.open == waiting | undecided | set(self.asked)

    @invariant()
    def only_active_goals_have_waiting_requests(self) -> None:
        assert all(goal.status in ACTIVE for goal in self.core.goals.values() if goal.waiting)
        assert len(self.core.goals) <= 4

    @invariant()
    def the_published_states_are_true(self) -> None:
        for info in self.core.infos():
            assert self.states[info.uuid] is info.status


TestRandomEvents = RandomEvents.TestCase
TestRandomEvents.settings = settings(max_examples=60, stateful_step_count=50, derandomize=True, deadline=None)
