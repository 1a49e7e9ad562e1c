"""Answers, feedback and results on their way out: handed over by any thread, sent by one, in order."""

import logging
import queue
import threading

import zenoh

from controller.daemon.events import Payload, Reply
from controller.daemon.messages import encode, refused
from controller.motion import codes

log = logging.getLogger(__name__)

JSON = zenoh.Encoding.APPLICATION_JSON
MOST_WAITING = 1_000


class Outbox:
    """A thread that alone makes the Zenoh calls which may wait for a slow peer.

    The results of accepted goals are never lost here. All else is dropped while more waits than peers take: requests
    could else pile up without limit, and a peer that is given no answer sees its request end.

    Args:
        session: open session.
        prefix: of all keys, "hyperbit/<arm>".
    """

    def __init__(self, session: zenoh.Session, prefix: str) -> None:
        self._queue: queue.SimpleQueue[tuple[zenoh.Query | str, str, Payload] | None] = queue.SimpleQueue()
        self._prefix = prefix
        self._full = False
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
        self._put(key, key, payload, needed=key == "result" and payload["status"] != "refused")

    def answer(self, query: zenoh.Query, key: str) -> Reply:
        """Returns the function that answers a query on `key` and ends it."""
        return lambda payload: self._put(query, key, payload, needed=False)

    def close(self, timeout: float = 2.0) -> None:
        """Sends what is left, for `timeout` seconds at most."""
        self._queue.put(None)
        self._thread.join(timeout)

    def waiting(self) -> int:
        """Returns how many messages are still to be sent."""
        return self._queue.qsize()

    def _put(self, target: zenoh.Query | str, key: str, payload: Payload, *, needed: bool) -> None:
        full = self._queue.qsize() >= MOST_WAITING
        if full and not self._full:
            log.warning("peers do not take what is sent: answers are dropped")
        self._full = full
        if needed or not full:
            self._queue.put((target, key, payload))

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            target, key, payload = item
            try:
                data = encode(payload)
            except Exception:
                log.exception("not to be encoded: %r", payload)
                data = encode(refused(codes.INVALID_GOAL, "internal error, see the journal"))
            try:
                if isinstance(target, str):
                    self._publishers[target].put(data)
                else:
                    with target:
                        target.reply(f"{self._prefix}/{key}", data, encoding=JSON)
            except Exception as error:  # a peer that is gone must not end the service of the others
                log.warning("not sent on %s: %s", key, error)
