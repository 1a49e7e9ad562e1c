"""Action servers: the core's events from three services and the program, its actions to replies and two topics."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from hyperbit.controller.ros2.wire import action_events as events
from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.action_core import MOST_GOALS, ActionCore
from hyperbit.controller.ros2.wire.action_events import GoalInfo, Status
from hyperbit.controller.ros2.wire.cdr import message, serialize
from hyperbit.controller.ros2.wire.names import resolve
from hyperbit.controller.ros2.wire.services import Request

if TYPE_CHECKING:
    from hyperbit.controller.ros2.wire.node import Node

SECOND = 1_000_000_000  # [ns]
CANCEL, STATUS = "action_msgs/srv/CancelGoal", "action_msgs/msg/GoalStatusArray"
log = logging.getLogger(__name__)


class GoalHandle:
    """One goal, for the program that executes it. Its methods may be called from any thread.

    `accept` or `reject` comes first, then `execute`, then one of `succeed`, `abort` and, once `on_cancel` was called,
    `canceled`. Each raises IllegalTransition if the goal's state does not allow it.

    Attributes:
        uuid: the goal's id, 16 bytes.
        goal: the goal's message.
    """

    def __init__(self, uuid: bytes, goal: Any, server: ActionServer) -> None:
        self.uuid, self.goal = uuid, goal
        self._server = server

    @property
    def status(self) -> Status:
        """State of the goal; UNKNOWN before it is accepted, and after it is forgotten."""
        return self._server.status(self.uuid)

    def accept(self) -> None:
        """Accepts the goal."""
        self._server.step(events.GoalDecided(self.uuid, accepted=True, stamp=time.time_ns()))

    def reject(self) -> None:
        """Rejects the goal."""
        self._server.step(events.GoalDecided(self.uuid, accepted=False, stamp=0))

    def execute(self) -> None:
        """Tells that execution has begun; a goal that is canceling already goes on canceling."""
        self._server.step(events.StatusChanged(self.uuid, Status.EXECUTING))

    def feedback(self, value: Any) -> None:
        """Publishes feedback: a message, or its fields by name. After the goal's end it is dropped."""
        self._server.step(events.FeedbackGiven(self.uuid, value))

    def succeed(self, result: Any) -> None:
        """Ends the goal with success; `result` is a message, or its fields by name."""
        self.end(Status.SUCCEEDED, result)

    def abort(self, result: Any) -> None:
        """Ends the goal with a failure."""
        self.end(Status.ABORTED, result)

    def canceled(self, result: Any) -> None:
        """Ends a goal that is canceling."""
        self.end(Status.CANCELED, result)

    def end(self, status: Status, result: Any) -> None:
        """Ends the goal with one of these states."""
        self._server.end(self.uuid, status, result)


class Policy(NamedTuple):
    """How an action server treats its goals.

    Attributes:
        may_cancel: returns whether a goal may be canceled; it answers at once.
        on_cancel: called when a goal is canceling; the program then ends it.
        result_timeout: how long the result of an ended goal is kept [s].
        most_goals: number of goals that are known at once; further ones are rejected, or the oldest ended is forgotten.
    """

    may_cancel: Callable[[GoalHandle], bool] = lambda goal: True
    on_cancel: Callable[[GoalHandle], None] = lambda goal: None
    result_timeout: float = 10.0
    most_goals: int = MOST_GOALS


