"""A queue of requests that one thread serves in order of arrival; each is answered once."""

import logging
import queue
import threading
import time
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from controller.motion.codes import INVALID_GOAL, Refusal
from controller.planning.messages import CLOSING, Reply, refused

log = logging.getLogger(__name__)

IDLE = 0.02  # [s] without a request before the thread calls `idle`
MOST_LINES = 5  # refusals logged in one second


class Request(Protocol):
    """A request with its answer."""

    @property
    def reply(self) -> Reply:
        """Takes the answer."""

    @property
    def goal(self) -> str | None:
        """The id of its goal; None if it has none."""


R = TypeVar("R", bound=Request)


class RequestQueue(Generic[R]):
    """Requests, and the thread that serves them. For any thread; all methods but `close` return at once.

    Attributes:
        closing: whether all requests are refused from now on.

    Args:
        what: what is requested, e.g. "goals".
        most: requests that may wait.
        serve: serves a request; raises Refusal to refuse it.
        idle: called repeatedly while no request waits.
    """

    def __init__(
        self, what: str, most: int, serve: Callable[[R], None], idle: Callable[[], None] | None = None
    ) -> None:
        self.closing = False
        self._what, self._most, self._serve, self._idle = what, most, serve, idle
        self._queue: queue.SimpleQueue[R | None] = queue.SimpleQueue()  # faster than queue.Queue
        self._refusals = LimitedLog(log)
        self._thread = threading.Thread(target=self._run, name=what, daemon=True)

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def close(self, timeout: float = 2.0) -> None:
        """Refuses the waiting requests and ends the thread; `serve` must check `closing` itself."""
        self.closing = True
        self._queue.put(None)
        self._thread.join(timeout)

    def waiting(self) -> int:
        """Returns the number of waiting requests."""
        return self._queue.qsize()

    def submit(self, make: Callable[[], R], reply: Reply) -> None:
        """Queues a request, or refuses it at once if it is malformed or too many wait.

        Args:
            make: returns the request; raises Refusal if it is malformed.
            reply: takes the refusal.
        """
        try:
            request = make()
            if self.closing:
                raise Refusal(INVALID_GOAL, CLOSING)
            if self._queue.qsize() >= self._most:
                raise Refusal(INVALID_GOAL, f"busy: {self._most} {self._what} are waiting already")
        except Refusal as refusal:
            reply(refused(refusal.code, str(refusal), refusal.goal))
        else:
            self._queue.put(request)

    def _run(self) -> None:
        while (request := self._next()) is not None:
            try:
                if self.closing:
                    raise Refusal(INVALID_GOAL, CLOSING)
                self._serve(request)
            except Refusal as refusal:
                self._refusals.info("%s: %s refused: %s", self._what, request.goal or "one", refusal)
                request.reply(refused(refusal.code, str(refusal), request.goal))
            except Exception:
                log.exception("planning failed")
                words = "internal error while planning, see the journal"
                request.reply(refused(INVALID_GOAL, words, request.goal))

    def _next(self) -> R | None:
        """Waits for the next request; returns None at the end."""
        while True:
            try:
                return self._queue.get(timeout=IDLE if self._idle else None)
            except queue.Empty:
                if self._idle:
                    self._idle()


class LimitedLog:
    """Logs at most MOST_LINES a second; the first line after that says how many were omitted. For any thread.

    Args:
        log: to write to.
        clock: [s].
    """

    def __init__(self, log: logging.Logger, clock: Callable[[], float] = time.monotonic) -> None:
        self._log, self._clock, self._lock = log, clock, threading.Lock()
        self._since, self._written, self._left_out = -float("inf"), 0, 0

    def info(self, text: str, *arguments: object) -> None:
        """Logs a line, or counts it."""
        with self._lock:
            now = self._clock()
            if now - self._since >= 1.0:
                self._since, self._written = now, 0
            if self._written >= MOST_LINES:
                self._left_out += 1
                return
            self._written += 1
            left_out, self._left_out = self._left_out, 0
        self._log.info(text, *arguments)
        if left_out:
            self._log.info("%d lines like this were omitted before", left_out)
