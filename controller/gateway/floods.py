"""Brake for floods of bad requests: refuses them cheaply in the Zenoh callback, and slows their senders.

In a flood the callback pauses. Zenoh then stops reading the connections of the flood, and the interpreter is free for
other threads. A goal from another client waits for the 256 messages before it in the callback's queue, about 60 ms.
"""

import threading
import time
from collections.abc import Callable

import msgspec

from controller.motion.codes import INVALID_GOAL, Refusal
from controller.motion.goal import MOST_BYTES, GoalMessage, parse
from controller.planning.core.messages import Payload, refused

MOST_AT_ONCE = 20  # refusals a second without pauses; only these give a reason, which takes a hundred times as long
PAUSE_EVERY, PAUSE = 10, 0.002  # number of further refusals for each pause, and its length [s]
BRIEFLY = "the goal is malformed; no details are given while many bad requests arrive"

_decode = msgspec.json.Decoder(GoalMessage).decode


class FloodBrake:
    """Refuses payloads that are no goals, and slows the callback down if many come. For any thread.

    Args:
        clock: [s].
        pause: sleeps for a time [s].
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, pause: Callable[[float], None] = time.sleep
    ) -> None:
        self._clock, self._pause, self._lock = clock, pause, threading.Lock()
        self._since, self._refused = -float("inf"), 0  # number of refusals in the second that began at `_since`

    def refusal(self, payload: bytes) -> Payload | None:
        """Returns the refusal of a malformed goal; None if the payload decodes."""
        if decodes(payload):
            return None
        if self._refused >= MOST_AT_ONCE and self._clock() - self._since < 1.0:
            return refused(INVALID_GOAL, BRIEFLY)
        try:
            parse(payload)
        except Refusal as refusal:
            return refused(refusal.code, str(refusal))
        return None

    def slow_down(self) -> None:
        """Counts a request that was refused at once, and pauses if there are too many."""
        with self._lock:
            if (now := self._clock()) - self._since >= 1.0:
                self._since, self._refused = now, 0
            self._refused += 1
            pauses = self._refused > MOST_AT_ONCE and self._refused % PAUSE_EVERY == 0
        if pauses:
            self._pause(PAUSE)


def decodes(payload: bytes) -> bool:
    """Returns whether a payload has a goal's size and decodes as a goal; `parse` checks more."""
    if len(payload) > MOST_BYTES:
        return False
    try:
        _decode(payload)
    except (msgspec.DecodeError, RecursionError, UnicodeError):
        return False
    return True
