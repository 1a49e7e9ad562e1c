"""An action server on the wire."""

import threading
from collections.abc import Callable
from typing import Any

import pytest

from hyperbit.controller.ros2.wire.action_core import IllegalTransition
from hyperbit.controller.ros2.wire.action_events import CancelCode, Status
from hyperbit.controller.ros2.wire.action_server import GoalHandle, Policy
from hyperbit.controller.ros2.wire.cdr import BadMessage
from hyperbit.controller.ros2.wire.node import Node
from hyperbit.controller.ros2.wire.session import Session
from tests.network.played import Router
from tests.ros2.client import FOLLOW, Client, Result, trajectory
from tests.waiting import PATIENCE, eventually

Connect = Callable[[], Session]
SUCCEEDED, CANCELED, ABORTED = Status.SUCCEEDED, Status.CANCELED, Status.ABORTED


class Arm:
    """A program with an action server, and its client. Goals wait until the test ends them."""

    def __init__(self, connect: Connect, distro: str = "jazzy", **policy: Any) -> None:
        self.node = Node(connect(), "arm", distro=distro)
        self.goals: list[GoalHandle] = []
        self.canceling: list[GoalHandle] = []
        settings = Policy(on_cancel=self.canceling.append, **policy)
        self.server = self.node.action_server("follow", FOLLOW, self.on_goal, settings)
        self.client = Client(Node(connect(), "client", distro=distro), "follow")
        eventually(lambda: len(self.node.session.tokens()) == 12)

    def on_goal(self, goal: GoalHandle) -> None:
        match goal.goal.trajectory.joint_names[0]:
            case "raises":
                raise RuntimeError("of the program")
            case "unknown":
                goal.reject()
            case "later":
                self.goals.append(goal)
            case _:
                goal.accept()
                goal.execute()
                self.goals.append(goal)

    def send(self, joint: str = "j1", identity: bytes = b"") -> tuple[bytes, Any]:
        return self.client.send_goal(trajectory([joint], [[0.5], [1.0]]), identity)

    def begun(self) -> bytes:
        """Sends a goal; returns its id when it is executed, which a client need not wait for."""
        goal, _ = self.send()
        eventually(lambda: [it for it in self.goals if it.uuid == goal])
        return goal

    def asked(self, goal: bytes) -> Callable[[], Result | None]:
        """Asks for a result in a thread; returns what waits for it."""
        got: list[Result | None] = []
        thread = threading.Thread(target=lambda: got.append(self.client.result(goal)))
        thread.start()

        def wait() -> Result | None:
            thread.join(PATIENCE)
            return got[0]

        return wait


@pytest.fixture
def arm(connect: Connect) -> Arm:
    return Arm(connect)


@pytest.mark.parametrize("distro", ["jazzy", "kilted"])
def test_a_goal_succeeds_with_feedback_and_one_result(connect: Connect, distro: str) -> None:
    arm = Arm(connect, distro)
    goal, response = arm.send()
    assert response.accepted
    assert response.stamp.sec > 1_600_000_000
    (handle,) = eventually(lambda: arm.goals)
    assert handle.uuid == goal
    points = handle.goal.trajectory.points
    assert [(list(it.positions), it.time_from_start.sec) for it in points] == [([0.5], 1), ([1.0], 2)]
    wait = arm.asked(goal)
    eventually(lambda: (handle.feedback({"joint_names": ["j1"]}), arm.client.feedback)[1])
    first = arm.client.feedback[0]
    assert (bytes(first.goal_id.uuid), first.feedback.joint_names) == (goal, ["j1"])
    handle.succeed({"error_code": 0, "error_string": "there"})
    assert wait() == arm.client.result(goal) == Result(SUCCEEDED, 0, "there")
    eventually(lambda: arm.client.states and arm.client.states[-1] == [(goal, SUCCEEDED)])


def test_a_goal_is_rejected_by_the_program_or_because_it_raises(arm: Arm) -> None:
    for joint in ("unknown", "raises"):
        goal, response = arm.send(joint)
        assert (response.accepted, response.stamp.sec) == (False, 0)
        assert arm.client.get_result(goal).status == Status.UNKNOWN
    assert not arm.goals
    assert arm.send("j1", goal)[1].accepted, "the same goal may come again"


def test_a_goal_may_be_accepted_later(arm: Arm) -> None:
    got: list[Any] = []
    thread = threading.Thread(target=lambda: got.append(arm.send("later")))
    thread.start()
    (handle,) = eventually(lambda: arm.goals)
    assert handle.status is Status.UNKNOWN
    handle.accept()
    thread.join(PATIENCE)
    assert got[0][1].accepted
    assert handle.status is Status.ACCEPTED


def test_a_goal_is_canceled_by_its_id(arm: Arm) -> None:
    goal, other = arm.begun(), arm.begun()
    wait = arm.asked(goal)
    assert arm.client.cancel(goal) == (CancelCode.NONE, [goal])
    eventually(lambda: arm.canceling)
    assert [it.uuid for it in arm.canceling] == [goal]
    expected = [(goal, Status.CANCELING), (other, Status.EXECUTING)]
    eventually(lambda: arm.client.states and arm.client.states[-1] == expected)
    arm.canceling[0].canceled({"error_string": "stopped"})
    assert wait() == Result(CANCELED, 0, "stopped")
    assert arm.client.cancel(goal) == (CancelCode.TERMINATED, [])


def test_goals_are_canceled_by_their_time(arm: Arm) -> None:
    goal, response = arm.send()
    stamp = response.stamp.sec
    for sec, canceled in ((stamp - 10, []), (-1, []), (stamp + 10, [goal])):
        assert arm.client.cancel(sec=sec) == (CancelCode.NONE, canceled)


@pytest.mark.parametrize("raises", [False, True])
def test_a_cancel_is_rejected(connect: Connect, raises: bool) -> None:
    def may_cancel(goal: GoalHandle) -> bool:
        if raises:
            raise RuntimeError("of the program")
        return False

    arm = Arm(connect, may_cancel=may_cancel)
    assert arm.client.cancel(arm.begun()) == (CancelCode.REJECTED, [])
    assert arm.goals[0].status is Status.EXECUTING
    assert not arm.canceling


def test_the_program_cannot_make_illegal_transitions(arm: Arm) -> None:
    goal = arm.begun()
    (handle,) = arm.goals
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
    assert arm.client.result(goal) == Result(SUCCEEDED, 0, "")


def test_the_end_of_the_node_answers_what_waits(arm: Arm) -> None:
    goal = arm.begun()
    wait = arm.asked(goal)
    eventually(lambda: arm.server.open)
    arm.node.close()
    assert wait() == Result(ABORTED, 0, "")


def test_goals_survive_the_routers_loss(arm: Arm, router: Router) -> None:
    goal = arm.begun()
    router.end()
    arm.goals[0].succeed({"error_string": "meanwhile"})
    eventually(lambda: not arm.node.session.connected())
    router.start()
    # The first queries may find no service yet.
    assert eventually(lambda: arm.client.result(goal)) == Result(SUCCEEDED, 0, "meanwhile")
