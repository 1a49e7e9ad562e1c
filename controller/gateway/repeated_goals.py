"""Goals that come twice: a client that hears no answer asks again, and must not move the arm twice.

A goal is known by the request number that hyperbit's clients attach to it, or, from other clients, by its payload if
that has an id. The number names one request for ever; a payload names its goal until the goal has ended, since the
same file may be sent again later.
"""

import hashlib
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from controller.planning.messages import Payload, Reply

REMEMBERED = 60.0  # [s] after the last answer; clients ask again for a few seconds
FORGET_EVERY = 1.0  # [s]
MOST = 1_000  # goals remembered
WITH_ID = re.compile(rb'"id"\s*:\s*"')


@dataclass(eq=False)
class Known:
    """A goal that came in.

    Attributes:
        keys: of the table, by which it is known.
        replies: who waits for the answer.
        answer: None until it is there.
        ended: whether no result is to come any more.
        at: when it was last heard of [s].
    """

    keys: list[bytes]
    replies: list[Reply]
    at: float
    answer: Payload | None = None
    ended: bool = field(default=False)


class RepeatedGoals:
    """Answers a repeated goal as it was answered first. For any thread.

    Args:
        clock: [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self._known: dict[bytes, Known] = {}
        self._forget_at = -float("inf")

    def take(self, payload: bytes, request: bytes, reply: Reply, submit: Callable[[bytes, Reply], None]) -> None:
        """Hands a goal on, or answers it as before.

        Args:
            payload: of the goal.
            request: number that the client attached; empty if none.
            reply: takes the answer.
            submit: takes the payload of a goal that is new, and who is to be answered.
        """
        keys = [b"number" + request[:64]] if request else []
        if WITH_ID.search(payload):
            keys.append(b"payload" + hashlib.blake2b(payload, digest_size=16).digest())
        with self._lock:
            self._forget()
            known = next((it for key in keys if (it := self._known.get(key)) is not None), None)
            if known is None:
                known = new = Known(keys, [reply], self._clock())
                self._known |= dict.fromkeys(keys, new)
                answer = None
            else:
                new, answer = None, known.answer
                known.at = self._clock()
                if answer is None:
                    known.replies.append(reply)
        if new is not None:
            submit(payload, lambda answer: self._answered(new, answer))
        elif answer is not None:
            reply(answer)

    def ended(self, goal: str | None) -> None:
        """Forgets the payload of a goal that has its result."""
        with self._lock:
            for known in {id(it): it for it in self._known.values()}.values():
                if known.answer is not None and known.answer.get("id") == goal:
                    self._end(known)

    def _answered(self, known: Known, answer: Payload) -> None:
        with self._lock:
            known.answer, known.at = answer, self._clock()
            replies, known.replies = known.replies, []
            if not answer.get("accepted"):
                self._end(known)
        for reply in replies:
            reply(answer)

    def _end(self, known: Known) -> None:
        known.ended = True
        for key in known.keys:
            if key.startswith(b"payload") and self._known.get(key) is known:
                del self._known[key]

    def _forget(self) -> None:
        """Forgets goals that ended long ago, once in a while, and the oldest if there are too many."""
        if (now := self._clock()) >= self._forget_at:
            self._forget_at = now + FORGET_EVERY
            old = [key for key, known in self._known.items() if known.ended and known.at + REMEMBERED < now]
            for key in old:
                del self._known[key]
        while len(self._known) > MOST:
            del self._known[next(iter(self._known))]
