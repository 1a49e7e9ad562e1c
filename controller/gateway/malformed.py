"""Payloads that are no goals are refused in the Zenoh callback, at little cost: a flood of them delays nobody.

In a flood the callback pauses. Zenoh then stops to read the connections of the flood, and the interpreter is free for
others. A goal from another client waits for the 256 messages before it in the callback's queue, some 30 ms.
"""

import threading
import time
from collections.abc import Callable

import msgspec

from controller.motion.codes import INVALID_GOAL, Refusal
from controller.motion.goal import MOST_BYTES, GoalMessage, parse
from controller.planning.messages import Payload, refused

MOST_EXPLAINED = 20  # refusals in one second; finding the words takes a hundred times as long as the check
PAUSE_EVERY, PAUSE = 20, 0.002  # malformed goals beyond these, and [s]
BRIEFLY = "the goal is malformed; why is not said, as too many malformed goals come"

_decode = msgspec.json.Decoder(GoalMessage).decode


class MalformedGoals:
    """Refuses payloads that do not decode as a goal. For any thread.

    Attributes:
        refused: how many so far.

    Args:
        clock: [s].
        pause: sleeps for a time [s].
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, pause: Callable[[float], None] = time.sleep
    ) -> None:
        self._clock, self._pause, self._lock = clock, pause, threading.Lock()
        self._since, self._explained = -float("inf"), 0
        self.refused = 0

    def refusal(self, payload: bytes) -> Payload | None:
        """Returns the answer to a malformed goal; None if the payload is to be looked at further."""
        if decodes(payload):
            return None
        if not self._explains():
            self.refused += 1
            if self.refused % PAUSE_EVERY == 0:
                self._pause(PAUSE)
            return refused(INVALID_GOAL, BRIEFLY)
        try:
            parse(payload)
        except Refusal as refusal:
            self.refused += 1
            return refused(refusal.code, str(refusal))
        return None

    def _explains(self) -> bool:
        """Whether there is time to find the words of a refusal."""
        with self._lock:
            now = self._clock()
            if now - self._since >= 1.0:
                self._since, self._explained = now, 0
            self._explained += 1
            return self._explained <= MOST_EXPLAINED


def decodes(payload: bytes) -> bool:
    """Returns whether a payload is of a goal's size and decodes as a goal; `parse` checks more."""
    if len(payload) > MOST_BYTES:
        return False
    try:
        _decode(payload)
    except (msgspec.DecodeError, RecursionError, UnicodeError):
        return False
    return True
