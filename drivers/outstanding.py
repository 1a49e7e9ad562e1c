"""Frames on their way to the wire: sent, and not yet given back by the interface."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import Counter
from collections.abc import Iterator

import can

_Key = tuple[int, bytes]


class Outstanding:
    """What was sent and has not come back; by identifier and data, for controllers do not keep the order.

    Nothing counts as outstanding before the first frame ever came back: not every interface gives them back.

    Attributes:
        last: when one came back last [s on the monotonic clock]; infinite if none ever did.

    Args:
        longest: time after which a frame is waited for no more [s]: the word of it may have been lost.
    """

    def __init__(self, longest: float) -> None:
        self._longest = longest
        self._lock = threading.Lock()
        self.last = math.inf
        self._sent: dict[_Key, list[float]] = {}
        self._written_off: Counter[_Key] = Counter()

    @property
    def waiting(self) -> bool:
        """Whether anything is outstanding."""
        return self.last < math.inf and bool(self._sent)

    @property
    def oldest(self) -> float | None:
        """When the oldest of it was sent, None if nothing is outstanding [s on the monotonic clock]."""
        with self._lock:
            return min((times[0] for times in self._sent.values()), default=None) if self.last < math.inf else None

    @contextlib.contextmanager
    def sending(self, message: can.Message) -> Iterator[None]:
        """Notes a frame for as long as it is outstanding: from before it is sent, unless that fails."""
        key, now = _key(message), time.monotonic()
        with self._lock:
            for old in [k for k, times in self._sent.items() if now - times[0] > self._longest]:
                self._write_off(old)
            self._sent.setdefault(key, []).append(now)
        try:
            yield
        except BaseException:
            with self._lock:
                self._take(key)
            raise

    def came_back(self, message: can.Message) -> bool:
        """Takes a frame that was sent from this computer; returns whether it was one of ours."""
        key = _key(message)
        with self._lock:
            ours = self._take(key)
            if not ours and self._written_off[key]:
                self._written_off[key] -= 1
                ours = True
            if ours:
                self.last = time.monotonic()
            return ours

    def write_off(self) -> None:
        """Waits for nothing of what was sent so far; it may still come back."""
        with self._lock:
            for key in list(self._sent):
                self._write_off(key)

    def forget(self) -> None:
        """Forgets all that was sent: it cannot come back to a bus that is opened anew."""
        with self._lock:
            self._sent.clear()
            self._written_off.clear()

    def _write_off(self, key: _Key) -> None:
        self._written_off[key] += len(self._sent.pop(key))

    def _take(self, key: _Key) -> bool:
        times = self._sent.get(key)
        if not times:
            return False
        del times[0]
        if not times:
            del self._sent[key]
        return True


def _key(message: can.Message) -> _Key:
    return message.arbitration_id, bytes(message.data)
