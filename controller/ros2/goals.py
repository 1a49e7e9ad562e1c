"""Goals of the two actions: from the client to the daemon, and exactly one result back.

A message with the result may be lost with the network, or be sent while the bridge is down. So the bridge also asks the
daemon's ledger for the result of each goal.
"""

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec

from hyperbit.controller.messages.goals import GoalEnd, LedgerAnswer
from hyperbit.controller.messages.state import State
from hyperbit.controller.network.client import Client, Unanswered
from hyperbit.controller.ros2.answers import request, sentence
from hyperbit.controller.ros2.goal_book import KEPT, MOST_OWED, BookedGoal, GoalBook
from hyperbit.controller.ros2.jobs import Jobs, Passage, Say, Task, Withdrawn
from hyperbit.controller.ros2.messages import ERROR, INFO, WARN
from hyperbit.controller.ros2.poses import BadGoal, Fields
from hyperbit.controller.ros2.trajectories import time_tolerance
from hyperbit.controller.ros2.wire.actions import ActionServer, GoalHandle, IllegalTransition, Policy, Status
from hyperbit.controller.ros2.wire.node import Node

ACTION = "control_msgs/action/FollowJointTrajectory"
ASK_EVERY = 2.0  # [s] between two requests for the result of an open goal
CANCEL_EVERY = 1.0  # [s] between two cancels of a goal, until the daemon reports its end
ENDING_TIMEOUT = 2.0  # [s] for the answer to one cancel or question; the next goals wait meanwhile
KNOWN_WITHIN = 15.0  # [s] after which a goal that the ledger does not have is lost; a request is on its way for 10 s
GONE_AFTER = 60.0  # [s] without a daemon, after which its goals are lost
LOST = -4  # code: the end of the goal is not known
TOO_LATE = -5  # code: the time tolerance is exceeded


class Kind(NamedTuple):
    """One of the actions."""

    name: str  # relative to the node's namespace
    convert: Callable[[Any], Fields]  # from an action's goal to the daemon's goal; raises BadGoal
    feedback: Callable[[State, tuple[str, ...]], Fields]  # from a `state` and the joints' names


@dataclass
class OpenGoal:
    """A goal whose end the daemon has not reported."""

    booked: BookedGoal
    handle: GoalHandle | None  # None: no client waits, but a cancel is owed
    since: float  # the bridge knows the goal since this time [s]
    decided: bool = True
    early: GoalEnd | None = None  # result that came before the decision
    asked: float = -math.inf  # time of the last request for the result [s]
    canceled: float = -math.inf  # time of the last cancel [s]


