"""An action server on the wire, driven by a client that shares no code with it."""

import threading
from collections.abc import Callable
from typing import Any

import pytest

from hyperbit.controller.ros2.wire.action_core import IllegalTransition
from hyperbit.controller.ros2.wire.action_events import Status
from hyperbit.controller.ros2.wire.action_server import ActionServer, GoalHandle, Policy
from hyperbit.controller.ros2.wire.cdr import BadMessage
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from tests.ros2.client import ABORTED, CANCELED, CANCELING, EXECUTING, SUCCEEDED, Client, Result
from tests.waiting import PATIENCE, eventually

FOLLOW = "control_msgs/action/FollowJointTrajectory"
Connect = Callable[[], Session]


class Arm:
    """A program with an action server; goals wait in `goals` until the test ends them."""

    def __init__(self, session: Session, distro: str = "jazzy", **policy: Any) -> None:
        self.node = Node(session, "arm", distro=distro)
        self.goals: list[GoalHandle] = []
        self.canceling: list[GoalHandle] = []
        settings = Policy(on_cancel=self.canceling.append, **policy)
        self.server: ActionServer = self.node.action_server("follow", FOLLOW, self.on_goal, settings)

    def on_goal(self, goal: GoalHandle) -> None:
        joint = goal.goal.trajectory.joint_names[0]
        if joint == "raises":
            raise RuntimeError("of the program")
        if joint == "unknown":
            goal.reject()
            return
        goal.accept()
        goal.execute()
        self.goals.append(goal)

    def goal(self, number: int = 0) -> GoalHandle:
        """The goal of this number, once it is executed, which the client need not have waited for."""
        return eventually(lambda: self.goals[number : number + 1])[0]


@pytest.fixture
def arm(connect: Connect) -> Arm:
    return Arm(connect())


@pytest.fixture
def client(connect: Connect, arm: Arm) -> Client:
    client = Client(connect().zenoh, "follow")
    eventually(lambda: len(arm.node.session.tokens()) == 6)
    return client


def asked(client: Client, goal: bytes) -> tuple[threading.Thread, list[Result | None]]:
    got: list[Result | None] = []
    thread = threading.Thread(target=lambda: got.append(client.get_result(goal)))
    thread.start()
    return thread, got


@pytest.mark.parametrize("distro", ["jazzy", "kilted"])
def test_a_goal_succeeds_with_feedback_and_one_result(connect: Connect, distro: str) -> None:
    arm = Arm(connect(), distro)
    client = Client(connect().zenoh, "follow", "jazzy" if distro == "jazzy" else "kilted")
    goal, accepted, stamp = client.send_goal(joint="j1")
    assert accepted
    assert stamp > 1_600_000_000
    assert arm.goal().uuid == goal
    points = arm.goal().goal.trajectory.points
    assert [(list(it.positions), it.time_from_start.sec) for it in points] == [([0.5], 1), ([1.0], 2)]
    thread, got = asked(client, goal)
    eventually(lambda: (arm.goal().feedback({"joint_names": ["j1"]}), client.feedback)[1])
    assert client.feedback[0] == (goal, "j1")
    assert not got
    arm.goal().succeed({"error_code": 0, "error_string": "there"})
    thread.join(PATIENCE)
    assert got == [Result(SUCCEEDED, 0, "there")]
    assert client.get_result(goal) == Result(SUCCEEDED, 0, "there")  # after the end, too
    eventually(lambda: client.states and client.states[-1] == [(goal, SUCCEEDED)])


def test_a_goal_is_rejected(arm: Arm, client: Client) -> None:
    goal, accepted, stamp = client.send_goal(joint="unknown")
    assert not accepted
    assert stamp == 0
    assert client.get_result(goal) == Result(0, 0, "")
    assert not arm.goals


def test_a_goal_is_rejected_if_the_program_raises(arm: Arm, client: Client) -> None:
    goal, accepted, _ = client.send_goal(joint="raises")
    assert not accepted
    assert client.send_goal(goal)[1]  # the same goal may come again


