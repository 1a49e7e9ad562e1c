"""Recognizes repeated goals: a client without an answer asks again, and must not move the arm twice.

A goal is recognized by the request number that hyperbit's clients attach to it. Goals of other clients are recognized
by their payload if it has an id. A number always identifies the same request. A payload identifies its goal only until
the goal has ended, because the same file may be sent again later.
"""

import hashlib
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from controller.planning.core.messages import Payload, Reply

REMEMBERED = 60.0  # [s] after the last answer; clients repeat a request for a few seconds
FORGET_EVERY = 1.0  # [s]
MOST = 1_000  # goals remembered
WITH_ID = re.compile(rb'"id"\s*:\s*"')


@dataclass(eq=False)
class Known:
    """A goal that has arrived.

    Attributes:
        keys: of the table, by which it is recognized.
        replies: functions that wait for the answer.
        answer: None until it is known.
        ended: whether no result will follow.
        at: time of its last message [s].
    """

    keys: list[bytes]
    replies: list[Reply]
    at: float
    answer: Payload | None = None
    ended: bool = field(default=False)


class RepeatedGoals:
    """Answers a repeated goal with the answer to the first one. For any thread.

    Args:
        clock: [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._lock = clock, threading.Lock()
        self._known: dict[bytes, Known] = {}
        self._forget_at = -float("inf")

    def take(self, payload: bytes, request: bytes, reply: Reply, submit: Callable[[bytes, Reply], None]) -> None:
        """Submits a new goal, or repeats the answer to a known one.

        Args:
            payload: of the goal.
            request: number that the client attached; empty if none.
            reply: takes the answer.
            submit: takes the payload of a new goal, and the function that takes its answer.
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
        """Forgets the payload of a goal that has ended."""
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
        """Drops goals that ended more than REMEMBERED ago, every FORGET_EVERY, and the oldest ones above MOST."""
        if (now := self._clock()) >= self._forget_at:
            self._forget_at = now + FORGET_EVERY
            old = [key for key, known in self._known.items() if known.ended and known.at + REMEMBERED < now]
            for key in old:
                del self._known[key]
        while len(self._known) > MOST:
            del self._known[next(iter(self._known))]
