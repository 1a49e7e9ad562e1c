"""The goals that action clients wait for, in a file: a bridge that is started again owes their results still."""

import logging
import threading
import time
from pathlib import Path
from typing import Annotated

import msgspec

from controller.ros2.answers import GoalResult

KEPT = 60.0  # [s] for which a result is kept after its goal's end
MOST_GOALS = 64  # in the file; of more, the results that came first are forgotten
LATEST = 2**31 * 10**9  # [ns since 1970] that a message of ROS 2 can hold
log = logging.getLogger(__name__)


class BookedGoal(msgspec.Struct, frozen=True):
    """A goal of an action client.

    Attributes:
        uuid: id of the goal, in hexadecimal.
        kind: "tip" or "actuators".
        joints: names of the joints of its trajectory.
        stamp: when it came [ns since 1970].
        result: of the daemon, or of the bridge; None: there is none yet.
        ended: UNIX time of the result [s].
        canceling: whether a cancel was accepted before its end; then its result may be that it is canceled.
    """

    uuid: Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{32}\Z")]
    kind: str
    joints: tuple[str, ...]
    stamp: Annotated[int, msgspec.Meta(ge=0, lt=LATEST)]
    result: GoalResult | None = None
    ended: float = 0.0
    canceling: bool = False

    @property
    def id(self) -> str:
        """Id of the daemon's goal."""
        return f"ros2-{self.uuid}"


class GoalBook:
    """All goals without a result, and those that ended lately. For any thread.

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
        except (OSError, msgspec.MsgspecError) as error:
            log.error("goals before the start are not known: %s: %s", path, error)

    def goals(self) -> list[BookedGoal]:
        """Returns all goals, the oldest first."""
        with self._lock:
            return list(self._goals.values())

    def add(self, goal: BookedGoal) -> bool:
        """Writes a new goal; returns False if its id is that of a goal of the other action."""
        with self._lock:
            known = self._goals.get(goal.uuid)
            if known is not None and known.kind != goal.kind:
                return False
            self._goals[goal.uuid] = goal
            self._write()
            return True

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
        self._goals = {key: goal for key, goal in self._goals.items() if goal.result is None or goal.ended > until}
        ended = [key for key, goal in self._goals.items() if goal.result is not None]
        for key in ended[: max(len(self._goals) - MOST_GOALS, 0)]:
            del self._goals[key]
        fresh = self._path.with_suffix(".new")
        try:
            fresh.write_bytes(msgspec.json.encode(list(self._goals.values())))
            fresh.replace(self._path)
        except OSError as error:
            log.error("a restart would forget the goals: %s: %s", self._path, error.strerror)
