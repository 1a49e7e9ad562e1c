"""Zenoh subscriptions to all keys of an arm, queued for one thread."""

import threading
import time
from collections import deque
from typing import NamedTuple

import zenoh

MOST_WAITING = 64 << 20  # bytes of payloads that wait to be read
ARM_TIMEOUT = 10.0  # [s] for the daemon to describe the arm
GIVEN = ("arm", "alive", "gone", "request")  # keys of the listener's own; on the network nobody publishes on them
PARTS = b'{"with": ["drawing", "file"]}'


class ReceivedMessage(NamedTuple):
    at: int  # time of arrival, CLOCK_MONOTONIC [ns]
    key: str  # after "hyperbit/<arm>/"; "alive" and "gone" for the liveliness token, "arm" for the daemon's answer
    data: bytes


class Listener:
    """Subscribes to all keys of one arm. Callbacks only queue messages, so that Zenoh never waits for the reader."""

    def __init__(self, session: zenoh.Session, arm: str) -> None:
        self._session, self._prefix = session, f"hyperbit/{arm}"
        self._waiting, self._bytes, self._news = deque[ReceivedMessage](), 0, threading.Condition()
        self._dropped = 0
        self._declared = [
            session.declare_subscriber(f"{self._prefix}/**", self._on_sample),
            session.declare_subscriber(f"{self._prefix}/@request", self._on_sample),
            session.liveliness().declare_subscriber(f"{self._prefix}/alive", self._on_token, history=True),
        ]

    def close(self) -> None:
        while self._declared:
            self._declared.pop().undeclare()  # type: ignore[no-untyped-call]

    def ask(self) -> None:
        """Requests the arm's description from the daemon; the answer is queued with the key "arm"."""
        key, every = f"{self._prefix}/arm", zenoh.QueryTarget.ALL
        self._session.get(key, self._on_reply, target=every, payload=PARTS, timeout=ARM_TIMEOUT)

    def receive_messages(self, timeout: float) -> list[ReceivedMessage]:
        """Returns the queued messages, oldest first; waits at most `timeout` [s] for the first."""
        with self._news:
            if not self._waiting:
                self._news.wait(timeout)
            taken, self._bytes = list(self._waiting), 0
            self._waiting.clear()
            return taken

    def dropped(self) -> int:
        """Returns the number of messages dropped since the last call because the queue was full."""
        with self._news:
            dropped, self._dropped = self._dropped, 0
            return dropped

    def _on_sample(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).removeprefix(f"{self._prefix}/")
        if key not in GIVEN:
            self.put("request" if key == "@request" else key, sample.payload.to_bytes())

    def _on_token(self, sample: zenoh.Sample) -> None:
        self.put("alive" if sample.kind == zenoh.SampleKind.PUT else "gone", b"")

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self.put("arm", reply.ok.payload.to_bytes())

    def put(self, key: str, data: bytes) -> None:
        item = ReceivedMessage(time.monotonic_ns(), key, data)
        with self._news:
            if self._bytes + len(data) > MOST_WAITING:
                self._dropped += 1
                return
            self._bytes += len(data)
            self._waiting.append(item)
            self._news.notify()