class ActionGoals:
    """The goals of all actions, and the cancels that are owed to the daemon. Thread-safe."""

    def __init__(
        self, node: Node, kinds: Mapping[str, Kind], book: GoalBook, client: Client, jobs: Jobs, say: Say
    ) -> None:
        self._kinds, self._book, self._client, self._jobs, self._say = kinds, book, client, jobs, say
        self._open: dict[str, OpenGoal] = {}
        self._computer = node.session.computer
        self._lock = threading.Lock()
        self._gone: float | None = None  # time at which the daemon disappeared [s]
        self._cancels = Task(self._computer, "cancels", self._send_cancels, say)
        self._ledger = Task(self._computer, "ledger", self._ask_results, say)
        policy = Policy(self._may_cancel, self._on_cancel, KEPT)
        self._servers = {
            name: node.action_server(kind.name, ACTION, self._on_goal(name), policy) for name, kind in kinds.items()
        }
        for booked in book.goals():
            self._restore(booked)

    def receive_result(self, result: GoalEnd) -> None:
        self._end(result.id or "", result)

    def receive_alive(self, *, alive: bool) -> None:
        self._gone = None if alive else self._gone or self._computer.monotonic()

    def publish_feedback(self, state: State) -> None:
        with self._lock:
            goal = self._open.get(state.goal or "")
            handle = goal.handle if goal is not None else None
        if goal is not None and handle is not None:
            handle.feedback(self._kinds[goal.booked.kind].feedback(state, goal.booked.joints))

    def poll(self, now: float) -> None:
        """Sends due cancels and result requests; ends goals after a long absence of the daemon. `now` [s]."""
        if self._gone is None:
            self._owe_late(now)
            for task, due in ((self._cancels, self._due_cancel), (self._ledger, self._due_question)):
                if due(now) is not None:
                    task.ask()
            return
        with self._lock:
            lost = [it for it in self._open.values() if it.handle and now > max(self._gone, it.since) + GONE_AFTER]
        for goal in lost:
            self._lose(goal, f"the daemon is gone for {GONE_AFTER:g} s; how the goal ended is not known")

    def check_room(self) -> None:
        """Raises BadGoal if too many cancels are owed."""
        with self._lock:
            owed = sum(it.booked.owed and it.handle is None for it in self._open.values())
        if owed >= MOST_OWED:
            raise BadGoal(f"{owed} goals are not canceled yet, expected less than {MOST_OWED}")

    def owe_cancel(self, booked: BookedGoal) -> None:
        """Repeats the cancel of a goal without client until the daemon reports the goal's end."""
        self._owe(OpenGoal(booked, None, self._computer.monotonic()))
        self._cancels.ask()

    def close(self) -> None:
        """Sends the cancels that are due, and ends all goals: no client can wait for a closed bridge."""
        self._cancels.close()
        self._ledger.close()
        with self._lock:
            running = [goal for goal in self._open.values() if goal.handle]
        for goal in running:
            rest = "the next one goes on to cancel it" if goal.booked.owed else "the arm carries the goal on"
            self._lose(goal, f"the bridge to ROS 2 has ended; {rest}")

    def _on_goal(self, kind: str) -> Callable[[GoalHandle], None]:
        def on_goal(handle: GoalHandle) -> None:
            passage = Passage(self._jobs.order)
            if not self._jobs.submit(lambda: start(handle, passage)):
                self._reject(kind, handle, "too many requests wait")

        def start(handle: GoalHandle, passage: Passage) -> None:
            code, why, may_run = LOST, "the request failed", True
            try:
                self._start(kind, handle, passage)
                why = ""
            except BadGoal as error:
                code, why, may_run = error.code, str(error), False
            except (Unanswered, Withdrawn) as error:
                why = str(error)
            finally:  # whatever has failed, the client gets an answer
                if why:
                    self._withdraw(daemon_id(handle), may_run=may_run and passage.sent)
                    self._reject(kind, handle, why, code)

        return on_goal

    def _start(self, kind: str, handle: GoalHandle, passage: Passage) -> None:
        """Sends a goal to the daemon, and accepts it if the daemon accepts it.

        Raises:
            BadGoal: the goal does not run.
            Unanswered, Withdrawn: the goal may run, if it was sent.
        """
        self.check_room()
        allowed = time_tolerance(handle.goal)
        goal = {**self._kinds[kind].convert(handle.goal), "id": daemon_id(handle)}
        joints = tuple(handle.goal.trajectory.joint_names)
        booked = BookedGoal(handle.uuid.hex(), kind, joints, self._computer.stamp())
        if why := self._book.add(booked):
            raise BadGoal(why)
        begun = OpenGoal(booked, handle, self._computer.monotonic(), decided=False)
        with self._lock:
            self._open[booked.id] = begun
        answer = request(self._client, "goal", goal, passage)
        if not answer.accepted:
            raise BadGoal(sentence(answer) or "no reason is given", answer.code)
        if allowed is not None:
            within = max(goal["stamp"] - self._computer.time(), 0.0) + goal["waypoints"][-1]["t"] + allowed
            begun.booked = msgspec.structs.replace(booked, since=self._computer.monotonic(), within=within)
            self._book.put(begun.booked)
        handle.accept()
        handle.execute()
        with self._lock:
            begun.decided = True
        if begun.early is not None:
            self._end(booked.id, begun.early)
        self._say(INFO, f"goal {booked.id} of {self._kinds[kind].name} is accepted: {sentence(answer)}")

    def _withdraw(self, name: str, *, may_run: bool) -> None:
        """Removes a rejected goal; cancels it if the daemon may run it."""
        with self._lock:
            goal = self._open.pop(name, None) if name in self._open and not self._open[name].decided else None
        if goal is None:
            return
        if may_run:
            self.owe_cancel(msgspec.structs.replace(goal.booked, client=False))
        else:
            self._book.remove(goal.booked)

    def _reject(self, kind: str, handle: GoalHandle, why: str, code: int = -1) -> None:
        self._say(WARN, f"a goal of {self._kinds[kind].name} is rejected (code {code}): {why}")
        if handle.status is Status.UNKNOWN:
            handle.reject()

    def _restore(self, booked: BookedGoal) -> None:
        """Continues a goal of an earlier run of the bridge."""
        server: ActionServer | None = self._servers.get(booked.kind) if booked.client else None
        handle = None
        if server is not None:
            status, fields = Status.CANCELING if booked.canceling else Status.EXECUTING, None
            if booked.result is not None:
                status, fields = ending(booked.result, canceling=booked.canceling)
            try:
                handle = server.restore(bytes.fromhex(booked.uuid), booked.stamp, status, fields)
            except IllegalTransition:  # its client has just repeated it, and the daemon knows it
                if not booked.owed:
                    return
        if booked.owed or (handle and booked.result is None):
            with self._lock:
                self._open[booked.id] = OpenGoal(
                    booked, None if booked.result is not None else handle, self._computer.monotonic()
                )
        elif handle is None:
            self._book.remove(booked)

    def _owe(self, goal: OpenGoal) -> None:
        with self._lock:
            goal.booked = msgspec.structs.replace(goal.booked, canceling=True, owed=True)
            self._open[goal.booked.id] = goal
            self._book.put(goal.booked)

    def _owe_late(self, now: float) -> None:
        """Owes the cancel of each goal that exceeds its time tolerance; no client has asked for it."""
        with self._lock:
            for goal in self._open.values():
                booked = goal.booked
                late = booked.within is not None and now > booked.since + booked.within
                if goal.decided and goal.handle and late and not booked.owed:
                    goal.booked = msgspec.structs.replace(booked, owed=True)
                    self._book.put(goal.booked)

    def _may_cancel(self, handle: GoalHandle) -> bool:
        """Writes that a cancel is owed before the client learns of its acceptance: a kill may come between."""
        with self._lock:
            goal = self._open.get(daemon_id(handle))
        if goal is not None and goal.handle is handle:
            self._owe(goal)
        return True

    def _on_cancel(self, _: GoalHandle) -> None:
        self._cancels.ask()

    def _due_cancel(self, now: float) -> OpenGoal | None:
        """Returns the goal whose cancel is due for the longest time."""
        with self._lock:
            due = [it for it in self._open.values() if it.booked.owed and now >= it.canceled + CANCEL_EVERY]
        return min(due, key=lambda it: it.canceled, default=None)

    def _due_question(self, now: float) -> OpenGoal | None:
        """Returns the goal whose result has to be asked for first."""
        with self._lock:
            due = [it for it in self._open.values() if it.decided and now >= it.asked + ASK_EVERY]
        return min(due, key=lambda it: it.asked, default=None)

    def _send_cancels(self) -> None:
        """Sends the cancels that are due until the daemon fails to answer."""
        while (goal := self._due_cancel(self._computer.monotonic())) is not None:
            first, goal.canceled = goal.canceled < 0, self._computer.monotonic()
            try:
                request(self._client, "cancel", {"id": goal.booked.id}, timeout=ENDING_TIMEOUT)
            except Unanswered as error:
                if first:
                    self._say(ERROR, f"goal {goal.booked.id} is not canceled yet: {error}")
                return

    def _ask_results(self) -> None:
        """Asks the daemon's ledger for due results until the daemon fails to answer."""
        while (goal := self._due_question(self._computer.monotonic())) is not None:
            goal.asked = self._computer.monotonic()
            try:
                answer = request(self._client, "result", {"id": goal.booked.id}, timeout=ENDING_TIMEOUT)
            except Unanswered:
                return
            if isinstance(answer, LedgerAnswer) and answer.result is not None:
                self._end(goal.booked.id, answer.result)
            elif answer.reason == "unknown-goal" and self._computer.monotonic() > goal.since + KNOWN_WITHIN:
                why = "the daemon does not know the goal; how it ended is not known"
                self._end(goal.booked.id, GoalEnd("lost", code=LOST, message=why))

    def _lose(self, goal: OpenGoal, why: str) -> None:
        """Reports to a client that the end of its goal is unknown. An owed cancel stays."""
        self._end(goal.booked.id, GoalEnd("lost", code=LOST, message=why), known=False)

    def _end(self, name: str, result: GoalEnd, *, known: bool = True) -> None:
        """Ends a goal, once. `known`: the daemon has ended the goal as well, so no cancel is owed."""
        with self._lock:
            goal = self._open.get(name)
            if goal is None:
                return
            if not goal.decided:
                goal.early = result
                return
            handle, goal.handle = goal.handle, None
            booked = msgspec.structs.replace(goal.booked, owed=goal.booked.owed and not known)
            # A cancel that is accepted after this comes too late.
            canceling = handle is not None and handle.status is Status.CANCELING
            if result.status == "canceled" and goal.booked.owed and not goal.booked.canceling:
                why = "the arm was not there within goal_time_tolerance, and the goal was canceled"
                result = GoalEnd("aborted", code=TOO_LATE, message=why)
            if handle is not None:
                now = self._computer.monotonic()
                booked = msgspec.structs.replace(booked, result=result, ended=now, canceling=canceling)
            goal.booked = booked
            if not booked.owed:
                del self._open[name]
            (self._book.put if booked.owed or booked.client else self._book.remove)(booked)
        if handle is not None:
            status, fields = ending(result, canceling=canceling)
            handle.end(status, fields)
        self._say(INFO if result.status == "succeeded" else WARN, f"goal {name} {result.status}: {result.message}")


def ending(result: GoalEnd, *, canceling: bool) -> tuple[Status, Fields]:
    status = Status.CANCELED if result.status == "canceled" and canceling else Status.ABORTED
    fields = {"error_code": result.code, "error_string": f"{result.status}: {result.message}"}
    return Status.SUCCEEDED if result.status == "succeeded" else status, fields


def daemon_id(handle: GoalHandle) -> str:
    return f"ros2-{handle.uuid.hex()}"
