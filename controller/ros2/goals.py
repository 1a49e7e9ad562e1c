"""Goals of the two actions: from the client to the daemon, and exactly one result back.

The daemon's ledger knows how a goal ended. So the bridge asks for the result of each goal now and then, whatever became
of the message with the result: lost with the network, or sent while the daemon or the bridge was away.
"""

import contextlib
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec

from controller.network.client import Client, Unanswered
from controller.ros2.answers import Answer, GoalResult, LedgerAnswer, request
from controller.ros2.goal_book import KEPT, BookedGoal, GoalBook
from controller.ros2.messages import ERROR, INFO, WARN
from controller.ros2.poses import BadGoal, Fields
from controller.ros2.wire.action_core import IllegalTransition
from controller.ros2.wire.action_events import Status
from controller.ros2.wire.action_server import ActionServer, GoalHandle, Policy
from controller.ros2.wire.node import Node

ACTION = "control_msgs/action/FollowJointTrajectory"
ASK_EVERY = 2.0  # [s] for the result of a running goal
KNOWN_WITHIN = 15.0  # [s] after which a goal that the ledger does not have is lost
GONE_AFTER = 60.0  # [s] without a daemon, after which its goals are lost
LOST = -4  # code: the end of the goal is not known

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
    since: float
    asked: float


