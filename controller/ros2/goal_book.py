"""Goals of action clients, kept in a file, so that a restarted bridge still sends their results."""

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec

from hyperbit.controller.host.files import read_kept
from hyperbit.controller.host.keeper import write_whole
from hyperbit.controller.messages.goals import GoalEnd
from hyperbit.controller.ros2.wire.session import LATEST

KEPT = 60.0  # [s] for which a result is kept after its goal's end
MOST_GOALS = 64  # in the file; the oldest results above this number are forgotten
MOST_OWED = 64  # cancels that are owed to the daemon; above this number no goal begins
TOPICS = ("goal_pose", "goal_path")
log = logging.getLogger(__name__)


class BookedGoal(msgspec.Struct, frozen=True):
    """A goal of an action client, or a goal of a topic whose cancel is owed. Seconds are of CLOCK_MONOTONIC."""

    uuid: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{32}\Z")]  # hexadecimal
    kind: str  # "tip" or "actuators", or the topic's name
    joints: tuple[str, ...]
    stamp: Annotated[int, msgspec.Meta(ge=0, le=LATEST)]  # of arrival [ns since 1970]
    result: GoalEnd | None = None
    ended: float = 0.0  # time of the result [s]
    canceling: bool = False  # a cancel was accepted before the end, so the result may be "canceled"
    owed: bool = False  # a cancel is repeated until the daemon reports the goal's end
    since: float = 0.0  # time of the acceptance [s]
    within: float | None = None  # after the acceptance; a later goal exceeds its time tolerance [s]
    client: bool = True  # a client knows that the goal is accepted, or waits for the decision

    @property
    def id(self) -> str:
        """Id of the daemon's goal."""
        return f"ros2-{self.kind}-{self.uuid[:8]}" if self.kind in TOPICS else f"ros2-{self.uuid}"


class GoalBook:
    """Goals without a result, goals whose cancel is owed, and goals that ended lately. Thread-safe.

    Each change replaces the file, so a killed process leaves the old file or the new one. No fsync is needed: a power
    failure ends the waiting clients as well.
    """

    def __init__(self, path: Path, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._path, self._lock, self._monotonic = path, threading.Lock(), monotonic
        path.parent.mkdir(parents=True, exist_ok=True)
        kept = read_kept(path, list[BookedGoal], "goals and owed cancels of earlier runs are not known")
        now = monotonic()  # a later time is of an earlier start of the computer
        self._goals = {
            goal.uuid: msgspec.structs.replace(goal, since=min(goal.since, now), ended=min(goal.ended, now))
            for goal in kept or ()
        }

    def goals(self) -> list[BookedGoal]:
        """Returns all goals, the oldest first."""
        with self._lock:
            return list(self._goals.values())

    def add(self, goal: BookedGoal) -> str:
        """Writes a new goal; returns "", or why its id cannot be used."""
        with self._lock:
            known = self._goals.get(goal.uuid)
            if known is not None and known.kind != goal.kind:
                return f"a goal of the other action has the id {goal.uuid}; another one is needed"
            if known is not None and known.owed:
                return f"an earlier goal has the id {goal.uuid}, and is not canceled yet; another id is needed"
            self._goals[goal.uuid] = goal
            self._write()
            return ""

    def put(self, goal: BookedGoal) -> None:
        with self._lock:
            self._goals[goal.uuid] = goal
            self._write()

    def remove(self, goal: BookedGoal) -> None:
        with self._lock:
            self._goals.pop(goal.uuid, None)
            self._write()

    def _write(self) -> None:
        until = self._monotonic() - KEPT
        self._goals = {key: goal for key, goal in self._goals.items() if stays(goal, until)}
        ended = [key for key, goal in self._goals.items() if goal.result is not None and not goal.owed]
        for key in ended[: max(len(self._goals) - MOST_GOALS, 0)]:
            del self._goals[key]
        try:
            write_whole(self._path, msgspec.json.encode(list(self._goals.values())), sync=False)
        except OSError as error:
            log.error("a restart would forget the goals: %s: %s", self._path, error.strerror)


def stays(goal: BookedGoal, until: float) -> bool:
    """Returns whether the book keeps a goal: it is open, or it ended after `until`."""
    return goal.result is None or goal.owed or goal.ended > until
