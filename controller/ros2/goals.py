"""Goals of the two actions: from the client to the daemon, and exactly one result back.

The daemon's ledger knows how a goal ended. So the bridge asks for the result of each goal now and then, whatever became
of the message with the result: lost with the network, or sent while the daemon or the bridge was away.
"""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from controller.network.client import Unanswered
from controller.ros2.goal_book import KEPT, BookedGoal, GoalBook
from controller.ros2.messages import ERROR, INFO, WARN
from controller.ros2.poses import BadGoal, Fields
from controller.ros2.wire.action_events import Status
from controller.ros2.wire.action_server import ActionServer, GoalHandle, Policy
from controller.ros2.wire.node import Node

ACTION = "control_msgs/action/FollowJointTrajectory"
ASK_EVERY = 2.0  # [s] for the result of a running goal
KNOWN_WITHIN = 15.0  # [s] after which a goal that the ledger does not have is lost
GONE_AFTER = 60.0  # [s] without a daemon, after which its goals are lost
LOST = -4  # code: the end of the goal is not known
TIMEOUT = 10.0  # [s] for an answer of the daemon

Request = Callable[[str, Mapping[str, Any]], dict[str, Any]]
Say = Callable[[int, str], None]


class Kind(NamedTuple):
    """One of the actions.

    Attributes:
        name: of the action, relative to the node's namespace.
        convert: returns the daemon's goal of a goal's message; raises BadGoal.
        feedback: returns the fields of a feedback from a `state` and the joints' names.
    """

    name: str
    convert: Callable[[Any], Fields]
    feedback: Callable[[Mapping[str, Any], tuple[str, ...]], Fields]


@dataclass
class RunningGoal:
    """A goal without a result.

    Attributes:
        booked: the goal.
        handle: for the action's client.
        since: when the bridge began to know it [s].
        asked: when its result was asked for [s].
    """

    booked: BookedGoal
    handle: GoalHandle
    since: float = field(default_factory=time.monotonic)
    asked: float = field(default_factory=time.monotonic)