class ActionGoals:
    """The goals of all actions. For any thread.

    Args:
        node: whose actions they are.
        kinds: the actions by kind.
        book: file of the goals.
        client: of the daemon.
        submit: runs a function in a thread of the bridge's; returns False if too many wait.
        say: tells a sentence on /rosout.
    """

    def __init__(
        self,
        node: Node,
        kinds: Mapping[str, Kind],
        book: GoalBook,
        client: Client,
        submit: Callable[[Callable[[], None]], bool],
        say: Say,
    ) -> None:
        self._kinds, self._book, self._client, self._submit, self._say = kinds, book, client, submit, say
        self._running: dict[str, RunningGoal] = {}
        self._early: dict[str, GoalResult | None] = {}  # results that came before the goal's client knew of it
        self._lock = threading.Lock()
        self._gone: float | None = None  # since when the daemon is gone [s]
        policy = Policy(on_cancel=self._on_cancel, result_timeout=KEPT)
        self._servers = {
            name: node.action_server(kind.name, ACTION, self._on_goal(name), policy) for name, kind in kinds.items()
        }
        for booked in book.goals():
            self._restore(booked)

    def receive_result(self, result: GoalResult) -> None:
        """Accepts a `result` of the daemon."""
        self._end(result.id, result)

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
            if not self._submit(lambda: start(handle)):
                self._reject(kind, handle, "too many requests wait")

        def start(handle: GoalHandle) -> None:
            try:
                self._start(kind, handle)
            finally:  # whatever has failed, the client gets an answer
                with self._lock:
                    self._early.pop(daemon_id(handle), None)
                if handle.status is Status.UNKNOWN:
                    with contextlib.suppress(IllegalTransition):  # it is rejected already
                        handle.reject()

        return on_goal

    def _start(self, kind: str, handle: GoalHandle) -> None:
        """Sends a goal to the daemon; accepts or rejects it by the daemon's answer."""
        try:
            goal = {**self._kinds[kind].convert(handle.goal), "id": daemon_id(handle)}
        except BadGoal as error:
            self._reject(kind, handle, str(error), error.code)
            return
        booked = BookedGoal(handle.uuid.hex(), kind, tuple(handle.goal.trajectory.joint_names), time.time_ns())
        if not self._book.add(booked):
            self._reject(kind, handle, f"a goal of the other action has the id {booked.uuid}; another one is needed")
            return
        with self._lock:
            self._early[booked.id] = None
        try:
            answer = request(self._client, Answer, "goal", goal)
        except Unanswered as error:
            answer = Answer(accepted=False, code=LOST, message=str(error))
            if not self._submit(lambda: self._cancel(booked)):  # it may have arrived
                self._say(ERROR, f"goal {booked.id} is rejected, but the arm may carry it out: too many requests wait")
        if not answer.accepted:
            self._book.remove(booked)
            self._reject(kind, handle, answer.text, answer.code)
            return
        handle.accept()
        handle.execute()
        now = time.monotonic()
        with self._lock:
            self._running[booked.id] = RunningGoal(booked, handle, now, now)
            early = self._early.pop(booked.id)
        if handle.status is Status.CANCELING:  # since a moment ago, when the goal was not among those that run
            self._on_cancel(handle)
        if early is not None:
            self._end(booked.id, early)
        self._say(INFO, f"goal {booked.id} of {self._kinds[kind].name} is accepted")

    def _reject(self, kind: str, handle: GoalHandle, why: str, code: int = -1) -> None:
        self._say(WARN, f"a goal of {self._kinds[kind].name} is rejected (code {code}): {why}")
        handle.reject()

    def _restore(self, booked: BookedGoal) -> None:
        """Continues a goal of the bridge before this one."""
        server: ActionServer | None = self._servers.get(booked.kind)
        if server is None:
            self._book.remove(booked)
            return
        try:
            handle = server.restore(bytes.fromhex(booked.uuid), booked.stamp, canceling=booked.canceling)
        except IllegalTransition:  # its client has just sent it again, and the daemon knows it
            return
        with self._lock:
            self._running[booked.id] = RunningGoal(booked, handle, time.monotonic(), 0.0)
        if booked.result is not None:
            self._end(booked.id, booked.result)

    def _on_cancel(self, handle: GoalHandle) -> None:
        with self._lock:
            goal = self._running.get(daemon_id(handle))
            if goal is not None:
                goal.booked = msgspec.structs.replace(goal.booked, canceling=True)
                self._book.put(goal.booked)
        if goal is not None:
            self._submit(lambda: self._cancel(goal.booked))

    def _cancel(self, booked: BookedGoal) -> None:
        try:
            answer = request(self._client, Answer, "cancel", {"id": booked.id})
        except Unanswered as error:
            self._say(ERROR, f"goal {booked.id} is not canceled: {error}")
            return
        if not answer.accepted:
            self._say(INFO, f"goal {booked.id} is not canceled: {answer.text}")

    def _ask(self, goal: RunningGoal) -> None:
        """Asks the daemon's ledger for the result of a goal."""
        try:
            answer = request(self._client, LedgerAnswer, "result", {"id": goal.booked.id})
        except Unanswered:
            return
        if answer.result is not None:
            self._end(goal.booked.id, answer.result)
        elif answer.reason == "unknown-goal" and time.monotonic() > goal.since + KNOWN_WITHIN:
            self._lose(goal, "the daemon does not know the goal; how it ended is not known")

    def _lose(self, goal: RunningGoal, why: str) -> None:
        self._end(goal.booked.id, GoalResult("lost", LOST, why))

    def _end(self, name: str, result: GoalResult) -> None:
        """Ends a goal, once."""
        with self._lock:
            goal = self._running.pop(name, None)
            if name in self._early:
                self._early[name] = result
        if goal is None:
            return
        booked, handle = goal.booked, goal.handle
        canceling = handle.status is Status.CANCELING  # a cancel that is accepted after this comes too late
        ended = booked.ended or time.time()
        self._book.put(msgspec.structs.replace(booked, result=result, ended=ended, canceling=canceling))
        code, sentence = LOST if result.code is None else result.code, f"{result.status}: {result.message}"
        fields = {"error_code": code, "error_string": sentence}
        if result.status == "succeeded":
            handle.succeed(fields)
        elif result.status == "canceled" and canceling:
            handle.canceled(fields)
        else:
            handle.abort(fields)
        self._say(INFO if result.status == "succeeded" else WARN, f"goal {name} {sentence}")


def daemon_id(handle: GoalHandle) -> str:
    """Returns the id of the daemon's goal."""
    return f"ros2-{handle.uuid.hex()}"
