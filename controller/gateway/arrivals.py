"""Two stages of a request before the planner: the brake for floods, and the memory of repeated goals.

No lock is needed. Any thread appends to a deque, or adds to a dictionary by `setdefault`; both are atomic. Only the
thread of the planner's core, which gives answers and results, removes entries.
"""

import hashlib
import itertools
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

from hyperbit.controller.messages.goals import Answer

MOST_AT_ONCE = 20  # refusals a second without pauses; only these give a reason, which takes a hundred times as long
PAUSE_EVERY, PAUSE = 10, 0.002  # number of further requests for each pause, and its length [s]
REMEMBERED = 60.0  # [s] after the last answer; clients repeat a request for a few seconds
FORGET_EVERY = 1.0  # [s]
MOST = 1_000  # keys of goals remembered

Reply = Callable[[Answer], None]  # must not wait


class Clocks(NamedTuple):
    monotonic: Callable[[], float] = time.monotonic
    wall: Callable[[], float] = time.time
    pause: Callable[[float], None] = time.sleep  # the thread


class Rate:
    """Counts events up to `most` within the last second. Threads that share it may count a few more."""

    def __init__(self, most: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._times = clock, deque[float](maxlen=most)

    def add(self) -> None:
        self._times.append(self._clock())

    def exceeded(self) -> bool:
        return len(self._times) == self._times.maxlen and self._clock() - self._times[0] < 1.0

    def admits(self) -> bool:
        if self.exceeded():
            return False
        self.add()
        return True


class FloodBrake:
    """Slows down Zenoh's callback of a key if many requests on it are refused.

    In a flood the callback pauses. Zenoh then stops reading the connections of the flood, and the interpreter is free
    for other threads. A goal from another client waits for the 256 messages before it in the callback's queue, about
    60 ms.
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, pause: Callable[[float], None] = time.sleep
    ) -> None:
        self.refused = Rate(MOST_AT_ONCE, clock)
        self.explained = Rate(MOST_AT_ONCE, clock)  # admits refusals that give their reason
        self._requests, self._pause = itertools.count(1), pause

    def slow_down(self) -> None:
        """Pauses occasionally while too many requests are refused. Call it after each request."""
        if self.refused.exceeded() and next(self._requests) % PAUSE_EVERY == 0:
            self._pause(PAUSE)


@dataclass(eq=False)
class ArrivedGoal:
    keys: list[bytes]  # that identify a repetition
    at: float  # time of its last message [s]
    replies: deque[Reply] = field(default_factory=deque)  # waiting for the answer
    answer: Answer | None = None
    ended: bool = False  # no result will follow

    def await_answer(self, reply: Reply) -> None:
        """Replies with the answer, now or when it comes.

        A reply is appended before the answer is looked for, and the answer is stored before replies are taken. So
        each reply is taken by one of both threads, and by one alone.
        """
        self.replies.append(reply)
        self.reply()

    def store_answer(self, answer: Answer) -> None:
        self.answer, self.ended = answer, self.ended or not answer.accepted
        self.reply()

    def reply(self) -> None:
        while self.answer is not None and self.replies:
            try:
                reply = self.replies.popleft()
            except IndexError:  # another thread took the reply
                return
            reply(self.answer)


def keys_of(payload: bytes, attached: bytes, *, has_id: bool) -> list[bytes]:
    """Returns the keys that identify a repeated goal; `attached` is empty without an attachment."""
    digest = hashlib.blake2b(payload, digest_size=16).digest()
    keys = [b"number" + digest + attached[:64]] if attached else []
    return [*keys, b"payload" + digest] if has_id else keys


class RepeatedGoals:
    """Answers a repeated goal with the answer to the first one: a client without an answer asks again.

    A goal is recognized by its payload together with what the client attached, such as the number of the request. A
    payload that has an id is recognized by itself, but only until its goal has ended, because the same file may be sent
    again later.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._forget_at = clock, -float("inf")
        self.known: dict[bytes, ArrivedGoal] = {}

    def receive_goal(self, keys: list[bytes], reply: Reply, request: Callable[[Reply], object]) -> None:
        """Calls `request` for a new goal, with the receiver of its answer; repeats the answer to a known goal."""
        goal = ArrivedGoal(keys, self._clock())
        goal.await_answer(reply)
        for key in keys:
            known = self.known.setdefault(key, goal)
            if known is not goal:  # the goal is already known by another key; it gets the same answer
                known.at = self._clock()
                known.await_answer(goal.store_answer)
                return
        try:
            request(partial(self._answered, goal))
        except BaseException:
            for key in keys:
                self.known.pop(key, None)
            raise

    def ended(self, goal: str | None) -> None:
        """Forgets the payload of a goal that has ended. For the thread that gives the answers."""
        for known in set(self.known.copy().values()):
            if known.answer is not None and known.answer.id == goal:
                known.ended = True
                self._forget_payload(known)

    def _answered(self, goal: ArrivedGoal, answer: Answer) -> None:
        """Gives an answer; forgets goals that ended long ago, and the oldest ones above MOST."""
        goal.at = self._clock()
        goal.store_answer(answer)
        if goal.ended:
            self._forget_payload(goal)
        if goal.at >= self._forget_at:
            self._forget_at = goal.at + FORGET_EVERY
            for key, known in self.known.copy().items():
                if known.ended and known.at + REMEMBERED < goal.at:
                    self.known.pop(key, None)
        for key in list(self.known)[:-MOST]:
            self.known.pop(key, None)

    def _forget_payload(self, goal: ArrivedGoal) -> None:
        for key in goal.keys:
            if key.startswith(b"payload") and self.known.get(key) is goal:
                self.known.pop(key, None)
