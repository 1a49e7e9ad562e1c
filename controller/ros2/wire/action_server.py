"""Action servers: connect the core to its three services, its two topics and the program."""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from hyperbit.controller.ros2.wire import action_events as events
from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.action_core import MOST_GOALS, ActionCore
from hyperbit.controller.ros2.wire.action_events import GoalInfo, Status
from hyperbit.controller.ros2.wire.cdr import message, serialize
from hyperbit.controller.ros2.wire.names import resolve
from hyperbit.controller.ros2.wire.services import Request
from hyperbit.controller.ros2.wire.session import Computer

if TYPE_CHECKING:
    from hyperbit.controller.ros2.wire.node import Node

SECOND = 1_000_000_000  # [ns]
LATEST = 2**31 * SECOND - 1  # [ns since 1970], of the times of ROS 2
CANCEL, STATUS = "action_msgs/srv/CancelGoal", "action_msgs/msg/GoalStatusArray"
log = logging.getLogger(__name__)


class GoalHandle:
    """One goal, for the program that executes it. Thread-safe. `uuid` has 16 bytes.

    `accept` or `reject` comes first, then `execute`, then one of `succeed`, `abort` and, once `on_cancel` was called,
    `canceled`. Each raises IllegalTransition if the goal's state does not allow it.
    """

    def __init__(self, uuid: bytes, goal: Any, server: ActionServer) -> None:
        self.uuid, self.goal = uuid, goal
        self._server = server

    @property
    def status(self) -> Status:
        """UNKNOWN before acceptance, and after the goal is forgotten."""
        return self._server.status(self.uuid)

    def accept(self) -> None:
        self._server.step(events.GoalDecided(self.uuid, accepted=True, stamp=self._server.stamp()))

    def reject(self) -> None:
        self._server.step(events.GoalDecided(self.uuid, accepted=False, stamp=0))

    def execute(self) -> None:
        """Reports that execution has begun. A canceling goal goes on canceling."""
        self._server.step(events.StatusChanged(self.uuid, Status.EXECUTING))

    def feedback(self, value: Any) -> None:
        """Publishes feedback: a message, or its fields by name. Feedback after the goal's end is dropped."""
        self._server.step(events.FeedbackGiven(self.uuid, value))

    def succeed(self, result: Any) -> None:
        """Ends the goal with success; `result` is a message, or its fields by name."""
        self.end(Status.SUCCEEDED, result)

    def abort(self, result: Any) -> None:
        self.end(Status.ABORTED, result)

    def canceled(self, result: Any) -> None:
        self.end(Status.CANCELED, result)

    def end(self, status: Status, result: Any) -> None:
        self._server.end(self.uuid, status, result)


class Policy(NamedTuple):
    """How an action server treats its goals.

    `may_cancel` returns at once. `on_cancel` is called when a goal is canceling; the program then ends it.
    """

    may_cancel: Callable[[GoalHandle], bool] = lambda goal: True
    on_cancel: Callable[[GoalHandle], None] = lambda goal: None
    result_timeout: float = 10.0  # a result is kept this long after the goal's end [s]
    most_goals: int = MOST_GOALS  # known at once; a further goal is rejected, or the oldest ended one is forgotten


class ActionServer:
    """An action of one node. Zenoh's threads call the program back, one at a time for each service.

    Args:
        on_goal: called with each new goal; an exception rejects the goal.

    Raises:
        BadName: the name is not allowed.
        UnknownType: the type is not known.
    """

    def __init__(
        self, node: Node, name: str, type_name: str, on_goal: Callable[[GoalHandle], None], policy: Policy
    ) -> None:
        self._types, self._type, self._computer = node.types, type_name, node.session.computer
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

    @property
    def open(self) -> int:
        """Number of requests that wait for a reply."""
        return len(self._requests)

    def status(self, uuid: bytes) -> Status:
        with self._lock:
            return self._core.status(uuid)

    def stamp(self) -> int:
        return stamp_now(self._computer)

    def restore(self, uuid: bytes, stamp: int, status: Status, result: Any = None) -> GoalHandle:
        """Returns a goal that an earlier server had accepted. Its message is unknown.

        Args:
            uuid: 16 bytes.
            stamp: time of acceptance [ns since 1970].
            result: of an ended goal.

        Raises:
            IllegalTransition: the goal is known already.
        """
        handle = GoalHandle(uuid, None, self)
        self.step(events.GoalRestored(uuid, handle, stamp, status, self._result({} if result is None else result)))
        return handle

    def close(self, result: Any = None) -> None:
        """Rejects undecided goals, and aborts active ones with this result, or with an empty one."""
        self.step(events.ServerClosed(self._result({} if result is None else result)))

    def end(self, uuid: bytes, status: Status, result: Any) -> None:
        """Ends a goal.

        Raises:
            BadMessage: `result` does not fit the action's type; the goal goes on.
            IllegalTransition: the goal's state does not allow it.
        """
        self.step(events.StatusChanged(uuid, status, self._result(result)))

    def step(self, event: events.Event) -> None:
        calls: list[Callable[[], None]] = []
        with self._lock:  # replies and publications keep the core's order
            for action in self._core.step(event, self._computer.monotonic()):
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


def stamp_now(computer: Computer) -> int:
    """Returns the UNIX time [ns], at most LATEST: the clock may be set to any year."""
    return min(computer.time_ns(), LATEST)


def _time(stamp: int) -> dict[str, int]:
    return {"sec": stamp // SECOND, "nanosec": stamp % SECOND}


def _info(info: GoalInfo) -> dict[str, Any]:
    return {"goal_id": {"uuid": info.uuid}, "stamp": _time(info.stamp)}
