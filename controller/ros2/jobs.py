"""Threads for requests to the daemon, and their order: a stop or cancel never waits for a motion request."""

import contextlib
import threading
from collections.abc import Callable, Iterator

from hyperbit.controller.ros2.answers import TIMEOUT
from hyperbit.controller.ros2.messages import WARN
from hyperbit.controller.ros2.wire.session import Computer

MOST_WAITING = 64  # waiting requests for motion or plans
WORKERS = 4
STOP, CANCEL = "stop", "cancel"

Say = Callable[[int, str], None]


class Withdrawn(RuntimeError):
    """A stop or cancel overtakes a motion request."""


class Order:
    """The order of arrival: a stop or cancel is sent before later requests, and bars earlier motion requests."""

    def __init__(self, computer: Computer) -> None:
        self._changed = computer.condition()
        self.arrived = 0  # stops and cancels so far
        self._last = {STOP: 0, CANCEL: 0}  # number of the last one of each
        self._unsent: dict[int, str] = {}

    def arrive(self, key: str) -> int:
        """Counts a stop or cancel; returns its number."""
        with self._changed:
            self.arrived += 1
            self._last[key] = self.arrived
            self._unsent[self.arrived] = key
            return self.arrived

    @contextlib.contextmanager
    def sending(self, key: str, number: int) -> Iterator[None]:
        """Notes at exit that all stops or cancels up to this number are sent, or failed."""
        try:
            yield
        finally:
            with self._changed:
                for it in [it for it, kind in self._unsent.items() if kind == key and it <= number]:
                    del self._unsent[it]
                self._changed.notify_all()

    @contextlib.contextmanager
    def passing(self, ticket: int, barring: tuple[str, ...], wait: float) -> Iterator[None]:
        """Holds stops and cancels back while a motion request is sent.

        Args:
            ticket: value of `arrived` when the request came.
            barring: the kinds that bar the request if they come after it.
            wait: longest time until earlier ones are sent [s].

        Raises:
            Withdrawn: the request may not be sent.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: all(it > ticket for it in self._unsent), wait):
                raise Withdrawn("a stop or cancel that came before it is not sent yet")
            for key in barring:
                if self._last[key] > ticket:
                    raise Withdrawn(f"a {key} came after it")
            yield


class Passage:
    """The way of one motion request, from its arrival on.

    The kinds `barring` bar it; earlier stops and cancels delay it by at most `wait` [s].
    """

    def __init__(self, order: Order, barring: tuple[str, ...] = (STOP, CANCEL), wait: float = TIMEOUT) -> None:
        self._order, self._ticket, self._barring, self._wait = order, order.arrived, barring, wait
        self.sent = False  # whether it was sent at least once

    @contextlib.contextmanager
    def __call__(self) -> Iterator[None]:
        with self._order.passing(self._ticket, self._barring, self._wait):
            self.sent = True
            yield


class Task:
    """Runs a function in its own thread on demand. One run meets all demands that wait."""

    def __init__(self, computer: Computer, name: str, function: Callable[[], None], say: Say) -> None:
        self._pool, self._function, self._say = computer.pool(1, f"ros2-{name}"), function, say
        self._lock, self._waiting = threading.Lock(), False

    def ask(self) -> bool:
        """Asks for a run that begins after now; returns False after `close`."""
        with self._lock:
            if not self._waiting:
                try:
                    self._pool.submit(self._run)
                except RuntimeError:
                    return False
                self._waiting = True
            return True

    def close(self) -> None:
        self._pool.shutdown()

    def _run(self) -> None:
        with self._lock:
            self._waiting = False
        guarded(self._function, self._say)


class Jobs:
    """A few threads for motion and plan requests; a limited number of jobs may wait."""

    def __init__(self, computer: Computer, say: Say) -> None:
        self._say, self._pool = say, computer.pool(WORKERS, "ros2")
        self.order = Order(computer)
        self._free = threading.BoundedSemaphore(MOST_WAITING)

    def submit(self, job: Callable[[], None]) -> bool:
        """Queues a job; returns False if too many wait."""
        if not self._free.acquire(blocking=False):
            return False

        def run() -> None:
            try:
                guarded(job, self._say)
            finally:
                self._free.release()

        try:
            self._pool.submit(run)
        except RuntimeError:  # the bridge ends
            self._free.release()
            return False
        return True

    def close(self) -> None:
        """Waits for running jobs; drops waiting ones."""
        self._pool.shutdown(cancel_futures=True)


def guarded(job: Callable[[], None], say: Say) -> None:
    """Runs a job and logs an exception, so that its thread goes on."""
    try:
        job()
    except Exception as error:
        say(WARN, f"a request failed: {error!r}")
