"""The judge finds nothing wrong with the bridge, and each planted defect by the rule that the defect breaks."""

import contextlib
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest

from hyperbit.controller.ros2 import goals, jobs, messages, requests
from hyperbit.controller.ros2.goal_book import TOPICS, GoalBook
from hyperbit.controller.ros2.goals import ActionGoals
from hyperbit.controller.ros2.jobs import Order, Task
from hyperbit.controller.ros2.requests import Ending, Requests
from hyperbit.controller.ros2.wire.action_events import Status
from hyperbit.controller.ros2.wire.action_server import ActionServer, GoalHandle
from tests.ros2.fuzz.inputs import Inputs
from tests.ros2.fuzz.world import MOTION, World
from tests.ros2.judge import judge
from tests.ros2.judge.actions import Wrong

pytestmark = pytest.mark.timeout(600)
MESSAGES = 3_000  # within which each defect is found

Patch = tuple[Any, str, Any]


class Defect(NamedTuple):
    """A planted defect.

    Attributes:
        found: regular expression of the sentence of the rule that finds the defect.
        times: patches of bridge and judge alike, with which nothing is wrong.
    """

    patches: list[Patch]
    found: str
    seed: int = 0
    times: tuple[Patch, ...] = ()


_task, _put, _restore, _ending = Task.__init__, GoalBook.put, ActionServer.restore, goals.ending
_end, _passing, _owe_cancel = ActionGoals._end, Order.passing, ActionGoals.owe_cancel
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


def _owe_topics(self: ActionGoals, booked: Any) -> None:
    if booked.kind in TOPICS:
        _owe_cancel(self, booked)
    else:
        self._book.remove(booked)


def _owe_actions(self: ActionGoals, booked: Any) -> None:
    if booked.kind not in TOPICS:
        _owe_cancel(self, booked)


def _lose_debts(self: ActionGoals, name: str, result: Any, *, known: bool = True) -> None:
    _end(self, name, result)


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


SOON = ((goals, "GONE_AFTER", 0.5), (judge, "GONE_AFTER", 0.5))  # clients lose their goals more often
OWED = "the accepted cancel of .* is not repeated|is sent while a cancel of its id is owed"
EARLY = "has ended with status 6, and the daemon has not said so"
DEFECTS = {
    "stops wait behind what asks for motion": Defect(
        [(Task, "__init__", _share_places)], "a (stop|cancel) is not sent within"
    ),
    "a stop bars nothing": Defect([(Order, "passing", _bar_nothing)], "is sent, though a (stop|cancel) came after it"),
    "what comes later overtakes a stop": Defect(
        [(Order, "passing", _wait_for_nothing)], "is sent, though a (stop|cancel) that came before it is not sent"
    ),
    "a stop is answered before it is sent": Defect(
        [(Ending, "receive", _answer_at_once)], "(stop|cancel) is answered True, the daemon has not said so"
    ),
    "a cancel is sent once": Defect([(ActionGoals, "_due_cancel", _send_cancels_once)], OWED, seed=3),
    "a cancel is forgotten by a restart": Defect([(GoalBook, "put", _forget_cancels)], OWED),
    "a cancel is given up with its client": Defect([(ActionGoals, "_end", _lose_debts)], OWED, times=SOON),
    "a cancel is given up while its goal may come": Defect([(goals, "KNOWN_WITHIN", 0.0)], OWED),
    "an action's goal without an answer is not canceled": Defect(
        [(ActionGoals, "owe_cancel", _owe_topics)], OWED, seed=5
    ),
    "a topic's goal without an answer is not canceled": Defect(
        [(ActionGoals, "owe_cancel", _owe_actions)], "the accepted cancel of ros2-goal_p.* is not repeated", seed=5
    ),
    "a goal is accepted whatever the daemon says": Defect(
        [(goals.Answer, "accepted", True)], "send_goal is answered True, the daemon's answer is (False|None)", seed=1
    ),
    "a result is dropped": Defect([(ActionGoals, "receive_result", lambda *_: None)], "its client was not told"),
    "each goal succeeds": Defect([(goals, "ending", _always_succeed)], "has ended with status 4, and the daemon"),
    "canceled goals are aborted": Defect([(goals, "ending", _abort_canceled)], EARLY),
    "each code is 0": Defect([(goals, "ending", _other_code)], r"is told to be Result\(status=., code=0, "),
    "a result changes by a restart": Defect([(GoalBook, "put", _forget_sentences)], "has two results", seed=1),
    "an ended goal runs again after a restart": Defect(
        [(ActionServer, "restore", _restore_as_executing)], "has come from status [456] to [123]", seed=1
    ),
    "a goal is lost too early": Defect([(goals, "GONE_AFTER", 1.0)], EARLY, seed=1),
    "a goal is canceled before its time is over": Defect(
        [(goals, "time_tolerance", lambda _: 0.5)], "is canceled, and nobody asked for it"
    ),
    "there is no feedback": Defect([(GoalHandle, "feedback", lambda *_: None)], "there is no feedback of"),
    "old poses move the arm": Defect(
        [(requests, "check_stamp", lambda *_: None)], "goal is sent, and nobody asked for it"
    ),
    "a request has no reply": Defect(
        [(Requests, "_answer", _no_reply)], "a request on (reset|plan) has no reply", seed=3
    ),
    "joints are shown as commanded": Defect(
        [(messages, "joint_state", _show_commanded)], "joint_states are not what the daemon has measured"
    ),
}


def test_the_judge_finds_nothing_if_clients_lose_their_goals_more_often(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for patch in SOON:
        monkeypatch.setattr(*patch)
    World(Inputs(random.Random(1)), tmp_path).run(1_500)


@pytest.mark.parametrize("name", DEFECTS)
def test_the_judge_finds_a_defect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    defect = DEFECTS[name]
    for patch in (*defect.patches, *defect.times):
        monkeypatch.setattr(*patch)
    with pytest.raises(Wrong, match=defect.found):
        World(Inputs(random.Random(defect.seed)), tmp_path).run(MESSAGES)


def replayed(folder: Path) -> str:
    world = World(Inputs(random.Random(0)), folder)
    world.run(300)
    return repr((world.chance.random(), world.clock.now, world.network.words, world.counts))


def test_a_seed_replays_exactly_in_another_process(tmp_path: Path) -> None:
    script = "import sys; from pathlib import Path; from tests.ros2.test_judge import replayed as it; "
    command = [sys.executable, "-c", f"{script}print(it(Path(sys.argv[1])))", str(tmp_path / "other")]
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == replayed(tmp_path / "own")
