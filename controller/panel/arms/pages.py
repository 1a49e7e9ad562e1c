"""Open pages. A page gets the latest content of each section at most 20 times a second; a slow page skips some."""

import asyncio
import contextlib
import itertools
import time
from collections.abc import Awaitable, Callable

from hyperbit.controller.panel.access.people import Person
from hyperbit.controller.panel.arms.heartbeats import PERIOD, Heartbeats

LEAST_GAP = 0.05  # [s] between two updates of one page
MOST_REPLIES = 64  # unsent answers of a page

_numbers = itertools.count(1)


class Page:
    """One open page. Used only on the event loop of the pages."""

    def __init__(self, person: Person, clock: Callable[[], float] = time.monotonic) -> None:
        self.person, self.number = person, next(_numbers)
        self.heartbeats = Heartbeats(clock)  # sent to the page with each message, at least every PERIOD seconds
        self._latest: dict[str, bytes] = {}
        self._replies: list[bytes] = []
        self._news = asyncio.Event()
        self._closing = False

    def offer(self, section: str, data: bytes) -> None:
        """Queues the content of a section, encoded; it replaces unsent content of the same section."""
        self._latest[section] = data
        self._news.set()

    def reply(self, data: bytes) -> None:
        """Queues an answer to a request of this page; the page is closed if it reads too few answers."""
        self._replies.append(data)
        self._closing |= len(self._replies) > MOST_REPLIES
        self._news.set()

    async def send_updates(self, send: Callable[[bytes], Awaitable[None]]) -> None:
        """Sends queued sections and answers as JSON arrays until the page is closed."""
        while not self._closing:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._news.wait(), PERIOD)
            self._news.clear()
            heartbeat = b'{"section":"heartbeat","number":%d}' % self.heartbeats.next()
            parts = [heartbeat, *self._latest.values(), *self._replies]
            self._latest, self._replies = {}, []
            began = time.monotonic()
            await send(b"[" + b",".join(parts) + b"]")
            await asyncio.sleep(max(began + LEAST_GAP - time.monotonic(), 0.0))


class Control:
    """Control of an arm: one page at a time, so that two operators do not work against each other.

    The first page that commands gets control. Pages of the same person pass it on. Another operator may take it. A page
    that is closed releases it. Stop and cancel need no control.
    """

    def __init__(self) -> None:
        self._holder: Page | None = None
        self._since = 0.0

    def described(self) -> dict[str, object]:
        holder = self._holder
        return {
            "name": None if holder is None else holder.person.name,
            "page": None if holder is None else holder.number,
            "since": self._since,
        }

    def refusal(self, page: Page) -> str | None:
        """Returns why a page may not command; None: the page has control now."""
        if self._holder is not None and self._holder.person.name != page.person.name:
            return f"{self._holder.person.name} has control: take it first"
        if self._holder is not page:  # control was free, or another page of the same person had it
            self.take_control(page)
        return None

    def take_control(self, page: Page) -> None:
        self._holder, self._since = page, time.time()

    def release_control(self, page: Page) -> bool:
        had = self._holder is page
        if had:
            self._holder = None
        return had


class RateLimit:
    """A rate limit (token bucket): `rate` actions per second [1/s], at most `most` in a burst."""

    def __init__(self, rate: float, most: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._most, self._clock = rate, most, clock
        self._tokens, self._at = most, clock()
        self.refused = 0  # consecutive refusals

    def take_token(self) -> bool:
        """Returns whether an action is allowed now, and counts it."""
        now = self._clock()
        self._tokens, self._at = min(self._tokens + (now - self._at) * self._rate, self._most), now
        if self._tokens < 1.0:
            self.refused += 1
            return False
        self._tokens, self.refused = self._tokens - 1.0, 0
        return True
