"""The account of goals that must end by a time."""

import math
from collections.abc import Callable

from tests.ros2.client import ABORTED
from tests.ros2.judge.actions import Goal, Result, Wrong
from tests.ros2.judge.reader import Invalid, Reader, end_limit

CODE, WITHIN = -5, 2.0  # of the result; [s] until an end that is due begins


class Limits:
    """Which goals may be canceled without a client's request, and which must be.

    Args:
        clock: returns a time that is never set [s].
        epoch: returns the UNIX time [s], for stamps.
    """

    def __init__(self, clock: Callable[[], float], epoch: Callable[[], float]) -> None:
        self._clock, self._epoch = clock, epoch
        self._asked: dict[bytes, tuple[float, float]] = {}  # by id: stamp, and time that it is allowed after it [s]
        self._due: dict[str, float] = {}  # by the daemon's id: time before which no cancel is due [s]
        self.sure: dict[str, float] = {}  # the same, of goals whose clients know that they are accepted

    def receive(self, payload: bytes) -> None:
        try:
            stamp, allowed = end_limit(Reader(payload))
        except Invalid:
            return
        if allowed is not None:
            self._due[f"ros2-{payload[4:20].hex()}"] = self._end(stamp, allowed)
            self._asked[payload[4:20]] = stamp, allowed

    def receive_acceptance(self, uuid: bytes) -> None:
        if uuid in self._asked:
            stamp, allowed = self._asked.pop(uuid)
            self.sure[f"ros2-{uuid.hex()}"] = self._end(stamp, allowed)

    def allows(self, name: str) -> bool:
        """Returns whether a goal may be canceled because its time is over."""
        return self._clock() >= self._due.get(name, math.inf)

    def check(self, goal: Goal) -> None:
        if self._clock() > self.sure.get(goal.id, math.inf) + WITHIN:
            raise Wrong(f"{goal.id} exceeds its time, and is not canceled")

    def explains(self, goal: Goal, result: Result) -> bool:
        """Returns whether a result tells that the time of a goal is over."""
        late = (result.status, result.code) == (ABORTED, CODE) and "goal_time_tolerance" in result.text
        return late and self.allows(goal.id)

    def _end(self, stamp: float, allowed: float) -> float:
        return self._clock() + max(stamp - self._epoch(), 0.0) + allowed
