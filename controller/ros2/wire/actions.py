"""Action servers: three services and two topics for the goals of one action.

The states and transitions are those of rcl_action, see goal_state_machine.c and action_server.c of ros2/rcl.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple

from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.cdr import message, serialize
from hyperbit.controller.ros2.wire.endpoints import Request
from hyperbit.controller.ros2.wire.names import resolve
from hyperbit.controller.ros2.wire.session import SECOND

if TYPE_CHECKING:
    from hyperbit.controller.ros2.wire.node import Node

CANCEL, STATUS = "action_msgs/srv/CancelGoal", "action_msgs/msg/GoalStatusArray"
NO_UUID = bytes(16)
log = logging.getLogger(__name__)


class Status(IntEnum):
    """States of a goal. UNKNOWN: the goal is not accepted."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


class CancelCode(IntEnum):
    """Return codes of action_msgs/srv/CancelGoal."""

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL = 2
    TERMINATED = 3


ACTIVE = (Status.ACCEPTED, Status.EXECUTING, Status.CANCELING)
# Permitted earlier states by new state.
BEFORE: dict[Status, tuple[Status, ...]] = {
    Status.ACCEPTED: (Status.UNKNOWN,),
    Status.EXECUTING: (Status.ACCEPTED,),
    Status.CANCELING: (Status.ACCEPTED, Status.EXECUTING),
    Status.SUCCEEDED: (Status.EXECUTING, Status.CANCELING),
    Status.ABORTED: (Status.EXECUTING, Status.CANCELING),
    Status.CANCELED: (Status.CANCELING,),
}


class IllegalTransition(RuntimeError):
    """The program asked for a transition that the goal's state does not allow. The goal has not changed."""


class GoalHandle:
    """One goal, for the program that executes it. Thread-safe.

    `accept` or `reject` comes first, then `execute`, then one of `succeed`, `abort` and, once `on_cancel` was called,
    `canceled`. Each raises IllegalTransition if the goal's state does not allow it.

    Attributes:
        uuid: 16 bytes.
        goal: the action's goal; None if an earlier server had accepted it.
        status: UNKNOWN before acceptance.
        stamp: time of acceptance [ns since 1970].
        request: of the client, until it is answered; the server's.
        waiting: requests for the result; the server's, as are the next two.
        result: of an ended goal.
        ended: time on the computer's monotonic clock [s].
    """

    def __init__(self, server: ActionServer, uuid: bytes, goal: Any, request: Request | None = None) -> None:
        self.uuid, self.goal = uuid, goal
        self.status, self.stamp = Status.UNKNOWN, 0
        self.request, self.waiting = request, list[Request]()
        self.result: Any = None
        self.ended = 0.0
        self._server = server

    def accept(self) -> None:
        server = self._server
        with server._lock:
            request = self._undecided()
            self.request, self.status, self.stamp = None, Status.ACCEPTED, server._computer.stamp()
            request.reply({"accepted": True, "stamp": _time(self.stamp)})
            server._publish_status()

    def reject(self) -> None:
        with self._server._lock:
            self._server._reject(self, self._undecided())

    def execute(self) -> None:
        """Reports that execution has begun. A canceling goal goes on canceling."""
        with self._server._lock:
            if self.status is not Status.CANCELING:  # between acceptance and execution; the program need not know
                self._check(Status.EXECUTING)
                self.status = Status.EXECUTING
                self._server._publish_status()

    def feedback(self, value: Any) -> None:
        """Publishes feedback: a message, or its fields by name. Feedback after the goal's end is dropped."""
        with self._server._lock:
            if self.status in ACTIVE:
                self._server._feedback.publish({"goal_id": {"uuid": self.uuid}, "feedback": value})

    def succeed(self, result: Any) -> None:
        """Ends the goal with success; `result` is a message, or its fields by name."""
        self.end(Status.SUCCEEDED, result)

    def abort(self, result: Any) -> None:
        self.end(Status.ABORTED, result)

    def canceled(self, result: Any) -> None:
        self.end(Status.CANCELED, result)

    def end(self, status: Status, result: Any) -> None:
        """Ends the goal. Raises BadMessage if `result` does not fit the action's type; the goal goes on then."""
        checked = self._server._checked(result)
        with self._server._lock:
            self._check(status)
            self._server._end(self, status, checked)
            self._server._publish_status()

    def _undecided(self) -> Request:
        if self.request is None:
            raise IllegalTransition(f"goal {self.uuid.hex()} does not wait for a decision")
        return self.request

    def _check(self, status: Status) -> None:
        if self.status not in BEFORE[status]:
            raise IllegalTransition(f"goal {self.uuid.hex()} is {self.status.name}, it cannot become {status.name}")