class ActionGoals:
    """The goals of all actions. For any thread.

    Args:
        node: whose actions they are.
        kinds: the actions by kind.
        book: file of the goals.
        request: sends a request to the daemon and returns its answer; raises Unanswered.
        submit: runs a function in a thread of the bridge's; returns False if too many wait.
        say: tells a sentence on /rosout.
    """

    def __init__(
        self,
        node: Node,
        kinds: Mapping[str, Kind],
        book: GoalBook,
        request: Request,
        submit: Callable[[Callable[[], None]], bool],
        say: Say,
    ) -> None:
        self._kinds, self._book, self._request, self._submit, self._say = kinds, book, request, submit, say
        self._running: dict[str, RunningGoal] = {}
        self._early: dict[str, Mapping[str, Any] | None] = {}  # results that came before the goal's client knew of it
        self._lock = threading.Lock()
        self._gone: float | None = None  # since when the daemon is gone [s]
        policy = Policy(on_cancel=self._on_cancel, result_timeout=KEPT)
        self._servers = {
            name: node.action_server(kind.name, ACTION, self._on_goal(name), policy) for name, kind in kinds.items()
        }
        for booked in book.goals():
            self._restore(booked)

    def receive_result(self, message: Mapping[str, Any]) -> None:
        """Accepts a `result` of the daemon."""
        self._end(str(message.get("id")), message)

    def receive_alive(self, *, alive: bool) -> None:
        """Accepts whether the daemon is there."""
        self._gone = None if alive else self._gone or time.monotonic()

    def publish_feedback(self, state: Mapping[str, Any]) -> None:
        """Publishes the feedback of the goal that a `state` names."""
        with self._lock:
            goal = self._running.get(str(state.get("goal")))
        if goal is not None:
            kind = self._kinds[goal.booked.kind]
            goal.handle.feedback(kind.feedback(state, goal.booked.joints))

    def poll(self, now: float) -> None:
        """Asks for the results that are due; ends goals of a daemon that does not come back. `now` [s]."""
        with self._lock:
            due = [goal for goal in self._running.values() if now >= goal.asked + ASK_EVERY]
        for goal in due:
            goal.asked = now
            if self._gone is not None and now > max(self._gone, goal.since) + GONE_AFTER:
                self._lose(goal, f"the daemon is gone for {GONE_AFTER:g} s; how the goal ended is not known")
            elif self._gone is None:
                self._submit(lambda goal=goal: self._ask(goal))  # type: ignore[misc]

    def close(self) -> None:
        """Ends all goals: their clients cannot wait for a bridge that has ended. The arm goes on."""
        with self._lock:
            running = list(self._running.values())
        for goal in running:
            self._lose(goal, "the bridge to ROS 2 has ended; the arm carries the goal on")

    def _on_goal(self, kind: str) -> Callable[[GoalHandle], None]:
        """Returns what accepts the goals of an action."""

        def on_goal(handle: GoalHandle) -> None:
            if not self._submit(lambda: self._start(kind, handle)):
                self._say(WARN, f"a goal of {self._kinds[kind].name} is rejected: too many requests wait")
                handle.reject()

        return on_goal

    def _start(self, kind: str, handle: GoalHandle) -> None:
        """Sends a goal to the daemon; accepts or rejects it by the daemon's answer."""
        booked = BookedGoal(handle.uuid.hex(), kind, tuple(handle.goal.trajectory.joint_names), time.time_ns())
        try:
            goal = {**self._kinds[kind].convert(handle.goal), "id": booked.id}
        except BadGoal as error:
            self._say(WARN, f"a goal of {self._kinds[kind].name} is rejected (code {error.code}): {error}")
            handle.reject()
            return
        self._book.put(booked)
        with self._lock:
            self._early[booked.id] = None
        try:
            answer = self._request("goal", goal)
        except Unanswered as error:
            answer = {"accepted": False, "code": LOST, "message": str(error)}
            self._submit(lambda: self._cancel(booked))  # it may have arrived
        if not answer["accepted"]:
            self._book.remove(booked)
            with self._lock:
                del self._early[booked.id]
            self._say(WARN, f"a goal of {self._kinds[kind].name} is rejected (code {answer['code']}): {told(answer)}")
            handle.reject()
            return
        handle.accept()
        handle.execute()
        with self._lock:
            self._running[booked.id] = RunningGoal(booked, handle)
            early = self._early.pop(booked.id)
        if early is not None:
            self._end(booked.id, early)
        self._say(INFO, f"goal {booked.id} of {self._kinds[kind].name} is accepted")

    def _restore(self, booked: BookedGoal) -> None:
        """Continues a goal of the bridge before this one."""
        server: ActionServer | None = self._servers.get(booked.kind)
        if server is None:
            return
        handle = server.restore(bytes.fromhex(booked.uuid), booked.stamp)
        self._running[booked.id] = RunningGoal(booked, handle, asked=0.0)
        if booked.result is not None:
            self._end(booked.id, booked.result)

    def _on_cancel(self, handle: GoalHandle) -> None:
        with self._lock:
            goal = self._running.get(f"ros2-{handle.uuid.hex()}")
        if goal is not None:
            self._submit(lambda: self._cancel(goal.booked))

    def _cancel(self, booked: BookedGoal) -> None:
        try:
            answer = self._request("cancel", {"id": booked.id})
        except Unanswered as error:
            self._say(ERROR, f"goal {booked.id} is not canceled: {error}")
            return
        if not answer["accepted"]:
            self._say(INFO, f"goal {booked.id} is not canceled: {told(answer)}")

    def _ask(self, goal: RunningGoal) -> None:
        """Asks the daemon's ledger for the result of a goal."""
        try:
            answer = self._request("result", {"id": goal.booked.id})
        except Unanswered:
            return
        if answer.get("result") is not None:
            self._end(goal.booked.id, answer["result"])
        elif answer.get("reason") == "unknown-goal" and time.monotonic() > goal.since + KNOWN_WITHIN:
            self._lose(goal, "the daemon does not know the goal; how it ended is not known")

    def _lose(self, goal: RunningGoal, why: str) -> None:
        self._end(goal.booked.id, {"status": "lost", "code": LOST, "message": why})

    def _end(self, name: str, message: Mapping[str, Any]) -> None:
        """Ends a goal, once."""
        with self._lock:
            goal = self._running.pop(name, None)
            if name in self._early:
                self._early[name] = message
        if goal is None:
            return
        booked, handle = goal.booked, goal.handle
        kept = {field: message.get(field) for field in ("status", "code", "message")}
        ended = booked.ended or time.time()
        self._book.put(BookedGoal(booked.uuid, booked.kind, booked.joints, booked.stamp, kept, ended))
        code = message.get("code")
        status = message.get("status")
        result = {"error_code": LOST if code is None else code, "error_string": f"{status}: {message.get('message')}"}
        if status == "succeeded":
            handle.succeed(result)
        elif status == "canceled" and handle.status is Status.CANCELING:
            handle.canceled(result)
        else:
            handle.abort(result)
        self._say(INFO if status == "succeeded" else WARN, f"goal {name} {result['error_string']}")


def told(answer: Mapping[str, Any]) -> str:
    """Returns the sentence of a refusal, with its reason."""
    reason = answer.get("reason")
    return f"{answer['message']} ({reason})" if reason else str(answer["message"])
