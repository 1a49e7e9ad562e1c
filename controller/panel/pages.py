"""Open pages: each gets the latest of every section, at most 20 times a second, and misses what it is too slow for."""

import asyncio
import itertools
import time
from collections.abc import Awaitable, Callable

from controller.panel.access import Person

LEAST_GAP = 0.05  # [s] between two updates of one page
MOST_REPLIES = 64  # that wait for a page

_numbers = itertools.count(1)


class Page:
    """One open page. On the pages' loop.

    Attributes:
        person: who opened it.
        number: tells pages of one person apart.
    """

    def __init__(self, person: Person) -> None:
        self.person, self.number = person, next(_numbers)
        self._latest: dict[str, bytes] = {}
        self._replies: list[bytes] = []
        self._news = asyncio.Event()
        self._closing = False

    def offer(self, section: str, data: bytes) -> None:
        """Takes the latest of a section, encoded; what was not sent yet of the same section is dropped."""
        self._latest[section] = data
        self._news.set()

    def reply(self, data: bytes) -> None:
        """Takes an answer to a request of this page; a page that reads none of many is closed."""
        self._replies.append(data)
        self._closing |= len(self._replies) > MOST_REPLIES
        self._news.set()

    async def send(self, send: Callable[[bytes], Awaitable[None]]) -> None:
        """Sends what there is until the page is gone: a JSON array of sections and answers each time."""
        while not self._closing:
            await self._news.wait()
            self._news.clear()
            parts = [*self._latest.values(), *self._replies]
            self._latest, self._replies = {}, []
            began = time.monotonic()
            await send(b"[" + b",".join(parts) + b"]")
            await asyncio.sleep(max(began + LEAST_GAP - time.monotonic(), 0.0))


class Control:
    """Who commands an arm: one page at a time, so that two operators do not work against each other.

    Whoever commands first has it, and passes it on between own pages. Another operator may take it, and a page that is
    closed gives it up. A stop and a cancel need no control.
    """

    def __init__(self) -> None:
        self._holder: Page | None = None
        self._since = 0.0

    def told(self, page: Page | None) -> dict[str, object]:
        """Returns who has control, as a page shows it."""
        holder = self._holder
        return {
            "name": None if holder is None else holder.person.name,
            "page": None if holder is None else holder.number,
            "since": self._since,
        }

    def refusal(self, page: Page) -> str | None:
        """Returns why a page may not command, or None; it then has control."""
        if self._holder is not None and self._holder.person.name != page.person.name:
            return f"{self._holder.person.name} has control: take it first"
        if self._holder is not page:  # of the same person, maybe a page that is just being closed
            self.take(page)
        return None

    def take(self, page: Page) -> None:
        """Gives control to a page."""
        self._holder, self._since = page, time.time()

    def release(self, page: Page) -> bool:
        """Takes control from a page; returns whether the page had it."""
        had = self._holder is page
        if had:
            self._holder = None
        return had


class Allowance:
    """How often something may be done: so many a second, and a few more at once.

    Args:
        rate: [1/s].
        most: at once.
        clock: [s].
    """

    def __init__(self, rate: float, most: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._most, self._clock = rate, most, clock
        self._left, self._at = most, clock()
        self.refused = 0

    def take(self) -> bool:
        """Returns whether it may be done now."""
        now = self._clock()
        self._left, self._at = min(self._left + (now - self._at) * self._rate, self._most), now
        if self._left < 1.0:
            self.refused += 1
            return False
        self._left, self.refused = self._left - 1.0, 0
        return True