class Policy(NamedTuple):
    """How an action server treats its goals.

    `may_cancel` returns at once. `on_cancel` is called when a goal is canceling; the program then ends it.
    """

    may_cancel: Callable[[GoalHandle], bool] = lambda goal: True
    on_cancel: Callable[[GoalHandle], None] = lambda goal: None
    result_timeout: float = 10.0  # a result is kept this long after the goal's end [s]
    most_goals: int = 64  # known at once; a further goal is rejected, or the oldest ended one is forgotten


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
        self._goals: dict[bytes, GoalHandle] = {}  # by uuid, in the order of their requests
        self._closed = False
        self._lock = threading.Lock()  # of all goals; replies and publications keep the order of changes
        base = f"{resolve(name, node.token.namespace, node.token.node)}/_action"
        self._feedback = node.publisher(f"{base}/feedback", f"{type_name}_FeedbackMessage")
        self._status = node.publisher(f"{base}/status", STATUS, qos.LATCHED)
        node.service(f"{base}/cancel_goal", CANCEL, self._receive_cancel)
        node.service(f"{base}/get_result", f"{type_name}_GetResult", self._receive_result_request)
        node.service(f"{base}/send_goal", f"{type_name}_SendGoal", self._receive_goal)

    @property
    def open(self) -> int:
        """Number of requests that wait for a decision or a result."""
        with self._lock:
            return sum(len(goal.waiting) + (goal.request is not None) for goal in self._goals.values())

    def restore(self, uuid: bytes, stamp: int, status: Status, result: Any = None) -> GoalHandle:
        """Returns a goal that an earlier server had accepted. Its message is unknown.

        Args:
            uuid: 16 bytes.
            stamp: time of acceptance [ns since 1970].
            status: its state now.
            result: of an ended goal.

        Raises:
            IllegalTransition: the goal is known already.
        """
        handle = GoalHandle(self, uuid, None)
        handle.status, handle.stamp, handle.result = status, stamp, self._checked(result or {})
        with self._lock:
            self._forget()
            if uuid in self._goals:
                raise IllegalTransition(f"goal {uuid.hex()} is known already")
            handle.ended = self._computer.monotonic()
            self._goals[uuid] = handle
            self._publish_status()
        return handle

    def close(self, result: Any = None) -> None:
        """Rejects undecided goals, and aborts active ones with this result, or with an empty one."""
        checked = self._checked(result or {})
        with self._lock:
            self._closed = True
            for goal in list(self._goals.values()):
                if goal.request is not None:
                    self._reject(goal, goal.request)
            active = [goal for goal in self._goals.values() if goal.status in ACTIVE]
            for goal in active:
                self._end(goal, Status.ABORTED, checked)
            if active:
                self._publish_status()

    # The requests of clients.

    def _receive_goal(self, request: Request) -> None:
        uuid = bytes(request.message.goal_id.uuid)
        with self._lock:
            self._forget()
            if len(self._goals) >= self._policy.most_goals:
                ended = [it for it in self._goals.values() if it.status > Status.CANCELING]
                if ended:
                    del self._goals[min(ended, key=lambda it: it.ended).uuid]
            if self._closed or uuid in self._goals or len(self._goals) >= self._policy.most_goals:
                request.reply({"accepted": False})
                return
            goal = self._goals[uuid] = GoalHandle(self, uuid, request.message.goal, request)
        try:
            self._on_goal(goal)
        except Exception:
            if goal.request is not None:
                goal.reject()
            raise

    def _receive_cancel(self, request: Request) -> None:
        """Asks the program which goals may be canceled."""
        info = request.message.goal_info
        with self._lock:
            self._forget()
            asked, code = self._cancelable(bytes(info.goal_id.uuid), info.stamp.sec * SECOND + info.stamp.nanosec)
        chosen = [goal for goal in asked if self._call(self._policy.may_cancel, goal)]
        with self._lock:
            canceling = [goal for goal in chosen if goal.status in BEFORE[Status.CANCELING]]
            for goal in canceling:
                goal.status = Status.CANCELING
            if asked and not canceling:
                code = CancelCode.TERMINATED if chosen else CancelCode.REJECTED
            request.reply({"return_code": int(code), "goals_canceling": [_info(goal) for goal in canceling]})
            if canceling:
                self._publish_status()
        for goal in canceling:
            self._call(self._policy.on_cancel, goal)

    def _cancelable(self, uuid: bytes, stamp: int) -> tuple[list[GoalHandle], CancelCode]:
        """Returns the goals that a client names, and the answer if there are none.

        It names one goal, all goals (zeros), or all goals accepted until `stamp` [ns since 1970].
        """
        able = [goal for goal in self._goals.values() if goal.status in BEFORE[Status.CANCELING]]
        if uuid == NO_UUID or stamp:
            everything = uuid == NO_UUID and not stamp
            able = [goal for goal in able if everything or goal.stamp <= stamp or goal.uuid == uuid]
            return able, CancelCode.NONE
        goal = self._goals.get(uuid)
        unknown = goal is None or goal.status is Status.UNKNOWN
        named = [goal for goal in able if goal.uuid == uuid]
        return named, CancelCode.NONE if named else CancelCode.UNKNOWN_GOAL if unknown else CancelCode.TERMINATED

    def _receive_result_request(self, request: Request) -> None:
        with self._lock:
            self._forget()
            goal = self._goals.get(bytes(request.message.goal_id.uuid))
            if goal is not None and goal.status in ACTIVE:
                goal.waiting.append(request)
            elif goal is None or goal.status is Status.UNKNOWN:
                request.reply({"status": int(Status.UNKNOWN)})
            else:
                request.reply({"status": int(goal.status), "result": goal.result})

    # Under the lock.

    def _reject(self, goal: GoalHandle, request: Request) -> None:
        del self._goals[goal.uuid]
        goal.request = None
        request.reply({"accepted": False})

    def _end(self, goal: GoalHandle, status: Status, result: Any) -> None:
        goal.status, goal.result, goal.ended = status, result, self._computer.monotonic()
        waiting, goal.waiting = goal.waiting, []
        for request in waiting:
            request.reply({"status": int(status), "result": result})

    def _forget(self) -> None:
        """Forgets goals whose results were kept long enough."""
        now = self._computer.monotonic()
        for goal in list(self._goals.values()):
            if goal.status > Status.CANCELING and now - goal.ended > self._policy.result_timeout:
                del self._goals[goal.uuid]

    def _publish_status(self) -> None:
        self._forget()
        known = [goal for goal in self._goals.values() if goal.status is not Status.UNKNOWN]
        self._status.publish(
            {"status_list": [{"goal_info": _info(goal), "status": int(goal.status)} for goal in known]}
        )

    def _checked(self, result: Any) -> Any:
        name = f"{self._type}_Result"
        found = message(result, name, self._types) if isinstance(result, Mapping) else result
        serialize(found, name, self._types)
        return found

    def _call(self, callback: Callable[[GoalHandle], bool | None], goal: GoalHandle) -> bool:
        """Calls the program, without the lock; an exception is logged, and means no."""
        try:
            return bool(callback(goal))
        except Exception:
            log.exception("a callback on a cancel of %s failed", self._type)
            return False


def _time(stamp: int) -> dict[str, int]:
    return {"sec": stamp // SECOND, "nanosec": stamp % SECOND}


def _info(goal: GoalHandle) -> dict[str, Any]:
    return {"goal_id": {"uuid": goal.uuid}, "stamp": _time(goal.stamp)}
