"""Answers, feedback and results on their way out: handed over by any thread, sent by one, in order, none lost."""

import logging
import queue
import threading

import msgspec
import zenoh

from controller.daemon.events import Payload, Reply

log = logging.getLogger(__name__)

JSON = zenoh.Encoding.APPLICATION_JSON


class Outbox:
    """A thread that alone makes the Zenoh calls which may wait for a slow peer.

    Args:
        session: open session.
        prefix: of all keys, "hyperbit/<arm>".
    """

    def __init__(self, session: zenoh.Session, prefix: str) -> None:
        self._queue: queue.SimpleQueue[tuple[zenoh.Query | str, Payload] | None] = queue.SimpleQueue()
        self._prefix = prefix
        self._publishers = {
            "result": session.declare_publisher(
                f"{prefix}/result", encoding=JSON, congestion_control=zenoh.CongestionControl.BLOCK
            ),
            "feedback": session.declare_publisher(
                f"{prefix}/feedback", encoding=JSON, congestion_control=zenoh.CongestionControl.DROP
            ),
        }
        self._thread = threading.Thread(target=self._run, name="outbox", daemon=True)
        self._thread.start()

    def publish(self, key: str, payload: Payload) -> None:
        """Publishes on `key`, "result" or "feedback"."""
        self._queue.put((key, payload))

    def answer(self, query: zenoh.Query) -> Reply:
        """Returns the function that answers a query and ends it."""
        return lambda payload: self._queue.put((query, payload))

    def close(self, timeout: float = 2.0) -> None:
        """Sends what is left, for `timeout` seconds at most."""
        self._queue.put(None)
        self._thread.join(timeout)

    def waiting(self) -> int:
        """Returns how many messages are still to be sent."""
        return self._queue.qsize()

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            target, payload = item
            try:
                data = msgspec.json.encode(payload)
                if isinstance(target, str):
                    self._publishers[target].put(data)
                else:
                    with target:
                        target.reply(str(target.key_expr), data, encoding=JSON)
            except Exception:  # a peer that is gone must not end the service of the others
                log.exception("not sent: %s", payload)