def test_a_goal_may_be_accepted_later(connect: Connect) -> None:
    waiting: list[GoalHandle] = []
    Node(connect(), "arm").action_server("follow", FOLLOW, waiting.append)
    client = Client(connect().zenoh, "follow")
    got: list[Any] = []
    thread = threading.Thread(target=lambda: got.append(client.send_goal()))
    thread.start()
    eventually(lambda: waiting)
    assert waiting[0].status is Status.UNKNOWN
    waiting[0].accept()
    thread.join(PATIENCE)
    assert got[0][1]
    assert waiting[0].status is Status.ACCEPTED


def test_a_goal_is_canceled_by_its_id(arm: Arm, client: Client) -> None:
    goal, _, _ = client.send_goal()
    other, _, _ = client.send_goal()
    arm.goal(1)
    thread, got = asked(client, goal)
    assert client.cancel(goal) == (0, [goal])
    eventually(lambda: arm.canceling)
    assert [it.uuid for it in arm.canceling] == [goal]
    eventually(lambda: client.states and client.states[-1] == [(goal, CANCELING), (other, EXECUTING)])
    assert not got
    arm.canceling[0].canceled({"error_string": "stopped"})
    thread.join(PATIENCE)
    assert got == [Result(CANCELED, 0, "stopped")]
    assert client.cancel(goal) == (3, [])  # it has ended


def test_goals_are_canceled_by_their_time(arm: Arm, client: Client) -> None:
    goal, _, stamp = client.send_goal()
    assert client.cancel(sec=stamp - 10) == (0, [])
    assert client.cancel(sec=-1) == (0, [])
    assert client.cancel(sec=stamp + 10) == (0, [goal])


@pytest.mark.parametrize("raises", [False, True])
def test_a_cancel_is_rejected(connect: Connect, raises: bool) -> None:
    def may_cancel(goal: GoalHandle) -> bool:
        if raises:
            raise RuntimeError("of the program")
        return False

    arm, client = Arm(connect(), may_cancel=may_cancel), Client(connect().zenoh, "follow")
    goal, _, _ = client.send_goal()
    assert client.cancel(goal) == (1, [])
    assert arm.goal().status is Status.EXECUTING
    assert not arm.canceling


def test_the_program_cannot_make_illegal_transitions(arm: Arm, client: Client) -> None:
    goal, _, _ = client.send_goal()
    handle = arm.goal()
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
    assert client.get_result(goal) == Result(SUCCEEDED, 0, "")


def test_the_end_of_the_node_answers_what_waits(arm: Arm, client: Client) -> None:
    goal, _, _ = client.send_goal()
    thread, got = asked(client, goal)
    eventually(lambda: arm.server._core.goals[goal].waiting)
    arm.node.close()
    thread.join(PATIENCE)
    assert got == [Result(ABORTED, 0, "")]
    assert arm.node.session.tokens() == []


def test_goals_survive_the_routers_loss(arm: Arm, client: Client, router: Any) -> None:
    goal, _, _ = client.send_goal()
    router.stop()
    arm.goal().succeed({"error_string": "meanwhile"})
    eventually(lambda: not arm.node.session.connected())
    router.start()
    eventually(lambda: arm.node.session.connected())
    # The first queries may find no service yet.
    assert eventually(lambda: client.get_result(goal)) == Result(SUCCEEDED, 0, "meanwhile")


def test_requests_of_garbage_do_no_harm(arm: Arm, client: Client) -> None:
    for key in ("send_goal", "get_result", "cancel_goal"):
        token = next(it for it in arm.node.session.tokens() if it.endpoint and it.endpoint.name.endswith(key))
        assert token.endpoint
        for payload in (b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 40):
            assert client.call(f"{key}/{token.endpoint.type}/{token.endpoint.hash}", payload) is not None
    assert arm.node.dropped()["/follow/_action/send_goal"] == {"content": 3}
    assert client.send_goal()[1]
