"""Delays of answers to wrong tokens. A right token is never delayed, so nobody can lock others out."""

import time
from collections.abc import Callable

FREE = 3  # wrong tokens of an address without delay: people mistype
FIRST_DELAY, LONGEST_DELAY = 0.25, 8.0  # [s]; each further wrong token doubles the delay
FORGOTTEN_AFTER = 60.0  # [s] without a wrong token
MOST_ADDRESSES = 1000


class WrongTokens:
    """Counts wrong tokens of each address. Not thread-safe."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._wrong: dict[str, tuple[int, float]] = {}  # number and last time, in the order of last times

    def delay(self, address: str) -> float:
        """Counts a wrong token of an address; returns the delay of its answer [s]."""
        now = self._clock()
        count, at = self._wrong.pop(address, (0, now))
        count = 1 if now - at > FORGOTTEN_AFTER else count + 1
        self._wrong[address] = count, now
        if len(self._wrong) > MOST_ADDRESSES:
            del self._wrong[next(iter(self._wrong))]
        return 0.0 if count <= FREE else float(min(FIRST_DELAY * 2.0 ** min(count - FREE - 1, 60), LONGEST_DELAY))
