"""The judge must find defects that are planted in the bridge, one at a time."""

import contextlib
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from controller.ros2 import goals, jobs, messages, requests
from controller.ros2.goal_book import GoalBook
from controller.ros2.goals import ActionGoals
from controller.ros2.jobs import Order, Task
from controller.ros2.requests import Ending, Requests
from controller.ros2.wire.action_events import Status
from controller.ros2.wire.action_server import ActionServer, GoalHandle
from tests.ros2.fuzz.inputs import Inputs
from tests.ros2.fuzz.world import MOTION, World
from tests.ros2.judge.actions import Wrong

pytestmark = pytest.mark.timeout(600)
MESSAGES = 10_000  # within which each defect is found

Patch = tuple[Any, str, Any]

_task, _put, _restore, _ending = Task.__init__, GoalBook.put, ActionServer.restore, goals.ending
_end, _passing, _reply = ActionGoals._end, Order.passing, Requests._answer
_joint_state, _receive = messages.joint_state, Ending.receive


def _share_places(self: Task, name: str, function: Callable[[], None], say: Any) -> None:
    _task(self, name, function, say)
    self._pool._name = self._pool.name = MOTION  # type: ignore[attr-defined]


@contextlib.contextmanager
def _bar_nothing(self: Order, ticket: int, barring: tuple[str, ...], wait: float) -> Iterator[None]:
    with _passing(self, ticket, (), wait):
        yield


@contextlib.contextmanager
def _wait_for_nothing(self: Order, ticket: int, barring: tuple[str, ...], wait: float) -> Iterator[None]:
    if any(self._last[key] > ticket for key in barring):
        raise jobs.Withdrawn("a stop came after it")
    yield


def _send_cancels_once(self: ActionGoals, now: float) -> Any:
    due = [goal for goal in self._open.values() if goal.booked.owed and goal.canceled < 0]
    return due[0] if due else None


def _forget_cancels(self: GoalBook, goal: Any) -> None:
    _put(self, msgspec.structs.replace(goal, owed=False))


def _forget_sentences(self: GoalBook, goal: Any) -> None:
    if goal.result is not None:
        goal = msgspec.structs.replace(goal, result=msgspec.structs.replace(goal.result, message=""))
    _put(self, goal)


def _remove_withdrawn(self: ActionGoals, name: str, *, may_run: bool) -> None:
    goal = self._open.pop(name, None)
    if goal is not None:
        self._book.remove(goal.booked)


def _lose_debts(self: ActionGoals, name: str, result: Any, *, known: bool = True) -> None:
    _end(self, name, result)


def _drop_early(self: ActionGoals, name: str, result: Any, *, known: bool = True) -> None:
    if name in self._open and self._open[name].decided:
        _end(self, name, result, known=known)


def _restore_as_executing(self: ActionServer, uuid: bytes, stamp: int, status: Status, result: Any = None) -> Any:
    handle = _restore(self, uuid, stamp, min(status, Status.EXECUTING))
    if status > Status.CANCELING:
        handle.abort(result)
    return handle


def _always_succeed(result: Any, *, canceling: bool) -> Any:
    return Status.SUCCEEDED, _ending(result, canceling=canceling)[1]


def _abort_canceled(result: Any, *, canceling: bool) -> Any:
    return _ending(result, canceling=False)


def _other_code(result: Any, *, canceling: bool) -> Any:
    status, fields = _ending(result, canceling=canceling)
    return status, {**fields, "error_code": 0}


def _no_reply(self: Requests, asked: Any, job: Callable[[], Any], empty: Any) -> None:
    self._jobs.submit(job)  # type: ignore[arg-type]


def _answer_at_once(self: Ending, asked: Any) -> None:
    _receive(self, asked)
    asked.reply({"success": True, "message": "it will be done"})


def _show_commanded(state: Any, actuators: Any) -> Any:
    return _joint_state({**state, "measured": state.get("commanded")}, actuators)


DEFECTS: dict[str, list[Patch]] = {
    "stops wait behind what asks for motion": [(Task, "__init__", _share_places)],
    "a stop bars nothing": [(Order, "passing", _bar_nothing)],
    "what comes later overtakes a stop": [(Order, "passing", _wait_for_nothing)],
    "a stop is answered before it is sent": [(Ending, "receive", _answer_at_once)],
    "a cancel is sent once": [(ActionGoals, "_due_cancel", _send_cancels_once)],
    "a cancel is forgotten by a restart": [(GoalBook, "put", _forget_cancels)],
    "a cancel is given up with its client": [(ActionGoals, "_end", _lose_debts), (goals, "GONE_AFTER", 0.0)],
    "a goal without an answer is not canceled": [(ActionGoals, "_withdraw", _remove_withdrawn)],
    "a topic's goal without an answer is not canceled": [(ActionGoals, "owe_cancel", lambda *_: None)],
    "a goal is accepted whatever the daemon says": [(goals.Answer, "accepted", True)],
    "a result that comes early is dropped": [(ActionGoals, "_end", _drop_early)],
    "a result is dropped": [(ActionGoals, "receive_result", lambda *_: None)],
    "each goal succeeds": [(goals, "ending", _always_succeed)],
    "canceled goals are aborted": [(goals, "ending", _abort_canceled)],
    "each code is 0": [(goals, "ending", _other_code)],
    "a result changes by a restart": [(GoalBook, "put", _forget_sentences)],
    "an ended goal runs again after a restart": [(ActionServer, "restore", _restore_as_executing)],
    "a goal is lost too early": [(goals, "GONE_AFTER", 1.0)],
    "a goal that the ledger may learn of is lost": [(goals, "KNOWN_WITHIN", 0.0)],
    "there is no feedback": [(GoalHandle, "feedback", lambda *_: None)],
    "old poses move the arm": [(requests, "check_stamp", lambda *_: None)],
    "a request has no reply": [(Requests, "_answer", _no_reply)],
    "joints are shown as commanded": [(messages, "joint_state", _show_commanded)],
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_the_judge_finds_a_defect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, defect: str) -> None:
    for owner, name, value in DEFECTS[defect]:
        monkeypatch.setattr(owner, name, value)
    with pytest.raises(Wrong) as found:
        World(Inputs(random.Random(0)), tmp_path).run(MESSAGES)
    print(f"{defect}: {str(found.value).splitlines()[0]}")
