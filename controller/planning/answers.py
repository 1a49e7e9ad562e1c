"""Pending requests to the executor."""

import itertools
import logging
import threading
import time
from collections.abc import Callable

from controller.program import Answer

log = logging.getLogger(__name__)

OnAnswer = Callable[[Answer | None], None]


class Answers:
    """Numbers requests, and delivers each answer once. For any thread.

    Args:
        patience: time after which an unanswered request is overdue [s].
        clock: [s].
    """

    def __init__(self, patience: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._patience, self._clock, self._lock = patience, clock, threading.Lock()
        self._numbers = itertools.count(1)
        self._waiting: dict[int, tuple[OnAnswer, float]] = {}

    def __len__(self) -> int:
        """Returns the number of pending requests."""
        return len(self._waiting)

    def expect(self, on_answer: OnAnswer) -> int:
        """Returns the number of a new request."""
        with self._lock:
            number = next(self._numbers)
            self._waiting[number] = on_answer, self._clock() + self._patience
            return number

    def withdraw(self, number: int) -> bool:
        """Removes a request that could not be sent; returns whether it was still pending."""
        with self._lock:
            return self._waiting.pop(number, None) is not None

    def answer(self, answer: Answer) -> None:
        """Delivers an answer to its request."""
        with self._lock:
            waiting = self._waiting.pop(answer.request, None)
        if waiting is not None:
            deliver(waiting[0], answer)

    def overdue(self) -> bool:
        """Returns whether a request is overdue."""
        with self._lock:
            return any(until < self._clock() for _, until in self._waiting.values())

    def fail_all(self) -> None:
        """Delivers None to all pending requests, as no answer will come."""
        with self._lock:
            waiting, self._waiting = list(self._waiting.values()), {}
        for on_answer, _ in waiting:
            deliver(on_answer, None)


def deliver(on_answer: OnAnswer, answer: Answer | None) -> None:
    """Calls `on_answer`; its exceptions are logged, so that they do not end the link."""
    try:
        on_answer(answer)
    except Exception:
        log.exception("an answer of the executor was not handled")
