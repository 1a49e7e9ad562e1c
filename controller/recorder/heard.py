"""What is heard of an arm over Zenoh, on its way to the recorder's thread."""

import threading
import time
from collections import deque
from typing import NamedTuple

import zenoh

MOST_WAITING = 64 << 20  # bytes of payloads that wait to be written
ARM_TIMEOUT = 10.0  # [s] for the daemon to describe the arm
BESIDES = b'{"with": ["drawing", "file"]}'


class Heard(NamedTuple):
    """A message.

    Attributes:
        at: when it was heard, CLOCK_MONOTONIC [ns].
        key: after "hyperbit/<arm>/"; "alive" and "gone" for the liveliness token, "arm" for the daemon's answer.
        data: payload.
    """

    at: int
    key: str
    data: bytes


class Ear:
    """Subscribes to all keys of one arm. Callbacks only store: nothing waits for who writes.

    Args:
        session: open session.
        arm: name of the arm.
    """

    def __init__(self, session: zenoh.Session, arm: str) -> None:
        self._session, self._prefix = session, f"hyperbit/{arm}"
        self._waiting, self._bytes, self._news = deque[Heard](), 0, threading.Condition()
        self._dropped = 0
        self._declared = [
            session.declare_subscriber(f"{self._prefix}/**", self._on_sample),
            session.declare_subscriber(f"{self._prefix}/@request", self._on_sample),
            session.liveliness().declare_subscriber(f"{self._prefix}/alive", self._on_token, history=True),
        ]

    def close(self) -> None:
        """Hears no more."""
        while self._declared:
            self._declared.pop().undeclare()  # type: ignore[no-untyped-call]

    def ask(self) -> None:
        """Asks the daemon for the arm's description; the answer comes as "arm"."""
        self._session.get(f"{self._prefix}/arm", self._on_reply, payload=BESIDES, timeout=ARM_TIMEOUT)

    def take(self, timeout: float) -> list[Heard]:
        """Returns what was heard, the oldest first; waits for something at most `timeout` [s]."""
        with self._news:
            if not self._waiting:
                self._news.wait(timeout)
            taken, self._bytes = list(self._waiting), 0
            self._waiting.clear()
            return taken

    def dropped(self) -> int:
        """Returns how many messages were dropped since the last call, because too many waited."""
        with self._news:
            dropped, self._dropped = self._dropped, 0
            return dropped

    def _on_sample(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).removeprefix(f"{self._prefix}/").replace("@request", "request", 1)
        if key not in ("arm", "alive", "gone"):
            self._put(key, sample.payload.to_bytes())

    def _on_token(self, sample: zenoh.Sample) -> None:
        self._put("alive" if sample.kind == zenoh.SampleKind.PUT else "gone", b"")

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._put("arm", reply.ok.payload.to_bytes())

    def _put(self, key: str, data: bytes) -> None:
        item = Heard(time.monotonic_ns(), key, data)
        with self._news:
            if self._bytes + len(data) > MOST_WAITING:
                self._dropped += 1
                return
            self._bytes += len(data)
            self._waiting.append(item)
            self._news.notify()


class LogClock:
    """Log times: UNIX time at the start, then as CLOCK_MONOTONIC goes, so that no step of the clock reorders a file."""

    def __init__(self) -> None:
        self._offset = time.time_ns() - time.monotonic_ns()

    def at(self, monotonic: int) -> int:
        """Returns the log time [ns] of a monotonic time [ns]."""
        return monotonic + self._offset

    def now(self) -> int:
        """Returns the log time now [ns]."""
        return self.at(time.monotonic_ns())
