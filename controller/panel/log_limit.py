"""A limit of log lines, so that a client that sends nonsense fills no disk."""

import logging
import time
from collections.abc import Callable

MOST_LINES, WITHIN = 10, 60.0  # lines of one kind, and the time in which they are counted [s]
MOST_KINDS = 1000


class LogLimit(logging.Filter):
    """Drops log lines of a kind that occurs too often. A kind is a message before its arguments are filled in.

    The first line after a pause has the number of dropped lines. `clock` returns the time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self.kinds: dict[tuple[str, str], tuple[float, int]] = {}  # begin of the count, and number of lines

    def filter(self, record: logging.LogRecord) -> bool:
        kind, now = (record.name, str(record.msg)[:200]), self._clock()
        begin, count = self.kinds.pop(kind, (now, 0))
        dropped = max(count - MOST_LINES, 0)
        if now - begin >= WITHIN:
            begin, count = now, 0
            if dropped:
                record.msg = f"{record.msg} ({dropped} such lines were dropped)"
        self.kinds[kind] = begin, count + 1
        if len(self.kinds) > MOST_KINDS:
            del self.kinds[next(iter(self.kinds))]
        return count < MOST_LINES
