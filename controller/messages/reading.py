"""Reads the messages of a daemon. Any Zenoh client may publish on a daemon's keys."""

import logging
import time
from collections.abc import Callable
from typing import Any

from msgspec import Struct

from hyperbit.controller.decoding.decoding import convert, decode
from hyperbit.controller.messages.arm import Description
from hyperbit.controller.messages.goals import Answer, Feedback, LedgerAnswer, Note, Plan, Result
from hyperbit.controller.messages.state import Diagnostics, State, Timeline

TELL_EVERY = 60.0  # [s] between two lines of the log on messages that cannot be read

log = logging.getLogger(__name__)


MESSAGES: dict[str, type[Struct]] = {  # by key; a client hears "request" as `@request`
    **{"state": State, "diagnostics": Diagnostics, "feedback": Feedback, "result": Result, "arm": Description},
    **{"request": Note, "timeline": Timeline},
}
ANSWERS: dict[str, type[Answer]] = {"plan": Plan, "result": LedgerAnswer}  # to accepted requests, others are `Answer`


Message = dict[str, Any]


def read(key: str, data: bytes, form: type[Struct] | None = None) -> Message:
    """Returns the message in a payload of `key` as it came, with fields of later versions.

    `form` is the type that it must have; None: that of MESSAGES. Raises Unreadable if it has another form.
    """
    message = decode(data, dict[str, Any])
    if (form := MESSAGES.get(key) if form is None else form) is not None:
        convert(message, form)
    return message


class UnreadCount:
    """Counts messages that cannot be read. Logs the first, and their number once a minute. For any thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._tell_at, self.count = clock, -float("inf"), 0

    def add(self, arm: str, key: str, error: Exception) -> None:
        self.count += 1
        if (now := self._clock()) >= self._tell_at:
            self._tell_at = now + TELL_EVERY
            log.warning("arm %s: %s cannot be read: %.200s (%d such messages so far)", arm, key, error, self.count)
