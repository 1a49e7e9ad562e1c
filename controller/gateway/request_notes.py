"""Publishes notes on requests and their answers, for recorders: a query itself reaches only the daemon.

Wildcards do not match the key `@request`. A subscriber to all keys does not receive the notes.
"""

import time
from collections.abc import Callable
from typing import Any

import msgspec

from controller.planning.messages import Payload, Reply

MOST_REFUSED = 50  # notes a second on refused requests
MOST_TEXT = 500  # characters of a payload that is no JSON


class RequestNotes:
    """Publishes a note on each answered request while there is a subscriber.

    Args:
        wanted: returns whether there is a subscriber; must be quick.
        publish: takes a key and a payload; must not wait.
        wall: UNIX time [s].
    """

    def __init__(
        self,
        wanted: Callable[[], bool],
        publish: Callable[[str, Payload], None],
        wall: Callable[[], float] = time.time,
    ) -> None:
        self._wanted, self._publish, self._wall = wanted, publish, wall
        self._second, self._refused = 0, 0

    def noting(self, key: str, payload: bytes, reply: Reply) -> Reply:
        """Returns a function that answers a request on `key` and publishes the note."""
        if not self._wanted():
            return reply
        stamp = self._wall()

        def answer(given: Payload) -> None:
            reply(given)
            if given.get("accepted") is True or self._few(int(stamp)):
                self._publish("@request", {"stamp": stamp, "key": key, **content_of(payload), "answer": given})

        return answer

    def _few(self, second: int) -> bool:
        """Returns whether another note on a refused request may be published in this second."""
        self._refused = 1 if second != self._second else self._refused + 1
        self._second = second
        return self._refused <= MOST_REFUSED


def content_of(payload: bytes) -> dict[str, Any]:
    """Returns `payload` as it came, null if it is empty; for a payload that is no JSON also its `text`."""
    if not payload:
        return {"payload": None}
    try:
        msgspec.json.decode(payload)
    except (msgspec.MsgspecError, RecursionError, UnicodeError):
        return {"payload": None, "text": payload[:MOST_TEXT].decode(errors="replace")}
    return {"payload": msgspec.Raw(payload)}
