"""The core of an action server: rules of rcl_action. tests/ros2/world judges random sequences of events."""

from typing import Any

import pytest

from hyperbit.controller.ros2.wire import action_events as events
from hyperbit.controller.ros2.wire.action_core import NO_UUID, ActionCore, IllegalTransition
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


Step = tuple[events.Event, list[Action] | None]  # None: its actions are those of an earlier case


def asked(request: int, uuid: bytes) -> Step:
    return events.GoalRequested(request, uuid, uuid), [events.AskGoal(uuid)]


def accepted(uuid: bytes, request: int = 0, stamp: int = 1) -> list[Step]:
    return [asked(request, uuid), (events.GoalDecided(uuid, accepted=True, stamp=stamp), None)]


def ended(uuid: bytes, status: Status = Status.SUCCEEDED) -> list[Step]:
    return [
        (events.StatusChanged(uuid, Status.EXECUTING), None),
        (events.StatusChanged(uuid, status, "result"), None),
    ]


def cancel(uuid: bytes, stamp: int, *answer: Action) -> Step:
    return events.CancelRequested(9, uuid, stamp), list(answer)


def refused(request: int, uuid: bytes) -> Step:
    return events.GoalRequested(request, uuid, uuid), [events.AnswerGoal(request, accepted=False)]


ALL_THREE = [*accepted(A, 0, 10), *accepted(B, 1, 20), *accepted(C, 2, 30)]
CANCELING_B = GoalInfo(B, 1, Status.CANCELING)
CASES: dict[str, list[Step]] = {
    "an accepted goal is answered and published": [
        asked(7, A),
        (
            events.GoalDecided(A, accepted=True, stamp=5),
            [events.AnswerGoal(7, accepted=True, stamp=5), events.PublishStatus((GoalInfo(A, 5, Status.ACCEPTED),))],
        ),
    ],
    "a rejected goal is answered and forgotten": [
        asked(7, A),
        (events.GoalDecided(A, accepted=False, stamp=0), [events.AnswerGoal(7, accepted=False)]),
        asked(8, A),
    ],
    "a known id is rejected while it is asked for": [asked(0, A), refused(1, A)],
    "a known id is rejected while it runs": [*accepted(A), refused(1, A)],
    "a known id is rejected after its end": [*accepted(A), *ended(A), refused(1, A)],
    "a result is answered before and after the end": [
        *accepted(A),
        (events.ResultRequested(1, A), []),
        (events.StatusChanged(A, Status.EXECUTING), None),
        (
            events.StatusChanged(A, Status.ABORTED, "result"),
            [
                events.AnswerResult(1, Status.ABORTED, "result"),
                events.PublishStatus((GoalInfo(A, 1, Status.ABORTED),)),
            ],
        ),
        (events.ResultRequested(2, A), [events.AnswerResult(2, Status.ABORTED, "result")]),
    ],
    "the result of a goal that nobody has sent is unknown": [
        (events.ResultRequested(1, A), [events.AnswerResult(1, Status.UNKNOWN, None)])
    ],
    "the result of a goal that is not decided is unknown": [
        asked(0, A),
        (events.ResultRequested(1, A), [events.AnswerResult(1, Status.UNKNOWN, None)]),
    ],
    "a cancel names one goal": [*ALL_THREE, cancel(B, 0, events.AskCancel(9, (B,)))],
    "a cancel names all goals": [*ALL_THREE, cancel(NO_UUID, 0, events.AskCancel(9, (A, B, C)))],
    "a cancel names all goals until a time": [*ALL_THREE, cancel(NO_UUID, 20, events.AskCancel(9, (A, B)))],
    "a cancel names all goals until a time, and one": [*ALL_THREE, cancel(C, 10, events.AskCancel(9, (A, C)))],
    "a cancel of an unknown goal": [cancel(B, 0, events.AnswerCancel(9, CancelCode.UNKNOWN_GOAL))],
    "a cancel of all of no goals": [cancel(NO_UUID, 0, events.AnswerCancel(9, CancelCode.NONE))],
    "a cancel of an ended goal": [*accepted(A), *ended(A), cancel(A, 0, events.AnswerCancel(9, CancelCode.TERMINATED))],
    "a cancel of no goals until a time": [
        *accepted(A),
        *ended(A),
        cancel(B, 9, events.AnswerCancel(9, CancelCode.NONE)),
    ],
    "a goal that is canceling cannot be canceled again": [
        *accepted(A),
        (events.CancelDecided(8, (A,)), None),
        cancel(A, 0, events.AnswerCancel(9, CancelCode.TERMINATED)),
    ],
    "goals that may be canceled are canceling": [
        *accepted(A),
        *accepted(B),
        (
            events.CancelDecided(9, (B,)),
            [
                events.AnswerCancel(9, CancelCode.NONE, (CANCELING_B,)),
                events.PublishStatus((GoalInfo(A, 1, Status.ACCEPTED), CANCELING_B)),
                events.TellCanceling(B),
            ],
        ),
    ],
    "a cancel may come between acceptance and execution": [
        *accepted(A),
        (events.CancelDecided(9, (A,)), None),
        (events.StatusChanged(A, Status.EXECUTING), []),
    ],
    "a cancel is rejected if no goal may be canceled": [
        *accepted(A),
        (events.CancelDecided(9, ()), [events.AnswerCancel(9, CancelCode.REJECTED)]),
    ],
    "a goal that ends before the decision on its cancel is terminated": [
        *accepted(A),
        *ended(A),
        (events.CancelDecided(9, (A,)), [events.AnswerCancel(9, CancelCode.TERMINATED)]),
    ],
    "feedback is published of active goals only": [
        *accepted(A),
        (events.FeedbackGiven(A, "half"), [events.PublishFeedback(A, "half")]),
        *ended(A),
        (events.FeedbackGiven(A, "all"), []),
    ],
    "an end of the server ends all goals": [
        *accepted(A),
        asked(2, B),
        (events.ResultRequested(3, A), []),
        (
            events.ServerClosed("closed"),
            [
                events.AnswerResult(3, Status.ABORTED, "closed"),
                events.AnswerGoal(2, accepted=False),
                events.PublishStatus((GoalInfo(A, 1, Status.ABORTED),)),
            ],
        ),
        refused(4, C),
    ],
}


