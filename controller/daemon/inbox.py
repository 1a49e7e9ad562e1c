"""The way to the control loop: what other threads hand over, bounded, and every request answered."""

import queue

from controller.daemon.events import Event, Request, Stop
from controller.daemon.messages import done, refused
from controller.motion import codes

MOST_WAITING = 256  # requests


class Inbox:
    """A queue from any thread, callback or signal handler to the control loop."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._closed = False

    def put(self, event: Event) -> None:
        """Takes what the daemon tells itself."""
        self._queue.put(event)

    def hand_over(self, request: Request) -> None:
        """Takes a peer's request, or refuses it when too many wait; only stops may go beyond that."""
        if self._closed:
            request.reply(refused(codes.INVALID_GOAL, "the daemon is shutting down; the arm holds"))
        elif self._queue.qsize() < (2 if isinstance(request, Stop) else 1) * MOST_WAITING:
            self._queue.put(request)
        elif isinstance(request, Stop):
            request.reply(done("an emergency stop is on its way already"))
        else:
            request.reply(refused(codes.INVALID_GOAL, f"busy: {MOST_WAITING} requests are waiting already"))

    def get(self, timeout: float) -> Event | None:
        """Returns the next event, None if none comes within `timeout` seconds."""
        try:
            return self._queue.get(timeout=timeout)
        except queue.Empty:
            return None

    def waiting(self) -> int:
        """Returns how many events wait."""
        return self._queue.qsize()

    def close(self) -> None:
        """Refuses the requests that wait, and all that come."""
        self._closed = True
        while not self._queue.empty():
            event = self._queue.get()
            if isinstance(event, Request):
                self.hand_over(event)
