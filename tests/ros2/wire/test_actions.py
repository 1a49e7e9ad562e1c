"""The rules of an action server, without a network. tests/ros2/world judges random sequences of requests."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from hyperbit.controller.ros2.wire.actions import (
    NO_UUID,
    ActionServer,
    CancelCode,
    GoalHandle,
    IllegalTransition,
    Policy,
    Status,
)
from hyperbit.controller.ros2.wire.endpoints import Received, Request
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import SECOND, Computer
from hyperbit.controller.ros2.wire.types import Types

A, B, C = (bytes([number]) * 16 for number in (1, 2, 3))
FOLLOW = "control_msgs/action/FollowJointTrajectory"
TYPES = Types("jazzy")
ENDS = (Status.SUCCEEDED, Status.CANCELED, Status.ABORTED)
# The transitions of rcl_action, see goal_state_machine.c of ros2/rcl.
LEGAL = {
    (Status.ACCEPTED, Status.EXECUTING),
    (Status.EXECUTING, Status.SUCCEEDED),
    (Status.EXECUTING, Status.ABORTED),
    (Status.CANCELING, Status.SUCCEEDED),
    (Status.CANCELING, Status.ABORTED),
    (Status.CANCELING, Status.CANCELED),
}


class Side:
    """A server in a node that keeps what is published; the time of acceptance is that of `now` [s]."""

    def __init__(self, **policy: Any) -> None:
        self.now, self.handles = 1.0, dict[bytes, GoalHandle]()
        self.published, self._handlers = dict[str, list[Any]](), dict[str, Any]()
        self.told = list[bytes]()
        computer = Computer(monotonic=lambda: self.now, time_ns=lambda: round(self.now * SECOND))
        node = SimpleNamespace(types=TYPES, session=SimpleNamespace(computer=computer))
        node.token = SimpleNamespace(namespace="/", node="arm")
        node.publisher, node.service = self._publisher, self._service
        on_cancel = lambda goal: self.told.append(goal.uuid)  # noqa: E731
        self.server = ActionServer(
            cast("Node", node), "follow", FOLLOW, self._on_goal, Policy(on_cancel=on_cancel, **policy)
        )

    def _publisher(self, topic: str, *_: object) -> SimpleNamespace:
        return SimpleNamespace(publish=self.published.setdefault(topic.rpartition("/")[2], []).append)

    def _service(self, name: str, _: str, handler: Any) -> None:
        self._handlers[name.rpartition("/")[2]] = handler

    def _on_goal(self, goal: GoalHandle) -> None:
        self.handles[goal.uuid] = goal

    def _ask(self, service: str, message: SimpleNamespace) -> list[Any]:
        replies = list[Any]()
        self._handlers[service](Request(Received(message, 1, 1, A), replies.append))
        return replies

    def send(self, uuid: bytes) -> list[Any]:
        return self._ask("send_goal", SimpleNamespace(goal_id=SimpleNamespace(uuid=uuid), goal="goal"))

    def ask_result(self, uuid: bytes) -> list[Any]:
        return self._ask("get_result", SimpleNamespace(goal_id=SimpleNamespace(uuid=uuid)))

    def cancel(self, uuid: bytes, sec: int = 0) -> tuple[int, list[bytes]]:
        info = SimpleNamespace(goal_id=SimpleNamespace(uuid=uuid), stamp=SimpleNamespace(sec=sec, nanosec=0))
        [answer] = self._ask("cancel_goal", SimpleNamespace(goal_info=info))
        return answer["return_code"], [it["goal_id"]["uuid"] for it in answer["goals_canceling"]]

    def accepted(self, uuid: bytes) -> GoalHandle:
        self.send(uuid)
        self.handles[uuid].accept()
        return self.handles[uuid]

    def ended(self, uuid: bytes) -> GoalHandle:
        goal = self.accepted(uuid)
        goal.execute()
        goal.succeed({})
        return goal

    def states(self) -> dict[bytes, Status]:
        listed = self.published["status"][-1]["status_list"]
        return {it["goal_info"]["goal_id"]["uuid"]: Status(it["status"]) for it in listed}


def test_a_goal_is_answered_once_it_is_decided_and_a_rejected_one_is_forgotten() -> None:
    side = Side()
    replies = side.send(A)
    assert replies == []
    side.handles[A].accept()
    assert replies == [{"accepted": True, "stamp": {"sec": 1, "nanosec": 0}}]
    assert side.states() == {A: Status.ACCEPTED}
    replies = side.send(B)
    side.handles[B].reject()
    assert replies == [{"accepted": False}]
    assert side.send(B) == []


@pytest.mark.parametrize("until", ["asked", "running", "ended"])
def test_a_known_id_is_rejected(until: str) -> None:
    side = Side()
    {"asked": side.send, "running": side.accepted, "ended": side.ended}[until](A)
    assert side.send(A) == [{"accepted": False}]


def test_a_result_is_answered_before_and_after_the_end_and_kept_for_its_time() -> None:
    side = Side(result_timeout=10.0)
    goal = side.accepted(A)
    first = side.ask_result(A)
    goal.execute()
    assert (first, side.server.open) == ([], 1)
    goal.abort({"error_code": 7})
    assert [(it["status"], it["result"].error_code) for it in first + side.ask_result(A)] == [(Status.ABORTED, 7)] * 2
    side.now += 10.0
    assert side.ask_result(A)[0]["status"] == Status.ABORTED
    side.now += 0.1
    assert side.ask_result(A) == [{"status": Status.UNKNOWN}]


def test_the_handle_of_a_forgotten_goal_does_not_change_a_new_goal_of_its_id() -> None:
    side = Side(result_timeout=10.0)
    old = side.ended(A)
    side.now += 10.1
    new = side.accepted(A)
    new.execute()
    with pytest.raises(IllegalTransition, match="is SUCCEEDED"):
        old.abort({})
    old.feedback({})
    assert (new.status, side.published["feedback"]) == (Status.EXECUTING, [])


@pytest.mark.parametrize("sent", [True, False])
def test_the_result_of_a_goal_that_is_not_accepted_is_unknown(sent: bool) -> None:
    side = Side()
    if sent:
        side.send(A)
    assert side.ask_result(A) == [{"status": Status.UNKNOWN}]


@pytest.mark.parametrize(
    ("uuid", "sec", "chosen"),
    [(B, 0, [B]), (NO_UUID, 0, [A, B, C]), (NO_UUID, 20, [A, B]), (C, 10, [A, C]), (B, 9, [B]), (NO_UUID, 9, [])],
)
def test_a_cancel_names_goals_by_id_and_time(uuid: bytes, sec: int, chosen: list[bytes]) -> None:
    side = Side()
    for side.now, each in ((10.0, A), (20.0, B), (30.0, C)):
        side.accepted(each)
    assert side.cancel(uuid, sec) == (CancelCode.NONE, chosen)
    assert side.told == chosen
    assert side.states() == {it: Status.CANCELING if it in chosen else Status.ACCEPTED for it in (A, B, C)}


def test_a_cancel_of_what_cannot_be_canceled_says_why() -> None:
    side = Side()
    assert side.cancel(A) == (CancelCode.UNKNOWN_GOAL, [])
    assert side.cancel(NO_UUID) == (CancelCode.NONE, [])
    side.ended(A)
    assert side.cancel(A) == (CancelCode.TERMINATED, [])
    side.accepted(B)
    side.cancel(B)
    assert side.cancel(B) == (CancelCode.TERMINATED, [])
    side.send(C)
    assert side.cancel(C) == (CancelCode.UNKNOWN_GOAL, [])
    assert Side(may_cancel=lambda goal: False).cancel(NO_UUID) == (CancelCode.NONE, [])


@pytest.mark.parametrize(("may", "code"), [(True, CancelCode.TERMINATED), (False, CancelCode.REJECTED)])
def test_a_cancel_whose_goal_ends_first_is_terminated_and_one_of_no_goal_is_rejected(may: bool, code: int) -> None:
    side = Side(may_cancel=lambda goal: goal.abort({}) is None if may else False)
    side.accepted(A).execute()
    assert side.cancel(A) == (code, [])


def test_a_cancel_may_come_between_acceptance_and_execution() -> None:
    side = Side()
    goal = side.accepted(A)
    side.cancel(A)
    goal.execute()
    assert goal.status is Status.CANCELING


def test_feedback_is_published_of_active_goals_only() -> None:
    side = Side()
    side.accepted(A).feedback({"joint_names": ["a"]})
    side.ended(B).feedback({})
    assert side.published["feedback"] == [{"goal_id": {"uuid": A}, "feedback": {"joint_names": ["a"]}}]


def test_the_end_of_the_server_ends_all_goals() -> None:
    side = Side()
    goal, undecided = side.accepted(A), side.send(B)
    waiting = side.ask_result(A)
    side.server.close({"error_code": 3})
    assert (waiting[0]["status"], waiting[0]["result"].error_code) == (Status.ABORTED, 3)
    assert (undecided, goal.status, side.states()) == ([{"accepted": False}], Status.ABORTED, {A: Status.ABORTED})
    assert side.send(C) == [{"accepted": False}]


def test_further_goals_are_rejected_unless_one_has_ended() -> None:
    side = Side(most_goals=2)
    side.accepted(A)
    goal = side.accepted(B)
    assert side.send(C) == [{"accepted": False}]
    goal.execute()
    goal.succeed({})
    side.accepted(C)
    assert side.states().keys() == {A, C}


@pytest.mark.parametrize("new", [Status.EXECUTING, *ENDS])
@pytest.mark.parametrize("old", [Status.ACCEPTED, Status.EXECUTING, Status.CANCELING, *ENDS])
def test_the_program_makes_legal_transitions_only(old: Status, new: Status) -> None:
    def move(status: Status) -> None:
        goal.execute() if status is Status.EXECUTING else goal.end(status, {})

    side = Side()
    goal = side.accepted(A)
    if old in (Status.CANCELING, Status.CANCELED):
        side.cancel(A)
    elif old is not Status.ACCEPTED:
        goal.execute()
    if old in ENDS:
        goal.end(old, {})
    assert goal.status is old
    if (old, new) in LEGAL:
        move(new)
        assert goal.status is new
    elif (old, new) != (Status.CANCELING, Status.EXECUTING):  # which changes nothing
        with pytest.raises(IllegalTransition, match=f"is {old.name}, it cannot become {new.name}"):
            move(new)


@pytest.mark.parametrize("accepted", [True, False])
def test_only_a_goal_that_waits_is_decided(accepted: bool) -> None:
    side = Side()
    side.send(A)
    goal = side.handles[A]
    goal.accept() if accepted else goal.reject()
    for decide in (goal.accept, goal.reject):
        with pytest.raises(IllegalTransition, match="does not wait for a decision"):
            decide()
