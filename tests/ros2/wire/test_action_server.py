"""An action server on the wire."""

import queue
import threading
from collections.abc import Callable
from typing import Any

import pytest

from hyperbit.controller.ros2.wire.actions import CancelCode, GoalHandle, IllegalTransition, Policy, Status
from hyperbit.controller.ros2.wire.cdr import BadMessage
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from tests.network.played import Router
from tests.ros2.client import Client
from tests.ros2.oracle.script import ABORTED, CANCELED, REJECTED_ORDER, SUCCEEDED, UNCANCELABLE_ORDER, script
from tests.waiting import PATIENCE, eventually

FIBONACCI = "test_msgs/action/Fibonacci"
DEFINITION = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n"
HASHES = {f"{FIBONACCI}_{part}": "RIHS01_" + "0" * 64 for part in ("SendGoal", "GetResult", "FeedbackMessage")}
LATER, RAISES, CANCEL_RAISES = 10, 11, 12  # orders of goals
A = [1] * 16


class Side:
    """The script's side of the wire: a program with an action server, and its client. Goals wait for their end."""

    def __init__(self, connect: Callable[[], Session]) -> None:
        self.node, client = Node(connect(), "server"), Node(connect(), "client")
        for node in (self.node, client):
            node.types.register(FIBONACCI, DEFINITION, HASHES)
        self.handles: dict[int, GoalHandle] = {}
        self.canceling: list[int] = []
        policy = Policy(may_cancel=self.may_cancel, on_cancel=lambda goal: self.canceling.append(goal.uuid[0]))
        self.server = self.node.action_server("fibonacci", FIBONACCI, self.on_goal, policy)
        self.client = Client(client, "fibonacci", FIBONACCI)
        eventually(lambda: len(self.node.session.tokens()) == 12)

    def on_goal(self, goal: GoalHandle) -> None:
        order = goal.goal.order
        if order == RAISES:
            raise RuntimeError("of the program")
        if order == REJECTED_ORDER:
            goal.reject()
            return
        if order != LATER:
            goal.accept()
            goal.execute()
        self.handles[goal.uuid[0]] = goal

    def may_cancel(self, goal: GoalHandle) -> bool:
        if goal.goal.order == CANCEL_RAISES:
            raise RuntimeError("of the program")
        return bool(goal.goal.order != UNCANCELABLE_ORDER)

    def send_goal(self, uuid: list[int], order: int = 1) -> bool:
        return bool(self.client.send_goal({"order": order}, bytes(uuid))[1].accepted)

    def handle(self, uuid: list[int]) -> GoalHandle:
        """Waits until the program has a goal."""
        handle = eventually(lambda: self.handles.get(uuid[0]))
        assert handle
        return handle

    def ask_result(self, uuid: list[int]) -> Callable[[], list[Any]]:
        got: queue.Queue[Any] = queue.Queue()
        threading.Thread(target=lambda: got.put(self.client.get_result(bytes(uuid)))).start()

        def result() -> list[Any]:
            response = got.get(timeout=PATIENCE)
            return [response.status, response.result.sequence.tolist()]

        return result

    def cancel(self, uuid: list[int], sec: int = 0) -> list[Any]:
        code, goals = self.client.cancel(bytes(uuid), sec)
        return [code, [it[0] for it in goals]]

    def end(self, uuid: list[int], how: int, sequence: list[int]) -> None:
        handle = self.handle(uuid)
        {SUCCEEDED: handle.succeed, CANCELED: handle.canceled, ABORTED: handle.abort}[how]({"sequence": sequence})

    def feedback(self, uuid: list[int], sequence: list[int]) -> list[Any]:
        handle = self.handle(uuid)
        eventually(lambda: (handle.feedback({"sequence": sequence}), self.client.feedback)[1])
        heard = self.client.feedback[0]
        return [int(heard.goal_id.uuid[0]), heard.feedback.sequence.tolist()]

    def until(self, uuid: list[int], status: int) -> list[list[int]]:
        known = lambda: [[[it[0], int(at)] for it, at in states] for states in self.client.states]  # noqa: E731
        return eventually(lambda: next((it for it in known() if [uuid[0], status] in it), []))


@pytest.fixture
def side(connect: Callable[[], Session]) -> Side:
    return Side(connect)


def test_actions_behave_as_those_of_rclpy(side: Side) -> None:
    for what, seen, expected in script(side):
        assert seen == expected, what
    assert side.canceling == [2, 4, 5, 8, 9]


def test_a_goal_is_rejected_if_the_program_raises_and_may_come_again(side: Side) -> None:
    for order in (REJECTED_ORDER, RAISES):
        assert not side.send_goal(A, order)
        assert side.ask_result(A)() == [Status.UNKNOWN, []]
    assert side.send_goal(A)


def test_a_goal_may_be_accepted_later(side: Side) -> None:
    got: queue.Queue[bool] = queue.Queue()
    threading.Thread(target=lambda: got.put(side.send_goal(A, LATER))).start()
    handle = side.handle(A)
    assert (handle.goal.order, handle.status) == (LATER, Status.UNKNOWN)
    handle.accept()
    assert got.get(timeout=PATIENCE)
    assert handle.status is Status.ACCEPTED


def test_goals_are_canceled_by_their_time(side: Side) -> None:
    stamp = side.client.send_goal({"order": 1}, bytes(A))[1].stamp.sec
    assert stamp > 1_600_000_000
    for sec, canceled in ((stamp - 10, []), (-1, []), (stamp + 10, [1])):
        assert side.cancel([0] * 16, sec) == [CancelCode.NONE, canceled]


def test_a_cancel_is_rejected_if_the_program_raises(side: Side) -> None:
    side.send_goal(A, CANCEL_RAISES)
    assert side.cancel(A) == [CancelCode.REJECTED, []]
    assert side.handle(A).status is Status.EXECUTING


def test_the_program_cannot_make_illegal_transitions(side: Side) -> None:
    side.send_goal(A)
    handle = side.handle(A)
    with pytest.raises(IllegalTransition, match="EXECUTING, it cannot become CANCELED"):
        handle.canceled({})
    with pytest.raises(BadMessage, match="no field 'code'"):
        handle.succeed({"code": 1})
    with pytest.raises(BadMessage, match="no field 'joints'"):
        handle.feedback({"joints": 1})
    handle.succeed({})
    with pytest.raises(IllegalTransition, match="SUCCEEDED"):
        handle.abort({})
    handle.feedback({})  # is dropped
    assert side.ask_result(A)() == [SUCCEEDED, []]


def test_the_end_of_the_node_answers_what_waits(side: Side) -> None:
    side.send_goal(A)
    wait = side.ask_result(A)
    eventually(lambda: side.server.open)
    side.node.close()
    assert wait() == [ABORTED, []]


def test_goals_survive_the_routers_loss(side: Side, router: Router) -> None:
    side.send_goal(A)
    router.end()
    side.end(A, SUCCEEDED, [7])
    eventually(lambda: not side.node.session.connected())
    router.start()
    # The first queries may find no service yet.
    found = eventually(lambda: side.client.get_result(bytes(A)))
    assert (found.status, found.result.sequence.tolist()) == (SUCCEEDED, [7])