@pytest.mark.parametrize("steps", CASES.values(), ids=CASES)
def test_each_event_has_its_actions(steps: list[Step]) -> None:
    core = ActionCore()
    for event, actions in steps:
        found = core.step(event, 0.0)
        assert actions is None or sorted(map(repr, found)) == sorted(map(repr, actions))


def core_after(*steps: Step, now: float = 0.0, **settings: Any) -> ActionCore:
    core = ActionCore(**settings)
    for event, _ in steps:
        core.step(event, now)
    return core


def test_a_result_is_kept_for_its_time() -> None:
    core = core_after(*accepted(A), *ended(A), now=5.0, result_timeout=10.0)
    known, unknown = (events.AnswerResult(1, Status.SUCCEEDED, "result"), events.AnswerResult(1, Status.UNKNOWN, None))
    assert core.step(events.ResultRequested(1, A), 15.0) == [known]
    assert core.step(events.ResultRequested(1, A), 15.1) == [unknown]
    assert core.step(events.GoalRequested(2, A, A), 15.2) == [events.AskGoal(A)]


def test_further_goals_are_rejected_unless_one_has_ended() -> None:
    core = core_after(*accepted(A), *accepted(B), most_goals=2)
    assert core.step(events.GoalRequested(2, C, C), 0.0) == [events.AnswerGoal(2, accepted=False)]
    for event, _ in ended(B):
        core.step(event, 0.0)
    assert core.step(events.GoalRequested(3, C, C), 0.0) == [events.AskGoal(C)]
    assert list(core.goals) == [A, C]


@pytest.mark.parametrize("new", [Status.EXECUTING, *ENDS])
@pytest.mark.parametrize("old", [Status.ACCEPTED, Status.EXECUTING, Status.CANCELING, *ENDS])
def test_the_program_makes_legal_transitions_only(old: Status, new: Status) -> None:
    steps = accepted(A)
    if old in (Status.CANCELING, Status.CANCELED):
        steps.append((events.CancelDecided(9, (A,)), None))
    if old in ENDS:
        steps += ended(A, old)
    elif old is Status.EXECUTING:
        steps.append((events.StatusChanged(A, Status.EXECUTING), None))
    core = core_after(*steps)
    assert core.status(A) is old
    if (old, new) in LEGAL:
        core.step(events.StatusChanged(A, new), 0.0)
        assert core.status(A) is new
    elif (old, new) != (Status.CANCELING, Status.EXECUTING):  # which changes nothing
        with pytest.raises(IllegalTransition, match=f"is {old.name}, it cannot become {new.name}"):
            core.step(events.StatusChanged(A, new), 0.0)


@pytest.mark.parametrize("uuid", [A, B])
def test_only_a_goal_that_waits_is_decided(uuid: bytes) -> None:
    core = core_after(*accepted(A))
    with pytest.raises(IllegalTransition, match="does not wait for a decision"):
        core.step(events.GoalDecided(uuid, accepted=True, stamp=2), 0.0)
