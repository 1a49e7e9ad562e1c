"""A client of an action, with the wire's own clients and subscribers; tests/ros2/wire has the bytes."""

import uuid
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.actions import Status
from hyperbit.controller.ros2.wire.endpoints import NoReply
from hyperbit.controller.ros2.wire.node import Node
from tests.waiting import PATIENCE

FOLLOW = "control_msgs/action/FollowJointTrajectory"


class Result(NamedTuple):
    status: Status
    error_code: int
    error_string: str


class Client:
    """Attributes: received feedback, and lists of ids with their status."""

    def __init__(self, node: Node, action: str, type_name: str = FOLLOW) -> None:
        self.node = node  # its token goes with it
        self.feedback: list[Any] = []
        self.states: list[list[tuple[bytes, Status]]] = []
        base = f"{action}/_action"
        self.goals = node.client(f"{base}/send_goal", f"{type_name}_SendGoal")
        self.results = node.client(f"{base}/get_result", f"{type_name}_GetResult")
        self.cancels = node.client(f"{base}/cancel_goal", "action_msgs/srv/CancelGoal")
        feedback = f"{type_name}_FeedbackMessage"
        node.subscriber(f"{base}/feedback", feedback, lambda it: self.feedback.append(it.message))
        node.subscriber(f"{base}/status", "action_msgs/msg/GoalStatusArray", self._on_status, qos.LATCHED)

    def _on_status(self, received: Any) -> None:
        goals = received.message.status_list
        self.states.append([(bytes(it.goal_info.goal_id.uuid), Status(it.status)) for it in goals])

    def send_goal(self, goal: Mapping[str, Any], identity: bytes = b"") -> tuple[bytes, Any]:
        """Sends a goal; returns its id and the response. Raises NoReply."""
        identity = identity or uuid.uuid4().bytes
        return identity, self.goals.call({"goal_id": {"uuid": identity}, "goal": goal}, PATIENCE).message

    def cancel(self, goal: bytes = bytes(16), sec: int = 0) -> tuple[int, list[bytes]]:
        """Cancels a goal, or all until a time; returns the code, and the ids of the goals that are canceled."""
        request = {"goal_info": {"goal_id": {"uuid": goal}, "stamp": {"sec": sec}}}
        response = self.cancels.call(request, PATIENCE).message
        return response.return_code, [bytes(it.goal_id.uuid) for it in response.goals_canceling]

    def get_result(self, goal: bytes) -> Any:
        """Waits for the result; returns the response, or None if nobody answered."""
        try:
            return self.results.call({"goal_id": {"uuid": goal}}, PATIENCE).message
        except NoReply:
            return None

    def result(self, goal: bytes) -> Result | None:
        """Waits for the result of a trajectory; None: nobody answered, or the goal is not known."""
        found = self.get_result(goal)
        if found is None or not found.status:
            return None
        return Result(Status(found.status), found.result.error_code, found.result.error_string)


def trajectory(joints: Sequence[str], points: Sequence[Sequence[float]], step: float = 1.0) -> dict[str, Any]:
    """Returns a goal of FollowJointTrajectory with a point each `step` [s]."""
    times = [round(k * step * 1e9) for k in range(1, len(points) + 1)]
    spread = [
        {"positions": list(point), "time_from_start": {"sec": at // 10**9, "nanosec": at % 10**9}}
        for point, at in zip(points, times, strict=True)
    ]
    return {"trajectory": {"joint_names": list(joints), "points": spread}}


def tip(*positions: tuple[float, float], step: float = 0.0) -> dict[str, Any]:
    return trajectory(["tip_x", "tip_y"], positions, step)
