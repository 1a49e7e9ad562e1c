"""Events for the loop's thread, posted by any thread."""

import os
import select
from collections import deque

from controller.planning.core.events import Event


class Inbox:
    """A queue of events. One thread reads it, and waits for it and for the link together.

    A post wakes a sleeping thread within about 50 us. A `SimpleQueue` needs 10 us less, but cannot wait for a socket.

    Attributes:
        events: oldest first; only the reading thread removes them.
    """

    def __init__(self) -> None:
        self.events: deque[Event] = deque()
        self._asleep = False  # whether the reading thread must be woken
        self._woken = self._closed = False  # whether there is a wake-up to read, and whether no more is needed
        self._wakeups = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._wakeups, select.POLLIN)
        self._watched = (-1, False)

    def post(self, event: Event) -> None:
        """Appends an event. For any thread; never waits."""
        self.events.append(event)
        if self._asleep:
            self._asleep = False  # before the wake-up: the reading thread then sets it again
            os.eventfd_write(self._wakeups, 1)

    def close(self) -> None:
        """Ends `wait`, from now on. For any thread."""
        self._closed = True
        os.eventfd_write(self._wakeups, 1)

    def wait(self, timeout: float, link: int, sending: bool) -> bool:
        """Waits for an event, or for the link.

        Args:
            timeout: longest time to wait [s].
            link: file descriptor to read; -1: none.
            sending: whether to wait until `link` can be written, too.

        Returns:
            whether the link is ready.
        """
        if self._watched != (link, sending):
            self._watch(link, sending)
        if self._woken:  # read only now: the call releases the GIL, and no event should wait for the GIL again
            os.eventfd_read(self._wakeups)
        self._asleep = True  # before the look at `events`, so that no event is missed
        ready = self._poll.poll(0 if self.events or self._closed else timeout * 1000)
        self._asleep = False
        self._woken = any(number == self._wakeups for number, _ in ready)
        return len(ready) > self._woken

    def _watch(self, link: int, sending: bool) -> None:
        if self._watched[0] >= 0:
            self._poll.unregister(self._watched[0])
        if link >= 0:
            self._poll.register(link, select.POLLIN | (select.POLLOUT if sending else 0))
        self._watched = (link, sending)

    def __del__(self) -> None:
        os.close(self._wakeups)  # not earlier, because threads may post until the end