class ActionServer:
    """An action of one node. The program is called back in threads of Zenoh's, one at a time for each service.

    Args:
        node: whose action it is.
        name: of the action.
        type_name: such as control_msgs/action/FollowJointTrajectory.
        on_goal: called with each new goal; the goal is rejected if it raises.
        policy: how goals are treated.

    Raises:
        BadName: the name is not allowed.
        UnknownType: the type is not known.
    """

    def __init__(
        self, node: Node, name: str, type_name: str, on_goal: Callable[[GoalHandle], None], policy: Policy
    ) -> None:
        self._types, self._type = node.types, type_name
        self._on_goal, self._policy = on_goal, policy
        self._core = ActionCore(policy.result_timeout, policy.most_goals)
        self._lock = threading.Lock()
        self._numbers = itertools.count()
        self._requests: dict[int, Request] = {}
        base = f"{resolve(name, node.token.namespace, node.token.node)}/_action"
        self._feedback = node.publisher(f"{base}/feedback", f"{type_name}_FeedbackMessage")
        self._status = node.publisher(f"{base}/status", STATUS, qos.LATCHED)
        node.service(f"{base}/cancel_goal", CANCEL, self._on_cancel_request)
        node.service(f"{base}/get_result", f"{type_name}_GetResult", self._on_result_request)
        node.service(f"{base}/send_goal", f"{type_name}_SendGoal", self._on_goal_request)

    def status(self, uuid: bytes) -> Status:
        """Returns the state of a goal."""
        with self._lock:
            return self._core.status(uuid)

    def restore(self, uuid: bytes, stamp: int, status: Status, result: Any = None) -> GoalHandle:
        """Returns a goal that a server before this one had accepted; its message is not known.

        Args:
            uuid: id of the goal, 16 bytes.
            stamp: when it was accepted [ns since 1970].
            status: of the goal.
            result: of an ended goal.

        Raises:
            IllegalTransition: the goal is known already.
        """
        handle = GoalHandle(uuid, None, self)
        self.step(events.GoalRestored(uuid, handle, stamp, status, self._result({} if result is None else result)))
        return handle

    def close(self, result: Any = None) -> None:
        """Rejects what is not decided, and aborts all active goals with this result, or an empty one."""
        self.step(events.ServerClosed(self._result({} if result is None else result)))

    def end(self, uuid: bytes, status: Status, result: Any) -> None:
        """Ends a goal.

        Raises:
            BadMessage: `result` does not fit the action's type; the goal goes on.
            IllegalTransition: the goal's state does not allow it.
        """
        self.step(events.StatusChanged(uuid, status, self._result(result)))

    def step(self, event: events.Event) -> None:
        """Steps the core, and carries out what it returns."""
        calls: list[Callable[[], None]] = []
        with self._lock:  # replies and publications keep the core's order
            for action in self._core.step(event, time.monotonic()):
                self._carry_out(action, calls)
        for call in calls:  # the program may call back
            call()

    def _carry_out(self, action: events.Action, calls: list[Callable[[], None]]) -> None:
        match action:
            case events.AskGoal(goal):
                calls.append(lambda: self._ask_goal(goal))
            case events.AnswerGoal(request, accepted, stamp):
                self._requests.pop(request).reply({"accepted": accepted, "stamp": _time(stamp)})
            case events.AskCancel(request, goals):
                calls.append(lambda: self._ask_cancel(request, goals))
            case events.AnswerCancel(request, code, infos):
                answer = {"return_code": int(code), "goals_canceling": [_info(info) for info in infos]}
                self._requests.pop(request).reply(answer)
            case events.TellCanceling(goal):
                calls.append(lambda: self._tell_canceling(goal))
            case events.AnswerResult(request, status, result):
                self._requests.pop(request).reply({"status": int(status), "result": result})
            case events.PublishStatus(infos):
                states = [{"goal_info": _info(info), "status": int(info.status)} for info in infos]
                self._status.publish({"status_list": states})
            case events.PublishFeedback(uuid, feedback):
                self._feedback.publish({"goal_id": {"uuid": uuid}, "feedback": feedback})

    def _result(self, result: Any) -> Any:
        """Returns a result that can be sent."""
        name = f"{self._type}_Result"
        found = message(result, name, self._types) if isinstance(result, Mapping) else result
        serialize(found, name, self._types)
        return found

    def _on_goal_request(self, request: Request) -> None:
        uuid = _uuid(request.message)
        self.step(events.GoalRequested(self._number(request), uuid, GoalHandle(uuid, request.message.goal, self)))

    def _on_cancel_request(self, request: Request) -> None:
        info = request.message.goal_info
        stamp = info.stamp.sec * SECOND + info.stamp.nanosec
        self.step(events.CancelRequested(self._number(request), _uuid(info), stamp))

    def _on_result_request(self, request: Request) -> None:
        self.step(events.ResultRequested(self._number(request), _uuid(request.message)))

    def _number(self, request: Request) -> int:
        with self._lock:
            number = next(self._numbers)
            self._requests[number] = request
        return number

    def _ask_goal(self, goal: GoalHandle) -> None:
        try:
            self._on_goal(goal)
        except Exception:
            if goal.status is Status.UNKNOWN:
                goal.reject()
            raise

    def _ask_cancel(self, request: int, goals: tuple[GoalHandle, ...]) -> None:
        chosen = []
        for goal in goals:
            try:
                if self._policy.may_cancel(goal):
                    chosen.append(goal.uuid)
            except Exception:
                log.exception("may_cancel of %s failed", self._type)
        self.step(events.CancelDecided(request, tuple(chosen)))

    def _tell_canceling(self, goal: GoalHandle) -> None:
        try:
            self._policy.on_cancel(goal)
        except Exception:
            log.exception("on_cancel of %s failed", self._type)


def _uuid(holder: Any) -> bytes:
    return bytes(holder.goal_id.uuid)


def _time(stamp: int) -> dict[str, int]:
    return {"sec": stamp // SECOND, "nanosec": stamp % SECOND}


def _info(info: GoalInfo) -> dict[str, Any]:
    return {"goal_id": {"uuid": info.uuid}, "stamp": _time(info.stamp)}
