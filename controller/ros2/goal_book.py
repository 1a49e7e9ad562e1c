"""The goals that action clients wait for, in a file: a bridge that is started again owes their results still."""

import logging
import threading
import time
from pathlib import Path
from typing import Annotated

import msgspec

from hyperbit.controller.host.keeper import set_aside, write_whole
from hyperbit.controller.ros2.answers import GoalResult

KEPT = 60.0  # [s] for which a result is kept after its goal's end
MOST_GOALS = 64  # in the file; of more, the results that came first are forgotten
MOST_OWED = 64  # cancels that are owed to the daemon; while there are more, no goal begins
TOPICS = ("goal_pose", "goal_path")
LATEST = 2**31 * 10**9  # [ns since 1970] that a message of ROS 2 can hold
log = logging.getLogger(__name__)


class BookedGoal(msgspec.Struct, frozen=True):
    """A goal of an action client, or one of a topic whose cancel is owed.

    Attributes:
        uuid: id of the goal, in hexadecimal.
        kind: "tip" or "actuators", or the topic's name.
        joints: names of the joints of its trajectory.
        stamp: when it came [ns since 1970].
        result: of the daemon, or of the bridge; None: there is none yet.
        ended: UNIX time of the result [s].
        canceling: whether a cancel was accepted before its end; then its result may be that it is canceled.
        owed: whether a cancel is owed to the daemon: it is repeated until the daemon tells how the goal ended.
        client: whether a client was told that the goal is accepted, or waits for that.
    """

    uuid: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{32}\Z")]
    kind: str
    joints: tuple[str, ...]
    stamp: Annotated[int, msgspec.Meta(ge=0, lt=LATEST)]
    result: GoalResult | None = None
    ended: float = 0.0
    canceling: bool = False
    owed: bool = False
    client: bool = True

    @property
    def id(self) -> str:
        """Id of the daemon's goal."""
        return f"ros2-{self.kind}-{self.uuid[:8]}" if self.kind in TOPICS else f"ros2-{self.uuid}"


class GoalBook:
    """All goals without a result, those whose cancel is owed, and those that ended lately. For any thread.

    Each change replaces the file, so that a kill of the process leaves the old one or the new one. A power failure ends
    the clients' waiting as well, so the disk is not waited for.

    Args:
        path: of the file; its folder is made.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, threading.Lock()
        self._goals: dict[str, BookedGoal] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._goals = {goal.uuid: goal for goal in msgspec.json.decode(path.read_bytes(), type=list[BookedGoal])}
        except FileNotFoundError:
            pass
        except (msgspec.MsgspecError, UnicodeError) as error:
            log.error("goals before the start are not known: %s: %s; renamed to %s", path, error, set_aside(path))
        except OSError as error:
            log.error("goals before the start are not known: %s: %s", path, error)

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
        """Writes what has become of a goal."""
        with self._lock:
            self._goals[goal.uuid] = goal
            self._write()

    def remove(self, goal: BookedGoal) -> None:
        """Removes a goal that was not accepted."""
        with self._lock:
            self._goals.pop(goal.uuid, None)
            self._write()

    def _write(self) -> None:
        until = time.time() - KEPT
        self._goals = {key: goal for key, goal in self._goals.items() if stays(goal, until)}
        ended = [key for key, goal in self._goals.items() if goal.result is not None and not goal.owed]
        for key in ended[: max(len(self._goals) - MOST_GOALS, 0)]:
            del self._goals[key]
        try:
            write_whole(self._path, msgspec.json.encode(list(self._goals.values())), sync=False)
        except OSError as error:
            log.error("a restart would forget the goals: %s: %s", self._path, error.strerror)


def stays(goal: BookedGoal, until: float) -> bool:
    """Returns whether a goal is open, or has ended after `until`."""
    return goal.result is None or goal.owed or goal.ended > until
