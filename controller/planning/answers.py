"""Requests that wait for the executor's answer."""

import itertools
import logging
import threading
import time
from collections.abc import Callable

from controller.program import Answer

log = logging.getLogger(__name__)

OnAnswer = Callable[[Answer | None], None]


class Answers:
    """Numbers requests, and gives each its answer once. For any thread.

    Args:
        patience: an executor that has not answered by then is broken [s].
        clock: [s].
    """

    def __init__(self, patience: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._patience, self._clock, self._lock = patience, clock, threading.Lock()
        self._numbers = itertools.count(1)
        self._waiting: dict[int, tuple[OnAnswer, float]] = {}

    def __len__(self) -> int:
        """Returns how many wait."""
        return len(self._waiting)

    def expect(self, on_answer: OnAnswer) -> int:
        """Returns the number of a new request."""
        with self._lock:
            number = next(self._numbers)
            self._waiting[number] = on_answer, self._clock() + self._patience
            return number

    def withdraw(self, number: int) -> bool:
        """Forgets a request that could not be sent; returns whether it still waited."""
        with self._lock:
            return self._waiting.pop(number, None) is not None

    def answer(self, answer: Answer) -> None:
        """Gives a request its answer."""
        with self._lock:
            waiting = self._waiting.pop(answer.request, None)
        if waiting is not None:
            tell(waiting[0], answer)

    def overdue(self) -> bool:
        """Returns whether a request has waited too long."""
        with self._lock:
            return any(until < self._clock() for _, until in self._waiting.values())

    def lose(self) -> None:
        """Tells all that wait that no answer will come."""
        with self._lock:
            waiting, self._waiting = list(self._waiting.values()), {}
        for on_answer, _ in waiting:
            tell(on_answer, None)


def tell(on_answer: OnAnswer, answer: Answer | None) -> None:
    """Gives an answer; a defect of who takes it must not end the link."""
    try:
        on_answer(answer)
    except Exception:
        log.exception("an answer of the executor was not handled")
